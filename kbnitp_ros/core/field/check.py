# SPDX-License-Identifier: Apache-2.0
"""A base class that compares dataclasses by value, and checks of arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import cache, wraps
from inspect import signature
from math import inf
from types import NoneType, UnionType
from typing import Any, get_args, get_type_hints, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

# Longer arrays are printed with their first and last values only.
MAX_PRINTED = 24


class Value:
    """A dataclass whose equality compares its fields, arrays bit for bit."""

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and bits(compared(self)) == bits(compared(other))

    def __repr__(self) -> str:
        with np.printoptions(threshold=MAX_PRINTED, edgeitems=3, precision=6):
            shown = ', '.join(f'{name}={value!r}' for name, value in compared(self).items())
        return ' '.join(f'{type(self).__name__}({shown})'.split())


def compared(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are compared, by name."""
    return {field.name: getattr(value, field.name) for field in fields(value) if field.compare}


def bits(value: Any) -> Any:
    """Return a value for comparison, with the bits of arrays and of floats."""
    if isinstance(value, np.ndarray | float):
        array = np.asarray(value)
        return array.shape, array.dtype, array.tobytes()
    if isinstance(value, Mapping):
        return {key: bits(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return [*map(bits, value)]
    return value


P = ParamSpec('P')
R = TypeVar('R')
T = TypeVar('T')

PACKAGE = __name__.partition('.')[0]

# Hints on how to make instances of the package's classes.
MADE_BY = {
    'Goal': 'Lane(...) or Area(...)',
    'SearchOptions': 'SearchOptions(max_steps=...)',
    'Results': 'Results.read(...)',
}


def typed(call: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to check arguments that are annotated with classes of the package."""
    names = tuple(signature(call).parameters)

    @cache
    def classes() -> dict[str, tuple[type, ...]]:
        known = {}
        for name, hint in get_type_hints(call).items():
            kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
            if all(each is NoneType or each.__module__.startswith(PACKAGE) for each in kinds):
                known[name] = kinds
        return known

    @wraps(call)
    def checked(*arguments: P.args, **options: P.kwargs) -> R:
        given = {**dict(zip(names, arguments)), **options}
        for name, known in classes().items():
            if name not in given:
                continue
            value = given[name]
            # Classes of goals are instances of the protocol `Goal` too.
            if isinstance(value, type) or not isinstance(value, known):
                kinds = [each.__name__ for each in known if each is not NoneType]
                wanted = ' or '.join(MADE_BY.get(kind, f'{kind}(...)') for kind in kinds)
                wanted = wanted or 'None'
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


def generator(rng: np.random.Generator | int) -> np.random.Generator:
    """Return a random generator, made from `rng` if that is a seed."""
    if isinstance(rng, np.random.Generator):
        return rng
    # numpy would wrap the old generators, and draw a seed for None.
    error: Exception | None = None
    if rng is not None and not isinstance(rng, np.random.RandomState | bool):
        try:
            return np.random.default_rng(rng)
        except (TypeError, ValueError) as refused:
            error = refused
    raise TypeError(
        f'rng is {in_short(rng)}: it must be a seed, at least 0, or a numpy.random.Generator, as '
        'numpy.random.default_rng(seed) makes it'
    ) from error


def number(name: str, value: Any, wanted: str, is_allowed: Callable[[float], bool]) -> float:
    """Return `value` as a float if it is a number that is allowed."""
    if type(value) is float and is_allowed(value):
        return value
    try:
        # A bool is a number in Python, and given for one by mistake.
        is_number = not isinstance(value, str | bool | np.bool_) and np.ndim(value) == 0
        as_float = float(value) if is_number else None
    except (TypeError, ValueError):
        as_float = None
    if as_float is None:
        raise TypeError(f'{name} is {in_short(value)}: it must be a number')
    if not is_allowed(as_float):
        raise ValueError(f'{name} is {value}: it must be {wanted}')
    return as_float


def probability(name: str, value: float) -> float:
    """Return `value` as a float if it is a probability."""
    return number(name, value, 'a probability in [0, 1]', lambda p: 0.0 <= p <= 1.0)


def cost(name: str, value: float) -> float:
    """Return a cost as a float from 0 to a billion: sums of larger costs may overflow."""
    return number(name, value, 'at least 0 and at most 1e9', lambda c: 0.0 <= c <= 1e9)


def whole_number(name: str, value: int, low: int, high: int | None = None) -> int:
    """Return `value` as an int if it is a whole number from `low` to `high`."""
    if type(value) is int and low <= value and (high is None or value <= high):
        return value
    allowed = f'at least {low}' if high is None else f'from {low} to {high}'
    most = inf if high is None else high
    number(name, value, f'a whole number {allowed}', lambda n: low <= n <= most and n == n // 1)
    return int(value)


def listed(name: str, values: Iterable[T], of: str = '') -> list[T]:
    """Return a collection as a list; `of` says of what it must be."""
    # Texts are iterable too, and arrays without dimensions claim to be.
    is_one = isinstance(values, str | bytes) or getattr(values, 'shape', None) == ()
    if is_one or not isinstance(values, Iterable):
        raise TypeError(f'{name} is {in_short(values)}: it must be a list{of}')
    return [*values]


def whole_numbers(
    name: str, values: Iterable[int], of_one: str, low: int, high: int | None = None
) -> list[int]:
    """Return a collection of whole numbers as a list; `of_one` names a single number."""
    return [whole_number(of_one, value, low, high) for value in listed(name, values)]


def cells_or_mask(name: str, given: Any, most: int | None = None) -> NDArray[np.bool_] | list[int]:
    """Return a mask as it is given, or cells as a list of numbers from 0 to `most`."""
    mask = np.array(listed(name, given), dtype=object)
    if mask.size and all(isinstance(each, bool | np.bool_) for each in mask.flat):
        return mask.astype(bool)
    return whole_numbers(name, mask.tolist(), f'{name} cell', 0, most)


def cell_numbers(name: str, given: Any, height: int, width: int) -> list[int]:
    """Return cells that are given by number, or by a mask of (cells,) or (height, width)."""
    cells = height * width
    found = cells_or_mask(name, given, cells - 1)
    if isinstance(found, np.ndarray):
        if found.shape not in ((cells,), (height, width)):
            raise ValueError(
                f'{name} is a mask of shape {found.shape}: it must be ({cells},) or '
                f'({height}, {width}), or a list of cell numbers'
            )
        return [*map(int, np.flatnonzero(found))]
    if len(found) == cells > 2 and set(found) <= {0, 1}:
        raise ValueError(f'{name} is a mask of numbers: it must be of bools, as mask.astype(bool)')
    return found


def as_array(name: str, values: Any, of: str = 'numbers') -> NDArray[Any]:
    """Return a copy of `values` as an array; `of` says of what it must be."""
    if isinstance(values, np.ma.MaskedArray) and values.mask.any():
        raise TypeError(f'{name} has masked values: give values to them, as with .filled(0)')
    try:
        return np.array(values)
    except ValueError as error:
        # Lists of different lengths.
        raise TypeError(f'{name} is {in_short(values)}: it must be an array of {of}') from error


def as_floats(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return a copy of `values` as an array of floats."""
    array = as_array(name, values)
    # numpy would read texts as numbers.
    is_text = array.dtype == object and any(isinstance(each, str | bytes) for each in array.flat)
    if array.dtype.kind in 'biufO' and not is_text:
        with suppress(TypeError, ValueError):
            return array.astype(np.float64, copy=False)
    raise TypeError(f'{name} is {in_short(values)}: it must be an array of numbers')


def probabilities(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return `values`, of any shape, as an array of probabilities."""
    array = as_floats(name, values)
    bad = array[~((array >= 0.0) & (array <= 1.0))]
    if bad.size:
        probability(name, bad[0])
    return array


def probability_map(name: str, values: ArrayLike, cells: int | None = None) -> NDArray[np.float64]:
    """Return `values` as one probability for each cell."""
    array = as_floats(name, values)
    if getattr(values, 'dtype', None) == np.bool_:
        raise TypeError(f'{name} is a mask: it must be of probabilities, as mask.astype(float)')
    if array.ndim != 1 or not array.size or cells not in (None, array.size):
        wanted = 'one value a cell' if cells is None else f'shape ({cells},), one value a cell'
        raise ValueError(f'{name} has shape {array.shape}: it must have {wanted}')
    bad = np.flatnonzero(~((array >= 0.0) & (array <= 1.0)))
    if bad.size:
        probability(f'{name} of cell {bad[0]}', array[bad[0]])
    return array


def yes_or_no(name: str, values: ArrayLike) -> NDArray[np.bool_]:
    """Return `values`, of any shape, as a copy of booleans."""
    array = as_array(name, values, 'True and False')
    if array.dtype == bool:
        return array
    bad = ~np.asarray((array == 0) | (array == 1))
    if bad.any():
        raise ValueError(f'{name} is {array[bad].tolist()[0]}: it must be True or False')
    return array.astype(bool)


def flag(name: str, value: Any) -> bool:
    """Return `value` as a bool if it is True or False."""
    array = yes_or_no(name, value)
    if array.ndim:
        raise TypeError(f'{name} is {in_short(value)}: it must be True or False')
    return bool(array)


def check_word(name: str, value: Any, allowed: Sequence[str]) -> None:
    """Check that `value` is one of some words."""
    # A tuple compares the entries of an array.
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f'{name} is {in_short(value)}: it must be one of {", ".join(allowed)}')


def on_field(name: str, cells: ArrayLike, count: int) -> NDArray[np.intp]:
    """Return `cells`, of any shape, as cells of a field of `count` cells."""
    array = as_array(name, cells, 'cells')
    if array.size and array.dtype.kind not in 'iu':
        raise TypeError(f'{name} is {in_short(cells)}: it must be of cells, whole numbers')
    off = array[(array < 0) | (array >= count)]
    if off.size:
        raise ValueError(f'{name} has the cell {off[0]}: the field has the cells 0 to {count - 1}')
    return array.astype(np.intp, copy=False)


def shallow_copy(value: T) -> T:
    """Return a shallow copy of an object, without the detours of `copy.copy`."""
    copied = object.__new__(type(value))
    copied.__dict__.update(value.__dict__)
    return copied


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of an array, which its owner may still change."""
    view = array.view()
    view.flags.writeable = False
    return view
