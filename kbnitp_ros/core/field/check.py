# SPDX-License-Identifier: Apache-2.0
"""A base class that compares dataclasses by value, and checks of arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from functools import cache, wraps
from inspect import signature
from itertools import chain
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Longer arrays are printed with their first and last values only.
SHOWN = 24


class Value:
    """A dataclass whose equality compares its fields, arrays bit for bit."""

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


P = ParamSpec('P')
R = TypeVar('R')
T = TypeVar('T')
Array = TypeVar('Array', bound=NDArray[Any])

CORE = __name__.removesuffix('.field.check')

# Hints on how to make instances of the core's classes.
MADE_BY = {'Goal': 'Lane(...) or Area(...)'}


def typed(call: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to check arguments that are annotated with classes of the core."""
    names = tuple(signature(call).parameters)

    @cache
    def classes() -> dict[str, tuple[type, ...]]:
        hints = get_type_hints(call)
        members = {
            name: get_args(hint) if get_origin(hint) is UnionType else (hint,)
            for name, hint in hints.items()
        }
        return {
            name: kinds
            for name, kinds in members.items()
            if all(isinstance(each, type) for each in kinds)
            and all(each is NoneType or each.__module__.startswith(CORE) for each in kinds)
        }

    @wraps(call)
    def checked(*arguments: P.args, **options: P.kwargs) -> R:
        known = classes()
        for name, value in chain(zip(names, arguments), options.items()):
            if name in known and not isinstance(value, known[name]):
                kinds = [each.__name__ for each in known[name] if each is not NoneType]
                wanted = ' or '.join(MADE_BY.get(kind, f'{kind}(...)') for kind in kinds)
                raise TypeError(f'{name} is {in_short(value)}: it must be {wanted}')
        return call(*arguments, **options)

    return checked


def typed_fields(kind: type[T]) -> type[T]:
    """Check the types of a dataclass's fields, as `typed` does for arguments."""
    kind.__init__ = typed(kind.__init__)  # type: ignore[method-assign]
    return kind


def in_short(value: object) -> str:
    """Return the representation of a value, in one line."""
    words = ' '.join(repr(value).split())
    return words if len(words) <= 80 else f'{words[:76]} ...'


def check_several(name: str, values: Iterable[Any]) -> Iterable[Any]:
    """Check that `values` is a collection."""
    if not isinstance(values, Iterable):
        raise TypeError(f'{name} is {in_short(values)}: it must be a list')
    return values


def generator(rng: np.random.Generator | int) -> np.random.Generator:
    """Return a random generator, made from `rng` if that is a seed."""
    try:
        return np.random.default_rng(rng)
    except (TypeError, ValueError) as error:
        raise TypeError(
            f'rng is {in_short(rng)}: it must be a seed, at least 0, or a numpy.random.Generator'
        ) from error


def as_number(name: str, value: object) -> float:
    """Return `value` as a float if it is a number."""
    try:
        if not isinstance(value, str):
            return float(value)  # type: ignore[arg-type]
    except TypeError:
        pass
    raise TypeError(f'{name} is {value!r}: it must be a number')


def probability(name: str, value: float) -> float:
    """Return `value` as a float if it is a probability."""
    number = as_number(name, value)
    if not 0.0 <= number <= 1.0:
        raise ValueError(f'{name} is {value}: it must be a probability in [0, 1]')
    return number


def probabilities(instance: Any) -> None:
    """Convert the fields of a frozen dataclass to floats, checked to be probabilities."""
    for field in fields(instance):
        value = probability(field.name, getattr(instance, field.name))
        object.__setattr__(instance, field.name, value)


def probability_map(name: str, values: ArrayLike, cells: int | None = None) -> NDArray[np.float64]:
    """Return `values` as one probability for each cell."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or not array.size or cells not in (None, array.size):
        wanted = 'one value a cell' if cells is None else f'shape ({cells},), one value a cell'
        raise ValueError(f'{name} has shape {array.shape}: it must have {wanted}')
    bad = np.flatnonzero(~((array >= 0.0) & (array <= 1.0)))
    if bad.size:
        raise ValueError(
            f'{name} of cell {bad[0]} is {array[bad[0]]}: it must be a probability in [0, 1]'
        )
    return array


def whole_number(name: str, value: int, low: int, high: int | None = None) -> int:
    """Return `value` as an int if it is a whole number from `low` to `high`."""
    as_number(name, value)
    if not (value >= low and (high is None or value <= high) and value == value // 1):
        allowed = f'at least {low}' if high is None else f'from {low} to {high}'
        raise ValueError(f'{name} is {value}: it must be a whole number {allowed}')
    return int(value)


def cost(name: str, value: float) -> float:
    """Return a cost as a float from 0 to a billion: sums of larger costs may overflow."""
    number = as_number(name, value)
    if not 0.0 <= number <= 1e9:
        raise ValueError(f'{name} is {value}: it must be at least 0 and at most 1e9')
    return number


def yes_or_no(name: str, values: ArrayLike) -> NDArray[np.bool_]:
    """Return `values`, of any shape, as booleans."""
    array = np.array(values)
    if array.dtype == np.bool_:
        return array
    bad = ~np.asarray((array == 0) | (array == 1))
    if bad.any():
        raise ValueError(f'{name} is {array[bad].tolist()[0]}: it must be True or False')
    return array.astype(bool)


def read_only(array: Array) -> Array:
    """Return a read-only view of an array, which its owner may still change."""
    view = array.view()
    view.flags.writeable = False
    return view


def frozen(array: NDArray[np.generic]) -> None:
    """Make `array` read-only in place."""
    array.flags.writeable = False
