# SPDX-License-Identifier: Apache-2.0
"""Messages of one deployment may arrive before its path."""

from kbnitp_ros.base.state import BaseState, MissingError
from kbnitp_ros.core.inference.record import OrderState
from kbnitp_ros.messages.deployments import read_status, status_message
from kbnitp_ros.messages.headers import from_stamp
import pytest
from samples import GRID, HOME, key

VALUES = {'recorded': True, 'presume_departure': False}


def test_a_status_before_its_path_is_kept():
    state = BaseState(GRID, 6, values=VALUES)
    message = status_message(key(1), OrderState.DEPARTED, 5)
    order, status = read_status(message, 'scout_1')
    for _ in range(2):
        with pytest.raises(MissingError, match='this planner has not sent it'):
            state.take_status(order, status)
    state.take_recorded(order, status.content)
    state.take_path(order, HOME, 7)
    assert state.is_away(order)
    assert from_stamp(message.deployment) == order.stamp


def test_the_path_that_was_recorded_first_replaces_the_own_one():
    state = BaseState(GRID, 6, values=VALUES)
    state.take_path(key(1), HOME, 7)
    assert state.take_recorded(key(1), 8)
    assert not state.take_other_path(key(1), [0, 1, 0], 9, 0)
    assert state.take_other_path(key(1), [0, 1, 0], 8, 0)
    assert list(state.paths[key(1)]) == [0, 1, 0]
    assert state.in_flight[key(1)].is_recorded
    # The first one stays.
    assert not state.take_recorded(key(1), 9)
