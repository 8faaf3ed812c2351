# SPDX-License-Identifier: Apache-2.0
"""How long a base waits for robots that were given up."""

from __future__ import annotations

from collections.abc import Mapping
import time
from typing import Any

from kbnitp_ros.base.deployments_in_flight import longest_absence
from kbnitp_ros.core import DeploymentKey
import numpy as np
from numpy.typing import NDArray

# How long the nodes of a base have to take in a return, in seconds.
TAKEN_IN = 5.0


class LateReturns:
    """The robots that were given up and may still come home."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = values
        self._until: dict[DeploymentKey, float] = {}

    def expect(self, key: DeploymentKey, path: NDArray[np.intp]) -> None:
        """Await a robot that was given up on a path, shape (steps + 1,)."""
        self._until[key] = time.monotonic() + longest_absence(self._values, key.agent, path)

    def end(self, key: DeploymentKey) -> None:
        """Await no robot that is home, once that has been taken in."""
        if key in self._until:
            self._until[key] = min(self._until[key], time.monotonic() + TAKEN_IN)

    @property
    def awaited(self) -> dict[DeploymentKey, float]:
        """Return the robots that may still come home, and for how many seconds."""
        now = time.monotonic()
        return {key: until - now for key, until in self._until.items() if until > now}
