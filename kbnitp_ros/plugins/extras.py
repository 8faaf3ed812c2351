# SPDX-License-Identifier: Apache-2.0
"""Packages that only a part of this one needs, and pip installs as an extra."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Name the extra that brings what is imported, where it is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        words = f"No module named {error.name!r}; pip install 'kbnitp_ros[{name}]'"
        raise ModuleNotFoundError(words, name=error.name) from None
