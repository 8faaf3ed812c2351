# SPDX-License-Identifier: Apache-2.0
"""The evidence of one deployment on single cells, and the methods that keep nothing else."""

from kbnitp_ros.core.inference.filtering.evidence import (
    check_cells,
    condition,
)
from kbnitp_ros.core.inference.filtering.loss_likelihood import (
    can_be_lost,
    lost_likelihood,
    multi_universe_likelihood,
    published_likelihood,
)
from kbnitp_ros.core.inference.filtering.one_pass import KnownModel, OnePass
from kbnitp_ros.core.inference.filtering.used_up import hazards_used_up

__all__ = [
    'KnownModel',
    'OnePass',
    'can_be_lost',
    'check_cells',
    'condition',
    'hazards_used_up',
    'lost_likelihood',
    'multi_universe_likelihood',
    'published_likelihood',
]
