# SPDX-License-Identifier: Apache-2.0
"""The goal of a mission and its stops are what the parameters say, or are refused."""

from kbnitp_ros.configuration import goal_of, grid_of, TABLE
from kbnitp_ros.configuration.mission import check_goal, search_options, stop_of
from kbnitp_ros.core import Area, Lane, Stop
from laws import for_each
import numpy as np
from PIL import Image
import pytest

SMALL = {
    'grid.width': 3, 'grid.height': 2, 'grid.resolution': 0.5, 'max_steps': 2, 'robots': 4,
}  # fmt: skip


def checked(**given):
    """Return the goal of a planner with these parameters, once it took them."""
    changed = {name.replace('__', '.'): value for name, value in given.items()}
    values = {parameter.name: parameter.default for parameter in TABLE} | SMALL | changed
    grid = grid_of(values)
    goal = goal_of(values, grid)
    check_goal(values, grid, [search_options(values)])
    return goal, stop_of(values)


def mask(folder, occupied, resolution=0.5):
    """Write a map in which these pixels are occupied, the highest row first; return its file."""
    pixels = np.where(np.array(occupied, dtype=bool), 0, 254).astype(np.uint8)
    Image.fromarray(pixels).save(folder / 'mask.png')
    file = folder / 'mask.yaml'
    file.write_text(
        f'image: mask.png\nresolution: {resolution}\norigin: [0, 0, 0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.2\n'
    )
    return str(file)


def test_cells_are_given_by_number_by_position_or_by_a_mask(tmp_path):
    assert checked() == (None, Stop())
    assert checked(goal__kind='lane', goal__cells=[4]) == (Lane(4), Stop())
    assert checked(goal__kind='lane', goal__position=[0.6, 0.9]) == (Lane(4), Stop())
    assert checked(goal__kind='area', goal__cells=[4, 1]) == (Area([1, 4]), Stop())
    drawn = mask(tmp_path, [[0, 1, 0], [0, 1, 0]])
    assert checked(goal__kind='area', goal__mask=drawn) == (Area([1, 4]), Stop())


def test_stops_are_those_of_the_parameters():
    sure = checked(goal__kind='lane', goal__cells=[4], stop__confidence=0.9, stop__losses=2)
    assert sure == (Lane(4, 0.9), Stop(losses=2))
    assert checked(stop__gain=0.3) == (None, Stop(gain=0.3))


@for_each('given, complaint', [
    ({'goal__cells': [4]}, 'goal map has no such thing as cells'),
    ({'stop__confidence': 0.9}, 'goal map has no such thing as a confidence'),
    ({'goal__kind': 'lane'}, 'goal lane has 0 cells'),
    ({'goal__kind': 'lane', 'goal__cells': [1, 4]}, 'goal lane has 2 cells'),
    ({'goal__kind': 'lane', 'goal__cells': [6]}, 'off the map'),
    ({'goal__kind': 'lane', 'goal__cells': [0]}, 'the base'),
    ({'goal__kind': 'lane', 'goal__cells': [5], 'max_steps': 1}, 'at most max_steps = 1'),
    ({'goal__kind': 'lane', 'goal__position': [9.0, 0.1]}, 'is outside the grid'),
    ({'goal__kind': 'lane', 'goal__position': [0.6]}, 'it must be x and y'),
    ({'goal__kind': 'lane', 'goal__cells': [4], 'goal__position': [0.6, 0.9]}, 'give one of'),
    ({'goal__kind': 'area', 'goal__cells': [1], 'bound': True}, 'bound is true'),
    ({'goal__kind': 'area', 'goal__cells': [1], 'stop__confidence': 0.9976}, 'takes 2083 ind'),
    ({'stop__losses': 5}, 'stop.losses is 5'),
])  # fmt: skip
def test_what_cannot_be_sought_is_refused(given, complaint):
    with pytest.raises(ValueError, match=complaint):
        checked(**given)


@for_each('occupied, resolution, complaint', [
    ([[0, 1]], 0.5, '2 x 1 pixels of 0.5 m, and the field 3 x 2 cells'),
    ([[0, 1], [0, 1], [0, 0]], 0.5, '2 x 3 pixels'),
    ([[0, 1, 0], [0, 1, 0]], 0.25, 'pixels of 0.25 m, .* cells of 0.5 m'),
    ([[0, 0, 0], [0, 0, 0]], 0.5, 'without cells'),
])  # fmt: skip
def test_a_mask_that_is_none_of_the_field_is_refused(occupied, resolution, complaint, tmp_path):
    drawn = mask(tmp_path, occupied, resolution)
    with pytest.raises(ValueError, match=complaint):
        checked(goal__kind='area', goal__mask=drawn)


def test_a_goal_stays_while_a_planner_runs():
    of_goals = {
        parameter.name: parameter.read_only
        for parameter in TABLE
        if parameter.name.startswith('goal')
    }
    assert of_goals == dict.fromkeys(
        ('goal.kind', 'goal.cells', 'goal.position', 'goal.mask'), True
    )
