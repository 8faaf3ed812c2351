# SPDX-License-Identifier: Apache-2.0
"""Beliefs and decisions equal those of version 1.0; benchmarks/golden.py made the data."""

from dataclasses import astuple
import json
from pathlib import Path

from kbnitp_ros.core import (
    Belief,
    Dynamics,
    Estimator,
    Grid,
    HazardDraws,
    Lane,
    Observation,
    RobotType,
    SensorModel,
    Unknowns,
)
import numpy as np
import pytest

FILE = Path(__file__).with_name('golden.npz')
LARGE, SMALL = Grid(9, 9, blocked=(12, 30, 31, 50)), Grid(4, 4, blocked=(6,))
PRIORS = {
    '9x9': Belief.prior(LARGE, 0.15, 0.205, 0.8),
    '4x4': Belief.prior(SMALL, np.linspace(0.1, 0.2, SMALL.cells), 0.205, 0.8),
}
MODEL = SensorModel(0.3)
# Robots of both types take turns.
TYPES = RobotType(), RobotType(lethality=0.2, false_positive=0.1)

TWO = Unknowns(lethality=(0.05, 0.95), hazard_density=(0.02, 0.6))
SEVEN = Unknowns((0.05, 0.95), (0, 0.2), (0.02, 0.6), (0.2, 1), (0, 0.5), (0.6, 1), (0, 0.4))
# Arguments of estimators with a closed form, and of those that learn.
CLOSED = {
    'relaxed_itp': {'method': 'relaxed_itp'},
    'relaxed_bnitp': {'method': 'relaxed_bnitp'},
    'kappa_bnitp_published': {'method': 'kappa_bnitp_published'},
    'kappa_bnitp': {},
    'changing': {'dynamics': Dynamics('changing', 0.01, 0.05)},
    'moving': {'dynamics': Dynamics('moving', move=0.2)},
    'used_up': {'dynamics': Dynamics('used_up')},
}
# The first rates of the last case follow their prior more closely than in version 1.0.
LEARNT = {
    'two numbers': {'unknowns': TWO},
    'seven numbers': {'unknowns': SEVEN},
    'kinds': {'dynamics': Dynamics('learn', 0.01, 0.05, 0.2)},
    'kinds and numbers': {'dynamics': Dynamics('learn'), 'unknowns': TWO},
}


def fold(mission, case, observations):
    """Return the results after each fifth deployment, by name."""
    estimator = Estimator(PRIORS[mission], MODEL, **(CLOSED | LEARNT)[case])
    known = {'joint': [], 'kinds': [], 'parameters': [], 'model': [], 'decision': []}
    for number, observation in enumerate(observations, 1):
        estimator.assimilate(observation, TYPES[number % 2 - 1])
        if number % 5:
            continue
        known['joint'].append(estimator.belief.joint)
        known['kinds'].append([*estimator.kinds.values()])
        known['parameters'].append([each.mean for each in estimator.parameters.values()])
        known['model'].append(astuple(estimator.model)[:5])
        if case == 'kappa_bnitp':
            draws, grid = HazardDraws.of(estimator, number), estimator.prior.grid
            lane = Lane(grid.cells - 1).decide(grid, draws, estimator.model, 2 * grid.width)
            known['decision'].append([lane.p_free, lane.survival, lane.hazards_mean])
    return {f'{mission} {case} {name}': np.array(each) for name, each in known.items()}


@pytest.mark.parametrize('case', CLOSED | LEARNT)
@pytest.mark.parametrize('mission', PRIORS)
def test_beliefs_equal_those_of_version_1(mission, case):
    golden, close = np.load(FILE), {'atol': 1e-12} if case in CLOSED else {'rtol': 1e-10}
    if case == 'kinds and numbers':
        close = {'atol': 0.005}
    outcomes = json.loads(str(golden[f'{mission} outcomes']))
    for name, found in fold(mission, case, [Observation(**each) for each in outcomes]).items():
        np.testing.assert_allclose(found, golden[name], **({'rtol': 0} | close), err_msg=name)
