# SPDX-License-Identifier: Apache-2.0
"""Dataclasses with arrays that compare and print like values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

# Longer arrays are printed with their first and last values only.
SHOWN = 24


class Value:
    """A dataclass that equals another of its class if all fields do, arrays bit for bit."""

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and all(
            is_equal(getattr(self, name), getattr(other, name)) for name in names(self)
        )

    def __repr__(self) -> str:
        with np.printoptions(threshold=SHOWN, edgeitems=3, precision=6):
            shown = ', '.join(f'{name}={getattr(self, name)!r}' for name in names(self))
        return ' '.join(f'{type(self).__name__}({shown})'.split())


def names(value: Any) -> list[str]:
    """Return the names of the fields of a dataclass that are compared."""
    return [field.name for field in fields(value) if field.compare]


def is_equal(one: Any, other: Any) -> bool:
    """Return whether two fields are equal, arrays and numbers bit for bit."""
    if isinstance(one, np.ndarray | float) and isinstance(other, np.ndarray | float):
        one, other = np.asarray(one), np.asarray(other)
        same_shape: bool = one.shape == other.shape and one.dtype == other.dtype
        return same_shape and one.tobytes() == other.tobytes()
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return False
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(is_equal(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(is_equal, one, other))
    return bool(one == other)
