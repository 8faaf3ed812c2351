# SPDX-License-Identifier: Apache-2.0
"""
Sampling where hazards do not stay: the causes of losses by Gibbs, with hazards summed out.

Each loss has a cause: the step in which it happened, and whether the robot failed or a hazard
struck it. Given all causes the cells are independent, and each is a chain in time with two states
that is summed out forward and backward. The belief averages these exact joints over the causes
drawn.
"""

from __future__ import annotations

from typing import ClassVar

from kbnitp_ros.core.field import (
    Belief,
    Dynamics,
    Observation,
    RobotType,
    SensorModel,
    Visits,
)
from kbnitp_ros.core.inference.filtering import (
    condition,
    IMPOSSIBLE,
    KnownModel,
    loss_weights,
    lost_likelihood,
    OnePass,
    OnePassEstimate,
    read_log_likelihood,
    UsedUpEstimate,
)
from kbnitp_ros.core.inference.sampling import cause_kernels
from kbnitp_ros.core.inference.sampling.cause_kernels import Change, Flights
import numpy as np
from numpy.typing import NDArray

CHAINS = 32
# Sweeps are made so many at a time until the belief has converged, and at most MOST_SWEEPS for a
# deployment.
SWEEPS = 4
MOST_SWEEPS = 8
# How far chance may take a converged belief, as a KL divergence in nats.
CONVERGED = 1e-3
# Exchanges proposed in a sweep for each loss.
EXCHANGES = 1

ONE_PASS = OnePass(lost_likelihood, correlated=True, dynamics=('changing', 'used_up'))

# Seeds are shared with the worlds of simulations, whose generators are keyed by seed and number.
OWN_KEY = 0x43415553

Floats = NDArray[np.float64]


class CauseSampler(KnownModel):
    """
    The evidence of a mission in a field whose hazards change or are used up.

    Equation :eq:`cause-conditional`. As of a `Sampler`, the belief is a function of the evidence,
    in its order, and of the seed; no array is changed once it is made.

    Parameters
    ----------
    belief, model, seed
        As of a `Sampler`.
    dynamics : Dynamics
        How hazards change.

    """

    version: ClassVar[int] = 1

    def __init__(self, belief: Belief, model: SensorModel, dynamics: Dynamics, seed: int) -> None:
        super().__init__(belief, model)
        self._is_used_up = dynamics.effect == 'used_up'
        self._change = Change(dynamics.appear, dynamics.vanish, int(not self._is_used_up))
        self._seed = seed
        self._possible = np.flatnonzero(belief.hazard > 0.0)
        self._place = np.full(belief.cells, -1, np.intp)
        self._place[self._possible] = np.arange(self._possible.size)
        # Given the readings, before the first deployment.
        self._before = belief.joint
        # Excludes what is impossible, and nothing else.
        self._one_pass = ONE_PASS(belief, model, dynamics=dynamics)
        self._flights = no_flights(self._possible.size)
        self._causes: NDArray[np.intp] = np.empty((CHAINS, 0), np.intp)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Assimilate one more deployment; refuse it as a `Sampler` does."""
        one_pass = self._one_pass.copy()
        one_pass.assimilate(observation, robot_type)
        model = robot_type.model(self.model)
        before = self._before
        if observation.readings is not None:
            visits = Visits.of(observation.path)
            before = before.copy()
            read = read_log_likelihood(model, visits, observation.readings)
            before[visits.cells] = condition(before[visits.cells], read[:, None, :])
        flights = self._with(observation, model)
        rng = np.random.default_rng([OWN_KEY, self._seed, flights.failed.size])
        new = np.full((CHAINS, int(not observation.survived)), -1)
        causes = np.concatenate([self._causes, new], axis=1)
        joint, error, drawn = self._drawn(flights, before, causes, one_pass, rng)
        self._before, self._flights, self._causes = before, flights, drawn
        self._one_pass = one_pass
        after = before.copy()
        after[self._possible] = joint
        self.belief = Belief(after / after.sum(axis=(1, 2), keepdims=True))
        self.sampling_error, self.is_converged = error, error <= CONVERGED

    def _drawn(
        self,
        flights: Flights,
        before: Floats,
        causes: NDArray[np.intp],
        one_pass: OnePassEstimate,
        rng: np.random.Generator,
    ) -> tuple[Floats, float, NDArray[np.intp]]:
        """
        Return the joints of the cells that may have a hazard, their error, and the causes.

        The one-pass belief counts as one draw more: what no draw had is not impossible.
        """
        held = before[self._possible]
        causes = causes.copy()
        losses = causes.shape[1]
        joints = np.zeros((CHAINS, *held.shape))

        def sweep(first: int) -> bool:
            exchanges = rng.random((CHAINS, EXCHANGES * losses, 5))
            uniforms = rng.random((CHAINS, losses))
            return cause_kernels.sweep(
                flights, self._change, held, causes, first, uniforms, exchanges, joints
            )

        if losses and (causes[:, -1] < 0).any() and not sweep(flights.failed.size - 1):
            unexplained = (causes < 0).any(axis=1)
            causes[unexplained] = self._explained(flights, one_pass)
        joints[:] = 0.0
        for sweeps in range(SWEEPS, MOST_SWEEPS + 1, SWEEPS):
            for _ in range(SWEEPS):
                if not sweep(0):
                    raise ValueError(IMPOSSIBLE)
            draws = CHAINS * sweeps
            joint = (joints.sum(axis=0) + one_pass.belief.joint[self._possible]) / (draws + 1)
            variance = joints.var(axis=0, ddof=1) / (CHAINS * sweeps**2)
            seen = joint > 0.0
            error = float((variance[seen] / joint[seen]).sum() / 2.0)
            if error <= CONVERGED:
                break
        return joint, error, causes

    def _explained(self, flights: Flights, one_pass: OnePassEstimate) -> list[int]:
        """Return causes that explain all losses: a hazard of its own for each that needs one."""
        chosen = one_pass.explanations.chosen if isinstance(one_pass, UsedUpEstimate) else {}
        cell_of = {loss: cell for cell, loss in chosen.items()}
        causes: list[int] = []
        needy = 0
        for t in flights.lost.tolist():
            start, end = flights.first_step[t], flights.first_step[t + 1]
            fits = flights.weight[start:end] > 0.0
            entry = flights.entry[start:end]
            if flights.failed[t] > 0.0:
                causes.append(2 * int(np.argmax(fits)))
                continue
            own = np.append(flights.cell, -1)[entry]
            if self._is_used_up:
                into = fits & (own == self._place[cell_of[needy]])
                needy += 1
            else:
                into = fits & (own >= 0)
            if not into.any():
                raise ValueError(IMPOSSIBLE)
            causes.append(2 * int(np.argmax(into)) + 1)
        return causes

    def _with(self, observation: Observation, model: SensorModel) -> Flights:
        """Return the deployments with one more."""
        flights, flown = self._flights, self._flights.failed.size
        visits = Visits.of(observation.path)
        held = self._place[visits.cells] >= 0
        cells = self._place[visits.cells[held]]
        first = flights.cell.size
        at = np.full(visits.cells.size, -1, np.intp)
        at[held] = first + np.arange(cells.size)
        is_lost = not observation.survived
        cell = np.append(flights.cell, cells)
        weight = loss_weights(observation) * (1.0 - model.malfunction) ** np.arange(
            observation.steps
        )
        strike = model.lethality * (1.0 - model.false_negative)
        spent = model.lethality * model.false_negative if self._is_used_up else 0.0
        remains = 1.0 - (model.lethality if self._is_used_up else strike)
        steps = observation.steps if is_lost else 0
        return Flights(
            first_entry=np.append(flights.first_entry, cell.size),
            cell=cell,
            time=np.append(flights.time, np.full(cells.size, flown)),
            visits=np.append(flights.visits, visits.counts[held]),
            first_of_cell=np.searchsorted(np.sort(cell), np.arange(self._possible.size + 1)),
            of_cell=np.argsort(cell, kind='stable'),
            first_step=np.append(flights.first_step, flights.first_step[-1] + steps),
            entry=np.append(flights.entry, at[visits.of_step][:steps]),
            weight=np.append(flights.weight, (weight / weight.max(initial=1e-300))[:steps]),
            remains=np.append(flights.remains, remains),
            spent=np.append(flights.spent, spent),
            failed=np.append(flights.failed, model.malfunction),
            struck=np.append(flights.struck, (1.0 - model.malfunction) * strike),
            lost=np.append(flights.lost, [flown] if is_lost else []).astype(np.intp),
        )


def no_flights(cells: int) -> Flights:
    """Return the evidence before the first deployment."""
    none, nothing = np.empty(0, np.intp), np.empty(0)
    start = np.zeros(1, np.intp)
    return Flights(
        first_entry=start,
        cell=none,
        time=none,
        visits=none,
        first_of_cell=np.zeros(cells + 1, np.intp),
        of_cell=none,
        first_step=start,
        entry=none,
        weight=nothing,
        remains=nothing,
        spent=nothing,
        failed=nothing,
        struck=nothing,
        lost=none,
    )
