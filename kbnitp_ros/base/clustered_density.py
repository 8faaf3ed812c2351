# SPDX-License-Identifier: Apache-2.0
"""Whether a belief in clustered hazards rests on a density that is hardly known, in words."""

from __future__ import annotations

from kbnitp_ros.core import Ledger

# A density is weakly known from this standard deviation on, as a part of its mean.
WEAK = 0.25


def density_note(ledger: Ledger) -> str:
    """Return how weakly the density of clustered hazards is known; empty if that does no harm."""
    estimator, grid = ledger.estimator, ledger.grid
    density = estimator.parameters.get('hazard_density')
    is_clustered = estimator.clustering is not None and estimator.clustering.coupling != 0.0
    if not is_clustered or density is None or density.sd < WEAK * density.mean:
        return ''
    unvisited = grid.may_be_hazardous.copy()
    for key in ledger.deployments:
        unvisited[ledger.path(key)] = False
    cells = int(grid.may_be_hazardous.sum())
    if 2 * unvisited.sum() <= cells:
        return ''
    return (
        f'hazards cluster and their density is only known as {density.mean:.2g} ± '
        f'{density.sd:.2g}, on which the belief about the {unvisited.sum()} of {cells} cells '
        'not visited rests: state it in prior.hazard or narrow learn.hazard_density'
    )
