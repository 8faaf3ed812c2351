# SPDX-License-Identifier: Apache-2.0
"""
The belief after one loss, by this project and by others: the same posterior of 20 cells.

That a robot survives is a noisy-OR of the hazards of its cells, so libraries for Bayesian networks
can tell what a loss says of them.
"""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from cases import Benchmark, timed
from kbnitp_ros.core import Belief, Observation, SensorModel, update
import numpy as np
from numpy.typing import NDArray

CELLS = 20
MODEL = SensorModel(0.5)
SAFE, HAZARDOUS = MODEL.survival((0, 1)).tolist()
# The base has no hazard and is no cell; it takes one step more.
LEAK = 1.0 - SAFE ** (CELLS + 1)
HAZARD = np.random.default_rng(1).uniform(0.05, 0.6, CELLS)

# Maximum difference of answers from this project's.
TOLERANCE = 1e-12


def by_update() -> NDArray[np.float64]:
    """Return P(Z = 1 | lost) of each cell by this project."""
    belief = Belief.from_maps([0.0, *HAZARD], np.full(CELLS + 1, 0.3), np.full(CELLS + 1, 0.3))
    lost = Observation([*range(CELLS + 1), 0], survived=False)
    return update(belief, MODEL, lost).hazard[1:]


def by_enumeration() -> NDArray[np.float64]:
    """Return P(Z = 1 | lost) from all 2^20 fields, in numpy."""
    fields = (np.arange(2**CELLS)[:, None] >> np.arange(CELLS) & 1).astype(bool)
    prior = np.where(fields, HAZARD, 1.0 - HAZARD).prod(axis=1)
    weight = prior * (1.0 - SAFE * np.where(fields, HAZARDOUS, SAFE).prod(axis=1))
    posterior: NDArray[np.float64] = weight @ fields / weight.sum()
    return posterior


def by_pyagrum() -> NDArray[np.float64]:
    """Return P(Z = 1 | lost) by a noisy-OR of pyAgrum, its own model for this."""
    import pyagrum

    net = pyagrum.BayesNet()
    lost = net.addNoisyORNet(pyagrum.LabelizedVariable('lost', '', 2), LEAK)
    for cell, hazard in enumerate(HAZARD):
        node = net.add(pyagrum.LabelizedVariable(f'z{cell}', '', 2))
        net.cpt(node).fillWith([1.0 - hazard, hazard])
        net.addWeightedArc(node, lost, 1.0 - HAZARDOUS / SAFE)
    inference = pyagrum.LazyPropagation(net)
    inference.setEvidence({'lost': 1})
    inference.makeInference()
    return np.array([inference.posterior(f'z{cell}')[1] for cell in range(CELLS)])


def by_pgmpy() -> NDArray[np.float64]:
    """Return P(Z = 1 | lost) by pgmpy's variable elimination, from a table of all 2^20 fields."""
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.inference import VariableElimination
    from pgmpy.models import DiscreteBayesianNetwork

    names = [f'z{cell}' for cell in range(CELLS)]
    net = DiscreteBayesianNetwork([(name, 'lost') for name in names])
    fields = (np.arange(2**CELLS)[:, None] >> np.arange(CELLS)[::-1] & 1).astype(bool)
    survival = SAFE * np.where(fields, HAZARDOUS, SAFE).prod(axis=1)
    net.add_cpds(
        *(TabularCPD(name, 2, [[1.0 - p], [p]]) for name, p in zip(names, HAZARD)),
        TabularCPD('lost', 2, [survival, 1.0 - survival], names, [2] * CELLS),
    )
    query = VariableElimination(net).query
    answers: list[Any] = [query([n], {'lost': 1}, show_progress=False) for n in names]
    return np.array([answer.values[1] for answer in answers])


def checked(posterior: Callable[[], NDArray[np.float64]]) -> Callable[[], float]:
    """Return a function that times a way to the posterior, after checking its result."""

    def run() -> float:
        off = abs(posterior() - by_update()).max()
        if off > TOLERANCE:
            raise RuntimeError(f'{posterior.__name__} is off by {off}')
        if posterior is by_update:
            return timed(posterior)
        start = time.perf_counter()
        posterior()
        return time.perf_counter() - start

    return run


BENCHMARKS = (
    Benchmark(
        'What one loss says of 20 cells',
        f'All compute the same posterior, within {TOLERANCE:g}.',
        {
            '`update`': checked(by_update),
            'pyAgrum, `addNoisyORNet`': checked(by_pyagrum),
            'enumeration in numpy': checked(by_enumeration),
            'pgmpy, a table': checked(by_pgmpy),
        },
    ),
)
