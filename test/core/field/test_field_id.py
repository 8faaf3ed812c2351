# SPDX-License-Identifier: Apache-2.0
"""Fields have the same name exactly if they are the same field, as docs/robots.md defines it."""

from dataclasses import replace
from hashlib import sha256
from math import pi
from pathlib import Path
import re

from kbnitp_ros.core import Grid
from laws import for_each
import numpy as np

PAGE = (Path(__file__).parents[3] / 'docs/robots.md').read_text()
FIELD = Grid(12, 8, resolution=0.5, origin=(-1.5, 2.0), yaw=0.3, blocked=[5, 17])


def test_the_example_of_the_page_is_right():
    (written,) = re.findall(r'^    ([0-9a-f]{60,})$', PAGE, re.MULTILINE)
    (name,) = re.findall(r'and the name `(\w{16})`', PAGE)
    assert sha256(bytes.fromhex(written)).hexdigest()[:16] == name
    assert replace(FIELD, through_corners=False).id == name


@for_each('change', [
    {'width': 13},
    {'height': 9},
    {'resolution': 0.25},
    {'origin': (-1.5, 2.0000001)},
    {'origin': (2.0, -1.5)},
    {'yaw': 0.300001},
    {'blocked': [5]},
    {'blocked': [5, 18]},
    {'connectivity': 4},
    {'through_corners': False},
])  # fmt: skip
def test_another_field_has_another_name(change):
    assert replace(FIELD, **change).id != FIELD.id


@for_each('one, other', [
    (FIELD, replace(FIELD, base=3, other_bases=[7])),
    (FIELD, FIELD.at(0)),
    (FIELD, replace(FIELD, blocked=[17, 5, 17])),
    (FIELD, replace(FIELD, yaw=0.3 + 2 * pi)),
    (Grid(3, 3, origin=(0.0, -0.0)), Grid(3, 3)),
    (Grid(3, 3, yaw=-0.0), Grid(3, 3)),
    (Grid(3, 3, yaw=pi), Grid(3, 3, yaw=-pi)),
    (Grid(3, 3, resolution=0.1), Grid(3, 3, resolution=float(np.float32(0.1)))),
    (Grid(3, 3, resolution=0.1), Grid(3, 3, resolution=0.1 + 1e-12)),
])  # fmt: skip
def test_the_same_field_has_the_same_name(one, other):
    assert one.id == other.id
