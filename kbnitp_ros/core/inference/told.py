# SPDX-License-Identifier: Apache-2.0
"""What methods share that take the sensor model and the prior for right."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from types import MappingProxyType
from typing import ClassVar, TypeVar

from kbnitp_ros.core.field import Belief, SensorModel
from kbnitp_ros.core.inference.unknowns import Learnt

Self = TypeVar('Self', bound='Told')


class Told:
    """
    An estimate that learns of the field alone.

    Parameters
    ----------
    belief : Belief
        Before the first deployment.
    model : SensorModel
        What the robots and their sensors are believed to be like.
    _
        What only methods that learn numbers, or draw them, have a use for.

    """

    learns: ClassVar[bool] = False
    parameters: Mapping[str, Learnt] = MappingProxyType({})
    sampling_error: float = 0.0
    is_settled: bool = True

    def __init__(self, belief: Belief, model: SensorModel, *_: object) -> None:
        self.belief = belief
        self.model = model

    def copy(self: Self) -> Self:
        """Return an estimate that goes on by itself from here; no array is ever changed."""
        return copy(self)
