# SPDX-License-Identifier: Apache-2.0
"""What came last, as much of it as may be remembered."""

from __future__ import annotations

from collections.abc import Hashable


class Recent:
    """
    A set that forgets what was added first.

    Parameters
    ----------
    size : int
        How many it remembers.

    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._added: dict[Hashable, None] = {}

    def add(self, each: Hashable) -> None:
        """Remember something; nothing is remembered twice."""
        self._added[each] = None
        while len(self._added) > self.size:
            del self._added[next(iter(self._added))]

    def discard(self, each: Hashable) -> None:
        """Forget something, if it is remembered."""
        self._added.pop(each, None)

    def __contains__(self, each: object) -> bool:
        """Say whether something is remembered."""
        return each in self._added
