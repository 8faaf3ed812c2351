# SPDX-License-Identifier: Apache-2.0
"""A hidden world drawn as two pictures."""

from kbnitp_ros.configuration.field import read_world
from kbnitp_ros.core import Grid
from laws import for_each
import pytest

GRID = Grid(3, 2, blocked=[5])


@pytest.fixture
def write(tmp_path):
    """Write a world file and return its path."""

    def write(text):
        path = tmp_path / 'world.yaml'
        path.write_text(text)
        return path

    return write


def test_the_first_row_is_the_top_row(write):
    world = read_world(write('hazard: [x.., ..x]\ntarget: ["...", .x.]'), GRID)
    assert world.hazard.tolist() == [False, False, True, True, False, False]
    assert world.target.tolist() == [False, True, False, False, False, False]


@for_each('text, told', [
    ('hazard: ["...", "..."', 'is not YAML'),
    ('hazard: []\ntarget: []\nhazard: []', "the key 'hazard' stands in line 3 and in line 1"),
    ('', 'must have hazard and target and nothing else'),
    ('- 1', 'must have hazard and target and nothing else'),
    ('hazard: ["...", "..."]', 'must have hazard and target and nothing else'),
    ('hazard: ["...", "..."]\ntarget: 3', 'target is 3: it must be a list of texts'),
    ('hazard: ["...", 100]\ntarget: []', "hazard is ['...', 100]: it must be a list of texts"),
    ('hazard: ["..."]\ntarget: []', 'hazard has 1 rows: the grid has 2'),
    ('hazard: ["...", "...."]\ntarget: []', 'hazard has 4 cells in row 2 from the top: the'),
    ('hazard: ["...", "..#"]\ntarget: []', "hazard has '..#' in row 2 from the top: cells"),
    ('hazard: ["...", "x.."]\ntarget: ["...", "..."]', 'hazard at the base 0'),
    ('hazard: ["..x", "..."]\ntarget: ["...", "..."]', 'cell 5: that cell is blocked'),
])  # fmt: skip
def test_what_is_no_world_is_refused(write, text, told):
    path = write(text)
    with pytest.raises(ValueError) as refusal:
        read_world(path, GRID)
    assert str(path) in str(refusal.value)
    assert told in str(refusal.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(OSError, match=r'nowhere\.yaml'):
        read_world(tmp_path / 'nowhere.yaml', GRID)
