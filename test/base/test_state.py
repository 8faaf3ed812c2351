# SPDX-License-Identifier: Apache-2.0
"""Messages of one deployment may arrive before its path."""

from kbnitp_ros.base.state import BaseState, MissingError
from kbnitp_ros.core.inference.record import OrderState, Standing, Verdict
from kbnitp_ros.messages.deployments import read_status, status_message
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.operator_actions import Action, OperatorAction, OperatorState
from laws import for_each
import numpy as np
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


def test_agents_of_robots_that_are_out_or_were_given_up_are_gone():
    state = BaseState(GRID, 6, values=VALUES)
    back, given_up, lost, out = (key(1, f'scout_{number}') for number in range(1, 5))
    for deployment in (back, given_up, lost, out):
        state.take_path(deployment, HOME)
    action = OperatorAction(1, Action.GIVE_UP, 4, dict.fromkeys((back, given_up), np.array(HOME)))
    state.take_action(action)
    verdicts = {back: Verdict.RETURN, given_up: Verdict.LOSS, lost: Verdict.LOSS}
    for deployment, verdict in verdicts.items():
        state.stand(deployment, Standing(verdict))
    assert state.gone_agents == {given_up.agent, out.agent}
    # Another robot takes its place.
    state.take_path(key(2, given_up.agent), HOME)
    state.stand(key(2, given_up.agent), Standing(Verdict.RETURN))
    assert state.gone_agents == {out.agent}


@for_each('author, reason, refusal', [
    ('Ann', 'no longer needed', 'taken back by Ann: no longer needed'),
    ('Ann', '', 'taken back by Ann'),
    ('', 'no longer needed', 'taken back by the operator: no longer needed'),
    ('', 'x' * 999, 'taken back by the operator: ' + 472 * 'x'),
])  # fmt: skip
def test_an_order_that_is_taken_back_is_named_with_its_reason_and_approved_anew(
    author, reason, refusal
):
    operator, paths = OperatorState(), {key(1): np.array(HOME)}
    again = {key(2): np.array(HOME)}
    assert operator.apply(OperatorAction(1, Action.APPROVE, 0, paths))
    assert operator.is_approved(0, again)
    said = {'author': author, 'reason': reason}
    assert operator.apply(OperatorAction(2, Action.TAKE_BACK, 1, paths, **said))
    assert {each: action.refusal for each, action in operator.taken_back.items()} == {
        key(1): refusal
    }
    assert not operator.is_approved(0, again)
    assert operator.apply(OperatorAction(3, Action.APPROVE, 0, again))
    assert operator.is_approved(0, again)
