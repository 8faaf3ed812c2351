# SPDX-License-Identifier: Apache-2.0
"""
Goals: lanes and areas to be certified free of hazards, and flights that serve a goal.

A goal computes the probability that it is reached, and the flight that serves it best. A new goal
needs one file and one line here, or an entry point of another package. With the goal 'map' robots
are sent for information.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Protocol, runtime_checkable

from kbnitp_ros.core.decision.decision import (
    cheapest_lanes,
    check_confidence,
    check_way,
    DECIMALS,
    Decision,
    different,
    lanes_within,
    LEAST,
    safest_path,
    STEP_COST,
    there_and_back,
)
from kbnitp_ros.core.decision.hazard_draws import (
    cells_on,
    HazardDraws,
    Hazards,
    Path,
)
from kbnitp_ros.core.field.belief import Belief, binary_entropy
from kbnitp_ros.core.field.check import Floats, whole_number, whole_numbers
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.planning.objective import camera_rates, Objective, positives
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import PathFinder
from kbnitp_ros.core.planning.plans import Plan
from kbnitp_ros.plugins import Registry, takes
import numpy as np
from numpy.typing import ArrayLike

# Maximum number of joint outcomes tracked: those of the last six robots in flight.
MAX_OUTCOMES = 64

# Number of the most uncertain cells that get a direct flight as a candidate.
DIRECT = 16
# Maximum number of candidate paths taken from each search for information.
SEARCHED = 24


@dataclass(frozen=True, eq=False)
class FlightState:
    """The state of a mission when a robot's flight is planned."""

    # The field, with the base of the robot.
    grid: Grid
    # The base of the mission, where lanes start.
    start: int
    # The draws of the hazards.
    draws: HazardDraws
    # The belief about targets: P(X | Z) of each cell.
    belief: Belief
    # The believed sensor model of the robot.
    model: SensorModel
    # The limits of the robot's path, and its minimum survival.
    options: SearchOptions
    # Joint probability of each draw and each outcome of the robots in flight, shape (outcomes,
    # draws).
    outcomes: Floats

    def with_sent(self, path: ArrayLike, model: SensorModel) -> FlightState:
        """Return the state after another robot, with this sensor model, has left on a path."""
        survived = self.draws.survivals([path], model)[0]
        outcomes = np.concatenate([self.outcomes * survived, self.outcomes * (1.0 - survived)])
        if len(outcomes) > MAX_OUTCOMES:
            # Sum over the outcomes of the robot sent first, which alternate from row to row.
            outcomes = outcomes[0::2] + outcomes[1::2]
        return replace(self, outcomes=outcomes)

    def best(self, survival: Floats, value: Floats) -> int | None:
        """Return the allowed path of the highest value; `survival` has shape (paths, draws)."""
        allowed = survival @ self.draws.weight >= self.options.minimum_survival
        valued = np.where(allowed, np.round(value, DECIMALS), -np.inf)
        return int(np.argmax(valued)) if allowed.any() else None

    def planned(self, path: Path, gain: float) -> Plan:
        """Return the plan of a path with a gain for the goal."""
        return replace(Plan.along(path, self.belief, self.model), gain=max(0.0, float(gain)))

    def searched(self, belief: Belief) -> list[Path]:
        """Return closed paths sought for information on a belief."""
        objective = Objective.of(belief, self.model, self.options)
        found = PathFinder(self.grid, self.options).candidates(objective)
        return [each.path for each in found[:SEARCHED]]

    def within_visits(self, paths: Iterable[Path]) -> list[Path]:
        """Return the different paths that visit no cell too often."""
        most = self.options.max_visits
        return [path for path in different(paths) if np.bincount(path[1:]).max() <= most]


def hazards_alone(grid: Grid, hazard: Floats) -> Belief:
    """Return the belief with these hazards and without targets."""
    none = np.zeros(hazard.size)
    return Belief.from_maps(hazard, none, none).on(grid)


def share(part: Floats, whole: Floats) -> Floats:
    """Return a conditional probability; 0 under an impossible condition."""
    given: Floats = part / np.where(whole > 0.0, whole, 1.0)
    return given.clip(0.0, 1.0)


def flights_over(situation: FlightState, over: Sequence[int]) -> list[Path]:
    """Return closed paths for information on the field, and direct flights to cells of `over`."""
    grid, options = situation.grid, situation.options
    hazard = situation.draws.p_hazard()
    paths = situation.searched(hazards_alone(grid, hazard))
    paths += situation.searched(situation.belief)
    with np.errstate(divide='ignore'):
        cost = -np.log1p(-hazard).clip(min=LEAST) + STEP_COST
    cells = np.array(over)
    cells = cells[grid.in_reach(options.max_steps)[cells]]
    open_first = cells[np.argsort(-binary_entropy(hazard[cells]), kind='stable')]
    ends = open_first[open_first != grid.base][:DIRECT]
    costs = np.tile(cost, (ends.size, 1))
    [lanes] = cheapest_lanes(grid, costs, grid.base, ends, [options.max_steps // 2])
    return paths + situation.within_visits(there_and_back(lane, lane) for lane in lanes)


def information(survival: Floats, outcomes: Floats) -> Floats:
    """Return each flight's information about all hazards, nats (:eq:`outcome-information`)."""
    known = outcomes.sum(axis=1)
    expected = survival @ share(outcomes, known[:, None]).T
    entropy: Floats = binary_entropy(expected.clip(0.0, 1.0)) @ known
    left: Floats = binary_entropy(survival) @ outcomes.sum(axis=0)
    return np.maximum(entropy - left, 0.0)


@dataclass(frozen=True)
class Area:
    """
    An area: cells to be certified free of hazards.

    A robot takes the path whose outcome and target readings are expected to decrease the entropy
    of hazards most, summed over the cells of the area.

    Parameters
    ----------
    cells : iterable of int
        Cells of the area, at least one.
    confidence : float, optional
        The mission ends once all cells are free with this probability, in (0, 1).

    Raises
    ------
    ValueError
        If the confidence is out of range or there are no cells.

    """

    name: ClassVar[str] = 'area'

    cells: Iterable[int]
    confidence: float | None = None

    def __post_init__(self) -> None:
        cells = tuple(sorted({*whole_numbers('cells', self.cells, 'goal', 0)}))
        if not cells:
            raise ValueError('goal is an area without cells: give at least one')
        object.__setattr__(self, 'cells', cells)
        check_confidence(self.confidence)

    def check(self, grid: Grid, max_steps: int) -> None:
        """Check that each cell is within reach of at least one base."""
        cells = cells_on(grid, list(self.cells), 'goal')
        in_reach = [grid.at(base).in_reach(max_steps) for base in sorted(grid.bases)]
        out = cells[~np.any(in_reach, axis=0)[cells]]
        if out.size:
            raise ValueError(
                f'goal has cells from which no robot can return within max_steps = {max_steps}, '
                f'such as {out[0]}: raise max_steps or choose a smaller area'
            )

    def decide(self, grid: Grid, draws: Hazards, model: SensorModel, max_steps: int) -> Decision:
        """Return the decision on whether all cells are free."""
        return Decision.about(self.name, draws, list(self.cells), self.confidence)

    def flight(self, situation: FlightState) -> Plan | None:
        """Return the next flight; None if no flight is allowed."""
        cells, outcomes = list(self.cells), situation.outcomes
        paths = flights_over(situation, cells)
        survival = situation.draws.survivals(paths, situation.model)
        here = situation.draws.hazardous[:, cells].astype(np.float64)
        gain = information_on(here, survival, outcomes)
        gain += readings_on(situation, paths, survival, cells, here)
        best = situation.best(survival, gain)
        return None if best is None else situation.planned(paths[best], gain[best])


def information_on(events: Floats, survival: Floats, outcomes: Floats) -> Floats:
    """
    Return flights' information about each event, summed, (flights,) nats.

    `events` has shape (draws, events) (:eq:`area-value`, :eq:`lane-information`).
    """

    def left(chance: Floats, happened: Floats) -> Floats:
        entropies: Floats = binary_entropy(share(happened, chance[:, None])).sum(axis=1)
        return chance * entropies

    gain = np.zeros(len(survival))
    for outcome in outcomes:
        happened = outcome @ events
        back = survival * outcome
        chance, returned = back.sum(axis=1), back @ events
        gain += left(outcome.sum(keepdims=True), happened[None]) - left(chance, returned)
        gain -= left(outcome.sum() - chance, happened - returned)
    return gain


def readings_on(
    situation: FlightState,
    paths: Sequence[Path],
    survival: Floats,
    cells: Sequence[int],
    events: Floats,
) -> Floats:
    """
    Return the readings' information about events, summed, (flights,) nats.

    The readings of each cell tell of its event, and `events` has shape (draws, cells); or all tell
    of one event, (draws, 1) (:eq:`area-readings`).
    """
    returned = survival * situation.outcomes.sum(axis=0)
    chance: Floats = returned.sum(axis=1)
    here = situation.draws.hazardous[:, cells]
    event, hazard, both = (
        share(returned @ each, chance[:, None]) for each in (events, here, here * events)
    )
    entropy, p = binary_entropy(event), event[..., None]
    # P(Z = 1) given the event, and given that it did not happen.
    given, otherwise = share(both, event)[..., None], share(hazard - both, 1.0 - event)[..., None]
    counts = [np.bincount(path[1:], minlength=situation.grid.cells) for path in paths]
    visits, joint = np.array(counts)[:, cells], situation.belief.joint[cells]
    target = share(joint, joint.sum(axis=2, keepdims=True))
    likelihood = positives(camera_rates(situation.model), int(visits.max(initial=0)))
    information = np.zeros(visits.shape)
    for count in np.unique(visits[visits > 0]).tolist():
        safe, hazardous = np.moveaxis(target @ likelihood[count, : count + 1].T, 1, 0)
        joint_with = p * (given * hazardous + (1.0 - given) * safe)
        reading = joint_with + (1.0 - p) * (otherwise * hazardous + (1.0 - otherwise) * safe)
        left = (reading * binary_entropy(share(joint_with, reading))).sum(axis=-1)
        information += (visits == count) * (entropy - left)
    # Information about one event is added as if independent, and limited to its entropy.
    limited: Floats = np.minimum(information.sum(axis=1), entropy.sum(axis=1))
    return chance * limited


# Maximum number of lanes that flights combine: at the highest step limit, at each lower limit.
OUT, BACK = 12, 4
# Minimum P(the best lane is free) for flights that seek information on that lane alone.
PROBABLE = 0.45
# Weight of a nat of information on all hazards, added to the rise of P(the best lane is free): it
# decides between flights that cannot change which lane is best.
WORTH = 0.02


@dataclass(frozen=True)
class Lane:
    """
    A lane from the base of the mission to a cell.

    A robot flies to the goal on one lane and back on the same or another one; from another base it
    flies to cells of lanes. The flight is chosen for the highest expected probability that the
    best lane is free or, if this lane is probably free, for information on it.

    Parameters
    ----------
    to : int
        Cell that the lane leads to.
    confidence : float, optional
        The mission ends once the safest lane is free with this probability, in (0, 1).

    Raises
    ------
    ValueError
        If the confidence is out of range or the cell is no whole number from 0.

    """

    name: ClassVar[str] = 'lane'

    to: int
    confidence: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'to', whole_number('goal', self.to, 0))
        check_confidence(self.confidence)

    def check(self, grid: Grid, max_steps: int) -> None:
        """Check that a lane of at most `max_steps` steps can reach the cell."""
        if self.to == grid.base:
            raise ValueError(f'goal is cell {self.to}, the base: choose another cell')
        check_way(grid, grid.base, self.to, max_steps)

    def decide(self, grid: Grid, draws: Hazards, model: SensorModel, max_steps: int) -> Decision:
        """Return the decision on the safest lane found, of at most `max_steps` steps one way."""
        return safest_path(grid, draws, model, grid.base, self.to, max_steps, self.confidence)

    def flight(self, situation: FlightState) -> Plan | None:
        """Return the next flight; None if no flight is allowed."""
        lanes, paths = self._flights(situation)
        if not paths:
            return None
        draws, outcomes = situation.draws, situation.outcomes
        free = draws.are_free(lanes)
        p_free = free @ outcomes.sum(axis=0)
        best_lane = int(np.argmax(np.round(p_free, DECIMALS)))
        if p_free[best_lane] >= PROBABLE:
            cells = np.unique(lanes[best_lane]).tolist()
            hazard = np.zeros(draws.cells)
            hazard[cells] = draws.p_hazard()[cells]
            paths += situation.searched(hazards_alone(situation.grid, hazard))
            survival = draws.survivals(paths, situation.model)
            is_free = free[best_lane, :, None]
            value = information_on(is_free, survival, outcomes)
            value += readings_on(situation, paths, survival, cells, is_free)
        else:
            survival = draws.survivals(paths, situation.model)
            value = expected_best(free, survival, outcomes)
            value += WORTH * information(survival, outcomes)
        best = situation.best(survival, value)
        if best is None:
            return None
        [rise] = expected_best(free, survival[[best]], outcomes)
        return situation.planned(paths[best], rise)

    def _flights(self, situation: FlightState) -> tuple[list[Path], list[Path]]:
        """Return lanes to the goal, and the closed paths that a robot may fly."""
        grid, draws, start = situation.grid, situation.draws, situation.start
        most = situation.options.max_steps
        least = int(grid.steps_from(start, grid.free)[self.to])
        if least >= grid.cells:
            return [], []
        half, longest = most // 2, max(least, most)
        is_near = start == grid.base and least <= half
        limits = [longest, most - least, half, least] if is_near else [longest]
        lanes, *shorter = lanes_within(grid, draws, start, self.to, limits)
        if start != grid.base:
            return lanes, flights_over(situation, np.unique(np.concatenate(lanes)).tolist())
        if not is_near:
            starts = [lane[: half + 1] for lane in lanes]
            return lanes, situation.within_visits(map(there_and_back, starts, starts))
        far, near, nearest = map(partial(best_lanes, draws), shorter, (OUT, BACK, BACK))
        # Exchanging out and back changes no outcome, so the longest lanes are only flown out.
        return lanes, situation.within_visits(
            there_and_back(out, back)
            for out in far + near
            for back in near + nearest
            if len(out) + len(back) - 2 <= most
        )


def best_lanes(draws: HazardDraws, lanes: Sequence[Path], count: int) -> list[Path]:
    """Return the `count` lanes with the highest probability of being free."""
    p_free = draws.are_free(lanes) @ draws.weight
    best = np.argsort(-np.round(p_free, DECIMALS), kind='stable')[:count]
    return [lanes[lane] for lane in best.tolist()]


def expected_best(free: Floats, survival: Floats, outcomes: Floats) -> Floats:
    """Return the expected rise of P(the best lane is free), (flights,) (:eq:`lane-value`)."""
    gain = np.zeros(len(survival))
    for outcome in outcomes:
        known = free * outcome
        before = known.sum(axis=1)
        returned = known @ survival.T
        gain += returned.max(axis=0) + (before[:, None] - returned).max(axis=0) - before.max()
    return gain


@runtime_checkable
class Goal(Protocol):
    """
    The goal of a mission.

    Attributes
    ----------
    name : str
        Name of the kind of goal.
    confidence : float or None
        Probability at which the mission ends; None to continue after any decision.

    """

    @property
    def name(self) -> str: ...

    @property
    def confidence(self) -> float | None: ...

    def check(self, grid: Grid, max_steps: int) -> None:
        """Check that a field allows the goal; raises ValueError."""

    def decide(self, grid: Grid, draws: Hazards, model: SensorModel, max_steps: int) -> Decision:
        """Return the decision on the goal, by draws of the hazards or by a mixture."""

    def flight(self, situation: FlightState) -> Plan | None:
        """Return the flight of the next robot; None if no flight is allowed."""


# Function of cells and a confidence that returns a goal, or None to map the field.
MakeGoal = Callable[[Sequence[int], 'float | None'], 'Goal | None']


def lane_to(cells: Sequence[int], confidence: float | None) -> Lane:
    """Return the goal of a lane to a cell."""
    if len(cells) != 1:
        raise ValueError(f'goal lane has {len(cells)} cells: give the one cell that it leads to')
    return Lane(cells[0], confidence)


def whole_map(cells: Sequence[int], confidence: float | None) -> None:
    """Return no goal: robots are sent where they learn the most."""
    for name, given in (('cells', list(cells)), ('confidence', confidence)):
        if given:
            raise ValueError(
                f'goal map takes no {name}, and {given} is given: choose the goal lane or area, '
                'or leave it out'
            )


GOALS: Registry[MakeGoal] = Registry(
    'goal',
    partial(takes, arguments=('cells', 'confidence')),
    {'map': whole_map, 'lane': lane_to, 'area': Area},
)
