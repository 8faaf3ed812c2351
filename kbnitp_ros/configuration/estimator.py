# SPDX-License-Identifier: Apache-2.0
"""The estimator that the parameters describe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.configuration.agents import robot_types_of
from kbnitp_ros.configuration.models import (
    clustering_of,
    dynamics_of,
    sensor_model_of,
    unknowns_of,
)
from kbnitp_ros.configuration.prior import prior_of
from kbnitp_ros.core import Estimator, Grid


def estimator_of(values: Mapping[str, Any], grid: Grid) -> Estimator:
    """Return the estimator of these parameters on this grid, before the first deployment."""
    unknowns = unknowns_of(values)
    for name in unknowns.priors:
        if all(
            getattr(robot_type, name, None) is not None
            for robot_type in robot_types_of(values, grid).values()
        ):
            raise ValueError(
                f'parameter learn.numbers has {name}: the robots of every agent have one of their '
                'own, which tell nothing of another'
            )
    return Estimator(
        prior_of(values, grid),
        sensor_model_of(values),
        values['method'],
        unknowns,
        values['seed'],
        dynamics=dynamics_of(values),
        clustering=clustering_of(values, grid),
    )
