# SPDX-License-Identifier: Apache-2.0
"""Registries of named entries: entries of this package, and plug-ins of other packages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from importlib import import_module
from importlib.metadata import entry_points, EntryPoint
from inspect import signature
from operator import attrgetter
from pathlib import Path
import sys
from typing import Any, Generic, TypeVar
from warnings import warn


def remedy(name: str) -> str:
    """Return the command that installs an extra for this copy of the package."""
    clone = Path(__file__).parents[1]
    if not (clone / 'setup.py').exists():
        # No index has the package: its name there may be somebody else's.
        return f"in a clone of kbnitp_ros: pip install '.[{name}]'"
    if name == 'study' and Path(sys.prefix) == clone / '.venv':
        return f'make study in {clone}'
    return f"pip install '{clone}[{name}]'"


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Name the extra that installs a missing import."""
    try:
        yield
    except ModuleNotFoundError as error:
        words = f'No module named {error.name!r}; {remedy(name)}'
        raise ModuleNotFoundError(words, name=error.name) from None


Entry = TypeVar('Entry')

PACKAGE = 'kbnitp_ros'


# Registries by kind.
REGISTRIES: dict[str, Registry[Any]] = {}


class PluginError(RuntimeError):
    """An entry of another package breaks the rules of its kind."""


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Entries of a kind by name: the package's own, and entry points of ``kbnitp_ros.<kind>s``."""

    def __init__(
        self,
        kind: str,
        check: Callable[[object], Entry],
        own: Mapping[str, object],
    ) -> None:
        self.kind = kind
        self.check = check
        self.own: tuple[str, ...] = ()
        self._entries: dict[str, Entry] = {}
        self._sources: dict[str, str] = {}
        self._refused: dict[str, str] = {}
        self._is_searched = False
        REGISTRIES[kind] = self
        self.fill(own)

    def fill(self, own: Mapping[str, object]) -> None:
        """Register the package's own entries."""
        self.own += tuple(own)
        self._entries |= {name: self.check(given) for name, given in own.items()}
        self._sources |= dict.fromkeys(own, PACKAGE)

    @property
    def added(self) -> tuple[str, ...]:
        """Return the names of entries from other packages."""
        return tuple(name for name in self if name not in self.own)

    @property
    def loaded(self) -> list[str]:
        """Return the names that `load` added."""
        return [name for name in self._entries if ':' in name]

    @property
    def refused(self) -> Mapping[str, str]:
        """Return the names of refused entries, with the reasons."""
        self._search()
        return self._refused

    def __getitem__(self, name: str) -> Entry:
        if isinstance(name, str) and name not in self._entries:
            self._search()
        if not isinstance(name, str) or name not in self._entries:
            raise KeyError(self.unknown(name))
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        # A YAML file may give any type for a name.
        return isinstance(name, str) and super().__contains__(name)

    def __iter__(self) -> Iterator[str]:
        self._search()
        return iter(self._entries)

    def __len__(self) -> int:
        self._search()
        return len(self._entries)

    __eq__ = object.__eq__
    __hash__ = object.__hash__

    @contextmanager
    def including(self, given: Mapping[str, Any]) -> Iterator[None]:
        """Add entries until the ``with`` statement is left."""
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

    def load(self, name: object) -> None:
        """Add ``module:name``, of a module in the working folder or installed, if it is one."""
        # Never called with a name from a log or a message: their senders could import anything.
        if not isinstance(name, str) or ':' not in name or name in self._entries:
            return
        module, _, inside = name.partition(':')
        sys.path.insert(0, folder := str(Path.cwd()))
        try:
            self._entries[name] = self.check(attrgetter(inside)(import_module(module)))
            self._sources[name] = f'the module {module}'
        # The import of a foreign module may raise anything, and end the process.
        except (Exception, SystemExit) as error:
            self._refused[name] = one_line(error)
        finally:
            sys.path.remove(folder)

    def find(self, given: str | Callable[..., Any]) -> Entry:
        """Return the entry of a name; return an entry given in place of a name unchanged."""
        if callable(given):
            check = self.check
            # Objects with arrays have no hash.
            with suppress(TypeError):
                hash(given)
                check = partial(checked, self.check)
            try:
                return check(given)
            except TypeError as error:
                raise TypeError(f'{self.kind} {entry_name(given)}: {error}') from error
        if given not in self:
            raise ValueError(self.unknown(given))
        return self[given]

    def unknown(self, name: object) -> str:
        """Return the message for a name that has no entry, in one line."""
        return f'{self.kind} is {" ".join(repr(name).split())}: {self.why_not(name)}'

    def why_not(self, name: object, *others: str) -> str:
        """Explain why a name has no entry: the name is refused, or unknown."""
        known = f'known are {", ".join((*self, *others))}'
        reason = self._refused.get(name) if isinstance(name, str) else None
        return f'{reason}; {known}' if reason else known

    @contextmanager
    def blamed(self, given: str | Callable[..., Any]) -> Iterator[None]:
        """Raise a PluginError for any error but ValueError in an entry of another package."""
        try:
            yield
        except (ValueError, PluginError):
            raise
        except Exception as error:
            if given in self.own:
                raise
            raise self.fault(given, f'failed: {one_line(error)}') from error

    def fault(self, given: str | Callable[..., Any], words: str) -> PluginError:
        """Return a PluginError that names an entry and its package."""
        source = given.__module__ if callable(given) else self._sources[given]
        return PluginError(
            f'{self.kind} {entry_name(given)!r} of {source} {words}; '
            f'kbnitp_ros.testing.check_{self.kind} finds such faults'
        )

    def _search(self) -> None:
        """Load the entry points of other packages, once."""
        if self._is_searched:
            return
        # Set first, since an imported module may request names: it gets the names found so far.
        self._is_searched = True
        points = sorted(entry_points(group=f'{PACKAGE}.{self.kind}s'), key=entry_source)
        count = Counter(point.name for point in points)
        for point in points:
            source = entry_source(point)
            try:
                if count[point.name] > 1:
                    others = [entry_source(each) for each in points if each.name == point.name]
                    raise ValueError(f'{" and ".join(others)} have the same name')
                self._add(point.name, point.load(), source)
            # The import of a foreign module may raise anything, and end the process.
            except (Exception, SystemExit) as error:
                reason = f'refused plug-in of {source}: {one_line(error)}'
                self._refused[point.name] = reason
                warn(f'{self.kind} {point.name!r}: {reason}', RuntimeWarning, stacklevel=4)

    def _add(self, name: str, given: object, source: str) -> None:
        if not name.isidentifier():
            raise ValueError('its name must be letters, digits and _, and begin with a letter')
        if name in self._entries:
            raise ValueError(f'{self._sources[name]} has a {self.kind} of this name')
        self._entries[name] = self.check(given)
        self._sources[name] = source


# Cached, since a mission finds its planner before each robot.
@lru_cache(maxsize=64)
def checked(check: Callable[[object], Entry], given: Hashable) -> Entry:
    """Return an entry that is given in place of a name, checked once."""
    return check(given)


def entry_name(given: str | Callable[..., Any]) -> str:
    """Return the name of an entry."""
    if isinstance(given, str):
        return given
    return str(getattr(given, '__qualname__', type(given).__qualname__))


def takes(given: object, arguments: Iterable[str]) -> Any:
    """Return a callable; raise a TypeError if it does not take these arguments."""
    names = tuple(arguments)
    how = f'it must be callable with ({", ".join(names)})'
    if not callable(given):
        raise TypeError(f'it is {given!r}: {how}')
    try:
        signature(given).bind(*names)
    # Some builtins have no signature.
    except (TypeError, ValueError) as error:
        raise TypeError(f'{how}: {error}') from error
    return given


def parameter_names(given: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of a callable's parameters; none if it does not tell them."""
    try:
        return tuple(signature(given).parameters)
    # Some builtins have no signature.
    except (TypeError, ValueError):
        return ()


def entry_source(point: EntryPoint) -> str:
    """Describe the distribution of an entry point, and its value."""
    whose = f'{point.dist.name} {point.dist.version}' if point.dist else 'a distribution'
    return f'{whose} (entry point {point.name} = {point.value})'


def one_line(error: BaseException) -> str:
    """Return an error as one line, with its type unless it is a ValueError or TypeError."""
    words = ' '.join(str(error).split())
    return words if type(error) in (ValueError, TypeError) else f'{type(error).__name__}: {words}'
