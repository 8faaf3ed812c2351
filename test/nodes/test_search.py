# SPDX-License-Identifier: Apache-2.0
"""The planner listens while it searches, and a search ends as it must."""

import time

from base import Base, GRID
from kbnitp_msgs.msg import Decision, Progress
from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.messages.deployments import read_path, report_message
import numpy as np
import pytest

AGENTS = [f'scout_{number}' for number in range(1, 9)]
WIDE = {
    'grid.width': 30, 'grid.height': 30, 'max_steps': 60, 'robots': 16, 'recorded': False,
    'beam_width': 24,
}  # fmt: skip
GOAL = {
    'goal.kind': 'lane',
    'goal.cells': [899],
    'method': 'kappa_bnitp_sampled',
    'learn.numbers': ['lethality'],
}
SEARCHING = 'waiting for the search for the paths of scout_1, scout_2, scout_3 and 5 more to end'


@pytest.fixture
def base(field):
    """Return a base whose planner searches for many seconds."""
    base = Base(field, AGENTS, **WIDE)
    base.until_state(SEARCHING)
    return base


def until_said(field, words):
    """Wait until the planner has said something, after a search."""
    field.until(lambda: words in field.said('/planner'), words, patience=240)


@pytest.mark.full
def test_a_pause_is_answered_while_paths_are_searched_for_and_no_robot_is_sent(base):
    seconds = []
    for data in (True, False, True, False, True):
        begun = time.monotonic()
        base.do('pause', data=data)
        seconds.append(time.monotonic() - begun)
    # Other processes may keep a call waiting, but not each.
    assert min(seconds) < 0.5
    field = base.field
    assert 'paths were found' not in field.said('/planner')
    kept = 'paths were found for scout_1, scout_2, scout_3 and 5 more, and are kept: waiting for '
    until_said(field, f'{kept}the operator')
    assert not any(base.paths.values())
    base.do('pause', data=False)
    for agent in AGENTS:
        field.until(lambda agent=agent: len(base.paths[agent]) == 1, f'path of {agent}')


@pytest.mark.full
def test_what_was_found_by_other_parameters_is_dropped(base):
    base.field.set_parameter('/planner', 'loss_cost', 1.0)
    dropped = 'the paths found for scout_1, scout_2, scout_3 and 5 more are dropped'
    until_said(base.field, dropped)
    assert not any(base.paths.values())
    base.do('end_mission')
    assert base.field.processes.stop(30)['/planner'] == 0


@pytest.mark.full
def test_a_pause_is_answered_while_what_may_be_relied_on_is_computed(field):
    """The hazards are drawn for a second or more, and lanes sought in all draws."""
    base = Base(field, **WIDE, **GOAL)
    paths, decisions = base.paths['scout_1'], field.listen(Decision, '/decision')
    field.until(lambda: paths, 'path', patience=240)
    before = len(decisions)
    key, cells = read_path(Grid(30, 30), 'scout_1', paths[0])
    home = Observation(cells, True, [False] * (len(cells) - 1))
    base.reports['scout_1'].publish(report_message(key, home, key.stamp + 1))
    base.until_held(1)
    base.do('pause')
    assert len(decisions) == before == 1
    field.until(lambda: len(decisions) == 2, 'decision', patience=240)
    base.do('pause', data=False)
    field.until(lambda: len(paths) == 2, 'next path', patience=240)


def test_plans_that_are_worth_nothing_are_not_sent(field):
    progress = field.listen(Progress, '/progress')
    base = Base(field, loss_cost=1000.0)
    why = 'nothing is worth a robot: the best plan is expected to bring'
    field.until(lambda: progress and why in progress[-1].reason, 'why no robot leaves')
    assert progress[-1].state == Progress.RUNNING
    assert not base.paths['scout_1']
    assert field.set_parameter('/planner', 'loss_cost', 0.0).successful
    base.until_sent(1)
    base.come_back()
    base.until_sent(2)


def test_where_nothing_is_to_be_learnt_no_robot_is_sent(field):
    known = {'prior.hazard': 0.0, 'prior.target': 0.0}
    base = Base(field, **known)
    base.until_state('nothing is worth a robot: no plan is expected to bring more than')
    base.do('end_mission')
    base.until_state('done: 0 of 4 robots deployed, ended by the operator')


def test_robots_keep_the_distance_of_their_agent_and_one_that_allows_no_step_is_refused(field):
    own = {'team.scout_2.max_distance': 2.0}
    base = Base(field, ['scout_1', 'scout_2'], max_distance=4.0, **own)
    for agent, longest in (('scout_1', 4.0), ('scout_2', 2.0)):
        base.until_sent(1, agent)
        (way,) = base.sent(agent)
        assert 0.0 < GRID.path_length(np.array(way)) <= longest
    refused = field.set_parameter('/planner', 'max_distance', 1.5)
    assert not refused.successful
    assert 'max_distance is 1.5 m, which allows no step' in refused.reason
    assert 'it must be at least 2 m, or 0 for no limit' in refused.reason
    refused = field.set_parameter('/planner', 'planner', 'coverage')
    assert 'which the planner coverage does not keep' in refused.reason
