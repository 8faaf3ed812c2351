# SPDX-License-Identifier: Apache-2.0
"""The expected information of paths, given robots in flight, and the objective of a path."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import lgamma, prod
from typing import Any, NamedTuple

from kbnitp_ros.core.field.belief import Belief, binary_entropy, surprisal
from kbnitp_ros.core.field.check import Floats, Places, read_only, typed
from kbnitp_ros.core.field.observation import as_path, Exposures, Visits
from kbnitp_ros.core.field.sensor import (
    log_predicted_survival,
    of_each,
    RobotType,
    SensorModel,
    times_log,
)
from kbnitp_ros.core.inference.filter import condition, Evidence, known_effects
from kbnitp_ros.core.planning.information_kernels import (
    evaluate_paths,
    first_invalid,
    left_open,
    open_entropies,
    predict_visits,
    Readings,
)
from kbnitp_ros.core.planning.options import SearchOptions
import numpy as np
from numpy.typing import ArrayLike

# Powers of :eq:`entropy-powers`; the first exponent is 1, for the predicted survival of a path.
EXPONENTS = np.array([1.0, 2.026, 3.832, 9.407, 28.14, 101.5, 482.6, 4111.0])
WEIGHTS = np.array(
    [
        1.000314622,
        -0.547169326,
        -0.271418285,
        -0.119928225,
        -0.043547782,
        -0.013911176,
        -0.003654438,
        -0.000665898,
    ]
)

# Maximum error of the entropy by this sum of powers, nats.
ERROR = 1.95e-5


# Maximum number of different cameras in one plan, and of combinations of their reading counts in
# a cell. Further readings by a camera are not counted, which changes plans very little.
MAX_CAMERAS = 6
MAX_WAYS = 1024


# The true and false positive rates of a `SensorModel`, on which readings depend.
Camera = tuple[float, float]


def camera_rates(model: SensorModel) -> Camera:
    """Return the camera of a sensor model."""
    return model.true_positive, model.false_positive


# Maximum number of readings of a cell, by camera.
Most = tuple[tuple[Camera, int], ...]


def most_counted(cameras: int) -> int | None:
    """Return the maximum number of readings counted for a cell and camera; None for all."""
    return None if cameras < 2 else int(MAX_WAYS ** (1.0 / cameras)) - 1


def check_cameras(cameras: int) -> None:
    """Check that there are at most `MAX_CAMERAS` different cameras."""
    if cameras > MAX_CAMERAS:
        raise ValueError(
            f'the robots have {cameras} different cameras (pairs of true_positive and '
            f'false_positive): paths can be planned for at most {MAX_CAMERAS} at a time'
        )


@lru_cache(maxsize=8)
def possible_readings(model: SensorModel, visits: int, earlier: Most) -> Readings:
    """Return the possible readings in up to `visits` visits, after up to `earlier` readings."""
    own = camera_rates(model)
    most = dict(earlier)
    most[own] = most.get(own, 0) + visits
    tables = [positives(camera, count) for camera, count in most.items()]
    counts = np.indices([count + 1 for count in most.values()]).reshape(len(most), -1).T
    outcomes = (counts + 1).prod(axis=1)
    likelihood = np.zeros((len(counts), outcomes.max(), 2))
    for state, of_cameras in enumerate(counts):
        row = np.ones((1, 2))
        for table, count in zip(tables, of_cameras):
            # The count of the last camera varies fastest.
            row = (row[:, None] * table[count, : count + 1]).reshape(-1, 2)
        likelihood[state, : len(row)] = row
    places = np.arange(len(counts)).reshape([count + 1 for count in most.values()])
    start = places[tuple(slice(dict(earlier).get(camera, 0) + 1) for camera in most)]
    further = places.strides[list(most).index(own)] // places.itemsize
    return Readings(
        survival=np.exp(times_log(np.arange(visits + 1)[:, None], model.log_survival)),
        after=start.reshape(-1, 1) + further * np.arange(visits + 1),
        outcomes=outcomes,
        likelihood=likelihood,
        noise=surprisal(likelihood).sum(axis=1),
    )


@lru_cache(maxsize=64)
def positives(camera: Camera, most: int) -> Floats:
    """Return P(k of m readings positive | X = x), indexed [m, k, x] (:eq:`reading-counts`)."""
    m, k = np.ogrid[: most + 1, : most + 1]
    log_factorial = np.array([lgamma(count + 1.0) for count in range(most + 1)])
    orderings = log_factorial[m] - log_factorial[k] - log_factorial[np.maximum(m - k, 0)]
    read_not, read = SensorModel(0.0, 0.0, 0.0, *camera).log_reading
    log_likelihood = times_log(k[..., None], read)
    log_likelihood = log_likelihood + times_log(np.maximum(m - k, 0)[..., None], read_not)
    likelihood: Floats = np.exp(orderings[..., None] + log_likelihood) * (k <= m)[..., None]
    return read_only(likelihood)


# Maximum number of joint outcomes tracked; each robot doubles their number, and the least probable
# are merged.
MAX_OUTCOMES = 16

# Minimum probability of a joint outcome: below it, rounding errors dominate.
NEGLIGIBLE = 1e-15


@dataclass(frozen=True, eq=False)
class JointOutcomes:
    """The joint outcomes, returned or lost, of the robots sent before."""

    # The belief before the robots were sent, still valid in cells that they do not visit.
    belief: Belief
    # Probability of each outcome, shape (outcomes,).
    probability: Floats
    # The cells that the robots visit, ascending, shape (n,).
    cells: Places
    # P(Z = z, X = x) of these cells given the outcome, without the readings; shape (outcomes, n,
    # 2, 2).
    joint: Floats
    # Probability of each number of readings by each camera: axes outcomes, cells, and one for each
    # camera, from 0 readings up; 0 or 1 except in merged outcomes.
    readings: Floats
    # The cameras of the robots.
    cameras: tuple[Camera, ...] = ()

    @property
    def most_readings(self) -> Most:
        """Return the maximum number of readings of a cell by each camera."""
        return tuple(zip(self.cameras, (count - 1 for count in self.readings.shape[2:])))

    @property
    def states(self) -> int:
        """Return the number of combinations of the cameras' numbers of readings."""
        return prod(self.readings.shape[2:])

    def of_cells(self, cells: Places) -> tuple[Floats, Floats]:
        """Return the joints and the numbers of readings of any cells, given each outcome."""
        outcomes = self.probability.size
        joint = self.belief.joint[cells][None].repeat(outcomes, 0)
        readings = np.zeros((outcomes, cells.size, self.states))
        readings[:, :, 0] = 1.0
        if self.cells.size:
            there = np.searchsorted(self.cells, cells)
            here = np.flatnonzero(np.append(self.cells, -1)[there] == cells)
            there = there[here]
            joint[:, here] = self.joint[:, there]
            readings[:, here] = self.readings[:, there].reshape(outcomes, there.size, self.states)
        return joint, readings


def nobody_deployed(belief: Belief) -> JointOutcomes:
    """Return the single joint outcome of no robots."""
    no_cells, nothing_read = np.empty(0, dtype=np.intp), np.empty((1, 0))
    return JointOutcomes(belief, np.ones(1), no_cells, np.empty((1, 0, 2, 2)), nothing_read)


@lru_cache(maxsize=8)
def all_cells(cells: int) -> Floats:
    """Return the interest in readings of all cells alike."""
    return read_only(np.ones(cells))


def after_deployment(
    outcomes: JointOutcomes, model: SensorModel, path: ArrayLike
) -> JointOutcomes:
    """Return the joint outcomes after one more robot is sent (:eq:`joint-outcomes`)."""
    if model.reach:
        if not outcomes.cells.size:
            outcomes = nobody_deployed(outcomes.belief.with_reach(model.reach))
        model = replace(model, reach=0.0)
    visits = Visits.of(as_path(path))
    cells = np.union1d(outcomes.cells, visits.cells)
    at = np.searchsorted(cells, visits.cells)
    joint, readings = outcomes.of_cells(cells)
    camera, counts = camera_rates(model), outcomes.readings.shape[2:]
    cameras = outcomes.cameras
    if camera not in cameras:
        cameras, counts = (*cameras, camera), (*counts, 1)
    axis = 2 + cameras.index(camera)
    room = [(0, 0)] * (2 + len(cameras))
    room[axis] = (0, visits.counts.max())
    readings = np.pad(readings.reshape(*readings.shape[:2], *counts), room)

    hazard = joint[:, at, 1].sum(axis=-1).clip(max=1.0)
    log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival).sum(axis=1)

    # Split each outcome into loss and return; drop nearly impossible outcomes.
    chance = np.stack([-np.expm1(log_survival), np.exp(log_survival)], axis=1)
    probability = (outcomes.probability[:, None] * chance).ravel()
    order = np.argsort(-probability, kind='stable')
    kept = order[probability[order] > NEGLIGIBLE]
    origin, is_return = kept // 2, kept % 2 == 1
    probability, joint, readings = probability[kept], joint[origin], readings[origin]

    # An outcome of the robots before is a hypothesis of the filter.
    none = np.zeros_like(visits.counts)
    for some, is_lost in ((is_return, False), (~is_return, True)):
        if some.any():
            of_cells = np.moveaxis(joint[np.ix_(some, at)], 0, -1)
            evidence = Evidence(visits, none, none, is_lost)
            after, _ = condition(of_cells, evidence, known_effects(model))
            joint[np.ix_(some, at)] = np.moveaxis(after, -1, 0)
    for count in np.unique(visits.counts):
        more = np.ix_(is_return, at[visits.counts == count])
        readings[more] = np.roll(readings[more], count, axis=axis)
    readings = _counted(readings, most_counted(len(cameras)))
    return _merged(JointOutcomes(outcomes.belief, probability, cells, joint, readings, cameras))


def _counted(readings: Floats, most: int | None) -> Floats:
    """Sum the probabilities of `most` or more readings by a camera into one count."""
    for axis in range(2, readings.ndim):
        if most is not None and readings.shape[axis] > most + 1:
            counted, beyond = np.split(readings, [most], axis)
            last = beyond.sum(axis=axis, keepdims=True)
            readings = np.concatenate([counted, last], axis)
    return readings


def _merged(outcomes: JointOutcomes) -> JointOutcomes:
    """Merge the least probable outcomes into at most `MAX_OUTCOMES` (:eq:`merged-outcomes`)."""
    if outcomes.probability.size <= MAX_OUTCOMES:
        return outcomes
    alone = MAX_OUTCOMES - 1
    weights = outcomes.probability[alone:]
    joint, readings = (
        np.concatenate([each[:alone], np.average(each[alone:], axis=0, weights=weights)[None]])
        for each in (outcomes.joint, outcomes.readings)
    )
    probability = np.append(outcomes.probability[:alone], weights.sum())
    return replace(outcomes, probability=probability, joint=joint, readings=readings)


@dataclass(frozen=True, eq=False)
class Objective:
    """The expected information of a path minus the cost of expected losses."""

    # The belief before the round.
    belief: Belief
    # The believed sensor model of the robot.
    model: SensorModel
    # Joint outcomes of earlier robots: in flight, or planned earlier in the round.
    outcomes: JointOutcomes
    # Weight of the information of readings in each cell, in [0, 1], shape (cells,).
    interest: Floats
    # The cost of a loss of the robot, nats, at least 0.
    loss_cost: float
    # Results by path, since the path of a plan was evaluated in its search.
    _evaluated: dict[bytes, tuple[float, Floats]] = field(default_factory=dict, init=False)

    @classmethod
    def of(
        cls,
        belief: Belief,
        model: SensorModel,
        options: SearchOptions | None = None,
        outcomes: JointOutcomes | None = None,
    ) -> Objective:
        """Return the objective of a robot; by default information, and no robot sent before."""
        loss_cost = options.loss_cost if options else 0.0
        # Evidence and strikes come from live hazards only.
        belief = belief.live(model.duds)
        outcomes = outcomes or nobody_deployed(belief)
        return cls(belief, model, outcomes, all_cells(belief.cells), loss_cost)

    def alone(self) -> Objective:
        """Return the objective of all information, without other robots."""
        if not self.outcomes.cells.size and self.interest is all_cells(self.belief.cells):
            return self
        return Objective.of(self.belief, self.model)

    def effective(self) -> Objective:
        """Return the objective without reach, on the hazards that act in each cell."""
        belief = self.belief.with_reach(self.model.reach)
        outcomes = self.outcomes if self.outcomes.cells.size else nobody_deployed(belief)
        return Objective(
            belief, replace(self.model, reach=0.0), outcomes, self.interest, self.loss_cost
        )

    def _in_reach(self, path: Places) -> tuple[float, float]:
        """Return a path's information and survival where hazards reach (:eq:`reach-left-open`)."""
        model, found = self.model, Exposures.of(path, self.belief.neighbors_in_reach())
        inside, beside = found.inside.sum(axis=0), found.beside.sum(axis=0)
        log_spared, log_beside = (
            np.log1p(-strike) if strike < 1.0 else -np.inf for strike in model.strikes
        )
        joint, steps = self.belief.joint[found.cells], path.size - 1
        kept = np.exp(times_log(inside, log_spared) + times_log(beside, log_beside))
        endured = (1.0 - model.malfunction) ** steps
        hazard = joint[:, 1].sum(axis=1)
        survival = float(endured * (1.0 - hazard * (1.0 - kept)).prod())
        # P(so many steps into hazards, and so many beside them).
        exposed = np.zeros((steps + 1, int(beside.sum()) + 1))
        exposed[0, 0] = 1.0
        most_in = most_by = 0
        for chance, entered, near in zip(hazard.tolist(), inside.tolist(), beside.tolist()):
            if chance == 0.0:
                continue
            block = exposed[: most_in + 1, : most_by + 1] * chance
            exposed[: most_in + 1, : most_by + 1] -= block
            most_in, most_by = most_in + entered, most_by + near
            exposed[slice(entered, most_in + 1), slice(near, most_by + 1)] += block
        a, b = np.ogrid[: most_in + 1, : most_by + 1]
        survives = endured * np.exp(times_log(a, log_spared) + times_log(b, log_beside))
        left = (exposed[: most_in + 1, : most_by + 1] * binary_entropy(survives)).sum()
        brought, table = 0.0, positives(camera_rates(model), int(inside.max()))
        target = joint[:, 0] + kept[:, None] * joint[:, 1]
        total = target.sum(axis=1)
        for count in np.unique(inside[inside > 0]).tolist():
            cells = (inside == count) & (total > 0.0)
            likelihood, share = table[count], target[cells] / total[cells, None]
            of_readings = surprisal(share @ likelihood.T).sum(axis=1)
            of_readings -= share @ surprisal(likelihood).sum(axis=0)
            brought += self.interest[found.cells[cells]] @ of_readings
        return float(binary_entropy(survival) - left + survival * brought), survival

    def after(self, path: ArrayLike) -> JointOutcomes:
        """Return the joint outcomes after this robot is sent along `path`."""
        return after_deployment(self.outcomes, self.model, path)

    def survival(self, path: ArrayLike) -> float:
        """Return the chance of a return under the belief (:eq:`path-survival`)."""
        if self.model.reach:
            return self._in_reach(as_path(path))[1]
        visits = Visits.of(as_path(path))
        hazard = self.belief.hazard[visits.cells]
        log_survival = log_predicted_survival(hazard, visits.counts, self.model.log_survival)
        return float(np.exp(log_survival.sum()))

    def of_visits(self, cells: Places, most: int) -> tuple[Floats, Floats]:
        """Return log survival and readings' information by outcome, cell and number of visits."""
        joint, earlier = self.outcomes.of_cells(cells)
        log_survival, information = np.empty((2, *joint.shape[:2], most + 1))
        predict_visits(
            possible_readings(self.model, most, self.outcomes.most_readings),
            joint.reshape(-1, 2, 2),
            earlier.reshape(-1, earlier.shape[-1]),
            tuple(self.model.log_survival.tolist()),
            log_survival.reshape(-1, most + 1),
            information.reshape(-1, most + 1),
        )
        return log_survival, information

    def of_paths(self, cells: Places, start: Places) -> tuple[Floats, Floats]:
        """Return information and survival of paths that stand one after another in `cells`."""
        if self.model.reach:
            found = [self._in_reach(path) for path in np.split(cells, start[1:-1])]
            values: Floats = np.array(found)
            return values[:, 0], values[:, 1]
        information, model = np.empty(start.size - 1), self.model
        survival = evaluate_paths(
            cells,
            start,
            self.belief.joint,
            self.belief.hazard,
            self.interest,
            model.step_survival,
            tuple(model.log_survival.tolist()),
            camera_rates(model),
            information,
        )
        return information, survival

    def evaluate(self, path: ArrayLike) -> tuple[float, Floats]:
        """
        Return a path's information, nats, and the chance of a return given each joint outcome.

        Equation :eq:`added-information`.
        """
        belief, model = self.belief, self.model
        cells = as_path(path)
        listed = cells.tolist()
        if min(listed) < 0 or max(listed) >= belief.cells:
            raise ValueError(
                f'path has cells from {min(listed)} to {max(listed)}: '
                f'the belief has the cells 0 to {belief.cells - 1}'
            )
        if not self.outcomes.cells.size:
            key = cells.tobytes()
            if key not in self._evaluated:
                information, survival = self.of_paths(cells, np.array([0, cells.size]))
                self._evaluated[key] = float(information[0]), survival
            return self._evaluated[key]
        if model.reach:
            return self.effective().evaluate(path)
        visits = Visits.of(cells)
        log_survival, read = (
            each[:, np.arange(visits.cells.size), visits.counts]
            for each in self.of_visits(visits.cells, int(visits.counts.max()))
        )
        survival = np.exp(np.ascontiguousarray(log_survival).sum(axis=1))
        log_safe, log_deadly = model.log_survival.tolist()
        entropies = open_entropies(cells.size - 1, log_safe, log_deadly)
        brought = (read * self.interest[visits.cells]).sum(axis=1)
        of_each = binary_entropy(survival) + survival * brought
        of_each -= left_open(visits.of_step, belief.hazard[visits.cells], entropies)
        return float((self.outcomes.probability * of_each).sum()), survival


@typed
def path_information(
    belief: Belief,
    model: SensorModel,
    paths: ArrayLike | Sequence[ArrayLike],
) -> Any:
    """
    Return the mutual information between the field and the outcome of one deployment.

    Equation :eq:`information`.

    The objective I(X; Y | Theta) + I(Z; Theta) of arXiv:2305.06929, eq. 1, equals
    I(Z, X; Theta, Y), since given X the readings are independent of Z. It is computed exactly as

        h(P0) - E_z[h(P(survive | z))] + P0 * sum_i I(X_i; Y_i^(n_i) | survived n_i visits)

    Parameters
    ----------
    belief : Belief
        Belief before the deployment.
    model : SensorModel
        Believed sensor model of the robot.
    paths : array_like of int, shape (steps + 1,), or a sequence of such paths
        The cells in order, the base first and last. Paths of equal length may be an array, (paths,
        steps + 1).

    Returns
    -------
    float, or ndarray of shape (paths,)
        Nats; a number for one path, an array for several. At least 0 except for rounding.

    Raises
    ------
    ValueError
        If a path has no step, is not closed or leaves the belief's cells; if the belief knows its
        grid, also if a path jumps or enters a blocked cell.

    """
    is_one, cells, start = joined_paths(paths)
    check_paths(belief, cells, start, 'path' if is_one else 'path[{}]')
    information, _ = Objective.of(belief, model).of_paths(cells, start)
    return float(information[0]) if is_one else information


def joined_paths(paths: Any) -> tuple[bool, Places, Places]:
    """Return if it is one path, and the cells of one or several paths with the start of each."""
    if isinstance(paths, np.ndarray):
        paths = np.asarray(paths)
    elif isinstance(paths, Iterable) and not isinstance(paths, Sequence):
        paths = [*paths]
    is_array = isinstance(paths, np.ndarray)
    are_several = isinstance(paths, Sequence) and len(paths) > 0 and np.ndim(paths[0]) == 1
    if not (are_several or (is_array and paths.ndim == 2)):
        cells = as_path(paths)
        return True, cells, np.array([0, cells.size])
    try:
        cells = paths.ravel() if is_array else np.concatenate(paths)
        sizes = np.array([*map(len, paths)], dtype=np.intp)
        is_valid = cells.ndim == 1 and cells.dtype.kind in 'iu' and sizes.min(initial=2) > 1
    except (TypeError, ValueError):
        is_valid = False
    if not is_valid:
        cells = np.concatenate([as_path(each, f'path[{k}]') for k, each in enumerate(paths)])
    return False, cells.astype(np.intp), np.append(0, sizes.cumsum())


def check_paths(belief: Belief, cells: Places, start: Places, name: str) -> None:
    """Check that paths are closed, and those of the belief's field; `name` takes a number."""
    grid = belief.grid
    neighbors = np.empty((0, 9), dtype=np.intp) if grid is None else grid.neighbor_table
    number = first_invalid(cells, start, belief.cells, neighbors)
    if number < 0:
        return
    path, name = np.split(cells, start[1:-1])[number], name.format(number)
    outside = path[(path < 0) | (path >= belief.cells)]
    if outside.size:
        raise ValueError(
            f'{name} has the cell {outside[0]}: the belief has the cells 0 to {belief.cells - 1}'
        )
    if path[0] != path[-1]:
        raise ValueError(
            f'{name} starts at cell {path[0]} and ends at {path[-1]}: it must return to its base'
        )
    if grid is not None:
        try:
            grid.check_cells(path)
            grid.check_steps(path)
        except ValueError as error:
            raise ValueError(f'{name}{str(error).removeprefix("path")}') from error


@typed
def team_information(
    belief: Belief,
    model: SensorModel,
    paths: Sequence[ArrayLike],
    outcomes: JointOutcomes | None = None,
    robot_types: Sequence[RobotType] = (),
) -> float:
    """
    Return the mutual information between the field and the outcomes of several deployments.

    Equation :eq:`team-information`.

    By the chain rule it is the sum of the information that each path adds to the earlier paths,
    approximated by :eq:`added-information`. For a single path it equals `path_information`.

    Parameters
    ----------
    belief, model
        As in `path_information`; the model is that of the common robot type.
    paths : sequence of array_like of int, each of shape (steps + 1,)
        The cells of each robot's path in order.
    outcomes : JointOutcomes, optional
        Joint outcomes of robots sent before, whose information is excluded; by default none.
    robot_types : sequence of RobotType
        Type of each robot; empty if all are alike.

    Returns
    -------
    float
        Nats.

    Raises
    ------
    ValueError
        If a path is invalid, as in `path_information`, or the numbers of types and paths differ.

    """
    _, cells, start = joined_paths(paths)
    check_paths(belief, cells, start, 'path[{}]')
    information, paths = 0.0, np.split(cells, start[1:-1])
    for path, robot_type in zip(paths, of_each(len(paths), robot_types)):
        objective = Objective.of(belief, robot_type.model(model), outcomes=outcomes)
        information += objective.evaluate(path)[0]
        outcomes = objective.after(path)
    return information


# Decimals of compared values, nats: closer values are ties, so rounding errors never decide.
DECIMALS = 9


class Candidate(NamedTuple):
    """A closed path and its objective value."""

    # The objective value, nats, rounded.
    value: float
    # Cells, the base first and last, shape (steps + 1,).
    path: Places

    @classmethod
    def along(cls, path: ArrayLike, objective: Objective) -> Candidate:
        """Return a path, shape (steps + 1,), with its exact value (:eq:`objective-value`)."""
        information, _ = objective.evaluate(path)
        if objective.loss_cost:
            information -= objective.loss_cost * (1.0 - objective.survival(path))
        return cls(round(information, DECIMALS), as_path(path))
