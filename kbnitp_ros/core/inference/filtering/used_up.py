# SPDX-License-Identifier: Apache-2.0
"""What one deployment tells of hazards that are gone once they strike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from kbnitp_ros.core.field import (
    Belief,
    Observation,
    SensorModel,
    sum_of_others,
    times_log,
    Visits,
)
from kbnitp_ros.core.inference.filtering.evidence import (
    check_cells,
    condition,
    IMPOSSIBLE,
    loss_weights,
    read_log_likelihood,
)
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def update_used_up(belief: Belief, model: SensorModel, observation: Observation) -> Belief:
    """
    Return the belief after one deployment in a field whose hazards are used up.

    Equations :eq:`used-up-returned` and :eq:`used-up-lost`.
    """
    cells, before, move = moves(belief, model, observation)
    after = np.einsum('czx,czy->cyx', before, move)
    total = after.sum(axis=(1, 2), keepdims=True)
    if not (total > 0.0).all():
        raise ValueError(IMPOSSIBLE)
    joint = belief.joint.copy()
    joint[cells] = after / total
    return Belief(joint)


def hazards_used_up(belief: Belief, model: SensorModel, observation: Observation) -> Floats:
    """
    Return how probably a deployment used up the hazard of each cell, shape (cells,).

    Equations :eq:`used-up-returned` and :eq:`used-up-lost`: what moves from a hazard before the
    deployment to none after it.

    Parameters
    ----------
    belief : Belief
        Before the deployment; hazards of different cells are taken for independent.
    model : SensorModel
        What the robot is believed to be like.
    observation : Observation
        What came of it.

    Raises
    ------
    ValueError
        If the path leaves the belief's cells or the outcome is impossible.

    """
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
    """Return how the hazards on a path move in a deployment."""
    check_cells(belief, observation)
    visits = Visits.of(observation.path)
    before = belief.joint[visits.cells]
    if observation.readings is None:
        weights = loss_weights(observation)
        return (
            visits.cells,
            before,
            lost_transition(belief.hazard[visits.cells], model, visits, weights),
        )
    read = read_log_likelihood(model, visits, observation.readings)
    endures = float(model.malfunction < 1.0)
    move = endures * survived_transition(model, visits.counts)
    return visits.cells, condition(before, read[:, None, :]), move


def survived_transition(model: SensorModel, counts: NDArray[np.intp]) -> Floats:
    """
    Return P(survived n visits, Z after = z' | Z before = z), shape (..., 2, 2) over [z, z'].

    Equation :eq:`used-up-survival`.
    """
    not_set_off = (1.0 - model.lethality) ** counts
    move = np.zeros((*counts.shape, 2, 2))
    move[..., 0, 0] = 1.0
    move[..., 1, 0] = model.false_negative * (1.0 - not_set_off)
    move[..., 1, 1] = not_set_off
    return move


def lost_transition(hazard: Floats, model: SensorModel, visits: Visits, weights: Floats) -> Floats:
    """
    Return the sum over the steps k of w_k P(lost in k, Z after = z' | Z before = z), exactly.

    Equation :eq:`used-up-lost`.
    """
    here = np.arange(visits.of_step.size)
    entered = visits.of_step[:, None] == np.arange(visits.cells.size)
    # Visits to each cell before each step, (steps, n), and what they do to its hazard.
    made = np.concatenate([np.zeros((1, visits.cells.size), np.intp), entered[:-1]]).cumsum(axis=0)
    moved = survived_transition(model, made)
    # In the step itself a robot that is lost has failed, or set the hazard off.
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
    """A hazard of its own for each loss that no malfunction explains."""

    # Shape (cells,). Where there may be a hazard, and no robot with a lethality of 1 has set it
    # off.
    possible: NDArray[np.bool_]
    # For each of the losses, the cells whose hazard may have caused it.
    allowed: tuple[tuple[int, ...], ...] = ()
    # By its cell, which loss a hazard explains.
    chosen: Mapping[int, int] = field(default_factory=dict)

    def with_deployment(self, observation: Observation, model: SensorModel) -> Explanations:
        """Return the explanations with one more deployment."""
        path = observation.path[1:]
        is_certain = model.lethality == 1.0
        if observation.survived:
            return self._entered(path) if is_certain else self
        if model.malfunction:
            known = path[: observation.steps_survived]
            return self._entered(known) if is_certain else self
        fits = (loss_weights(observation) > 0.0) & self.possible[path]
        if not is_certain:
            return self._explained(tuple(np.unique(path[fits]).tolist()))
        # The first step that explains it leaves most hazards to explain other losses.
        fits[np.setdiff1d(np.arange(path.size), np.unique(path, return_index=True)[1])] = False
        for step in np.flatnonzero(fits).tolist():
            try:
                explained = self._explained((int(path[step]),))
            except ValueError:
                continue
            return explained._entered(path[: step + 1])
        return self._explained(())

    def _entered(self, cells: NDArray[np.intp]) -> Explanations:
        """Return it when robots that set off every hazard entered these cells."""
        possible = self.possible.copy()
        possible[cells] = False
        return replace(self, possible=possible)

    def _explained(self, cells: tuple[int, ...]) -> Explanations:
        """Return it with a loss that a hazard in one of these cells explains."""
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
                f'the loss on a path through {len(cells)} cells that may have a hazard is '
                'impossible: hazards that strike are used up, there is no malfunction, and all of '
                'these explain losses before; allow for it with a malfunction above 0'
            )
        return replace(self, allowed=allowed, chosen=chosen)
