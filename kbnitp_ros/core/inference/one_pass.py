# SPDX-License-Identifier: Apache-2.0
"""Methods that assimilate each deployment once, with known numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, Dynamics, Learnt, STATIC, Unknowns
from kbnitp_ros.core.inference.filter import (
    check_cells,
    condition,
    Evidence,
    hazard_change,
    IMPOSSIBLE,
    known_effects,
    loss_weights,
)
from kbnitp_ros.core.inference.published import condition_published
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Explanations:
    """A different hazard for each loss that no malfunction explains."""

    # Cells that may have a hazard, and that no robot with a lethality of 1 has entered, shape
    # (cells,).
    possible: NDArray[np.bool_]
    # For each loss, the cells whose hazard may have caused it.
    allowed: tuple[tuple[int, ...], ...] = ()
    # The loss assigned to the hazard of each cell.
    chosen: Mapping[int, int] = field(default_factory=dict)

    def with_deployment(self, observation: Observation, model: SensorModel) -> Explanations:
        """Return the explanations with one more deployment."""
        path = observation.evidence[0][1:]
        is_certain = model.lethality == 1.0
        if observation.survived:
            return self._entered(path) if is_certain else self
        if model.malfunction:
            known = path[: observation.steps_survived]
            return self._entered(known) if is_certain else self
        fits = (loss_weights(observation) > 0.0) & self.possible[path]
        if not is_certain:
            return self._explained(tuple(np.unique(path[fits]).tolist()))
        # The earliest possible step leaves the most hazards to explain other losses.
        fits[np.setdiff1d(np.arange(path.size), np.unique(path, return_index=True)[1])] = False
        for step in np.flatnonzero(fits).tolist():
            try:
                explained = self._explained((int(path[step]),))
            except ValueError:
                continue
            return explained._entered(path[: step + 1])
        return self._explained(())

    def _entered(self, cells: NDArray[np.intp]) -> Explanations:
        """Return the explanations after a robot with a lethality of 1 has entered these cells."""
        possible = self.possible.copy()
        possible[cells] = False
        return replace(self, possible=possible)

    def _explained(self, cells: tuple[int, ...]) -> Explanations:
        """Return the explanations with one more loss, due to a hazard in one of these cells."""
        allowed, chosen = (*self.allowed, cells), dict(self.chosen)
        seen: set[int] = set()

        def finds_cell(loss: int) -> bool:
            for cell in allowed[loss]:
                if cell not in seen:
                    seen.add(cell)
                    if cell not in chosen or finds_cell(chosen[cell]):
                        chosen[cell] = loss
                        return True
            return False

        if not finds_cell(len(self.allowed)):
            raise ValueError(
                'the loss is impossible: with a malfunction of 0 each loss uses up another '
                'hazard, and no cell of this path is left for one; set malfunction above 0 to '
                'allow the loss'
            )
        return replace(self, allowed=allowed, chosen=chosen)


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
    # Factory of the inference that learns numbers or the kind of hazards; None if unsupported.
    bank: Callable[..., Any] | None = None
    takes_lost_at: ClassVar[bool] = True
    version: ClassVar[int] = 1

    def __call__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns = ALL_KNOWN,
        seed: int = 0,
        dynamics: Dynamics = STATIC,
    ) -> Any:
        """Return the inference before the first deployment."""
        prior = belief if self.correlated else belief.independent()
        if self.bank is not None and (
            unknowns.priors or dynamics.unknown_rates or dynamics.kind == 'learn'
        ):
            return self.bank(prior, model, unknowns, seed, dynamics, self.correlated)
        return OnePassEstimate(prior, model, self, dynamics)

    @property
    def learns(self) -> bool:
        """Return whether the method can learn unknown numbers."""
        return self.bank is not None

    def update(
        self,
        belief: Belief,
        model: SensorModel,
        observation: Observation,
        *,
        are_used_up: bool = False,
    ) -> Belief:
        """Return the posterior; cells off the path stay the same, bit for bit."""
        check_cells(belief, observation)
        evidence = Evidence.of(observation)
        effects = known_effects(model, are_used_up)
        cells, joint = evidence.visits.cells, belief.joint.copy()
        is_printed = self.is_published and not observation.survived
        after, log_chance = (condition_published if is_printed else condition)(
            joint[cells, ..., None], evidence, effects, self.correlated
        )
        if log_chance[0] == -np.inf:
            raise ValueError(IMPOSSIBLE)
        joint[cells] = after[..., 0]
        return Belief(joint)


class OnePassEstimate(KnownModel):
    """A one-pass belief about hazards that are static, change, move or are used up."""

    def __init__(
        self, belief: Belief, model: SensorModel, method: OnePass, dynamics: Dynamics = STATIC
    ) -> None:
        super().__init__(belief, model)
        self._method = method
        changes = dynamics.effect in ('changing', 'moving')
        self._change = hazard_change(belief, dynamics) if changes else None
        self._has_begun = False
        self._explanations: Explanations | None = None
        if dynamics.effect == 'used_up':
            self._explanations = Explanations(belief.hazard > 0.0)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Assimilate one more deployment; hazards may change before each but the first."""
        now, model = self.belief, robot_type.model(self.model)
        if self._explanations is not None:
            belief = self._method.update(now, model, observation, are_used_up=True)
            self._explanations = self._explanations.with_deployment(observation, model)
            self.belief = belief
            return
        if self._has_begun and self._change is not None:
            now = Belief(self._change(now.joint))
        self.belief = self._method.update(now, model, observation)
        self._has_begun = True
