# SPDX-License-Identifier: Apache-2.0
"""What is believed before the first deployment: numbers, maps, or an earlier mission's belief."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.core import Belief, Grid
from kbnitp_ros.log.evidence import last_belief
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.maps import read_probabilities

MAPS = ('hazard', 'target', 'kappa')

# In what fields must be the same for what is believed of one to be believed of the other.
SAME = ('width', 'height', 'resolution', 'origin', 'yaw', 'blocked')


def prior_of(values: Mapping[str, Any], grid: Grid) -> Belief:
    """Return the prior that the parameters of an estimator describe."""
    files = {name: values[f'prior.{name}_map'] for name in MAPS}
    log = values['prior.log']
    if log:
        if any(files.values()):
            raise ValueError(
                'parameter prior.log is given with a map of the prior: it says all of it'
            )
        return earlier_belief(log, grid)
    numbers = {name: values[f'prior.{name}'] for name in MAPS}
    maps = {
        name: read_probabilities(file, grid, numbers[name], values['prior.resample'])
        for name, file in files.items()
        if file
    }
    prior = numbers | maps
    if 'hazard' in maps and 'target' not in maps and numbers['hazard'] < 1.0:
        # The numbers say how likely a target is without a hazard, which the map leaves as it is.
        background = numbers['target'] - numbers['kappa'] * numbers['hazard']
        background = min(max(background / (1.0 - numbers['hazard']), 0.0), 1.0)
        prior['target'] = prior['kappa'] * maps['hazard'] + background * (1.0 - maps['hazard'])
    return Belief.prior(grid, **prior)


def earlier_belief(log: str, grid: Grid) -> Belief:
    """Return what a mission came to believe, of the same field."""
    known = last_belief(MissionLog(log))
    if known is None:
        raise ValueError(f'{log} has no belief on record')
    for name in SAME:
        if getattr(known.grid, name) != getattr(grid, name):
            raise ValueError(f'{log} is of a mission on {known.grid}: the parameters say {grid}')
    return known.belief.on(grid)
