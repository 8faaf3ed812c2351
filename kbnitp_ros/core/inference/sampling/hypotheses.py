# SPDX-License-Identifier: Apache-2.0
"""What is known of the sensors and of the field beforehand, and what is left open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

from kbnitp_ros.core.field import (
    Belief,
    Bins,
    Clustering,
    RobotType,
    SensorModel,
    times_log,
    Unknowns,
)
from kbnitp_ros.core.inference.filtering import can_be_lost
from kbnitp_ros.core.inference.sampling.prior_map import PriorMap, PriorMaps
from kbnitp_ros.core.inference.sampling.tally import Tally
import numpy as np
from numpy.typing import NDArray

# How far the hazards of a prior that is the same in all cells may differ by rounding.
SAME = 1e-12

RATES = ('lethality', 'malfunction', 'true_positive', 'false_positive')


class Clusters(NamedTuple):
    """A clustered prior, for each coupling J and each hazard density."""

    # Shape (cells, 4). The cells that share a side with each, -1 for none.
    neighbors: NDArray[np.intp]
    # Shape (couplings,). J.
    coupling: NDArray[np.float64]
    # Shape (couplings, densities). a and ln Z.
    field: NDArray[np.float64]
    log_z: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rates:
    """Rates of one robot type for each value of the numbers; one value where they are known."""

    # Shape (values,). Log chance of a step without malfunction, for each malfunction.
    log_endured: NDArray[np.float64]
    # Shape (values,). Log chance that a step into a hazard does not destroy the robot, for each
    # lethality.
    log_spared: NDArray[np.float64]
    # Shape (values,). As of a `SensorModel`.
    true_positive: NDArray[np.float64]
    false_positive: NDArray[np.float64]


class Hypotheses:
    """The values that each number of the sensor model and of the prior may have."""

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
        if 'lethality' in self.unknown and model.false_negative == 1.0:
            raise ValueError(
                'lethality is unknown, and makes no difference: '
                'with a false_negative of 1 every robot survives a strike'
            )
        self.bins = {
            **{field.name: Bins.known(0.0) for field in fields(Unknowns)},
            **{name: Bins.known(getattr(model, name)) for name in RATES},
            **open_bins,
        }
        safe = belief.joint[:, 0].sum(axis=1)
        background = np.zeros_like(safe)
        np.divide(belief.joint[:, 0, 1], safe, out=background, where=safe > 0.0)
        possible = belief.hazard > 0.0
        self.maps = PriorMaps(
            possible=possible,
            hazard=self._map('hazard_density', belief.hazard, possible),
            kappa=self._map('kappa', belief.kappa, possible),
            background=self._map('target_background', background.clip(max=1.0), safe > 0.0),
        )
        self.clusters: Clusters | None = None
        if clustering is not None:
            self._cluster(belief, clustering)
        self.prior_is_known = not {'hazard_density', 'kappa', 'target_background'}.intersection(
            self.unknown
        )
        # Of a clustered prior only the chains know what is expected in each cell.
        is_expected = self.prior_is_known or self.clusters is not None
        self.belief = belief if is_expected else self._averaged()

    def _cluster(self, belief: Belief, clustering: Clustering) -> None:
        """Take hazards for clustered."""
        undecided = self.maps.hazard.undecided
        if clustering.grid.cells != belief.cells:
            raise ValueError(
                f'clustering is of a grid of {clustering.grid.cells} cells, and the prior has '
                f'{belief.cells}'
            )
        hazard = belief.hazard[belief.hazard > 0.0]
        if hazard.size == 0 or hazard.max() == 1.0 or np.ptp(hazard) > SAME:
            raise ValueError(
                'the prior hazards differ between cells: clustered hazards need one density in '
                '(0, 1) for all cells that may have a hazard'
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
        self.maps = replace(self.maps, hazard=self.maps.hazard.with_log_odds(field.ravel()))

    def offset(self, name: str, place: Mapping[str, NDArray[np.intp]]) -> NDArray[np.intp]:
        """Return which offset of a prior map belongs to the numbers of each chain."""
        if name != 'hazard_density' or self.clusters is None:
            return place[name]
        return place['coupling'] * self.clusters.field.shape[1] + place['hazard_density']

    def _map(
        self, name: str, probability: NDArray[np.float64], where: NDArray[np.bool_]
    ) -> PriorMap:
        average = self.bins[name] if name in self.unknown else None
        try:
            return PriorMap.of(probability, where, average)
        except ValueError as error:
            raise ValueError(f'{name} is unknown, and makes no difference: {error}') from error

    def _averaged(self) -> Belief:
        hazard, kappa, background = (
            prior_map.mean(self.bins[name].log_prior)
            for name, prior_map in (
                ('hazard_density', self.maps.hazard),
                ('kappa', self.maps.kappa),
                ('target_background', self.maps.background),
            )
        )
        joint = [(1.0 - hazard) * (1.0 - background), (1.0 - hazard) * background]
        joint += [hazard * (1.0 - kappa), hazard * kappa]
        return self.belief_of(np.stack(joint, axis=-1).reshape(-1, 2, 2))

    def rates(self, robot_type: RobotType) -> Rates:
        """Return what robots of a type do: their own numbers are known, the others as here."""
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

    def belief_of(self, joint: NDArray[np.float64]) -> Belief:
        """Return the belief with these joints, without what the prior excludes."""
        joint = np.where(self._prior.joint > 0.0, joint, 0.0)
        return Belief(joint / joint.sum(axis=(1, 2), keepdims=True))

    def lethality(self, spared: float) -> float:
        """Return the lethality with which that share of robots survives a hazard."""
        lethality = (1.0 - spared) / (1.0 - self._model.false_negative)
        return min(max(lethality, 0.0), 1.0)

    def model_with(self, numbers: Mapping[str, float]) -> SensorModel:
        """Return the sensor model with some numbers, those of the prior left aside."""
        return replace(
            self._model, **{name: value for name, value in numbers.items() if name in RATES}
        )

    def refuse_impossible(self, tally: Tally) -> None:
        """Refuse evidence that no value allowed, and no hazards, explain."""
        # Whatever is unknown lies strictly between 0 and 1, and where makes no difference here.
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
                'the outcome is impossible under this prior, sensor model and what came before: '
                'allow for it with probabilities that are not exactly 0 or 1'
            )
