# SPDX-License-Identifier: Apache-2.0
"""What the message means that tells of the numbers that are learnt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import Ledger
from kbnitp_ros.messages.fields import Fields, filled
from kbnitp_ros.messages.headers import check_frame, header_fields
import numpy as np

if TYPE_CHECKING:
    from kbnitp_msgs.msg import ModelBelief

# Per cent.
QUANTILES = (5, 25, 50, 75, 95)


@dataclass(frozen=True)
class Known:
    """What is known of a number after some deployments."""

    # Its mean and standard deviation.
    mean: float
    sd: float
    # One for each of `QUANTILES`.
    quantiles: tuple[float, ...]
    # As many independent draws would tell the mean as well.
    effective_samples: float


def model_fields(ledger: Ledger, stamp: int) -> Fields:
    """Return the fields of the message that goes with a belief of this stamp, in nanoseconds."""
    parameters = ledger.estimator.parameters.values()
    return Fields(
        header=header_fields(stamp),
        deployments=len(ledger.deployments),
        name=list(ledger.estimator.parameters),
        mean=np.array([each.mean for each in parameters]),
        sd=np.array([each.sd for each in parameters]),
        effective_sample_size=np.array([each.effective_samples for each in parameters]),
        **{
            f'quantile_{percent}': np.array([each.quantile(percent / 100) for each in parameters])
            for percent in QUANTILES
        },
    )


def model_belief(ledger: Ledger, stamp: int) -> ModelBelief:
    """Return the message of `model_fields`."""
    from kbnitp_msgs.msg import ModelBelief

    return filled(ModelBelief(), model_fields(ledger, stamp))


def read_model_belief(message: Any) -> dict[str, Known]:
    """Return what a kbnitp_msgs/ModelBelief says, by the names of the numbers."""
    check_frame('header.frame_id', message.header.frame_id)
    fields = ('mean', 'sd', *(f'quantile_{each}' for each in QUANTILES), 'effective_sample_size')
    values = {field: list(getattr(message, field)) for field in fields}
    for field, each in values.items():
        if len(each) != len(message.name):
            raise ValueError(
                f'{field} has {len(each)} values: it must have one for each of the '
                f'{len(message.name)} names'
            )
    return {
        name: Known(mean, sd, tuple(quantiles), samples)
        for name, mean, sd, *quantiles, samples in zip(message.name, *values.values())
    }
