# SPDX-License-Identifier: Apache-2.0
"""How laws are run over cases, and how a broken one is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from kbnitp_ros.core import Belief
from kbnitp_ros.plugins import Registry
import numpy as np
from numpy.typing import NDArray

Subject = TypeVar('Subject')
Case = TypeVar('Case')

# How far numbers may be apart that are the same but for rounding.
ROUNDING = 1e-9


def hold(
    registry: Registry[Subject],
    given: object,
    laws: Mapping[str, Callable[[Subject, Case], None]],
    draw: Callable[[int], Case],
    cases: int,
    seed: int,
) -> None:
    """See that laws hold in cases that are drawn of seeds, as many as `cases`, from `seed` on."""
    name = f'{registry.kind} {given!r}'
    if isinstance(given, str):
        subject = registry.find(given)
    else:
        try:
            subject = registry.check(given)
        except (TypeError, ValueError) as error:
            raise AssertionError(f'{name} is none: {error}') from error
    for number in range(seed, seed + cases):
        case = draw(number)
        for law, check in laws.items():
            try:
                check(subject, case)
            except Exception as error:
                words = str(error) if type(error) is AssertionError else with_type(error)
                raise AssertionError(
                    f'{name} breaks a law in the case of seed {number}: {law}. {words}'
                ) from error


def require(holds: bool | np.bool_, words: str) -> None:
    """Raise an AssertionError unless something holds; `assert` is left out by python -O."""
    if not holds:
        raise AssertionError(words)


def require_close(
    found: NDArray[np.float64], expected: NDArray[np.float64], words: str, within: float = ROUNDING
) -> None:
    """Raise an AssertionError that shows where two arrays, of one shape, are further apart."""
    require(
        found.shape == expected.shape,
        f'{words}: the shape is {found.shape}, and it must be {expected.shape}',
    )
    off = ~(np.abs(found - expected) <= within)
    if off.any():
        place = tuple(int(index) for index in np.argwhere(off)[0])
        raise AssertionError(
            f'{words}: at {list(place)} it is {found[place]}, and it must be {expected[place]}'
        )


def require_same(one: Belief, other: Belief, words: str) -> None:
    """Raise an AssertionError that shows where two beliefs have other bits."""
    if one.joint.tobytes() != other.joint.tobytes():
        require_close(one.joint, other.joint, words, 0.0)
        raise AssertionError(f'{words}: the bits differ')


def with_type(error: Exception) -> str:
    """Return an error with its type."""
    return f'{type(error).__name__}: {error}'
