# SPDX-License-Identifier: Apache-2.0
"""Planners and methods that a study is handed, and knows by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

from kbnitp_ros.core import METHODS, PLANNERS
from kbnitp_ros.plugins import name_of

Given = Iterable[str | Callable[..., Any]] | Mapping[str, Callable[..., Any]]


class Own(NamedTuple):
    """What a study is handed, by name."""

    # As entries of `PLANNERS`.
    planners: Mapping[str, Callable[..., Any]]
    # As entries of `METHODS`.
    methods: Mapping[str, Callable[..., Any]]

    @contextmanager
    def known(self) -> Iterator[None]:
        """Have the registries know these by their names until the ``with`` statement is left."""
        with PLANNERS.including(self.planners), METHODS.including(self.methods):
            yield


def by_name(kind: str, given: Given) -> dict[str, str | Callable[..., Any]]:
    """Return what is to be compared, of a kind told in a word, by the names that tables have."""
    if isinstance(given, Mapping):
        return dict(given)
    named: dict[str, str | Callable[..., Any]] = {}
    for each in given:
        name = name_of(each).rpartition('.')[-1]
        if name in named or not name.isidentifier():
            reason = 'it has no name' if name not in named else 'two have this name'
            raise ValueError(
                f'{kind} {name!r}: {reason}; name them, as in {kind}s={{"mine": ...}}'
            )
        named[name] = each
    return named
