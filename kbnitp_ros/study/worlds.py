# SPDX-License-Identifier: Apache-2.0
"""Worlds of trials, with hazards apart, in blobs or in rows; and maps known beforehand."""

from __future__ import annotations

from collections.abc import Mapping

from kbnitp_ros.core import Belief, Grid, World
from kbnitp_ros.study.scenario import Scenario, Strategy
import numpy as np
from numpy.typing import NDArray

# Key of the generators of layouts, which no world and no robot has.
LAID_OUT = 0x4C41594F

# Key of the generators of maps, which no world and no robot has.
MAPPED = 0x4D415053

# How far neighbours of a blob reach, in cells: the standard deviation of a Gaussian kernel.
REACH = 1.0
# Hazards of a row, as far as the field has room for them.
ROW = 5


def world_of(
    scenario: Scenario,
    grid: Grid,
    truth: Mapping[str, float],
    rng: np.random.Generator,
    trial: int,
) -> World:
    """Draw the world of a trial."""
    densities = {name: truth[name] for name in vars(scenario.world)}
    if scenario.hazards.layout == 'independent':
        return World.random(grid, rng, **densities)
    own = np.random.default_rng([LAID_OUT, scenario.seed, trial])
    lay_out = {'blobs': blobs, 'rows': rows}[scenario.hazards.layout]
    count = round(densities['hazard_density'] * grid.cells)
    hazard = lay_out(grid, count, own) & grid.may_be_hazardous
    chance = np.where(hazard, densities['kappa'], densities['target_background'])
    return World(hazard, (rng.random((2, grid.cells))[1] < chance) & grid.free)


def blobs(grid: Grid, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return so many cells where a smooth Gaussian random field is highest."""
    row, column = np.divmod(np.arange(grid.cells), grid.width)
    squares = (row[:, None] - row) ** 2 + (column[:, None] - column) ** 2
    height = np.exp(-squares / (2.0 * REACH**2)) @ rng.standard_normal(grid.cells)
    hazard = np.zeros(grid.cells, np.bool_)
    hazard[np.argsort(-height)[:count]] = True
    return hazard


def rows(grid: Grid, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return so many cells in straight rows along x, y or a diagonal."""
    hazard = np.zeros((grid.height, grid.width), np.bool_)
    while hazard.sum() < count:
        up, along = rng.choice([(0, 1), (1, 0), (1, 1), (1, -1)])
        row, column = rng.integers(grid.height), rng.integers(grid.width)
        for _ in range(ROW):
            if hazard.sum() < count and 0 <= row < grid.height and 0 <= column < grid.width:
                hazard[row, column] = True
            row, column = row + up, column + along
    return hazard.ravel()


def surveyed(prior: Belief, world: World, team: Strategy, seed: int, trial: int) -> Belief:
    """Return the prior given the map that a team has of a world."""
    if not team.survey:
        return prior
    drawn = np.random.default_rng([MAPPED, seed, trial]).random(prior.cells)
    mapped = world.hazard ^ (drawn >= team.survey)
    trusted = team.trusted or team.survey
    likelihood = np.where(mapped[:, None] == [False, True], trusted, 1.0 - trusted)
    joint = prior.joint * likelihood[:, :, None]
    return Belief(joint / joint.sum(axis=(1, 2), keepdims=True))
