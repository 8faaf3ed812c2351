# SPDX-License-Identifier: Apache-2.0
"""Methods that fold each deployment into the belief once and forget it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from kbnitp_ros.core.field import (
    ALL_KNOWN,
    Belief,
    Dynamics,
    Learnt,
    Observation,
    RobotType,
    SensorModel,
    STATIC,
    Unknowns,
    Visits,
)
from kbnitp_ros.core.inference.filtering.evidence import (
    change_of,
    check_cells,
    given,
    returned_log_likelihood,
    survived_log_likelihood,
)
from kbnitp_ros.core.inference.filtering.used_up import Explanations, update_used_up
import numpy as np
from numpy.typing import NDArray

Self = TypeVar('Self', bound='KnownModel')


class KnownModel:
    """
    An inference that learns of the field alone, with a sensor model and a prior that are known.

    Parameters
    ----------
    belief : Belief
        Before the first deployment.
    model : SensorModel
        What the robots and their sensors are believed to be like.
    _
        What only methods that learn numbers, or draw them, have a use for.

    """

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
        """Return an inference that goes on by itself from here; no array is ever changed."""
        return copy(self)


@dataclass(frozen=True)
class OnePass:
    """
    A method that folds each deployment into the belief once and forgets it.

    A returned robot is evidence that all of them assimilate alike. They differ in the likelihood
    P(lost | Z_i = z) they give the cells of a lost robot's path, and in whether they hold hazard
    and target correlated.

    Attributes
    ----------
    lost : callable
        (hazard of the visited cells (n,), model, visits, lost_at of the steps or None) ->
        likelihood, shape (n, 2), indexed [visited cell, z]; any common factor is normalised away.
    correlated : bool
        Whether it holds kappa; without it a mission starts from kappa := target.
    dynamics : tuple of str
        The kinds of `Dynamics` that it takes besides static hazards. That of hazards that are used
        up is the exact likelihood, whatever `lost` is.
    bank : callable, optional
        Makes the inference of a mission that learns numbers or the kind of hazards.

    """

    lost: Callable[
        [NDArray[np.float64], SensorModel, Visits, NDArray[np.float64] | None], NDArray[np.float64]
    ]
    correlated: bool
    dynamics: tuple[str, ...] = ('changing',)
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
        """Return the estimate before the first deployment."""
        prior = belief if self.correlated else belief.independent()
        if self.bank is not None and (
            unknowns.priors or dynamics.unknown_rates or dynamics.kind == 'learn'
        ):
            return self.bank(prior, model, unknowns, seed, dynamics, self.correlated)
        if dynamics.effect in ('changing', 'moving'):
            return ChangingEstimate(prior, model, self, dynamics)
        if dynamics.effect == 'used_up':
            return UsedUpEstimate(prior, model, self)
        return OnePassEstimate(prior, model, self)

    @property
    def learns(self) -> bool:
        """Return whether it can learn numbers that are not known."""
        return self.bank is not None

    def update(self, belief: Belief, model: SensorModel, observation: Observation) -> Belief:
        """
        Return the belief after one deployment, as `kbnitp_ros.core.update` does.

        A return is equation :eq:`returned`, a loss after a last contact :eq:`loss-contact`,
        and one of which more is known :eq:`loss-located`.
        """
        check_cells(belief, observation)
        if not self.correlated:
            belief = independent(belief, observation.path[1:])
        if observation.readings is not None:
            visits = Visits.of(observation.path)
            return given(
                belief, visits.cells, returned_log_likelihood(model, visits, observation.readings)
            )
        if observation.steps_survived:
            survived = Visits.of(observation.path[: observation.steps_survived + 1])
            belief = given(
                belief, survived.cells, survived_log_likelihood(model, survived)[:, :, None]
            )
        steps, lost_at = observation.steps_survived, observation.lost_at
        visits = Visits.of(observation.path[steps:])
        lost = self.lost(
            belief.hazard[visits.cells],
            model,
            visits,
            None if lost_at is None else lost_at[steps:],
        )
        with np.errstate(divide='ignore'):
            return given(belief, visits.cells, np.log(lost)[:, :, None])


class OnePassEstimate(KnownModel):
    """A belief that a one-pass method folds deployments into."""

    def __init__(self, belief: Belief, model: SensorModel, method: OnePass) -> None:
        super().__init__(belief, model)
        self._method = method

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Assimilate one more deployment."""
        self.belief = self._method.update(self.belief, robot_type.model(self.model), observation)


class ChangingEstimate(OnePassEstimate):
    """A belief about hazards that change or move before every deployment but the first."""

    def __init__(
        self, belief: Belief, model: SensorModel, method: OnePass, dynamics: Dynamics
    ) -> None:
        super().__init__(belief, model, method)
        self._change = change_of(belief, dynamics)
        self._has_begun = False

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Have hazards change or move, and assimilate one more deployment."""
        now = self.belief
        if self._has_begun:
            now = Belief(self._change(now.joint))
        self.belief = self._method.update(now, robot_type.model(self.model), observation)
        self._has_begun = True


class UsedUpEstimate(OnePassEstimate):
    """A belief about hazards that are gone once they strike."""

    def __init__(self, belief: Belief, model: SensorModel, method: OnePass) -> None:
        super().__init__(belief, model, method)
        self.explanations = Explanations(belief.hazard > 0.0)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Assimilate one more deployment."""
        model = robot_type.model(self.model)
        belief = update_used_up(self.belief, model, observation)
        self.explanations = self.explanations.with_deployment(observation, model)
        self.belief = belief


def independent(belief: Belief, cells: NDArray[np.intp]) -> Belief:
    """Return the belief with hazard and target independent in `cells`."""
    joint = belief.joint.copy()
    joint[cells] = Belief(joint[cells]).independent().joint
    return Belief(joint)
