# SPDX-License-Identifier: Apache-2.0
"""Compare a recorded message with computed fields: bit for bit, or up to rounding."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from hashlib import blake2b
from math import nan
from typing import Any

from kbnitp_ros.messages.fields import Fields
import numpy as np
from numpy.typing import ArrayLike, NDArray

# The array fields that are maps, and how many values they have for each cell.
VALUES_PER_CELL = {'hazard': 1, 'target': 1, 'kappa': 1, 'joint': 4, 'data': 1}


@dataclass(frozen=True)
class Difference:
    """A field that is not as computed."""

    # Which one, such as 'info.width'.
    field: str
    # How it differs.
    text: str
    # Largest absolute difference of its numbers; NaN if there is none to be taken.
    largest: float = nan
    # Whether it is not larger than another processor's rounding makes it.
    is_rounding: bool = False
    # Where in a map that is.
    cell: int | None = None

    def __str__(self) -> str:
        return f'{self.field} {self.text}'


def differences(
    recorded: Any, computed: Fields, tolerance: float, rounded: Collection[str] = ()
) -> Iterator[Difference]:
    """Yield where a recorded message differs in the fields that were computed."""
    for name, ours in vars(computed).items():
        # Logs of earlier versions lack fields that were added.
        if not hasattr(recorded, name):
            continue
        theirs = getattr(recorded, name)
        # A number that is learnt; kappa is the name of a map as well.
        if name in rounded and np.ndim(ours) == 0:
            yield from _array_differences(name, [theirs], np.array([ours]), tolerance)
        else:
            yield from _differences_of_field(name, theirs, ours, tolerance)


def content_digest(message: Any, like: Fields) -> bytes:
    """Return a digest of the fields of a message that `like` has, arrays with the types there."""
    return blake2b(repr(list(_leaves(message, like))).encode(), digest_size=16).digest()


def _leaves(value: Any, like: Any) -> Iterator[Any]:
    if isinstance(like, Fields):
        for name, each in vars(like).items():
            if hasattr(value, name):
                yield from _leaves(getattr(value, name), each)
    elif isinstance(like, np.ndarray):
        yield np.asarray(value, like.dtype).tobytes()
    else:
        yield value


def _differences_of_field(
    name: str, theirs: Any, ours: Any, tolerance: float
) -> Iterator[Difference]:
    if isinstance(ours, Fields):
        for difference in differences(theirs, ours, tolerance):
            yield replace(difference, field=f'{name}.{difference.field}')
    elif isinstance(ours, np.ndarray):
        yield from _array_differences(name, theirs, ours, tolerance)
    elif isinstance(ours, list) and len(theirs) != len(ours):
        yield Difference(name, f'has {len(theirs)} values, computed are {len(ours)}')
    elif isinstance(ours, list):
        for index, elements in enumerate(zip(theirs, ours)):
            yield from _differences_of_field(f'{name}[{index}]', *elements, tolerance)
    # NaN differs from itself.
    elif theirs != ours and (theirs == theirs or ours == ours):
        yield Difference(name, f'is {theirs!r}, computed is {ours!r}')


def _array_differences(
    name: str, theirs: ArrayLike, ours: NDArray[Any], tolerance: float
) -> Iterator[Difference]:
    """Yield the worst difference of two arrays, if there is any."""
    recorded = np.asarray(theirs, dtype=ours.dtype)
    if recorded.size != ours.size:
        yield Difference(name, f'has {recorded.size} values, computed are {ours.size}')
        return
    differ = recorded.view(np.uint8) != ours.view(np.uint8)
    differ = differ.reshape(ours.size, ours.itemsize).any(axis=1)
    if not differ.any():
        return
    gap = np.abs(np.subtract(recorded, ours, dtype=np.float64))
    is_rounded = gap <= tolerance * np.maximum(1.0, np.abs(ours))
    # A difference that is no number is the worst.
    worst = int(np.argmax(np.where(differ, np.where(np.isnan(gap), np.inf, gap), -1.0)))
    cell = worst // VALUES_PER_CELL[name] if name in VALUES_PER_CELL else None
    place = f'value {worst}' if cell is None else f'cell {cell}'
    yield Difference(
        name,
        f'differs in {differ.sum()} values, by up to {gap[worst]:.3g} in {place} '
        f'({recorded[worst]}, computed is {ours[worst]})',
        float(gap[worst]),
        tolerance > 0.0 and bool(is_rounded[differ].all()),
        cell,
    )
