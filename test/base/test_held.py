# SPDX-License-Identifier: Apache-2.0
"""Held deployments are neither evidence nor losses, and robots that never moved do not count."""

from copy import deepcopy
from dataclasses import replace

from kbnitp_ros.base.obstacles import describe_obstacle
from kbnitp_ros.base.state import BaseState, EvidenceName, LackingError, MissingError
from kbnitp_ros.core import Report
from kbnitp_ros.core.inference.record import OrderState, Verdict
from kbnitp_ros.messages.deployments import AgentStatus
from kbnitp_ros.messages.operator_actions import Action, OperatorAction, OperatorState
from kbnitp_ros.messages.progress import Helper, Obstacle
from kbnitp_ros.messages.standings import read_standings
from laws import for_each
import numpy as np
import pytest
from samples import changed, EPOCH, GRID, HOME, key, new_ledger, standings
from test_obstacles import CLEAR, VALUES

HOME_PATH = np.array(HOME)
SECOND = 10**9
AWAY = (len(HOME) - 1) * SECOND + 10 * SECOND
# Longer than a robot on `HOME` may be away.
LONG = 100 * SECOND
BACK = Report(True, tuple((cell, 1) for cell in HOME[1:]), 5, content=1)
STILL = Report(True, ((0, -1),), 6, content=2)
FOREIGN = replace(BACK, field_id='0123456789abcdef', content=3)
LOST = Report(False, content=4)


class Base:
    """A base whose robots have departed, and its estimator."""

    def __init__(self, *keys):
        self.state = BaseState(GRID, 10, values=VALUES)
        self.ledger = new_ledger(max_steps=10)
        for order in keys:
            self.send(order)

    def send(self, order):
        self.state.take_path(order, HOME, 1)
        self.state.take_status(order, AgentStatus(OrderState.DEPARTED, order.stamp))
        self.ledger.record_path(order, HOME, 1)

    def hear(self, order, report):
        """Hear a report at both; what they refuse is said by the standings."""
        for node in (self.state, self.ledger):
            try:
                node.record_report(order, report)
            except ValueError:
                continue

    def judge(self):
        self.state.follow(read_standings(standings(self.ledger)))

    def tell(self, order, report):
        self.hear(order, report)
        self.judge()

    def now(self, **changes):
        return replace(CLEAR, base=self.state, newest=self.state.evidence, **changes)


def late(state, now):
    return state.overdue(now, lambda _: AWAY)


def overdue(state, now):
    """Return what is overdue at a time, at the second look."""
    late(state, now)
    return late(state, now + 1)


def test_a_held_return_is_never_overdue_and_blocks_nobody():
    one, other = key(1), key(2, 'scout_2')
    base = Base(one, other)
    late(base.state, 1)
    base.tell(one, FOREIGN)
    assert overdue(base.state, LONG) == [other]
    now = base.now(agents=['scout_1', 'scout_2'])
    assert now.unreported == [other]
    assert 'scout_1' not in now.free_agents
    base.tell(other, BACK)
    base.send(key(3, 'scout_2'))
    base.tell(key(3, 'scout_2'), BACK)
    now = base.now(agents=['scout_1', 'scout_2'])
    assert now.obstacle is Obstacle.ALL_LEFT
    assert now.ends_by(now.obstacle) is Helper.OPERATOR
    said = describe_obstacle(now, now.obstacle)
    assert f'the operator to decide on {one}: deployment {one} was made in another field' in said
    assert '/b/give_up' in said
    # A valid report ends it.
    base.tell(one, BACK)
    assert not base.state.held
    assert base.now().obstacle is Obstacle.ALL_DEPLOYED


def test_an_ended_mission_does_not_wait_for_a_held_return():
    base = Base(key(1))
    base.tell(key(1), FOREIGN)
    base.state.take_action(OperatorAction(1, Action.END, 1))
    assert base.now().obstacle is Obstacle.ALL_DEPLOYED


def test_no_robot_leaves_while_a_report_is_not_judged():
    base = Base(key(1))
    base.hear(key(1), BACK)
    now = base.now()
    assert now.obstacle is Obstacle.UNJUDGED
    assert now.ends_by(now.obstacle) is Helper.ESTIMATOR
    said = describe_obstacle(now, now.obstacle)
    assert said == f'the estimator to judge the report of {key(1)} on /a/standings'
    base.judge()
    # The belief names the same evidence before the next robot leaves.
    now = replace(base.now(), newest=EvidenceName(EPOCH, 0))
    assert now.obstacle is Obstacle.BELIEF_BEHIND
    assert base.now().obstacle is Obstacle.NONE
    # A report that changes nothing is judged, too.
    base.hear(key(1), LOST)
    assert base.now().obstacle is Obstacle.UNJUDGED
    base.judge()
    assert base.now().obstacle is Obstacle.NONE


def test_a_wait_for_the_recorder_or_for_an_absent_estimator_is_stated():
    base = Base(key(1))
    base.state.values = {**VALUES, 'recorded': True}
    base.state.take_recorded(key(1), 1)
    # Other than the hash of the path.
    report = replace(BACK, content=21)
    base.hear(key(1), report)
    now = base.now()
    assert now.obstacle is Obstacle.UNJUDGED
    assert now.ends_by(now.obstacle) is Helper.RECORDER
    assert not now.is_plain(now.obstacle)
    said = describe_obstacle(now, now.obstacle)
    assert said == (
        f'the recorder to acknowledge the report of {key(1)} on /a/scout_1/recorded (parameter '
        'recorded)'
    )
    base.state.take_recorded(key(1), report.content)
    assert now.ends_by(now.obstacle) is Helper.ESTIMATOR
    assert now.is_plain(now.obstacle)
    absent = replace(now, estimators=0)
    assert not absent.is_plain(absent.obstacle)


def test_a_loss_before_its_departure_waits_for_it_or_for_the_operator():
    base = Base()
    base.state.take_path(key(1), HOME, 1)
    base.ledger.record_path(key(1), HOME, 1)
    base.state.take_status(key(1), AgentStatus(OrderState.ACCEPTED, 2))
    base.ledger.record_status(key(1), OrderState.ACCEPTED)
    base.tell(key(1), LOST)
    now = base.now()
    assert now.obstacle is Obstacle.UNJUDGED
    assert now.ends_by(now.obstacle) is Helper.OPERATOR
    assert not now.is_plain(now.obstacle)
    assert '/a/scout_1/status, or the operator gives it up' in describe_obstacle(now, now.obstacle)
    # An ended mission does not wait for it.
    ended = deepcopy(base)
    ended.state.take_action(OperatorAction(1, Action.END, 1))
    assert ended.now().obstacle is Obstacle.ALL_DEPLOYED
    base.tell(key(1), Report(False, settled=base.state.heard_hashes(key(1)), content=9))
    assert base.state.standings[key(1)].verdict is Verdict.LOSS
    assert base.now().obstacle is Obstacle.NONE


def test_a_robot_that_leaves_its_base_late_has_its_whole_time():
    (one,) = keys = [key(1)]
    robots = Base(*keys).state
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
    base = Base(key(1))
    base.tell(key(1), FOREIGN)
    base.state.leave('scout_1')
    assert base.state.held
    late(base.state, 1)
    assert overdue(base.state, LONG) == []


def test_an_outcome_goes_only_when_the_standings_say_so():
    """Whatever is repeated, and in whatever order."""
    base = Base(key(1))
    stale = Base(key(1))
    stale.tell(key(1), FOREIGN)
    old = read_standings(standings(stale.ledger))
    base.tell(key(1), FOREIGN)
    base.tell(key(1), Report(False, settled=(3,), content=9))
    assert (base.state.lost, base.state.held) == (1, {})
    assert not base.state.follow(old)
    assert (base.state.lost, base.state.held) == (1, {})
    for _ in range(2):
        base.tell(key(1), STILL)
        assert base.state.unmoved == {key(1)}
        assert not base.state.follow(old)
        assert not base.state.follow(read_standings(standings(base.ledger)))
    assert (base.state.lost, base.state.in_flight) == (0, {})


def test_a_loss_that_is_taken_back_is_in_flight_again():
    base = Base(key(1))
    base.tell(key(1), LOST)
    assert (base.state.lost, base.state.in_flight, base.state.ended) == (1, {}, 1)
    base.tell(key(1), FOREIGN)
    assert base.state.held.keys() == base.state.in_flight.keys() == {key(1)}
    assert (base.state.lost, base.state.ended) == (0, 0)
    assert base.state.heard_hashes(key(1)) == (3, 4)


def test_standings_that_go_back_are_refused_and_change_nothing():
    base = Base(key(1), key(2))
    base.tell(key(1), BACK)
    base.tell(key(2), BACK)
    before = dict(base.state.standings)
    message = standings(base.ledger, epoch=EPOCH)
    earlier = changed(message, events=1, changes=1)
    assert not base.state.follow(read_standings(earlier))
    newer = new_ledger(max_steps=10)
    with pytest.raises(LackingError, match=r'2 judged deployments, such as scout_1 at 1.* resume'):
        base.state.follow(read_standings(standings(newer, epoch=EPOCH + 1)))
    with pytest.raises(MissingError, match='since is 5'):
        base.state.follow(read_standings(changed(message, events=6, since=5)))
    assert base.state.follow(read_standings(standings(base.ledger, epoch=EPOCH + 1)))
    with pytest.raises(ValueError, match='standings of an estimator that began at 2 count'):
        base.state.follow(read_standings(standings(base.ledger)))
    assert base.state.standings == before
    assert base.state.evidence == (EPOCH + 1, 2)


def test_robots_without_a_step_do_not_count_and_two_stop_their_agent():
    base = Base(key(1), key(2), key(3))
    state = base.state
    base.tell(key(1), STILL)
    assert state.still_agents == []
    base.tell(key(2), STILL)
    base.tell(key(2), STILL)
    assert state.still_agents == ['scout_1']
    assert base.now().robots == VALUES['robots'] + 2
    base.tell(key(3), BACK)
    assert state.still_agents == []
    assert state.unmoved == {key(1), key(2)}
    for number in (4, 5):
        base.send(key(number))
        base.tell(key(number), STILL)
    now = base.now()
    assert now.obstacle is Obstacle.NO_FREE_AGENT
    assert now.ends_by(now.obstacle) is Helper.OPERATOR
    said = describe_obstacle(now, now.obstacle)
    assert 'scout_1 came back without a step 2 times in a row' in said
    state.forgive('scout_1')
    assert now.obstacle is Obstacle.NONE
    for number in (6, 7):
        base.send(key(number))
        base.tell(key(number), BACK)
    done = base.now()
    assert done.obstacle is Obstacle.ALL_DEPLOYED
    assert describe_obstacle(done, done.obstacle) == '3 of 3 robots deployed'


def test_returns_without_a_step_are_told_in_the_order_of_deployments():
    """Whichever was judged last; a resumed pause forgives those before it."""
    base = Base(key(1), key(2), key(3))
    for number in (3, 1, 2):
        base.tell(key(number), BACK if number == 1 else STILL)
    assert base.state.still_agents == ['scout_1']
    base.state.take_action(OperatorAction(2 * SECOND + 1, Action.RESUME, 3))
    assert base.state.still_agents == []


@for_each('back', [10 * SECOND, 10**9 * SECOND])
def test_a_robot_keeps_its_time_when_the_clock_is_set_back(back):
    """It is overdue as long after its departure as if the clock had gone on."""
    (one,) = keys = [key(1)]
    robots = Base(one).state
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
