# SPDX-License-Identifier: Apache-2.0
"""The update of a loss as the paper prints it."""

from __future__ import annotations

from dataclasses import replace

from kbnitp_ros.core.field.check import Floats
from kbnitp_ros.core.inference.filter import (
    condition,
    Effects,
    Evidence,
    ratio,
)
import numpy as np


def condition_published(
    joint: Floats, evidence: Evidence, effects: Effects
) -> tuple[Floats, Floats]:
    """
    Return the joints of the path's cells given a loss, as `condition` does; ln P is 0.

    The posterior (arXiv:2305.06929, Algorithm 1, lines 10-12; eq. 9-11) sums the joint of the path
    (eq. 3-5) over the steps in which the robot may have been destroyed (:eq:`loss-published`).
    Eq. 5 assumes that no cell is entered twice: here a cell that is entered n times counts n
    times, and the belief becomes overconfident.
    """
    visits = evidence.visits
    first = evidence.first
    survived = replace(visits, counts=evidence.made[first])
    joint, log_chance = condition(
        joint, replace(evidence, visits=survived, is_lost=False), effects
    )
    counts, of_step = visits.counts - survived.counts, visits.of_step[first:]
    # Eq. 5 assumes that no cell is entered twice: earlier visits to a cell do not count here.
    survives = 1.0 - effects.malfunction
    hazard = joint[:, 1].sum(axis=1)
    survives_step = (survives * (1.0 - hazard * effects.strike))[of_step]
    reached = np.cumprod(np.concatenate([np.ones_like(survives_step[:1]), survives_step[:-1]]), 0)
    destroyed = evidence.lost_in[first:, None] * reached * (1.0 - survives_step)
    # Eq. 9-11: the robot was destroyed in this cell, or in another one.
    here = np.stack(
        [np.bincount(of_step, each, minlength=counts.size) for each in destroyed.T], axis=-1
    )
    elsewhere = counts[:, None] * destroyed.sum(axis=0) - here
    of_z = survives, survives * (1.0 - effects.strike)
    likelihood = np.stack([here * (1.0 - each) + elsewhere * each for each in of_z], axis=1)
    after = joint * likelihood[:, :, None]
    total = after.sum(axis=(1, 2), keepdims=True)
    is_open = (counts > 0)[:, None, None, None]
    log_chance = np.where((total > 0.0)[counts > 0].all(axis=(0, 1, 2)), log_chance, -np.inf)
    return np.where(is_open, ratio(after, np.broadcast_to(total, after.shape)), joint), log_chance
