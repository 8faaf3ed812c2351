# SPDX-License-Identifier: Apache-2.0
"""A map of hazards that is known before the first robot leaves."""

from __future__ import annotations

from kbnitp_ros.core import Belief, World
from kbnitp_ros.study.scenario import Strategy
import numpy as np

# Key of the generators of maps, which no world and no robot has.
MAPPED = 0x4D415053


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
