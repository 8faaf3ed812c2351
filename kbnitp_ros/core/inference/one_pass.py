# SPDX-License-Identifier: Apache-2.0
"""Methods that assimilate each deployment once."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, Dynamics, Learnt, STATIC, Unknowns
from kbnitp_ros.core.inference.bank import Bank
from kbnitp_ros.core.inference.filter import (
    check_cells,
    condition,
    Evidence,
    IMPOSSIBLE,
    independent,
    known_effects,
    ratio,
    take_finding,
)
from kbnitp_ros.core.inference.particles import Condition
from kbnitp_ros.core.inference.published import condition_published
import numpy as np

Self = TypeVar('Self', bound='KnownModel')


class KnownModel:
    """An inference of the field with a known sensor model and prior."""

    learns: ClassVar[bool] = False
    version: ClassVar[int] = 1
    dynamics: ClassVar[tuple[str, ...]] = ()
    parameters: Mapping[str, Learnt] = MappingProxyType({})
    sampling_error: float = 0.0
    is_converged: bool = True

    def __init__(self, belief: Belief, model: SensorModel, *_: object) -> None:
        self.belief = belief
        self.model = model

    def copy(self: Self) -> Self:
        """Return an independent copy; arrays are shared, since none is ever changed."""
        return copy(self)


@dataclass(frozen=True)
class OnePass:
    """A method that assimilates each deployment once and keeps no evidence."""

    # Whether the method updates kappa; if not, kappa := target.
    correlated: bool
    # Whether a loss counts as the paper prints it; if not, exactly.
    is_published: bool = False
    # Kinds of `Dynamics` besides static hazards.
    dynamics: tuple[str, ...] = ('changing',)
    # Whether the method can learn unknown numbers and the kind of hazards.
    learns: bool = False
    takes_lost_at: ClassVar[bool] = True
    changes_targets: ClassVar[bool] = True
    takes_findings: ClassVar[bool] = True
    takes_changes: ClassVar[bool] = True
    version: ClassVar[int] = 1

    def __call__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns = ALL_KNOWN,
        seed: int = 0,
        dynamics: Dynamics = STATIC,
        target_dynamics: Dynamics = STATIC,
    ) -> Any:
        """Return the inference before the first deployment."""
        if unknowns.kappa is not None and not self.correlated:
            raise ValueError('kappa cannot be learnt by a method without kappa: use kappa_bnitp')
        prior = belief if self.correlated else belief.independent()
        return Bank(prior, model, unknowns, seed, dynamics, self.on_loss, targets=target_dynamics)

    @property
    def reaches(self) -> bool:
        """Return whether the method takes hazards that reach."""
        return not self.is_published

    @property
    def takes_causes(self) -> bool:
        """Return whether the method takes the cause of a loss."""
        return not self.is_published

    @property
    def on_loss(self) -> Condition:
        """Return the update of a loss."""
        return condition_published if self.is_published else condition

    def update(
        self, belief: Belief, model: SensorModel, observation: Observation | Finding
    ) -> Belief:
        """
        Return the posterior; cells off the path stay the same, bit for bit.

        Returns and losses branch here (arXiv:2305.06929, Algorithm 1, lines 5 and 9).
        """
        if isinstance(observation, Finding):
            return self._after_finding(belief, model, observation)
        check_cells(belief, observation)
        evidence = Evidence.of(observation)
        if self.is_published and observation.by_hazard is not None:
            raise ValueError('by_hazard is given: the published update takes no cause of a loss')
        if model.reach:
            if self.is_published:
                raise ValueError('reach is not 0: the published update takes none')
            evidence = evidence.with_reach(belief.neighbors_in_reach())
            assert evidence.in_reach is not None
            evidence = evidence.in_reach
        if model.duds or belief.duds is not None:
            if self.is_published:
                raise ValueError('duds is not 0: the published update takes none')
            live = belief.live(model.duds)
            share = ratio(live.joint[:, 0] - belief.joint[:, 0], live.joint[:, 0])
            after_live = self.update(live, replace(model, duds=0.0), observation)
            return after_live.with_duds(share)
        cells, joint = evidence.visits.cells, belief.joint.copy()
        before = joint[cells, ..., None]
        if not self.correlated:
            before = independent(before)
        how = condition if observation.survived else self.on_loss
        after, log_chance = how(before, evidence, known_effects(model))
        if log_chance[0] == -np.inf:
            raise ValueError(IMPOSSIBLE)
        joint[cells] = after[..., 0]
        return Belief.computed(joint, belief.grid)

    def _after_finding(self, belief: Belief, model: SensorModel, finding: Finding) -> Belief:
        """Return the posterior; cells that the finding does not name stay, bit for bit."""
        finding.check(belief)
        live = belief.live(model.duds)
        share = ratio(live.joint[:, 0] - belief.joint[:, 0], live.joint[:, 0])
        states = np.concatenate([live.joint, share[:, None]], axis=1)
        before = states[finding.cells, ..., None]
        if not self.correlated:
            before[:, :2] = independent(before[:, :2])
        after, log_chance = take_finding(before, finding)
        if log_chance[0] == -np.inf:
            raise ValueError(IMPOSSIBLE)
        states[finding.cells] = after[..., 0]
        found = Belief.computed(states[:, :2], belief.grid)
        return found if live is belief else found.with_duds(states[:, 2])
