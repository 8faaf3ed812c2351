# SPDX-License-Identifier: Apache-2.0
"""No object of the core makes the arrays of its caller read-only, or changes them."""

from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    HazardDraws,
    Ledger,
    Observation,
    Plan,
    plan,
    SensorModel,
    update,
    World,
)
from kbnitp_ros.core.field.unknowns import Bins
from laws import for_each
import numpy as np

GRID, MODEL = Grid(3, 3), SensorModel(0.5)
BELIEF = Belief.prior(GRID, 0.2, 0.4, 0.7)
PATH, READ = np.array([0, 1, 0]), np.array([True, False])
MAPS = [np.full(9, 0.2), np.full(9, 0.4), np.full(9, 0.7)]
BLOCKED = np.array([4])


def fold(path):
    ledger = Ledger(GRID, 4, Estimator(BELIEF, MODEL))
    ledger.record_path(DeploymentKey('scout_1', 1), path)


USES = {
    'Observation': (lambda *given: Observation(given[0], True, given[1], entered=given[2]),
                    [PATH, READ, np.array([True, False])]),
    'lost_at': (lambda path, lost: Observation(path, False, lost_at=lost),
                [PATH, np.array([0.5, 1.0])]),
    'World': (World, [READ.repeat(5)[:9], READ.repeat(5)[:9]]),
    'Belief': (Belief, [BELIEF.joint.copy()]),
    'from_maps': (Belief.from_maps, MAPS),
    'prior': (lambda *maps: Belief.prior(GRID, *maps), MAPS),
    'Grid': (lambda blocked: Grid(3, 3, blocked=blocked).free, [BLOCKED]),
    'Plan': (lambda path: Plan(path, 1.0, 0.5), [PATH]),
    'HazardDraws': (lambda draws, weight: HazardDraws(draws, 4.0, weight),
                    [np.zeros((4, 9), dtype=bool), np.full(4, 0.25)]),
    'Bins': (Bins, [np.array([0.0, 1.0]), np.array([0.5]), np.zeros(1)]),
    'update': (lambda path, read: update(BELIEF, MODEL, Observation(path, True, read)),
               [PATH, READ]),
    'Ledger': (fold, [PATH]),
    'plan': (lambda visited: plan(GRID, BELIEF, MODEL, 4, visited=visited), [np.zeros(9, int)]),
}  # fmt: skip


@for_each('name', list(USES))
def test_arrays_of_the_caller_stay_as_they_are(name):
    use, arrays = USES[name]
    given = [array.copy() for array in arrays]
    use(*given)
    for array, before in zip(given, arrays):
        assert array.flags.writeable
        assert np.array_equal(array, before)
        array[...] = array
