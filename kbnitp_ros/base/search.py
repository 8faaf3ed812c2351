# SPDX-License-Identifier: Apache-2.0
"""A search for paths while the planner goes on listening."""

from __future__ import annotations

from concurrent.futures import Future
from typing import NamedTuple

from kbnitp_ros.base.rounds import PlannedRound


class SearchRequest(NamedTuple):
    """What paths are searched for."""

    # When the belief is from, in nanoseconds, and how many deployments it holds.
    belief: tuple[int, int]
    # Whose robots are to leave.
    agents: list[str]
    # How many rounds the operator refused in place of this one.
    refused: int
    # How often parameters were changed.
    changes: int

    def lasts(self, now: SearchRequest, is_rolling: bool) -> bool:
        """Return whether robots may leave now on what was found for this."""
        # Where robots leave one by one, a belief that came meanwhile is no news.
        return (
            (is_rolling or self.belief == now.belief)
            and {*self.agents} <= {*now.agents}
            and (self.refused, self.changes) == (now.refused, now.changes)
        )


class Search(NamedTuple):
    """A search for the paths of the next round."""

    request: SearchRequest
    found: Future[PlannedRound]
