# SPDX-License-Identifier: Apache-2.0
"""Held deployments are neither evidence nor losses, and robots that never moved do not count."""

from dataclasses import replace

from kbnitp_ros.base.obstacles import describe_obstacle, Obstacle
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.core import Report
from kbnitp_ros.messages.deployments import AgentStatus, OrderState
from kbnitp_ros.messages.operator_actions import Action, OperatorAction, OperatorState
from laws import for_each
import numpy as np
from samples import GRID, HOME, key
from test_obstacles import CLEAR, VALUES

HOME_PATH = np.array(HOME)
SECOND = 10**9
READINGS = tuple((cell, 1) for cell in HOME[1:])
AWAY = (len(HOME) - 1) * SECOND + 10 * SECOND
# Longer than a robot on `HOME` may be away.
LONG = 100 * SECOND


def departed(*keys):
    robots = BaseState(GRID, 10, values=VALUES)
    for order in keys:
        robots.take_path(order, HOME, 1)
        robots.take_status(order, AgentStatus(OrderState.DEPARTED, order.stamp))
    return robots


def late(robots, now):
    return robots.overdue(now, lambda _: AWAY)


def overdue(robots, now):
    """Return the robots that are overdue at two checks."""
    late(robots, now)
    return late(robots, now + 1)


def test_a_held_return_is_never_overdue_and_blocks_nobody():
    one, other = key(1), key(2, 'scout_2')
    robots = departed(one, other)
    late(robots, 1)
    robots.hold(one, 'its report is refused', is_left_to_operator=True)
    assert overdue(robots, LONG) == [other]
    now = replace(CLEAR, agents=['scout_1', 'scout_2'], base=robots, sent=3)
    assert now.unreported == [other]
    assert 'scout_1' not in now.free_agents
    # The belief lacks it, and is not behind.
    robots.end(other)
    now = replace(now, newest=2, last_received=2)
    assert now.obstacle is Obstacle.ALL_LEFT
    said = describe_obstacle(now, now.obstacle)
    assert f'the operator to decide on {one}: its report is refused' in said
    assert '/b/give_up' in said
    # After end_mission it is not awaited.
    # A valid report ends it.
    robots.end(one, 5)
    assert not robots.held
    assert now.free_agents == ['scout_1', 'scout_2']


def test_an_ended_mission_does_not_wait_for_a_held_return():
    robots = departed(key(1))
    robots.hold(key(1), 'its report is refused', is_left_to_operator=True)
    robots.take_action(OperatorAction(1, Action.END, 1))
    now = replace(CLEAR, base=robots, sent=2)
    assert now.obstacle is Obstacle.ALL_DEPLOYED


def test_a_robot_that_leaves_its_base_late_has_its_whole_time():
    (one,) = keys = [key(1)]
    robots = departed(*keys)
    late(robots, 1)
    assert overdue(robots, LONG) == keys
    robots.hold(one, 'it stands at its base', is_left_to_operator=False)
    assert late(robots, LONG + 2) == []
    # Still there when its time is over again.
    assert overdue(robots, 2 * LONG) == keys
    robots.hold(one, 'it stands at its base', is_left_to_operator=False)
    robots.leave('scout_2')
    assert robots.held
    robots.leave('scout_1')
    assert not robots.held
    assert overdue(robots, 2 * LONG + 2) == []
    assert overdue(robots, 3 * LONG) == keys


def test_a_refused_report_stays_with_the_operator_whatever_the_robot_says():
    (one,) = keys = [key(1)]
    robots = departed(*keys)
    robots.hold(one, 'its report is refused', is_left_to_operator=True)
    robots.leave('scout_1')
    assert robots.held
    late(robots, 1)
    assert overdue(robots, LONG) == []


def test_what_the_estimator_refuses_is_held_until_it_does_not():
    (one,) = keys = [key(1)]
    robots = departed(*keys)
    robots.follow({str(one): 'impossible'})
    assert not robots.held
    assert robots.record_report(one, Report(True, READINGS, 5))
    robots.follow({'scout_1 at 7': 'unknown'})
    assert not robots.held
    for _ in range(2):
        robots.follow({str(one): 'impossible'})
        assert robots.held == {one: 'the estimator refuses its report: impossible'}
        assert not robots.outcomes
    robots.follow({})
    assert not robots.in_flight
    # The report that it mended counts.
    robots = departed(*keys)
    robots.record_report(one, Report(True, READINGS, 5))
    robots.follow({str(one): 'impossible'})
    assert robots.record_report(one, Report(True, tuple((cell, 0) for cell, _ in READINGS), 6))
    assert not robots.in_flight
    # Not what the planner itself refuses.
    robots = departed(one)
    robots.hold(one, 'its report is refused', is_left_to_operator=True)
    robots.follow({})
    assert robots.held


def test_robots_without_a_step_do_not_count_and_two_stop_their_agent():
    robots = departed(key(1), key(2), key(3))
    now = replace(CLEAR, base=robots, sent=3, newest=3, last_received=3)
    robots.end(key(1), 5, moved=False)
    assert robots.still_agents == []
    robots.end(key(2), 6, moved=False)
    robots.end(key(2), 6, moved=False)
    assert robots.still_agents == ['scout_1']
    assert now.robots == VALUES['robots'] + 2
    robots.end(key(3), 7)
    assert robots.still_agents == []
    assert robots.unmoved == {key(1), key(2)}
    for number in (4, 5):
        robots.take_path(key(number), HOME, 1)
        robots.end(key(number), 8, moved=False)
    now = replace(now, sent=5, newest=5, last_received=5)
    assert now.obstacle is Obstacle.NO_FREE_AGENT
    said = describe_obstacle(now, now.obstacle)
    assert 'scout_1 came back without a step 2 times in a row' in said
    robots.release(*robots.still_agents)
    assert now.obstacle is None
    done = replace(now, sent=7, newest=7, last_received=7)
    assert done.obstacle is Obstacle.ALL_DEPLOYED
    assert describe_obstacle(done, done.obstacle) == '3 of 3 robots deployed'


@for_each('back', [10 * SECOND, 10**9 * SECOND])
def test_a_robot_keeps_its_time_when_the_clock_is_set_back(back):
    """It is overdue as long after its departure as if the clock had gone on."""
    (one,) = keys = [key(1)]
    robots = departed(one)
    begun = 2 * 10**9 * SECOND
    assert late(robots, begun) == []
    assert late(robots, begun - back + 1) == []
    # The set-back itself takes no time.
    assert overdue(robots, begun - back + AWAY - SECOND) == []
    assert overdue(robots, begun - back + AWAY + SECOND) == keys


def test_a_refusal_of_the_operator_ends_with_the_next_departure():
    state = OperatorState()
    paths = {key(1): HOME_PATH}
    state.apply(OperatorAction(1, Action.REFUSE, 4, paths))
    state.apply(OperatorAction(2, Action.APPROVE, 4, paths))
    assert [[each.tolist() for each in refused] for refused in state.refused(4)] == [[HOME]]
    assert state.is_approved(4, paths)
    for robots_left in (3, 5):
        assert state.refused(robots_left) == []
        assert not state.is_approved(robots_left, paths)
