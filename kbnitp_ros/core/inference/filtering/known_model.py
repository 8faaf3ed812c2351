# SPDX-License-Identifier: Apache-2.0
"""The base of methods that take the sensor model and the prior as known."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from types import MappingProxyType
from typing import ClassVar, TypeVar

from kbnitp_ros.core.field import Belief, Learnt, SensorModel

Self = TypeVar('Self', bound='KnownModel')


class KnownModel:
    """
    An inference that learns of the field alone, with a sensor model and a prior that are known.

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
    version: ClassVar[int] = 1
    dynamics: ClassVar[tuple[str, ...]] = ()
    parameters: Mapping[str, Learnt] = MappingProxyType({})
    sampling_error: float = 0.0
    is_converged: bool = True

    def __init__(self, belief: Belief, model: SensorModel, *_: object) -> None:
        self.belief = belief
        self.model = model

    def copy(self: Self) -> Self:
        """Return an inference that goes on by itself from here; no array is ever changed."""
        return copy(self)
