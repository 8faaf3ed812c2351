# SPDX-License-Identifier: Apache-2.0
"""Compare a recorded message with a computed one, field by field and bit for bit."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# The array fields that are maps, and how many values they have for each cell.
VALUES_PER_CELL = {'hazard': 1, 'target': 1, 'kappa': 1, 'joint': 4, 'data': 1}


@dataclass(frozen=True)
class Difference:
    """
    A field that is not as computed.

    Attributes
    ----------
    field : str
        Which one, such as 'info.width'.
    text : str
        How it differs.
    largest : float
        Largest absolute difference of an array's values; NaN if there is none to be taken.
    cell : int or None
        Where in a map that is.

    """

    field: str
    text: str
    largest: float = nan
    cell: int | None = None

    def __str__(self) -> str:
        return f'{self.field} {self.text}'


def differences(recorded: Any, computed: Any) -> Iterator[Difference]:
    """
    Yield where a recorded message differs.

    Parameters
    ----------
    recorded : object
        As decoded from a log.
    computed : ROS message
        Its fields are the ones compared.

    """
    # A field that an earlier version of the type did not have yet says what it says by default.
    default = type(computed)()
    for name in computed.get_fields_and_field_types():
        theirs, ours = getattr(recorded, name, getattr(default, name)), getattr(computed, name)
        yield from differences_of_field(name, theirs, ours)


def differences_of_field(name: str, theirs: Any, ours: Any) -> Iterator[Difference]:
    """Yield where a recorded field differs from the computed one."""
    if hasattr(ours, 'get_fields_and_field_types'):
        for difference in differences(theirs, ours):
            yield replace(difference, field=f'{name}.{difference.field}')
    elif isinstance(ours, array):
        yield from array_differences(name, theirs, ours)
    elif isinstance(ours, list) and len(theirs) == len(ours):
        for index, elements in enumerate(zip(theirs, ours)):
            yield from differences_of_field(f'{name}[{index}]', *elements)
    elif isinstance(ours, list):
        yield Difference(name, f'has {len(theirs)} values, computed are {len(ours)}')
    elif theirs != ours:
        yield Difference(name, f'is {theirs!r}, computed is {ours!r}')


def content(message: Any, like: Any) -> tuple[Any, ...]:
    """
    Return what is in a message: equal for messages that do not differ, whoever decoded them.

    Parameters
    ----------
    message : object
        As decoded from a log, or a ROS message.
    like : ROS message
        One of its type.

    """
    return tuple(
        content_of_field(getattr(message, name), getattr(like, name))
        for name in like.get_fields_and_field_types()
    )


def content_of_field(value: Any, like: Any) -> Any:
    """Return what is in a field, arrays as their bytes."""
    if hasattr(like, 'get_fields_and_field_types'):
        return content(value, like)
    if isinstance(like, list):
        return tuple(value)
    return np.asarray(value, like.typecode).tobytes() if isinstance(like, array) else value


def array_differences(name: str, theirs: ArrayLike, ours: array[Any]) -> Iterator[Difference]:
    """Yield the worst difference of two arrays, if there is any."""
    recorded, computed = np.asarray(theirs, dtype=ours.typecode), np.asarray(ours)
    if recorded.size != computed.size:
        yield Difference(name, f'has {recorded.size} values, computed are {computed.size}')
        return
    differ = recorded.view(np.uint8) != computed.view(np.uint8)
    differ = differ.reshape(computed.size, computed.itemsize).any(axis=1)
    if not differ.any():
        return
    gap = np.abs(np.subtract(recorded, computed, dtype=np.float64))
    worst = int(np.argmax(np.where(differ, gap, -1.0)))
    cell = worst // VALUES_PER_CELL[name] if name in VALUES_PER_CELL else None
    place = f'value {worst}' if cell is None else f'cell {cell}'
    yield Difference(
        name,
        f'differs in {differ.sum()} values, by up to {gap[worst]:.3g} in {place} '
        f'({recorded[worst]}, computed is {computed[worst]})',
        float(gap[worst]),
        cell,
    )
