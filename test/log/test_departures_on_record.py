# SPDX-License-Identifier: Apache-2.0
"""What becomes of orders, by what agents say in any order in which it is heard."""

from collections import Counter
from itertools import permutations

from kbnitp_msgs.msg import AgentStatus as AgentStatusMessage
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.record import Departures
from kbnitp_ros.messages.deployments import AgentStatus, OrderState, read_status, status_message
from kbnitp_ros.messages.headers import to_stamp
from laws import for_each
import numpy as np
import pytest

KEY = DeploymentKey('scout_1', 70)
ACCEPTED = AgentStatus(OrderState.ACCEPTED, 80, content=1)
DEPARTED = AgentStatus(OrderState.DEPARTED, 90, content=2)
REFUSED = AgentStatus(OrderState.REFUSED, 90, 'a newer path came', 3)
HOME = 100


def test_a_status_comes_back_and_bad_ones_are_refused_by_name():
    said = {
        OrderState.ACCEPTED: status_message(KEY, OrderState.ACCEPTED, 80),
        OrderState.DEPARTED: status_message(KEY, OrderState.DEPARTED, 80),
        OrderState.REFUSED: status_message(KEY, OrderState.REFUSED, 80, 'the battery is low'),
    }
    for state, message in said.items():
        key, status = read_status(message, 'scout_1')
        assert (key, status.state, status.stamp, status.reason) == (KEY, state, 80, message.reason)
    assert len({read_status(each, 'scout_1')[1].content for each in said.values()}) == 3
    for change, told in (
        ({'agent': 'scout_2'}, "agent is 'scout_2': on this topic it must be 'scout_1'"),
        ({'state': 0}, 'state is 0: it must be from 1 to 3'),
        ({'state': 4}, 'state is 4'),
        ({'reason': 'a rest'}, "reason is 'a rest' and state DEPARTED"),
        ({'state': 3}, "reason is '' and state REFUSED"),
        ({'state': 3, 'reason': 'x' * 501}, 'reason has 501 characters'),
        ({'deployment': to_stamp(-1)}, 'deployment is -1'),
    ):
        bad = status_message(KEY, OrderState.DEPARTED, 80)
        for name, value in change.items():
            setattr(bad, name, value)
        with pytest.raises(ValueError, match=told):
            read_status(bad, 'scout_1')
    bad = AgentStatusMessage(agent='scout_1', state=2)
    with pytest.raises(ValueError, match='header.frame_id'):
        read_status(bad, 'scout_1')


@for_each('seed', range(200))
def test_departures_and_reports_mean_the_same_in_any_order(seed):
    """As a node hears them that starts late, by each topic's own order."""
    rng = np.random.default_rng(seed)
    statuses = [each for each in (ACCEPTED, DEPARTED) if rng.random() < 0.7]
    has_report = DEPARTED in statuses and rng.random() < 0.7
    heard = [*statuses, *(['report'] * has_report)]
    ends = []
    for order in permutations(heard):
        if [each for each in order if each != 'report'] != statuses:
            continue
        departures = Departures()
        # What is heard twice says nothing new.
        for each in (*order, *order):
            if each == 'report':
                departures.end(KEY, HOME)
            else:
                departures.take(KEY, each)
        ends.append((departures.out, departures.is_at_base(KEY)))
    out = {KEY} if DEPARTED in statuses and not has_report else set()
    is_at_base = statuses == [ACCEPTED]
    assert ends == [(out, is_at_base)] * len(ends)


def test_what_contradicts_is_refused_and_changes_nothing():
    other = AgentStatus(OrderState.DEPARTED, 91, content=4)
    late = AgentStatus(OrderState.DEPARTED, HOME + 1, content=5)
    for before, status, told in (
        ([DEPARTED], other, 'DEPARTED, and was DEPARTED before: the first counts'),
        ([DEPARTED], REFUSED, 'REFUSED, and was DEPARTED before'),
        ([REFUSED], DEPARTED, 'DEPARTED, and was REFUSED before'),
        ([DEPARTED], AgentStatus(OrderState.ACCEPTED, 95), 'ACCEPTED, and was DEPARTED before'),
        ([DEPARTED, 'report'], REFUSED, 'REFUSED, and was DEPARTED'),
        (['report'], REFUSED, 'REFUSED after it was reported'),
        (['report'], late, 'DEPARTED after it was reported'),
    ):
        departures = Departures()
        for each in before:
            if each == 'report':
                departures.end(KEY, HOME)
            else:
                departures.take(KEY, each)
        known = departures.status(KEY), set(departures.out)
        with pytest.raises(ValueError, match=told):
            departures.take(KEY, status)
        assert (departures.status(KEY), departures.out) == known


def test_a_robot_that_stays_is_not_lost_and_one_that_returns_was_away():
    departures = Departures()
    departures.take(KEY, REFUSED)
    with pytest.raises(ValueError, match='its robot stays at the base: a newer path came'):
        departures.check_loss(KEY)
    departures.end(KEY, HOME)
    assert not departures.is_refused(KEY)
    departures.check_loss(KEY)


def test_all_states_have_a_name_in_the_message():
    names = Counter(getattr(AgentStatusMessage, state.name) == state for state in OrderState)
    assert names == {True: 3}
