# SPDX-License-Identifier: Apache-2.0
"""Missions are the same under any settings of numpy."""

from kbnitp_ros.core import (
    Belief,
    Clustering,
    Dynamics,
    Grid,
    Learning,
    METHODS,
    run_mission,
    SearchOptions,
    SensorModel,
    Unknowns,
    World,
)
from laws import for_each
import numpy as np
import pytest

GRID = Grid(6, 5)
LETHALITY = Unknowns(lethality=(0.0, 1.0))
KINDS = {
    **{name: {'method': name} for name in METHODS},
    'learning': {'learning': Learning(Unknowns(lethality=(0.0, 1.0), hazard_density=(0.0, 1.0)))},
    'used up': {'dynamics': Dynamics('used_up')},
    'changing': {'dynamics': Dynamics('changing', 0.01, 0.02)},
    'clustered': {
        'method': 'kappa_bnitp_sampled',
        'learning': Learning(LETHALITY, clustering=Clustering(GRID, 'learn')),
    },
    'beam': {'options': SearchOptions('beam')},
}


def beliefs(kind):
    rng = np.random.default_rng(1)
    world = World.random(GRID, rng, 0.15, 0.8, 0.1)
    prior, chosen = Belief.prior(GRID, 0.3, 0.3, 0.8), {'options': SearchOptions('relaxed')}
    made = run_mission(GRID, prior, SensorModel(0.5), world, 4, rng, **{**chosen, **KINDS[kind]})
    return [deployment.belief.joint.tobytes() for deployment in made]


@pytest.mark.slow
@for_each('kind', KINDS)
def test_missions_do_not_depend_on_numpy_errors(kind):
    with np.errstate(all='raise'):
        found = beliefs(kind)
    with np.errstate(all='ignore'):
        assert found == beliefs(kind)
