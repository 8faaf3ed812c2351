# SPDX-License-Identifier: Apache-2.0
"""A search for paths while the planner goes on listening."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import NamedTuple

from kbnitp_ros.base.rounds import PlannedRound


class Situation(NamedTuple):
    """
    What paths are searched for.

    Attributes
    ----------
    belief : (int, int)
        When the belief is from, in nanoseconds, and how many deployments it holds.
    agents : list of str
        Whose robots are to leave.
    refused : int
        How many rounds the operator refused in place of this one.
    changes : int
        How often parameters were changed.

    """

    belief: tuple[int, int]
    agents: list[str]
    refused: int
    changes: int

    def lasts(self, now: Situation, is_rolling: bool) -> bool:
        """Return whether robots may leave now on what was found for this."""
        # Where robots leave one by one, a belief that came meanwhile is no news.
        return (
            (is_rolling or self.belief == now.belief)
            and {*self.agents} <= {*now.agents}
            and (self.refused, self.changes) == (now.refused, now.changes)
        )


class Search:
    """
    A search for the paths of the next round, in a thread of its own.

    Compiled kernels leave Python's lock to others, and no search can be interrupted: one that is
    not wanted any more runs to its end, and nothing comes of it.

    Parameters
    ----------
    find : callable
        The search.
    situation : Situation
        What it is begun for.
    when_over : callable
        Called in that thread when it is over.

    """

    def __init__(
        self,
        find: Callable[[], PlannedRound],
        situation: Situation,
        when_over: Callable[[], object],
    ) -> None:
        self.situation = situation
        self._find = find
        self._when_over = when_over
        self._found: Future[PlannedRound] = Future()
        # A process that ends does not wait for it.
        Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        try:
            self._found.set_result(self._find())
        except BaseException as error:
            self._found.set_exception(error)
        self._when_over()

    @property
    def is_over(self) -> bool:
        """Return whether it has found paths, or that there are none."""
        return self._found.done()

    def found(self) -> PlannedRound:
        """Return what it found, once it is over; raises what the search raised."""
        return self._found.result()
