# SPDX-License-Identifier: Apache-2.0
"""
The goals: what a mission is to make sure of.

A goal says how probably it is reached, and which flight brings it nearest. A new one is one file
and one line here, or an entry point of another package. Without one, which is 'map', robots are
sent where the most is to be learnt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast, Protocol, runtime_checkable

from kbnitp_ros.core.decision.area import Area
from kbnitp_ros.core.decision.decision import Decision
from kbnitp_ros.core.decision.flights import Flight, Situation
from kbnitp_ros.core.decision.hazard_draws import HazardDraws
from kbnitp_ros.core.decision.lane import Lane
from kbnitp_ros.core.field import Grid, SensorModel
from kbnitp_ros.plugins import Registry, takes


@runtime_checkable
class Goal(Protocol):
    """
    What a mission is to make sure of.

    Attributes
    ----------
    name : str
        That of its kind.
    confidence : float or None
        The probability at which it is reached and the mission is over; None: the mission goes on.

    """

    @property
    def name(self) -> str: ...

    @property
    def confidence(self) -> float | None: ...

    def check(self, grid: Grid, max_steps: int) -> None:
        """Refuse a field, with a ValueError, on which it cannot be reached."""

    def decide(
        self, grid: Grid, draws: HazardDraws, model: SensorModel, max_steps: int
    ) -> Decision:
        """Return what may be relied on."""

    def flight(self, situation: Situation) -> Flight | None:
        """Return the flight of the next robot; None if it may make none."""


# Makes a goal of cells and a confidence; none to map the field.
MakeGoal = Callable[[Sequence[int], 'float | None'], 'Goal | None']


def as_goal(given: object) -> MakeGoal:
    """Return what makes goals, to be registered."""
    takes(given, ('cells', 'confidence'))
    return cast(MakeGoal, given)


def lane_to(cells: Sequence[int], confidence: float | None) -> Lane:
    """Return the goal of a lane to a cell."""
    if len(cells) != 1:
        raise ValueError(f'goal lane has {len(cells)} cells: it must be the one that it leads to')
    return Lane(cells[0], confidence)


def whole_map(cells: Sequence[int], confidence: float | None) -> None:
    """Return no goal: robots are sent where the most is to be learnt."""
    for name, given in (('cells', list(cells)), ('a confidence', confidence)):
        if given:
            raise ValueError(
                f'goal map has no such thing as {name}, and it is {given}: choose the goal lane '
                'or area, or give none'
            )


GOALS = Registry('goal', as_goal, {'map': whole_map, 'lane': lane_to, 'area': Area})
