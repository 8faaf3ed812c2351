# SPDX-License-Identifier: Apache-2.0
"""One-pass filters: the posterior after a deployment in closed form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.observation import Observation, Visits
from kbnitp_ros.core.field.sensor import (
    log_predicted_survival,
    RobotType,
    SensorModel,
    sum_of_others,
    times_log,
)
from kbnitp_ros.core.field.unknowns import (
    ALL_KNOWN,
    Dynamics,
    joint_after_change,
    joint_after_moves,
    Learnt,
    neighbors_to_move_to,
    Rates,
    STATIC,
    Unknowns,
)
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Numbers of a sensor model that can be unknown.
RATES = ('lethality', 'malfunction', 'true_positive', 'false_positive')

# Text of the exception for impossible evidence.
IMPOSSIBLE = (
    'the outcome is impossible under this belief and sensor model: '
    'allow for it with probabilities that are not exactly 0 or 1'
)


def safe_log(chance: Floats) -> Floats:
    """Return the logarithm, -inf for 0."""
    log: Floats = np.log(chance, out=np.full_like(chance, -np.inf), where=chance > 0.0)
    return log


def ratio(part: Floats, whole: Floats) -> Floats:
    """Return part / whole, 0 if both are 0."""
    share: Floats = np.divide(part, whole, out=np.zeros_like(part), where=whole > 0.0)
    return share


def check_cells(belief: Belief, observation: Observation) -> None:
    """Check that a path lies in the field of a belief."""
    beyond = observation.path[observation.path >= belief.cells]
    if beyond.size:
        raise ValueError(
            f'path has the cell {beyond[0]}: the belief has the cells 0 to {belief.cells - 1}'
        )


def read_log_likelihood(
    model: SensorModel, visits: Visits, readings: NDArray[np.bool_] | NDArray[np.int8]
) -> NDArray[np.float64]:
    """Return log P(readings | X = x) of each visited cell, shape (n, 2) (:eq:`returned`)."""
    positive = np.bincount(visits.of_step, weights=readings == 1)
    negative = np.bincount(visits.of_step, weights=readings == 0)
    read = times_log(positive[:, None], model.log_reading[1])
    read += times_log(negative[:, None], model.log_reading[0])
    return read


def loss_weights(observation: Observation) -> NDArray[np.float64]:
    """Return the likelihood of a loss in each step given its observation, shape (steps,)."""
    if observation.lost_at is not None:
        return observation.lost_at
    weights = np.ones(observation.steps)
    weights[: observation.steps_survived] = 0.0
    return weights


def given(belief: Belief, cells: NDArray[np.intp], log_likelihood: NDArray[np.float64]) -> Belief:
    """Return the belief given evidence on `cells`; other cells stay the same, bit for bit."""
    joint = belief.joint.copy()
    joint[cells] = condition(joint[cells], log_likelihood)
    return Belief(joint)


def condition(
    joint: NDArray[np.float64], log_likelihood: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the normalised joints of cells given evidence (:eq:`returned`)."""
    with np.errstate(divide='ignore'):
        log_joint = np.log(joint) + log_likelihood
    peak = log_joint.max(axis=(1, 2), keepdims=True)
    if not np.isfinite(peak).all():
        raise ValueError(IMPOSSIBLE)
    posterior: NDArray[np.float64] = np.exp(log_joint - peak)
    posterior /= posterior.sum(axis=(1, 2), keepdims=True)
    return posterior


def hazard_change(
    prior: Belief, dynamics: Dynamics, rates: Mapping[str, Rates] = MappingProxyType({})
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the function that updates joints for hazard changes between deployments."""
    possible = prior.hazard > 0.0
    appear, vanish, move = (
        rates.get(name, getattr(dynamics, name)) for name in ('appear', 'vanish', 'move')
    )
    if dynamics.effect == 'changing':
        return partial(joint_after_change, possible=possible, appear=appear, vanish=vanish)
    if dynamics.effect == 'moving':
        if prior.grid is None:
            raise ValueError(
                'hazards are moving, and the prior has no grid for them to move on: make it with '
                'Belief.prior(grid, ...) or belief.on(grid)'
            )
        neighbors = neighbors_to_move_to(prior.grid, possible)
        return partial(joint_after_moves, neighbors=neighbors, move=move)
    return lambda joint: joint


def lost_likelihood(
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: Visits,
    lost_at: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """
    Return P(lost | Z_i = z) = 1 - s_z^n_i prod_{k != i} S_k (:eq:`loss-exact`).

    It is the sum over the steps in which the robot may have been lost (:eq:`loss-universes`).
    """
    if lost_at is not None:
        return located_likelihood(hazard, model, visits, lost_at)
    log_survival = model.log_survival
    others = sum_of_others(log_predicted_survival(hazard, visits.counts, log_survival))
    return -np.expm1(times_log(visits.counts[:, None], log_survival) + others[..., None])


def located_likelihood(
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: Visits,
    lost_at: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return sum_k lost_at[k] P(lost in step k | Z_i = z) (:eq:`located-exact`)."""
    survives, dies = np.exp(model.log_survival), -np.expm1(model.log_survival)
    chance = np.stack([1.0 - hazard, hazard], axis=1)
    reached = np.ones_like(chance)
    likelihood = np.zeros_like(chance)
    for cell, weight in zip(visits.of_step, lost_at):
        spared = chance[cell] @ survives
        lost, goes_on = np.full_like(chance, chance[cell] @ dies), np.full_like(chance, spared)
        lost[cell], goes_on[cell] = dies, survives
        likelihood += weight * reached * lost
        reached *= goes_on
        if spared > 0.0:
            chance[cell] *= survives / spared
    return likelihood


def published_likelihood(
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: Visits,
    lost_at: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the paper's likelihood of a loss, eq. 5 and 10-12 (:eq:`loss-published`)."""
    survives = model.survival(hazard)[visits.of_step]
    reached = np.concatenate([[1.0], np.cumprod(survives[:-1])])
    destroyed_here = reached * (1.0 - survives)
    if lost_at is not None:
        destroyed_here *= lost_at
    here = np.bincount(visits.of_step, weights=destroyed_here)
    elsewhere = visits.counts * destroyed_here.sum() - here
    survives_given = model.survival((0, 1))
    likelihood: NDArray[np.float64] = here[:, None] * (1.0 - survives_given)
    likelihood += elsewhere[:, None] * survives_given
    return likelihood


def can_be_lost(
    possible: NDArray[np.bool_],
    of_step: NDArray[np.integer],
    lost_at: NDArray[np.float64],
    survives: NDArray[np.float64],
    dies: NDArray[np.float64],
) -> bool:
    """Return whether some arrangement of hazards makes the loss possible."""
    open_to = possible.copy()
    for cell, weight in zip(of_step, lost_at):
        if weight > 0.0 and (open_to[cell] & (dies > 0.0)).any():
            return True
        open_to[cell] &= survives > 0.0
        if not open_to[cell].any():
            return False
    return False


def update_used_up(belief: Belief, model: SensorModel, observation: Observation) -> Belief:
    """Return the posterior if hazards are used up (:eq:`used-up-returned`, :eq:`used-up-lost`)."""
    cells, before, move = moves(belief, model, observation)
    after = np.einsum('czx,czy->cyx', before, move)
    total = after.sum(axis=(1, 2), keepdims=True)
    if not (total > 0.0).all():
        raise ValueError(IMPOSSIBLE)
    joint = belief.joint.copy()
    joint[cells] = after / total
    return Belief(joint)


def hazards_used_up(belief: Belief, model: SensorModel, observation: Observation) -> Floats:
    """Return P(used up) of each cell's hazard (:eq:`used-up-returned`, :eq:`used-up-lost`)."""
    cells, before, move = moves(belief, model, observation)
    moved = before.sum(axis=2)[:, :, None] * move
    total = moved.sum(axis=(1, 2))
    if not (total > 0.0).all():
        raise ValueError(IMPOSSIBLE)
    used_up = np.zeros(belief.cells)
    used_up[cells] = moved[:, 1, 0] / total
    return used_up


def moves(
    belief: Belief, model: SensorModel, observation: Observation
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return the path's cells, joints given the readings, and P(outcome, Z after | Z before)."""
    check_cells(belief, observation)
    path, readings = observation.evidence
    visits = Visits.of(path)
    before = belief.joint[visits.cells]
    if readings is None:
        weights = loss_weights(observation)
        return (
            visits.cells,
            before,
            lost_transition(belief.hazard[visits.cells], model, visits, weights),
        )
    read = read_log_likelihood(model, visits, readings)
    endures = float(model.malfunction < 1.0)
    move = endures * survived_transition(model, visits.counts)
    return visits.cells, condition(before, read[:, None, :]), move


def survived_transition(model: SensorModel, counts: NDArray[np.intp]) -> Floats:
    """Return P(survived n visits, Z after | Z before), (..., 2, 2) (:eq:`used-up-survival`)."""
    not_set_off = (1.0 - model.lethality) ** counts
    move = np.zeros((*counts.shape, 2, 2))
    move[..., 0, 0] = 1.0
    move[..., 1, 0] = model.false_negative * (1.0 - not_set_off)
    move[..., 1, 1] = not_set_off
    return move


def lost_transition(hazard: Floats, model: SensorModel, visits: Visits, weights: Floats) -> Floats:
    """Return sum_k w_k P(lost in k, Z after | Z before), exactly (:eq:`used-up-lost`)."""
    here = np.arange(visits.of_step.size)
    entered = visits.of_step[:, None] == np.arange(visits.cells.size)
    # Visits to each cell before each step, (steps, n), and their effect on its hazard.
    made = np.concatenate([np.zeros((1, visits.cells.size), np.intp), entered[:-1]]).cumsum(axis=0)
    moved = survived_transition(model, made)
    # In the step of the loss the robot failed, or a hazard struck it and was used up.
    failed, struck = model.malfunction, model.lethality * (1.0 - model.false_negative)
    lost = np.array([[failed, 0.0], [(1.0 - failed) * struck, failed]])
    own = np.matmul(moved[here, visits.of_step], lost)
    prior = np.stack([1.0 - hazard, hazard], axis=-1)
    with np.errstate(divide='ignore'):
        chance = np.log(np.einsum('nz,knzy->kn', prior, moved))
        chance[here, visits.of_step] = np.log(np.einsum('kz,kzy->k', prior[visits.of_step], own))
        others = sum_of_others(chance)
        others += np.log(weights)[:, None] + times_log(here, np.log1p(-failed))[:, None]
    peak = others.max(initial=-np.inf)
    if peak == -np.inf:
        return np.zeros((visits.cells.size, 2, 2))
    moved[here, visits.of_step] = own
    summed: Floats = np.einsum('kn,knzy->nzy', np.exp(others - peak), moved)
    return summed


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

    # Likelihood of a loss, (n, 2), indexed [visited cell, z], up to a common factor. Arguments:
    # hazard of the visited cells (n,), sensor model, visits, and `lost_at` of the steps or None.
    lost: Callable[
        [NDArray[np.float64], SensorModel, Visits, NDArray[np.float64] | None], NDArray[np.float64]
    ]
    # Whether the method updates kappa; if not, kappa := target.
    correlated: bool
    # Kinds of `Dynamics` besides static hazards. For hazards that are used up the exact likelihood
    # replaces `lost`.
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

    def update(self, belief: Belief, model: SensorModel, observation: Observation) -> Belief:
        """Return the posterior (:eq:`returned`, :eq:`loss-contact`, :eq:`loss-located`)."""
        check_cells(belief, observation)
        path, readings = observation.evidence
        if path.size == 1:
            # A return without a step that counts.
            return belief
        if not self.correlated:
            joint, entered = belief.joint.copy(), path[1:]
            joint[entered] = Belief(joint[entered]).independent().joint
            belief = Belief(joint)
        if readings is not None:
            visits = Visits.of(path)
            survived = times_log(visits.counts[:, None], model.log_survival)
            read = read_log_likelihood(model, visits, readings)
            return given(belief, visits.cells, survived[:, :, None] + read[:, None, :])
        if observation.steps_survived:
            known = Visits.of(observation.path[: observation.steps_survived + 1])
            survived = times_log(known.counts[:, None], model.log_survival)
            belief = given(belief, known.cells, survived[:, :, None])
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
            belief = update_used_up(now, model, observation)
            self._explanations = self._explanations.with_deployment(observation, model)
            self.belief = belief
            return
        if self._has_begun and self._change is not None:
            now = Belief(self._change(now.joint))
        self.belief = self._method.update(now, model, observation)
        self._has_begun = True
