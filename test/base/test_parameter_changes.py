# SPDX-License-Identifier: Apache-2.0
"""Which parameters of a planner may change in a mission under way."""

from kbnitp_ros.base.checks import check_changes, check_robots
from kbnitp_ros.configuration import parameters_of
from kbnitp_ros.core import Grid
from laws import for_each
import pytest

GRID = Grid(9, 9)
VALUES = {name: each.default for name, each in parameters_of('planner').items()}


@for_each('changes', [{'robots': 4}, {'robots': 9}, {'beam_width': 8}, {'use_sim_time': 'odd'}])
def test_what_the_mission_can_have_is_taken(changes):
    check_changes(changes, VALUES, GRID, {}, sent=4)


@for_each('changes, why', [
    ({'robots': 3}, '^parameter robots is 3: 4 robots were sent'),
    ({'beam_width': 0}, 'beam_width'),
    ({'beam_width': 10**6}, 'beam_width'),
    ({'planner': 'beem'}, 'beam'),
])  # fmt: skip
def test_what_the_mission_cannot_have_is_refused(changes, why):
    with pytest.raises(ValueError, match=why):
        check_changes(changes, VALUES, GRID, {}, sent=4)


def test_a_log_with_more_robots_is_refused():
    check_robots(5, 5)
    with pytest.raises(ValueError, match='5 ends the mission'):
        check_robots(4, 5)
