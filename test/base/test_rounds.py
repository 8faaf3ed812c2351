# SPDX-License-Identifier: Apache-2.0
"""Which paths of a round are sent by the planner that goes on with a mission."""

from kbnitp_ros.base.knowledge import Knowledge
from kbnitp_ros.base.rounds import Rounds
from kbnitp_ros.configuration import parameters_of
from kbnitp_ros.core import Belief, Estimator, Grid, Ledger, SensorModel
from kbnitp_ros.messages.beliefs import belief_maps, read_belief_maps
from kbnitp_ros.messages.headers import next_name
from laws import for_each
import numpy as np

GRID = Grid(4, 4)
AGENTS = ['scout_1', 'scout_2', 'scout_3']
MISSION = 1_000_000_000


def planned_on():
    prior = Belief.prior(GRID, 0.15, 0.2, 0.8)
    return read_belief_maps(
        belief_maps(Ledger(GRID, 6, Estimator(prior, SensorModel(0.5))), MISSION, MISSION)
    )


@for_each('planner', ['coverage', 'relaxed'])
@for_each('recorded', [0, 1, 2])
@for_each('is_refused', [False, True])
def test_what_is_missing_of_a_round_is_what_was_planned(planner, recorded, is_refused):
    """Whether the robots of the paths on record stay at the base or not."""
    values = {name: each.default for name, each in parameters_of('planner').items()}
    values |= {'planner': planner, 'max_steps': 6, 'loss_cost': 0.0}

    def rounds():
        return Rounds(GRID, values, warn=print, knowledge=Knowledge(GRID, values, {}))

    plans = rounds().search(planned_on(), AGENTS, {}, next_name(MISSION, MISSION))().plans
    on_record = dict([(key, plan.path) for key, plan in plans.items()][:recorded])
    at_base = set(on_record) if is_refused else set()
    resumed = rounds()
    for key in set(on_record) - at_base:
        resumed.note_path(on_record[key])
    missing = resumed.missing(planned_on(), AGENTS, on_record, at_base=at_base)
    assert list(missing) == list(plans)[recorded:]
    for key, plan in missing.items():
        np.testing.assert_array_equal(plan.path, plans[key].path)
