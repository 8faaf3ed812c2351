# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with a log."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class LogError(ValueError):
    """A file that is no mission log, a corrupt one, or parts that do not make one."""


@contextmanager
def same_types(path: str | Path) -> Iterator[None]:
    """Raise a LogError where messages of a log do not have the fields that their types have."""
    try:
        yield
    except (AttributeError, TypeError) as error:
        raise LogError(f'{path} has messages of another version of their type: {error}') from error
