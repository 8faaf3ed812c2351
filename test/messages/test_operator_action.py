# SPDX-License-Identifier: Apache-2.0
"""What the operator decides of paths from several bases."""

from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.messages.operator_actions import (
    Action,
    operator_action_message,
    OperatorAction,
    read_operator_action,
)
from laws import for_each
import numpy as np
import pytest
from samples import changed

GRID = Grid(6, 5, base=0, other_bases=(29,))


def test_paths_from_each_base_are_refused_by_operators():
    paths = {DeploymentKey('near', 4): [0, 1, 0], DeploymentKey('far', 5): [29, 28, 29]}
    action = OperatorAction(7, Action.REFUSE, 3, {k: np.array(p) for k, p in paths.items()}, 0)
    seen = read_operator_action(GRID, operator_action_message(GRID, action))
    assert {key: path.tolist() for key, path in seen.paths.items()} == paths
    with pytest.raises(ValueError, match='start at the base 0, not at cell 29'):
        read_operator_action(Grid(6, 5), operator_action_message(GRID, action))


@for_each('fields, told', [
    ({'action': 0}, 'action is 0: it must be from 1 to 6'),
    ({'action': Action.REFUSE}, "agents is '': action is REFUSE"),
    ({'agents': ['scout_1']}, 'agents has 1 names: paths has 0'),
])  # fmt: skip
def test_actions_that_are_none_are_refused(fields, told):
    message = operator_action_message(GRID, OperatorAction(7, Action.PAUSE, 3, {}, 0))
    assert read_operator_action(GRID, message).action is Action.PAUSE
    with pytest.raises(ValueError, match=told):
        read_operator_action(GRID, changed(message, **fields))
