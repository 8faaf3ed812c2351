# SPDX-License-Identifier: Apache-2.0
"""Maps of hazards known beforehand: how often they are right, and believed."""

from kbnitp_ros.core import Belief, Grid, World
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import surveyed
import numpy as np
import pytest

pytestmark = pytest.mark.slow

GRID = Grid(40, 40)
WORLD = World.random(GRID, np.random.default_rng(3), 0.15, 0.8, 0.1)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)


def test_a_map_is_right_as_often_as_told_and_believed_as_often_as_trusted():
    cells = np.arange(1, GRID.cells)
    for survey, trusted in ((0.7, 0.0), (0.9, 0.0), (0.5, 0.8)):
        belief = surveyed(PRIOR, WORLD, Strategy(survey=survey, trusted=trusted), 1, 2)
        told = belief.hazard[cells] > 0.15
        assert (told == WORLD.hazard[cells]).mean() == pytest.approx(survey, abs=0.04)
        odds = (trusted or survey) / (1 - (trusted or survey))
        expected = np.where(told, odds, 1 / odds) * 0.15 / 0.85
        assert belief.hazard[cells] == pytest.approx(expected / (1 + expected))
        assert belief.kappa == pytest.approx(PRIOR.kappa)
        assert belief.hazard[0] == 0.0
    assert surveyed(PRIOR, WORLD, Strategy(), 1, 2) is PRIOR


def test_a_better_map_is_wrong_only_where_a_poorer_one_is():
    wrong = [
        (surveyed(PRIOR, WORLD, Strategy(survey=survey), 1, 2).hazard > 0.15) != WORLD.hazard
        for survey in (0.7, 0.9)
    ]
    assert (wrong[0] | ~wrong[1])[1:].all()
