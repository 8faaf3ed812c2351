# SPDX-License-Identifier: Apache-2.0
"""Convert ModelBelief messages: learnt numbers, kinds of hazard, and the check of the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, TYPE_CHECKING

from kbnitp_ros.core import Ledger, ModelCheck
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


class ModelState(NamedTuple):
    """Learnt numbers, kinds of hazard with their probabilities, and the check of the model."""

    numbers: dict[str, Known]
    kinds: dict[str, float]
    check: ModelCheck


NOTHING_LEARNT = ModelState({}, {}, ModelCheck(False, {}, ''))


def model_fields(ledger: Ledger, stamp: int) -> Fields:
    """Return the fields of the message that goes with a belief of this stamp, in nanoseconds."""
    estimator = ledger.estimator
    parameters, check = estimator.parameters.values(), estimator.check
    return Fields(
        header=header_fields(stamp),
        deployments=len(ledger.deployments),
        name=list(estimator.parameters),
        mean=np.array([each.mean for each in parameters]),
        sd=np.array([each.sd for each in parameters]),
        effective_sample_size=np.array([each.effective_samples for each in parameters]),
        **{
            f'quantile_{percent}': np.array([each.quantile(percent / 100) for each in parameters])
            for percent in QUANTILES
        },
        kind=list(estimator.kinds),
        kind_probability=np.array(list(estimator.kinds.values())),
        alternative=list(check.alternatives),
        alternative_ratio=np.array(list(check.alternatives.values())),
        in_doubt=check.is_in_doubt,
        reason=check.reason,
    )


def model_belief(ledger: Ledger, stamp: int) -> ModelBelief:
    """Return the message of `model_fields`."""
    from kbnitp_msgs.msg import ModelBelief

    return filled(ModelBelief(), model_fields(ledger, stamp))


def read_model_belief(message: Any) -> ModelState:
    """Return the contents of a kbnitp_msgs/ModelBelief; those of 0.3.0 have numbers alone."""
    check_frame('header.frame_id', message.header.frame_id)
    fields = ('mean', 'sd', *(f'quantile_{each}' for each in QUANTILES), 'effective_sample_size')
    values = {field: list(getattr(message, field)) for field in fields}
    for field, each in values.items():
        if len(each) != len(message.name):
            raise ValueError(
                f'{field} has {len(each)} values: it must have one for each of the '
                f'{len(message.name)} names'
            )
    numbers = {
        name: Known(mean, sd, tuple(quantiles), samples)
        for name, mean, sd, *quantiles, samples in zip(message.name, *values.values())
    }
    if not hasattr(message, 'kind'):
        return NOTHING_LEARNT._replace(numbers=numbers)
    for listed, field in (('kind', 'kind_probability'), ('alternative', 'alternative_ratio')):
        if len(getattr(message, listed)) != len(getattr(message, field)):
            raise ValueError(f'{field} must have one value for each {listed}')
    kinds = dict(zip(message.kind, message.kind_probability))
    ratios = dict(zip(message.alternative, message.alternative_ratio))
    return ModelState(numbers, kinds, ModelCheck(message.in_doubt, ratios, message.reason))
