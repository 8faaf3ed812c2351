# SPDX-License-Identifier: Apache-2.0
"""The possible values of unknown numbers of the sensor model and the prior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.sensor import RobotType, SensorModel, times_log
from kbnitp_ros.core.field.unknowns import Bins, Unknowns
from kbnitp_ros.core.inference.filters import can_be_lost, RATES, ratio
from kbnitp_ros.core.inference.tally import Tally
import numpy as np
from numpy.typing import NDArray

# Log odds in place of infinity: above any evidence, small enough to round off no evidence.
CERTAIN = 1e6
# Log odds of a certain hazard, and of a certain target.
CERTAIN_HAZARD = 300.0
CERTAIN_TARGET = 700.0
# Bounds of the bisection for offsets of log odds, and its number of steps.
FURTHEST = 1000.0
HALVINGS = 60


@dataclass(frozen=True, eq=False)
class PriorMap:
    """A probability for each cell: the prior with one offset added to all log odds."""

    # The prior's log odds, shape (cells,).
    log_odds: NDArray[np.float64]
    # Whether the probability is neither 0 nor 1, so that an offset changes it, shape (cells,).
    undecided: NDArray[np.bool_]
    # Offset for each possible average of the undecided cells, shape (values,); a single 0 if the
    # average is known.
    offset: NDArray[np.float64]
    # log (1 - p) with each offset, shape (cells, values); 0 in cells that are not undecided.
    log_absent: NDArray[np.float64]

    @classmethod
    def of(
        cls, probability: NDArray[np.float64], undecided: NDArray[np.bool_], average: Bins | None
    ) -> PriorMap:
        """Return a prior map; `average`: possible averages of undecided cells, None if known."""
        with np.errstate(divide='ignore'):
            log_odds = np.log(probability) - np.log1p(-probability)
        log_odds = log_odds.clip(-CERTAIN, CERTAIN)
        offset: NDArray[np.float64] = np.zeros(1)
        if average is not None:
            offset = offsets(log_odds[undecided], average.values)
        log_absent = np.zeros((log_odds.size, offset.size))
        log_absent[undecided] = -softplus(log_odds[undecided, None] + offset)
        return cls(log_odds, undecided, offset, log_absent)

    def within(self, cells: NDArray[np.intp]) -> PriorMap:
        """Return the map restricted to `cells`."""
        return replace(
            self,
            log_odds=self.log_odds[cells],
            undecided=self.undecided[cells],
            log_absent=self.log_absent[cells],
        )

    def at(
        self, place: NDArray[np.intp], cells: NDArray[np.intp] | slice = slice(None)
    ) -> NDArray[np.float64]:
        """Return the log odds of cells with the offset of each chain, (1 or chains, cells)."""
        if self.offset.size == 1:
            return self.log_odds[None, cells]
        return self.log_odds[cells] + self.undecided[cells] * self.offset[place, None]

    def odds(self, lowest: float, highest: float) -> NDArray[np.float64]:
        """Return the odds with each offset, within limits of log odds, shape (values, cells)."""
        log_odds = self.at(np.arange(self.offset.size))
        odds: NDArray[np.float64] = np.exp(log_odds.clip(lowest, highest))
        return odds

    def mean(self, log_prior: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probabilities averaged over the offsets, shape (cells,)."""
        shifted = self.log_odds[:, None] + self.undecided[:, None] * self.offset
        mean: NDArray[np.float64] = (expit(shifted) * np.exp(log_prior)).sum(axis=1)
        return mean


def offsets(log_odds: NDArray[np.float64], averages: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the offset of log odds that gives each average probability (:eq:`prior-offset`)."""
    low, high = np.full_like(averages, -FURTHEST), np.full_like(averages, FURTHEST)
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        below = expit(log_odds[:, None] + middle).mean(axis=0) < averages
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    offset: NDArray[np.float64] = (low + high) / 2.0
    return offset


def softplus(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log(1 + exp(x)) without overflow."""
    result: NDArray[np.float64] = np.maximum(log_odds, 0.0) + np.log1p(np.exp(-np.abs(log_odds)))
    return result


def expit(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the probability at log odds x."""
    with np.errstate(over='ignore'):
        probability: NDArray[np.float64] = 1.0 / (1.0 + np.exp(-log_odds))
    return probability


# Tolerance of equal hazards in a uniform prior.
SAME = 1e-12

# Prior maps whose average may be unknown: P(Z = 1), P(X = 1 | Z = 1) and P(X = 1 | Z = 0).
MAPS = ('hazard_density', 'kappa', 'target_background')
# Limits of the log odds of each map.
LIMITS = {
    'hazard_density': (-CERTAIN_HAZARD, CERTAIN_HAZARD),
    'kappa': (-np.inf, CERTAIN_TARGET),
    'target_background': (-np.inf, CERTAIN_TARGET),
}


def prior_maps(
    belief: Belief, model: SensorModel, unknown: Sequence[str]
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.bool_]]]:
    """Return `MAPS` by name with their undecided cells; refuse unknowns without effect."""
    if 'lethality' in unknown and model.false_negative == 1.0:
        raise ValueError(
            'lethality is unknown but has no effect: '
            'with a false_negative of 1 every robot survives a strike'
        )
    safe = belief.joint[:, 0].sum(axis=1)
    background = ratio(belief.joint[:, 0, 1], safe).clip(max=1.0)
    maps = {}
    for name, values, where in zip(
        MAPS,
        (belief.hazard, belief.kappa, background),
        (belief.hazard > 0.0, belief.hazard > 0.0, safe > 0.0),
    ):
        maps[name] = values, where & (values > 0.0) & (values < 1.0)
        if name in unknown and not maps[name][1].any():
            raise ValueError(f'{name} is unknown but has no effect: the prior decides every cell')
    return maps


def make_joint(
    hazard: NDArray[np.float64], kappa: NDArray[np.float64], background: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the joints, (cells, 2, 2, ...), for the three `MAPS`, each (cells, ...)."""
    safe = 1.0 - hazard
    joint = [safe * (1.0 - background), safe * background, hazard * (1.0 - kappa), hazard * kappa]
    return np.stack(joint, axis=1).reshape(-1, 2, 2, *hazard.shape[1:])


class Clusters(NamedTuple):
    """A clustered prior for each coupling J and each hazard density."""

    # Neighbours that share a side with each cell, shape (cells, 4); -1 for none.
    neighbors: NDArray[np.intp]
    # Values of J, shape (couplings,).
    coupling: NDArray[np.float64]
    # Values of a and of ln Z, shape (couplings, densities).
    field: NDArray[np.float64]
    log_z: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rates:
    """Rates of a robot type, by the values of each number; a known number has one value."""

    # Log chance of a step without malfunction, for each value of malfunction, shape (values,).
    log_endured: NDArray[np.float64]
    # Log chance to survive a step into a hazard, without malfunction, by lethality, shape
    # (values,).
    log_spared: NDArray[np.float64]
    # Rates of the camera as in `SensorModel`, shape (values,).
    true_positive: NDArray[np.float64]
    false_positive: NDArray[np.float64]


class Hypotheses:
    """The possible values of each number of the sensor model and of the prior."""

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        clustering: Clustering | None = None,
    ) -> None:
        self._model = model
        self._prior = belief
        open_bins = {name: prior.bins() for name, prior in unknowns.priors.items()}
        self.unknown = tuple(open_bins)
        self.bins = {
            **{field.name: Bins.known(0.0) for field in fields(Unknowns)},
            **{name: Bins.known(getattr(model, name)) for name in RATES},
            **open_bins,
        }
        # Cells that may have a hazard.
        self.possible = belief.hazard > 0.0
        self.maps = {
            name: PriorMap.of(*each, self.bins[name] if name in self.unknown else None)
            for name, each in prior_maps(belief, model, self.unknown).items()
        }
        self.clusters: Clusters | None = None
        if clustering is not None:
            self._cluster(belief, clustering)
        self.prior_is_known = not set(MAPS) & set(self.unknown)
        # The expectation of a clustered prior in each cell is estimated by the chains.
        is_expected = self.prior_is_known or self.clusters is not None
        self.belief = belief
        if not is_expected:
            means = [self.maps[name].mean(self.bins[name].log_prior) for name in MAPS]
            self.belief = self.make_belief(make_joint(*means))

    def _cluster(self, belief: Belief, clustering: Clustering) -> None:
        """Set up clustered hazards."""
        undecided = self.maps['hazard_density'].undecided
        if clustering.grid.cells != belief.cells:
            raise ValueError(
                f'clustering is of a grid of {clustering.grid.cells} cells, but the prior has '
                f'{belief.cells} cells'
            )
        hazard = belief.hazard[belief.hazard > 0.0]
        if hazard.size == 0 or hazard.max() == 1.0 or np.ptp(hazard) > SAME:
            raise ValueError(
                'the prior hazards differ between cells, or are 0 or 1: clustered hazards need '
                'one density in (0, 1) for all cells that may have a hazard'
            )
        densities = belief.hazard[undecided][:1]
        if 'hazard_density' in self.unknown:
            densities = self.bins['hazard_density'].values
        bins = clustering.bins
        field, log_z = clustering.fields(undecided, densities)
        self.clusters = Clusters(clustering.neighbors, bins.values, field, log_z)
        self.bins['coupling'] = bins
        if bins.values.size > 1:
            self.unknown += ('coupling',)
        log_odds, prior = field.ravel(), self.maps['hazard_density']
        # All undecided cells have the same log odds: the field a for each coupling and density.
        self.maps['hazard_density'] = replace(
            prior,
            log_odds=np.where(undecided, log_odds[0], prior.log_odds),
            offset=log_odds - log_odds[0],
            log_absent=np.zeros((prior.log_odds.size, 1)),
        )

    def offset(self, name: str, place: Mapping[str, NDArray[np.intp]]) -> NDArray[np.intp]:
        """Return the index of a prior map's offset in each chain, given the numbers' `place`."""
        if name != 'hazard_density' or self.clusters is None:
            return place[name]
        return place['coupling'] * self.clusters.field.shape[1] + place['hazard_density']

    def rates(self, robot_type: RobotType) -> Rates:
        """Return the rates of a robot type; numbers that the type sets have one value."""
        values = {name: self.bins[name].values for name in RATES}
        values |= {name: np.array([value]) for name, value in robot_type.sensors.items()}
        strike = values['lethality'] * (1.0 - robot_type.model(self._model).false_negative)
        with np.errstate(divide='ignore'):
            return Rates(
                log_endured=np.log1p(-values['malfunction']),
                log_spared=np.log1p(-strike),
                true_positive=values['true_positive'],
                false_positive=values['false_positive'],
            )

    def make_belief(self, joint: NDArray[np.float64]) -> Belief:
        """Return the belief with these joints, setting states that the prior excludes to 0."""
        joint = np.where(self._prior.joint > 0.0, joint, 0.0)
        return Belief(joint / joint.sum(axis=(1, 2), keepdims=True))

    def lethality(self, spared: float) -> float:
        """Return the lethality at which a robot survives a hazard with the chance `spared`."""
        lethality = (1.0 - spared) / (1.0 - self._model.false_negative)
        return min(max(lethality, 0.0), 1.0)

    def model_with(self, numbers: Mapping[str, float]) -> SensorModel:
        """Return the sensor model with these numbers, ignoring numbers of the prior."""
        return replace(
            self._model, **{name: value for name, value in numbers.items() if name in RATES}
        )

    def refuse_impossible(self, tally: Tally) -> None:
        """Raise ValueError if the evidence is impossible for all hazards and values of numbers."""
        # Any values of unknown numbers will do: all lie strictly between 0 and 1.
        model = self.model_with({name: self.bins[name].values[0] for name in self.unknown})
        models = [robot_type.model(model) for robot_type in tally.robot_types]
        with np.errstate(divide='ignore'):
            cell = np.log(self._prior.joint)
        for each, survived, positive, negative in zip(
            models, tally.survived, tally.positive, tally.negative
        ):
            cell += times_log(survived[:, None], each.log_survival)[:, :, None]
            cell += times_log(positive[:, None], each.log_reading[1])[:, None]
            cell += times_log(negative[:, None], each.log_reading[0])[:, None]
        possible = np.isfinite(cell).any(axis=2)
        exposed = np.bincount(
            tally.path, tally.visits * possible[tally.cell, 1], minlength=tally.steps.size
        )
        log_survival = np.array([each.log_survival for each in models])[tally.robot_type]
        spared = times_log(tally.steps - exposed, log_survival[:, 0])
        spared += times_log(exposed, log_survival[:, 1])
        ends = tally.first_step[1:-1]
        explained = all(
            can_be_lost(
                possible,
                cells,
                lost_at,
                np.exp(models[robot_type].log_survival),
                -np.expm1(models[robot_type].log_survival),
            )
            for cells, lost_at, robot_type in zip(
                np.split(tally.step_cell, ends), np.split(tally.lost_at, ends), tally.located_type
            )
        )
        if not (possible.any(axis=1).all() and (spared < 0.0).all() and explained):
            raise ValueError(
                'the outcome is impossible under this prior, sensor model and earlier evidence: '
                'allow for it with probabilities that are not exactly 0 or 1'
            )
