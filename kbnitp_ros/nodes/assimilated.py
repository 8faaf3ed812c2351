# SPDX-License-Identifier: Apache-2.0
"""Which evidence each belief of an estimator names."""

from __future__ import annotations

from collections.abc import Sequence

from kbnitp_ros.core import deployment_order, DeploymentKey, Ledger

# One of so many beliefs names all that it holds, so that a reader who lost one can go on.
COMPLETE_EVERY = 64


class NewEvidence:
    """What was assimilated since the belief before."""

    # A report that replaces another leaves the number of deployments as it was, so the belief
    # after it names all that it holds.

    def __init__(self) -> None:
        self._keys: set[DeploymentKey] = set()
        self._published = 0
        # What the next belief adds to; 0 if it is to be complete.
        self._since = 0
        self._until_complete = COMPLETE_EVERY

    def add(self, key: DeploymentKey) -> None:
        """Take note of a deployment whose report was assimilated."""
        self._keys.add(key)

    def name_all(self) -> None:
        """Have the next belief name all that it holds."""
        self._since = 0

    def take(self, ledger: Ledger) -> tuple[int, Sequence[DeploymentKey]]:
        """Return what the belief of a ledger, which is published next, says of its evidence."""
        since, held = self._since, len(ledger.deployments)
        named = sorted(self._keys, key=deployment_order) if since else ledger.deployments
        self._until_complete = (self._until_complete if since else COMPLETE_EVERY) - 1
        has_grown = held > self._published
        self._since = held if has_grown and self._until_complete else 0
        self._published = held
        self._keys.clear()
        return since, named
