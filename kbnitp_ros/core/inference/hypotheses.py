# SPDX-License-Identifier: Apache-2.0
"""The possible values of numbers, and the tally of the evidence, for sampling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import Floats, Places
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import RobotType, SensorModel, times_log
from kbnitp_ros.core.field.unknowns import Unknowns
from kbnitp_ros.core.inference import sampling_kernels as gibbs
from kbnitp_ros.core.inference.filter import RATES, safe_log
from kbnitp_ros.core.inference.prior_maps import (
    classes_of_cells,
    expit,
    make_joint,
    MAPS,
    offsets,
    prior_maps,
)
import numpy as np
from numpy.typing import NDArray

# Log odds in place of infinity: above any evidence, small enough to round off no evidence.
CERTAIN = 1e6

# Tolerance of equal hazards in a uniform prior.
SAME = 1e-12


class Hypotheses:
    """The possible values of each number of the sensor model and of the prior."""

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        clustering: Clustering | None = None,
    ) -> None:
        self.prior, self.model = belief, model
        # Bins of the unknown numbers, by name; and log odds of each prior map, (values, cells),
        # their undecided cells and the offsets of the values.
        self.bins = {name: prior.bins() for name, prior in unknowns.priors.items()}
        self.log_odds: dict[str, Floats] = {}
        self.undecided: dict[str, NDArray[np.bool_]] = {}
        self.offset: dict[str, Floats] = {}
        for name, (chance, undecided) in prior_maps(belief, model, tuple(self.bins)).items():
            with np.errstate(divide='ignore'):
                log_odds = np.log(chance) - np.log1p(-chance)
            log_odds = log_odds.clip(-CERTAIN, CERTAIN)
            offset: Floats = np.zeros(1)
            if name in self.bins:
                offset = offsets(log_odds[undecided], self.bins[name].values)
            self.log_odds[name] = log_odds + undecided * offset[:, None]
            self.undecided[name], self.offset[name] = undecided, offset
        self.prior_is_known = not set(MAPS) & self.bins.keys()
        # Numbers that are equal for cells with equal priors, shape (cells,).
        self.alike = classes_of_cells(belief)[1]
        self.clustering = clustering
        if clustering is not None:
            self._cluster(clustering)

    def _cluster(self, clustering: Clustering) -> None:
        """Replace the log odds of undecided cells by the fields of a clustered prior."""
        prior, undecided = self.prior, self.undecided['hazard_density']
        grid, own = clustering.grid, prior.grid or clustering.grid
        if grid.cells != prior.cells or grid.width != own.width:
            cells = f'{own.width} x {own.height}' if prior.grid else prior.cells
            raise ValueError(
                f'clustering is of a grid of {grid.width} x {grid.height} cells: the prior has '
                f'{cells} cells'
            )
        hazard = prior.hazard[prior.hazard > 0.0]
        if hazard.size == 0 or hazard.max() == 1.0 or np.ptp(hazard) > SAME:
            raise ValueError(
                'the prior hazards differ between cells, or are 0 or 1: clustered hazards need '
                'one density in (0, 1) for all cells that may have a hazard'
            )
        densities = hazard[:1]
        if 'hazard_density' in self.bins:
            densities = self.bins['hazard_density'].values
        # The field a and ln Z for each coupling and each density.
        self.fields, self.log_z = clustering.fields(undecided, densities)
        if clustering.bins.values.size > 1:
            self.bins['coupling'] = clustering.bins
        log_odds = self.log_odds['hazard_density'][:1]
        self.log_odds['hazard_density'] = np.where(undecided, self.fields.reshape(-1, 1), log_odds)

    def by_type(self, name: str, robot_types: Sequence[RobotType]) -> Floats:
        """Return a number's values by robot type, (values, types); a type's own is known."""
        common = self.bins[name].values if name in self.bins else [getattr(self.model, name)]
        own = [robot_type.sensors.get(name) for robot_type in robot_types]
        return np.stack([np.full(len(common), common if v is None else v) for v in own], axis=1)

    def index(self, name: str, place: Mapping[str, Places]) -> Places:
        """Return the row of a prior map's log odds in each chain, (1 or chains,)."""
        index = place.get(name, np.zeros(1, np.intp))
        if name == 'hazard_density' and 'coupling' in place:
            index = index + place['coupling'] * self.fields.shape[1]
        return index

    def model_with(self, numbers: Mapping[str, float]) -> SensorModel:
        """Return the sensor model with these numbers, ignoring numbers of the prior."""
        return replace(
            self.model, **{name: value for name, value in numbers.items() if name in RATES}
        )

    def make_belief(self, joint: Floats) -> Belief:
        """Return the belief with these joints, setting states that the prior excludes to 0."""
        joint = np.where(self.prior.joint > 0.0, joint, 0.0)
        return Belief(joint / joint.sum(axis=(1, 2), keepdims=True))

    def belief(self) -> Belief:
        """Return the belief before the first deployment; of clusters, without their ties."""
        if self.prior_is_known or self.clustering is not None:
            return self.prior
        means = []
        for name in MAPS:
            weights = np.exp(self.bins[name].log_prior) if name in self.bins else np.ones(1)
            means.append((weights[:, None] * expit(self.log_odds[name])).sum(axis=0))
        return self.make_belief(make_joint(*means))


@dataclass(frozen=True, eq=False)
class Loss:
    """A lost path: where on it the robot may have been lost."""

    robot_type: int
    # Cells of the steps in which it may have been lost, and the likelihood of a loss in each.
    steps: Places
    lost_at: Floats

    @cached_property
    def blocks(self) -> tuple[Places, Places, Floats, Places]:
        """Return the cells, their visits in each block, and each block's `lost_at` and length."""
        start = np.append(0, np.flatnonzero(np.diff(self.lost_at)) + 1)
        lengths = np.diff(start, append=self.steps.size)
        cells, of_step = np.unique(self.steps, return_inverse=True)
        place = of_step * start.size + np.repeat(np.arange(start.size), lengths)
        visits = np.bincount(place, minlength=cells.size * start.size)
        return cells, visits, self.lost_at[start], lengths


@dataclass(frozen=True, eq=False)
class Tally:
    """Immutable evidence of all deployments and findings (:eq:`loss-factor`)."""

    # Robot types so far, reduced to the fields of the sensor model.
    robot_types: tuple[RobotType, ...]
    # Survived steps, positive and negative readings, shape (3, types, cells).
    counts: NDArray[np.int32]
    # Log likelihood of all findings given Z and X, shape (cells, 2, 2).
    found: Floats
    losses: tuple[Loss, ...] = ()
    # Number of deployments and findings.
    events: int = 0

    def after(self, observation: Observation, robot_type: RobotType) -> Tally:
        """Return the evidence with one more deployment, by a robot of this type."""
        sensors = RobotType(**robot_type.sensors)
        robot_types, counts = self.robot_types, self.counts.copy()
        if sensors not in robot_types:
            robot_types = (*robot_types, sensors)
            counts = np.pad(counts, ((0, 0), (0, 1), (0, 0)))
        of_type, losses = robot_types.index(sensors), self.losses
        path, readings = observation.evidence
        survived, seen, unseen = path[1:], path[:0], path[:0]
        if readings is None:
            survived = survived[: observation.steps_survived]
            stretch, lost_at = observation.lost_on
            weights = np.ones(stretch.size - 1) if lost_at is None else lost_at
            losses = (*losses, Loss(of_type, stretch[1:], weights))
        else:
            seen, unseen = survived[readings == 1], survived[readings == 0]
        for count, steps in zip(counts[:, of_type], (survived, seen, unseen)):
            count += np.bincount(steps, minlength=count.size).astype(np.int32)
        return Tally(robot_types, counts, self.found, losses, self.events + 1)

    def with_finding(self, finding: Finding) -> Tally:
        """Return the evidence with one more finding (:eq:`finding`)."""
        likelihoods = np.diag(finding.of_hazard)[:2], np.diag(finding.of_target)
        found = self.found.copy()
        found[finding.cells] += np.add.outer(*map(safe_log, likelihoods))
        return replace(self, found=found, events=self.events + 1)

    def has_evidence(self) -> NDArray[np.bool_]:
        """Return a mask of the cells on a path or in a finding, shape (cells,)."""
        has: NDArray[np.bool_] = (self.counts[0] > 0).any(axis=0)
        has |= self.found.any(axis=(1, 2))
        for loss in self.losses:
            has[loss.steps] = True
        return has

    def refuse_impossible(self, hypotheses: Hypotheses) -> None:
        """Raise ValueError if no hazards and no values of unknown numbers allow the evidence."""
        # Any values of unknown numbers will do: all lie strictly between 0 and 1.
        numbers = {name: bins.values[0] for name, bins in hypotheses.bins.items()}
        common = hypotheses.model_with(numbers)
        models = [robot_type.model(common) for robot_type in self.robot_types]
        with np.errstate(divide='ignore'):
            cell = np.log(hypotheses.prior.joint)
        cell += self.found
        for model, *of_type in zip(models, *self.counts):
            survived, positive, negative = (count[:, None] for count in of_type)
            cell += times_log(survived, model.log_survival)[:, :, None]
            cell += times_log(positive, model.log_reading[1])[:, None]
            cell += times_log(negative, model.log_reading[0])[:, None]
        possible = np.isfinite(cell).any(axis=2)
        if not possible.any(axis=1).all() or not all(
            can_be_lost(possible, loss.steps, loss.lost_at, survival, 1.0 - survival)
            for loss in self.losses
            for survival in [np.exp(models[loss.robot_type].log_survival)]
        ):
            raise ValueError(
                'the outcome is impossible under this prior, sensor model and earlier evidence: '
                'allow for it with probabilities that are not exactly 0 or 1'
            )

    def blocks(self, cells: Places, most: int) -> gibbs.Losses:
        """Cut the lost paths into blocks, and index them by the place of each cell in `cells`."""
        parts = [loss.blocks for loss in self.losses]
        none = np.empty(0, np.intp)
        own, visits, weight, lengths = (
            np.concatenate([none, *each]) for each in (zip(*parts) if parts else [()] * 4)
        )
        sizes, blocks = (np.array([part[k].size for part in parts], np.intp) for k in (0, 2))
        types = np.array([loss.robot_type for loss in self.losses], np.intp)
        # Of each cell of a loss: its place in `cells`, the loss, and the loss's first block.
        cell, loss = cells.searchsorted(own), np.arange(sizes.size).repeat(sizes)
        first = starts(blocks)[loss]
        unexposed, order = (types * most).repeat(blocks), np.argsort(cell, kind='stable')
        return gibbs.Losses(
            first_cell=starts(sizes),
            cell=cell.astype(np.int32),
            first_entry=starts(np.bincount(cell, minlength=cells.size)),
            first_block=first[order],
            end_block=(first + blocks[loss])[order].astype(np.int32),
            row=starts(blocks[loss])[:-1][order],
            visits=visits.astype(np.int32),
            blocks=blocks.astype(np.int32),
            weight=weight.astype(np.float64),
            steps=(unexposed + lengths).astype(np.int32),
            unexposed=unexposed.astype(np.int32),
        )


def starts(sizes: NDArray[Any]) -> NDArray[np.int32]:
    """Return the start of each of several groups, and the end of the last."""
    return np.append(0, sizes.cumsum()).astype(np.int32)


def can_be_lost(
    possible: NDArray[np.bool_],
    of_step: NDArray[np.integer],
    lost_at: NDArray[np.float64],
    survives: NDArray[np.float64],
    dies: NDArray[np.float64],
) -> bool:
    """Decide on a loss: it is possible if an arrangement of hazards allows it."""
    open_to = possible.copy()
    for cell, weight in zip(of_step, lost_at):
        if weight > 0.0 and (open_to[cell] & (dies > 0.0)).any():
            return True
        open_to[cell] &= survives > 0.0
        if not open_to[cell].any():
            return False
    return False
