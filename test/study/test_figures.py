# SPDX-License-Identifier: Apache-2.0
"""What the pictures of a mission show."""

from __future__ import annotations

from kbnitp_ros.core import Belief, Grid, Observation, World
from kbnitp_ros.study.figures import draw_number, mission_maps, Number, steps_into
from matplotlib.figure import Figure
import numpy as np
import pytest

GRID = Grid(3, 2)
RETURNED = Observation([0, 1, 1, 0], True, [False] * 3)
LOST = Observation([0, 4, 5, 0], False)
HEARD_OF = Observation([0, 3, 4, 0], False, steps_survived=1)


def test_steps_are_made_by_those_that_returned_and_as_far_as_lost_ones_were_heard_of():
    made, unknown = steps_into(GRID, [RETURNED, LOST, HEARD_OF])
    assert made.tolist() == [1, 2, 0, 1, 0, 0]
    assert unknown.tolist() == [2, 0, 0, 0, 2, 1]


def test_no_deployments_have_no_steps():
    assert np.sum(steps_into(GRID, [])) == 0


def test_the_maps_are_drawn(tmp_path):
    world = World(np.zeros(6, dtype=bool), np.ones(6, dtype=bool))
    prior = Belief.prior(GRID, 0.5, 0.45, 0.8)
    numbers = {'lethality': Number(np.linspace([0.0] * 5, [0.3, 0.4, 0.5, 0.6, 0.7], 3), 0.5)}
    for name, learnt in (('maps.png', {}), ('learnt.png', numbers)):
        mission_maps(tmp_path / name, GRID, prior, world, [RETURNED, LOST], learnt, 'a note')
        assert (tmp_path / name).read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize('truth', [0.45, None])
def test_a_number_is_drawn_from_before_the_first_deployment_on(truth):
    quantiles = np.sort(np.random.default_rng(0).random((4, 5)), axis=1)
    axes = Figure().subplots()
    draw_number(axes, 'lethality', Number(quantiles, truth))
    median, *others = axes.lines
    assert median.get_xdata().tolist() == [0, 1, 2, 3]
    assert median.get_ydata().tolist() == quantiles[:, 2].tolist()
    assert [line.get_ydata()[0] for line in others] == ([] if truth is None else [truth])
    assert axes.get_ylim() == (0, 1)
    outer, inner = (band.get_paths()[0].get_extents() for band in axes.collections)
    assert (outer.y0, outer.y1) == (quantiles[:, 0].min(), quantiles[:, 4].max())
    assert (inner.y0, inner.y1) == (quantiles[:, 1].min(), quantiles[:, 3].max())
