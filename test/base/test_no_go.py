# SPDX-License-Identifier: Apache-2.0
"""No-go areas: cells that are added and lifted, and requests that are refused."""

from kbnitp_ros.base.no_go import changed_no_go, open_grid
from kbnitp_ros.core import Area, Grid, Lane
from kbnitp_ros.messages.operator_actions import Action, OperatorAction, OperatorState
from laws import for_each
import pytest

# A wall leaves one way between the rows, by cell 5.
FIELD = Grid(5, 3, base=0, other_bases=[14], blocked=[6, 7, 8, 9])


def test_areas_are_added_and_lifted_cell_by_cell():
    closed = changed_no_go(FIELD, (), [3, 2, 3], lift=False)
    assert closed == (2, 3)
    closed = changed_no_go(FIELD, closed, [3, 4], lift=False)
    assert closed == (2, 3, 4)
    assert changed_no_go(FIELD, closed, [2, 4], lift=True) == (3,)


@for_each('cells, lift, why', [
    ([], False, 'cells is empty: name at least one cell'),
    ([2, 15], False, 'cells has 15, off the map: allowed are 0 to 14'),
    ([15], True, 'cells has 15, off the map'),
    ([14, 2], False, 'cells has 14, a base'),
    ([3], False, 'all cells are in a no-go area already'),
    ([2, 3], True, 'cells has 2, which is in no no-go area'),
    ([1, 5], False, 'no robot could leave the base 0'),
    ([13], False, 'no robot could leave the base 14'),
])  # fmt: skip
def test_impossible_areas_are_refused(cells, lift, why):
    with pytest.raises(ValueError, match=why):
        changed_no_go(FIELD, (3,), cells, lift=lift)


def test_a_lane_needs_a_way_and_an_area_does_not():
    assert not open_grid(FIELD, [3, 4], Lane(2), 8).free[[3, 4]].any()
    assert not open_grid(FIELD, [1], Area([1, 2, 3]), 8).free[1]
    assert not open_grid(FIELD, [1], None, 8).free[1]
    with pytest.raises(ValueError, match='no way leads to it from cell 0'):
        open_grid(FIELD, [1], Lane(2), 8)
    with pytest.raises(ValueError, match='goal is cell 2, an obstacle'):
        open_grid(FIELD, [2], Lane(2), 8)


def test_areas_follow_from_the_actions_on_record():
    state = OperatorState()
    for stamp, (action, cells) in enumerate([
        (Action.NO_GO, (4, 2)),
        (Action.NO_GO, (3, 4)),
        (Action.LIFT, (4,)),
    ]):  # fmt: skip
        assert state.apply(OperatorAction(stamp, action, 0, cells=cells))
    assert state.no_go == (2, 3)
    assert not state.is_holding
    # An action that is published again changes nothing.
    assert not state.apply(OperatorAction(0, Action.NO_GO, 0, cells=(4, 2)))
    assert state.no_go == (2, 3)
