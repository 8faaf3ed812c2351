# SPDX-License-Identifier: Apache-2.0
"""Joint probabilities of the hazards, as draws or as a mixture, and the targets found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, TypeAlias

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import (
    as_array,
    as_floats,
    Floats,
    in_short,
    number,
    on_field,
    probabilities,
    probability,
    read_only,
    typed,
    whole_number,
)
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import (
    as_observations,
    as_path,
    Exposures,
    Observation,
)
from kbnitp_ros.core.field.sensor import RobotType, SensorModel, times_log
from kbnitp_ros.core.inference.estimator import Estimator
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Number of draws for a decision: an event of probability 0.5 % occurs in about ten draws.
DRAWS = 2048

# Expected standard error of a mixture's probability p that a lane is free: A (1 - p)^B / sqrt(n)
# with n particles, fitted to nine banks of 192 particles on the same evidence.
ERROR_SCALE, ERROR_POWER = 0.7, 0.7

# Maximum number of products for the distribution of the number of hazards in a set of cells.
MAX_PRODUCTS = 1 << 27

# Maximum number of bytes of the draws.
MAX_MEMORY = 1 << 30

# Part of the key of random generators, with the estimator's seed and the number of deployments.
OWN_KEY = 0x44524157

Bools = NDArray[np.bool_]
Path = NDArray[np.intp]


class JointHazards:
    """A joint distribution of all hazards: a weighted mixture of hypotheses or of draws."""

    # Weights, shape (members,), and P(hazard) of each cell in each member, (members, cells).
    weight: Any
    hazard: Any
    # `Grid.around` of hazards that reach; None if they cannot.
    around: Any

    @property
    def cells(self) -> int:
        """Return the number of cells of the field."""
        return int(self.hazard.shape[1])

    def p_hazard(self) -> Floats:
        """Return the probability of a hazard in each cell, shape (cells,)."""
        p: Floats = np.clip(self.weight @ self.hazard, 0.0, 1.0)
        return p

    def p_free(self, cells: ArrayLike) -> float:
        """Return the probability that no cell of `cells` has a hazard (:eq:`set-free`)."""
        there = np.unique(on_field('cells', cells, self.cells))
        return float(np.clip(self.weight @ self.are_free([there])[0], 0.0, 1.0))

    @typed
    def survival(self, path: ArrayLike, model: SensorModel) -> float:
        """Return the probability that a traveller survives a path (:eq:`traveller-survives`)."""
        return float(np.clip(self.weight @ self.survivals([as_path(path)], model)[0], 0.0, 1.0))

    def are_free(self, paths: Sequence[ArrayLike]) -> Floats:
        """Return P(no hazard on a path) in each member, shape (paths, members)."""
        raise NotImplementedError

    def survivals(self, paths: Sequence[ArrayLike], model: SensorModel) -> Floats:
        """Return P(survive a path) in each member, shape (paths, members)."""
        raise NotImplementedError

    def hazard_count(self, cells: ArrayLike) -> Floats:
        """Return P(n of `cells` have a hazard) for n = 0, 1, ... (:eq:`hazards-remaining`)."""
        raise NotImplementedError

    def error(self, cells: ArrayLike) -> float:
        """Return the standard error of `p_free` (:eq:`certificate-error`)."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class HazardDraws(JointHazards):
    """
    Weighted joint draws of all hazards.

    Joint probabilities of cells are shares of the draws, so the dependence between the cells of a
    lost path is kept.

    Parameters
    ----------
    hazardous : ndarray of bool, shape (draws, cells)
        Hazards in each draw, at least one draw.
    independent : float
        Effective number of independent draws, positive; infinity if `hazardous` lists all states.
    weight : ndarray, shape (draws,), optional
        Weight of each draw, at least 0, with sum 1; equal by default.
    around : ndarray of int, shape (cells, 8), optional
        `Grid.around`, if hazards may reach.
    live : ndarray of bool, shape (draws, cells), optional
        Those of the hazards that can strike; all by default.

    """

    hazardous: Bools
    independent: float
    weight: Floats = field(default_factory=lambda: np.empty(0))
    around: Path | None = None
    live: Bools | None = None

    def __post_init__(self) -> None:
        hazardous, weight = self.hazardous, as_floats('weight', self.weight)
        if getattr(hazardous, 'dtype', None) != np.bool_ or hazardous.ndim != 2:
            words = f'hazardous is {in_short(hazardous)}: it must be bools, (draws, cells)'
            raise TypeError(words)
        draws = len(hazardous)
        weight = weight if weight.size else np.full(draws, 1.0 / draws)
        if weight.shape != (draws,):
            raise ValueError(f'weight has shape {weight.shape}: it must be ({draws},)')
        independent = number('independent', self.independent, 'positive', lambda n: n > 0.0)
        vars(self).update(
            hazardous=read_only(hazardous), independent=independent, weight=read_only(weight)
        )

    @classmethod
    @typed
    def of(cls, estimator: Estimator, deployments: int, count: int = DRAWS) -> HazardDraws:
        """Draw from an estimator; the same evidence gives the same draws."""
        count = whole_number('count', count, 1)
        deployments = whole_number('deployments', deployments, 0)
        if (estimate := count * estimator.belief.cells) > MAX_MEMORY:
            raise ValueError(
                f'{count} draws of {estimator.belief.cells} cells take about '
                f'{estimate / 1e9:.1f} GB, and {MAX_MEMORY / 1e9:.1f} GB are allowed: '
                'take a smaller field, or the goal map'
            )
        rng = np.random.default_rng([OWN_KEY, estimator.seed, deployments])
        grid, belief = estimator.prior.grid, estimator.belief
        around, live = None if grid is None else grid.around, None
        hazardous, independent = estimator.draws(count, rng)
        if belief.duds is not None or estimator.model.duds:
            # By the marginals: the share of live hazards hardly depends on other cells.
            share = belief.live(estimator.model.duds).hazard / np.maximum(belief.hazard, 1e-300)
            live = hazardous & (rng.random(hazardous.shape) < share)
        return cls(hazardous, independent, around=around, live=live)

    @property
    def hazard(self) -> Bools:
        """Return the hazards in each draw, shape (draws, cells)."""
        return self.hazardous

    def hazard_count(self, cells: ArrayLike) -> Floats:
        """Return P(n of `cells` have a hazard) for n = 0, 1, ... (:eq:`hazards-remaining`)."""
        there = np.unique(on_field('cells', cells, self.cells))
        count = self.hazardous[:, there].sum(axis=1)
        return np.bincount(count, self.weight, there.size + 1).astype(np.float64)

    def survivals(self, paths: Sequence[ArrayLike], model: SensorModel) -> Floats:
        """Return the chance to survive each path, (steps + 1,), in each draw, (paths, draws)."""
        entered = [np.asarray(path)[1:] for path in paths]
        safe, strike = model.log_survival
        # A hazard beside a step counts as a part of one in the cell.
        beside = np.log1p(-model.strikes[1]) / (strike - safe) if model.strikes[1] else 0.0
        exposure = self._hazards_entered(entered, beside, self.live)
        steps = np.array([len(each) for each in entered])[:, None]
        return np.exp(times_log(steps - exposure, safe) + times_log(exposure, strike))

    def are_free(self, paths: Sequence[ArrayLike]) -> Floats:
        """Return 1 where a draw has no hazard on a path, 0 elsewhere; shape (paths, draws)."""
        return np.where(self._hazards_entered([*map(np.asarray, paths)]) == 0.0, 1.0, 0.0)

    def error(self, cells: ArrayLike) -> float:
        """Return the standard error of `p_free`, with one more draw for and one against it."""
        if self.independent == np.inf:
            return 0.0
        p = (self.p_free(cells) * self.independent + 1.0) / (self.independent + 2.0)
        return sqrt(p * (1.0 - p) / self.independent)

    def _hazards_entered(
        self, entered: Sequence[Path], beside: float = 0.0, live: Bools | None = None
    ) -> Floats:
        """Return the steps into hazards, and `beside` times those beside them, (paths, draws)."""
        of_paths = np.concatenate(entered)
        cells, place = np.unique(of_paths, return_inverse=True)
        on_field('path', cells, self.cells)
        path = np.repeat(np.arange(len(entered)), [len(each) for each in entered])
        if beside:
            assert self.around is not None
            near = self.around[of_paths]
            cells = np.unique(np.append(of_paths, near[near >= 0]))
            place = cells.searchsorted(of_paths)
        visits = np.zeros((len(entered), cells.size), dtype=np.float32)
        np.add.at(visits, (path, place), 1.0)
        if beside:
            step, _ = np.nonzero(near >= 0)
            np.add.at(visits, (path[step], cells.searchsorted(near[near >= 0])), beside)
        hazardous = self.hazardous if live is None else live
        return np.asarray(visits @ hazardous[:, cells].T.astype(np.float32), np.float64)


@dataclass(frozen=True, eq=False)
class Mixture(JointHazards):
    """
    Hypotheses under each of which the hazards of all cells are independent.

    Joint probabilities of cells are weighted sums of exact products.

    Parameters
    ----------
    hazard : array_like, shape (hypotheses, cells)
        P(hazard) of each cell under each hypothesis, at least one.
    weights : array_like, shape (hypotheses,)
        Probability of each hypothesis, at least 0, with sum 1.
    rates : mapping of str to ndarray, shape (hypotheses,)
        Numbers of the sensor model that differ between hypotheses, by name; and `live`, where some
        hazards are duds, P(hazard that can strike) of each cell, shape (hypotheses, cells).
    is_sampled : bool
        Whether the hypotheses are drawn at random, so that `error` is not 0.
    around : ndarray of int, shape (cells, 8), optional
        `Grid.around`, if hazards may reach.

    Raises
    ------
    ValueError
        If a shape is wrong, or the weights have a sum other than 1.

    """

    hazard: Floats
    weights: Floats
    rates: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    is_sampled: bool = True
    around: Path | None = None
    # Numbers of the sensor model that count for survival.
    strikes: ClassVar[tuple[str, ...]] = ('lethality', 'malfunction', 'reach')

    def __post_init__(self) -> None:
        hazard = probabilities('hazard', self.hazard)
        weights = as_floats('weights', self.weights)
        if hazard.ndim != 2 or not len(hazard):
            raise ValueError(f'hazard has shape {hazard.shape}: it must be (hypotheses, cells)')
        if weights.shape != (len(hazard),):
            raise ValueError(f'weights has shape {weights.shape}: it must be ({len(hazard)},)')
        if not (weights.min() >= 0.0 and abs(weights.sum() - 1.0) <= 1e-9):
            raise ValueError(f'weights has the sum {weights.sum()}: it must be 1, each at least 0')
        known = (*self.strikes, 'live')
        rates = {name: self.rates[name] for name in known if name in self.rates}
        vars(self).update(hazard=read_only(hazard), weights=read_only(weights), rates=rates)

    @property
    def weight(self) -> Floats:
        """Return the probability of each hypothesis, shape (hypotheses,)."""
        return self.weights

    def of_type(self, robot_type: RobotType) -> Mixture:
        """Return the mixture for a robot type, whose own numbers are known."""
        own = robot_type.sensors
        return replace(
            self, rates={name: each for name, each in self.rates.items() if name not in own}
        )

    def are_free(self, paths: Sequence[ArrayLike]) -> Floats:
        """Return P(no hazard on a path), (paths, hypotheses) (:eq:`mixture-free`)."""
        cells = [np.unique(on_field('path', path, self.cells)) for path in paths]
        return np.stack([(1.0 - self.hazard[:, there]).prod(axis=1) for there in cells])

    def survivals(self, paths: Sequence[ArrayLike], model: SensorModel) -> Floats:
        """Return P(survive a path) under each hypothesis, shape (paths, hypotheses)."""
        lethality, malfunction, reach = (
            np.asarray(self.rates.get(name, getattr(model, name)))[..., None]
            for name in self.strikes
        )
        strike = lethality * (1.0 - model.false_negative)
        chances, live = [], self.rates.get('live', self.hazard)
        for path in paths:
            entered = on_field('path', path, self.cells)[1:]
            cells, counts = np.unique(entered, return_counts=True)
            spared = (1.0 - strike) ** counts
            if np.any(reach) and self.around is not None:
                found = Exposures.of(np.asarray(path), self.around)
                cells = found.cells
                spared = (1.0 - strike) ** found.inside.sum(axis=0)
                spared = spared * (1.0 - reach * strike) ** found.beside.sum(axis=0)
            each = 1.0 - live[:, cells] * (1.0 - spared)
            chances.append(each.prod(axis=1) * (1.0 - malfunction[..., 0]) ** entered.size)
        return np.stack(chances)

    def hazard_count(self, cells: ArrayLike) -> Floats:
        """Return P(n of `cells` have a hazard) for n = 0, 1, ... (:eq:`hazards-remaining`)."""
        there = np.unique(on_field('cells', cells, self.cells))
        hazard, weights = self.hazard[:, there], self.weights
        most = max(1, MAX_PRODUCTS // (there.size + 1) ** 2)
        if len(hazard) > most:
            # Representatives of equal weight, by their expected numbers of hazards.
            order = np.argsort(hazard.sum(axis=1), kind='stable')
            points = (np.arange(most) + 0.5) / most
            places = weights[order].cumsum().searchsorted(points).clip(max=order.size - 1)
            hazard, weights = hazard[order[places]], np.full(most, 1.0 / most)
        count = np.zeros((len(hazard), there.size + 1))
        count[:, 0] = 1.0
        for chance in hazard.T:
            more = count[:, :-1] * chance[:, None]
            count[:, :-1] -= more
            count[:, 1:] += more
        return np.asarray(weights @ count)

    def error(self, cells: ArrayLike) -> float:
        """Return the standard error of `p_free` by the spread of the hypotheses."""
        if not self.is_sampled:
            return 0.0
        free = self.are_free([np.unique(cells)])[0]
        variance = self.weights**2 @ (free - self.weights @ free) ** 2
        return sqrt(float(variance))


# Objects by which goals are decided.
Hazards: TypeAlias = HazardDraws | Mixture


@typed
def joint_hazards(estimator: Estimator, deployments: int) -> Hazards:
    """Return an estimator's hazards: a mixture if its cells are independent, else draws."""
    hypotheses = estimator.hypotheses
    if hypotheses is None:
        return HazardDraws.of(estimator, deployments)
    grid = estimator.prior.grid
    around = None if grid is None else grid.around
    return Mixture(*hypotheses, estimator.particles < np.inf, around)


def highest_confidence(estimator: Estimator) -> float:
    """Return the confidence whose expected error is half of what is left to 1."""
    if estimator.hypotheses is None:
        return DRAWS / (DRAWS + 4.0)
    left = (2.0 * ERROR_SCALE / sqrt(estimator.particles)) ** (1.0 / (1.0 - ERROR_POWER))
    return max(0.0, 1.0 - float(left))


def cells_on(grid: Grid, cells: ArrayLike, what: str) -> Path:
    """Return `cells` as an array, shape (cells,), checked to be cells that robots may enter."""
    array = np.atleast_1d(as_array(what, cells, 'cells'))
    if array.size == 0 or array.dtype.kind not in 'iu' or array.ndim != 1:
        raise ValueError(f'{what} is {in_short(cells)}: it must be a list of at least one cell')
    for cell in array.tolist():
        if not 0 <= cell < grid.cells:
            raise ValueError(
                f'{what} is cell {cell}, off the map: allowed are 0 to {grid.cells - 1}'
            )
        if not grid.free[cell]:
            raise ValueError(f'{what} is cell {cell}, an obstacle: choose one that is free')
    return array.astype(np.intp)


class Target(NamedTuple):
    """A possible target in a cell."""

    # Cell of the target.
    cell: int
    # Probability of a target, in [0, 1].
    probability: float
    # Number of readings of the cell by returned robots.
    looks: int
    # Number of positive readings.
    found: int
    # Probability that all readings miss a target, in [0, 1]; 1 without readings.
    missed: float


@typed
def targets(
    belief: Belief, model: SensorModel, observations: Sequence[Observation], least: float = 0.0
) -> list[Target]:
    """
    Return the cells that may have a target, the most probable first.

    Equation :eq:`looks-missed`.

    Parameters
    ----------
    belief : Belief
        Belief after all observations.
    model : SensorModel
        Believed sensor model.
    observations : sequence of Observation
        Outcomes of all deployments.
    least : float
        Minimum probability of a target, in [0, 1].

    """
    least = probability('least', least)
    looks, found = np.zeros((2, belief.cells), dtype=np.intp)
    for observation in as_observations('observations', observations):
        on_field('path', observation.path, belief.cells)
        if observation.readings is not None:
            entered, readings = observation.path[1:], np.asarray(observation.readings, dtype=int)
            np.add.at(looks, entered[readings >= 0], 1)
            np.add.at(found, entered[readings == 1], 1)
    missed = (1.0 - model.true_positive) ** looks
    columns = belief.target, looks, found, missed
    return [
        Target(cell, *(column[cell].item() for column in columns))
        for cell in np.argsort(-belief.target, kind='stable').tolist()
        if belief.target[cell] >= least
    ]
