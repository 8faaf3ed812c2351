# SPDX-License-Identifier: Apache-2.0
"""Registries that other packages add to through entry points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import reduce
from importlib import import_module
from importlib.metadata import entry_points, EntryPoint
from inspect import signature
import re
from types import MappingProxyType
from typing import Any, Generic, TypeVar
from warnings import warn

Entry = TypeVar('Entry')

PACKAGE = 'kbnitp_ros'
NAME = re.compile('[A-Za-z][A-Za-z0-9_]*')


class PluginError(RuntimeError):
    """What another package added breaks the rules of its kind while it is used."""


class Registry(Mapping[str, Entry], Generic[Entry]):
    """
    What there is of a kind, by name.

    Other packages add to it with entry points of the group ``kbnitp_ros.<kind>s``. They are looked
    for when a name is asked for that is not the package's own, or when all are listed. One that
    cannot be had is refused with a RuntimeWarning, and everything else works. `kind` says in one
    word what each entry is. `check` takes what is to be added, the package's own too, and returns
    it as an entry; a TypeError or ValueError says what it lacks. `gone` says of each removed name
    what to use.
    """

    def __init__(
        self,
        kind: str,
        check: Callable[[object], Entry],
        own: Mapping[str, object],
        gone: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.kind = kind
        self.check = check
        self._entries: dict[str, Entry] = {}
        self._sources: dict[str, str] = {}
        self._refused = dict(gone)
        self._is_searched = False
        for name, given in own.items():
            self._add(name, given, PACKAGE)
        # The names of the package's own.
        self.own = tuple(self._entries)

    @property
    def added(self) -> tuple[str, ...]:
        """Return the names that other packages add."""
        return tuple(name for name in self if name not in self.own)

    @property
    def refused(self) -> Mapping[str, str]:
        """Return why the names that other packages wanted to add cannot be had."""
        self._search()
        return MappingProxyType(self._refused)

    def __getitem__(self, name: str) -> Entry:
        if name not in self._entries:
            self._search()
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        # What is given as a name may be anything that YAML can say.
        return isinstance(name, str) and super().__contains__(name)

    def __iter__(self) -> Iterator[str]:
        self._search()
        return iter(self._entries)

    def __len__(self) -> int:
        self._search()
        return len(self._entries)

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    @contextmanager
    def including(self, given: Mapping[str, Any]) -> Iterator[None]:
        """
        Have entries besides until the ``with`` statement is left.

        Raises
        ------
        ValueError, TypeError
            If a name is none or taken, or what is given lacks something that an entry must have.

        """
        self._search()
        before = dict(self._entries), dict(self._sources)
        try:
            for name, each in given.items():
                try:
                    self._add(name, each, str(each.__module__))
                except (ValueError, TypeError) as error:
                    raise type(error)(f'{self.kind} {name!r}: {error}') from error
            yield
        finally:
            self._entries, self._sources = before

    def find(self, given: str | Callable[..., Any]) -> Entry:
        """
        Return the entry of a name, or what is given in place of one.

        Raises
        ------
        ValueError
            If there is none; it says which there are, or why this one is refused.
        TypeError
            If what is given lacks something that an entry must have.

        """
        if callable(given):
            try:
                return self.check(given)
            except TypeError as error:
                raise TypeError(f'{self.kind} {name_of(given)}: {error}') from error
        if given not in self:
            raise ValueError(f'{self.kind} is {given!r}: {self.why_not(given)}')
        return self[given]

    def why_not(self, name: object, *others: str) -> str:
        """Return why a name is none: it is refused, or known are only these and the others."""
        known = f'known are {", ".join((*self, *others))}'
        reason = self._refused.get(name) if isinstance(name, str) else None
        return f'{reason}; {known}' if reason else known

    def source(self, given: str | Callable[..., Any]) -> str:
        """Return where an entry comes from: the distribution and its entry point, or a module."""
        return str(given.__module__) if callable(given) else self._sources[given]

    @contextmanager
    def blamed(self, given: str | Callable[..., Any]) -> Iterator[None]:
        """
        Name the package whose entry breaks while it is used.

        Raises
        ------
        PluginError
            Of any error but a ValueError, by which entries refuse what they are given.

        """
        try:
            yield
        except (ValueError, PluginError):
            raise
        except Exception as error:
            if given in self.own:
                raise
            raise self.fault(given, f'failed: {in_words(error)}') from error

    def fault(self, given: str | Callable[..., Any], words: str) -> PluginError:
        """Return the error that says what an entry did wrong."""
        return PluginError(
            f'{self.kind} {name_of(given)!r} of {self.source(given)} {words}; '
            f'kbnitp_ros.testing.check_{self.kind} finds such faults'
        )

    def _search(self) -> None:
        """Look for what other packages add, once."""
        if self._is_searched:
            return
        # One that asks for the names while it is imported sees those that there are by then.
        self._is_searched = True
        points = sorted(
            entry_points(group=f'{PACKAGE}.{self.kind}s'), key=lambda each: (each.name, of(each))
        )
        count = Counter(point.name for point in points)
        for point in points:
            try:
                if count[point.name] > 1:
                    others = [of(each) for each in points if each.name == point.name]
                    raise ValueError(f'{" and ".join(others)} have one of this name')
                self._add(point.name, loaded(point), of(point))
            # A module may raise anything, and end the process, when it is imported.
            except (Exception, SystemExit) as error:
                reason = f'it is refused, of {of(point)}: {in_words(error)}'
                self._refused[point.name] = reason
                warn(f'{self.kind} {point.name!r}: {reason}', RuntimeWarning, stacklevel=4)

    def _add(self, name: str, given: object, source: str) -> None:
        if not NAME.fullmatch(name):
            raise ValueError('its name must be letters, digits and _, and begin with a letter')
        if name in self._entries:
            raise ValueError(f'{self._sources[name]} has a {self.kind} of this name')
        self._entries[name] = self.check(given)
        self._sources[name] = source


def name_of(given: str | Callable[..., Any]) -> str:
    """Return the name of an entry, or of what is given in place of one."""
    if isinstance(given, str):
        return given
    return str(getattr(given, '__qualname__', type(given).__qualname__))


def takes(given: object, arguments: Iterable[str]) -> None:
    """
    Check that something can be called with so many arguments.

    Raises
    ------
    TypeError
        If not.

    """
    names = tuple(arguments)
    how = f'it must be callable with ({", ".join(names)})'
    if not callable(given):
        raise TypeError(f'it is {given!r}: {how}')
    try:
        signature(given).bind(*names)
    # Some builtins have no signature.
    except (TypeError, ValueError) as error:
        raise TypeError(f'{how}: {error}') from error


def loaded(point: EntryPoint) -> object:
    """Return what an entry point stands for."""
    module = import_module(point.module)
    return reduce(getattr, filter(None, point.attr.split('.')), module)


def of(point: EntryPoint) -> str:
    """Return the distribution that an entry point is of, and what it says."""
    whose = f'{point.dist.name} {point.dist.version}' if point.dist else 'a distribution'
    return f'{whose} (entry point {point.name} = {point.value})'


def in_words(error: BaseException) -> str:
    """Return an error as one line, with its type unless it is of those that checks raise."""
    words = ' '.join(str(error).split())
    return words if type(error) in (ValueError, TypeError) else f'{type(error).__name__}: {words}'
