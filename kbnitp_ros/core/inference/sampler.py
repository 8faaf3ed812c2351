# SPDX-License-Identifier: Apache-2.0
"""
Sampling: the joint posterior of the field and of unknown numbers, by many Gibbs chains.

Every lost path is a factor 1 - prod_i s_{z_i}^{n_i}; every survived step, every reading and every
finding is a local likelihood in which targets are summed out. A chain holds the hazards of all
cells with evidence and a value of each unknown number; a sweep draws each of them given all
others. The belief averages the conditional probabilities of the draws, which vary less than the
draws themselves (Rao-Blackwell). Cells without evidence are summed out like targets, unless
hazards are clustered. Each deployment or finding continues the chains of the previous one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy
from typing import ClassVar

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import ORDINARY, RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import Learnt, Unknowns
from kbnitp_ros.core.inference.chains import CHAINS, Chains, ChainState
from kbnitp_ros.core.inference.filter import check_cells
from kbnitp_ros.core.inference.hypotheses import Hypotheses, Tally
import numpy as np
from numpy.typing import NDArray

# Number of sweeps discarded after each deployment.
DISCARDED = 2

# Number of sweeps between tests of convergence, and maximum number of sweeps for a deployment.
SWEEPS = 2
MAX_SWEEPS = 32

# Number of sweeps to reach a clustered prior, and number of sweeps averaged for its belief.
PRIOR_SWEEPS = 64

# Limits of the sampling error of a converged belief (KL divergence, nats): with all numbers known,
# with unknown numbers, and with an unknown coupling. Unknown numbers change the belief by whole
# nats, so a larger error is accepted; a coupling also changes cells that were never visited.
CONVERGED = 2.5e-4
CONVERGED_LEARNING = 5e-3
CONVERGED_CLUSTERING = 1e-2

# Variance of a cell's hazard below which the autocorrelation of the chains ignores the cell.
TOLD_APART = 0.01

# Maximum bytes of the chains, and bytes of a chain for each cell.
MAX_MEMORY = 1 << 31
BYTES = 48

# Key that separates the sampler's random numbers from those of worlds with the same seed.
OWN_KEY = 0x53414D50


def generator(seed: int, events: int) -> np.random.Generator:
    """Return the random generator for the sampling after a number of deployments and findings."""
    return np.random.default_rng([OWN_KEY, seed, events])


class Sampler:
    """A belief by sampling, with all evidence of the mission."""

    learns: ClassVar[bool] = True
    draws_are_exact: ClassVar[bool] = True
    version: ClassVar[int] = 3
    takes_lost_at: ClassVar[bool] = True
    takes_findings: ClassVar[bool] = True
    clusters: ClassVar[bool] = True

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        clustering: Clustering | None = None,
    ) -> None:
        estimate = BYTES * CHAINS * belief.cells
        if estimate > MAX_MEMORY:
            raise ValueError(
                f'sampling {belief.cells} cells takes about {estimate / 1e9:.1f} GB, and '
                f'{MAX_MEMORY / 1e9:.1f} GB are allowed: take a smaller field, or another method'
            )
        self._hypotheses = hypotheses = Hypotheses(belief, model, unknowns, clustering)
        self._seed = seed
        counts, found = np.zeros((3, 1, belief.cells), np.int32), np.zeros((belief.cells, 2, 2))
        self._evidence = Tally((ORDINARY,), counts, found)
        self.belief = hypotheses.belief()
        rng = generator(seed, 0)
        self._state = ChainState.start(hypotheses, rng)
        self.parameters: Mapping[str, Learnt] = {
            name: Learnt(bins, np.exp(bins.log_prior)) for name, bins in hypotheses.bins.items()
        }
        self.model = hypotheses.model_with(
            {name: learnt.mean for name, learnt in self.parameters.items()}
        )
        self.sampling_error, self.is_converged = 0.0, True
        if clustering is not None:
            self._enter_prior(rng)

    def _enter_prior(self, rng: np.random.Generator) -> None:
        """Run the chains under the clustered prior, and take their average as the belief."""
        cells = np.ones(self.belief.cells, bool)
        state = self._state.with_cells(cells, self._hypotheses, rng)
        chains = Chains(self._hypotheses, self._evidence, state, rng)
        # Keep the numbers drawn from their priors: each chain draws a field for its numbers.
        for _ in range(PRIOR_SWEEPS):
            chains.sweep(has_numbers=False)
        chains.discard()
        for _ in range(PRIOR_SWEEPS):
            chains.sweep()
        joint, self.sampling_error = chains.joint()
        self.belief, self._state = self._hypotheses.make_belief(joint), chains.state

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Assimilate one more deployment."""
        check_cells(self.belief, observation)
        self._take(self._evidence.after(observation, robot_type))

    def assimilate_finding(self, finding: Finding) -> None:
        """Assimilate one more finding, of a field that nobody changed."""
        finding.check(self.belief)
        self._take(self._evidence.with_finding(finding))

    def _take(self, evidence: Tally) -> None:
        """Sample given all evidence, from where the chains are."""
        hypotheses = self._hypotheses
        evidence.refuse_impossible(hypotheses)
        rng = generator(self._seed, evidence.events)
        state = self._state.with_cells(evidence.has_evidence(), hypotheses, rng)
        chains = Chains(hypotheses, evidence, state, rng)
        converged = CONVERGED_LEARNING if hypotheses.bins else CONVERGED
        if 'coupling' in hypotheses.bins:
            converged = CONVERGED_CLUSTERING
        for _ in range(DISCARDED):
            chains.sweep()
        chains.discard()
        for _ in range(MAX_SWEEPS // SWEEPS):
            for _ in range(SWEEPS):
                chains.sweep()
            joint, error = chains.joint()
            if error <= converged:
                break
        self._evidence, self._state = evidence, chains.state
        self.belief = hypotheses.make_belief(joint)
        self.sampling_error, self.is_converged = error, error <= converged
        self.parameters, self.model = chains.learnt(), chains.model()

    def draws(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], float]:
        """Draw the hazards of all cells jointly, by further sweeps of a copy of the chains."""
        hazardous = np.stack([chains.hazards() for chains in self._after_sweeps(count, rng)])
        average = hazardous.mean(axis=(0, 1))
        spread = average * (1.0 - average)
        of_chains = hazardous.mean(axis=0).var(axis=0) * len(hazardous)
        varies = spread > TOLD_APART
        repeats = max(1.0, float((of_chains[varies] / spread[varies]).max(initial=1.0)))
        return hazardous.reshape(-1, average.size)[:count], count / repeats

    def draws_with_models(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.bool_], list[SensorModel]]:
        """Draw hazards jointly, with the sensor model of each draw."""
        drawn = [(chains.hazards(), chains.models()) for chains in self._after_sweeps(count, rng)]
        hazardous = np.concatenate([hazards for hazards, _ in drawn])[:count]
        return hazardous, [model for _, models in drawn for model in models][:count]

    def _after_sweeps(self, count: int, rng: np.random.Generator) -> Iterator[Chains]:
        """Yield the chains after each of the sweeps needed for `count` draws."""
        chains = Chains(self._hypotheses, self._evidence, self._state, rng)
        for _ in range(-(-count // CHAINS)):
            chains.sweep()
            yield chains

    def copy(self) -> Sampler:
        """Return an independent copy."""
        return copy(self)
