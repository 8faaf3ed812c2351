# SPDX-License-Identifier: Apache-2.0
"""How much of a field paths reach, in words."""

from kbnitp_ros.base.checks import cut_off_note, reach_note
from kbnitp_ros.core import Grid
from laws import for_each


@for_each('grid, max_steps, told', [
    (
        Grid(30, 30),
        18,
        '18 steps reach 10x10 of 30x30 cells, 100 of 900: max_steps 58 reaches them all',
    ),
    (
        Grid(5, 4, base=2, blocked=(10, 11, 12, 13, 14)),
        2,
        '2 steps reach 3x2 of 5x4 cells, 6 of 10: max_steps 4 reaches them all',
    ),
    (Grid(9, 9), 18, ''),
    (Grid(9, 9), 16, ''),
    (Grid(3, 1, blocked=(1,)), 4, ''),
])  # fmt: skip
def test_it_is_told_how_much_of_a_field_paths_reach(grid, max_steps, told):
    assert reach_note(grid, max_steps) == told


def test_it_is_told_how_much_is_within_a_distance():
    grid = Grid(9, 9, resolution=0.5)
    told = '18 steps and 4 m reach 5x5 of 9x9 cells, 17 of 81: max_steps 16 and max_distance 11.4 '
    assert reach_note(grid, 18, max_distance=4.0) == f'{told}reach them all'
    assert reach_note(grid, 18, max_distance=11.4) == ''


def test_it_is_told_what_is_cut_off():
    assert (
        cut_off_note(Grid(3, 2, blocked=(1, 4))) == '2 of 4 free cells are cut off from the base'
    )
    assert cut_off_note(Grid(3, 2, blocked=(1,))) == ''
