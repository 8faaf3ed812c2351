# SPDX-License-Identifier: Apache-2.0
"""In which step of its walk a robot was when its detector looked."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

# The step of a robot that is not so far within a cell that what it sees is there.
NONE = 0


@dataclass
class Span:
    """A time throughout which the robot was seen in one step."""

    # When it was seen there, in nanoseconds.
    first: int
    last: int
    # Which step of the walk, counted from 1, or `NONE`.
    step: int


class Whereabouts:
    """In which step the robot was at any time no longer ago than is kept, in nanoseconds."""

    def __init__(self, kept: int, gap: int) -> None:
        # Between two sights that are further apart than the gap the robot may have been anywhere.
        self._kept = kept
        self._gap = gap
        self._spans: deque[Span] = deque()

    def note(self, time: int, step: int) -> None:
        """Take note of the step, from 1, or `NONE`, that the robot was seen in at a time."""
        spans = self._spans
        if spans and time < spans[-1].last:
            spans.clear()
        if spans and spans[-1].step == step and time <= spans[-1].last + self._gap:
            spans[-1].last = time
        else:
            spans.append(Span(time, time, step))
        while spans[0].last < time - self._kept:
            spans.popleft()

    def step_within(self, since: int, until: int) -> int | None:
        """Return the step in which the robot was between two times, or `NONE`; None before."""
        if not self._spans or until > self._spans[-1].last:
            return None
        for span in reversed(self._spans):
            if span.first <= since:
                return span.step if until <= span.last else NONE
        return NONE
