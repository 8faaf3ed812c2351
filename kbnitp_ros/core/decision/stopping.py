# SPDX-License-Identifier: Apache-2.0
"""When a mission is over before its last robot has left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kbnitp_ros.core.decision.decision import Decision, too_few_draws
from kbnitp_ros.core.decision.goals import Goal
from kbnitp_ros.core.decision.hazard_draws import DRAWS
from kbnitp_ros.core.field.check import cost, whole_number
from kbnitp_ros.core.planning.plans import Plan


@dataclass(frozen=True)
class Stop:
    """
    When to stop, besides when a goal is reached.

    Parameters
    ----------
    gain : float
        Stop when what the next robots are expected to gain is less than this for each that is
        expected to be lost: in nats of information with the goal map and of hazards in the area
        with the goal area, in probability that the best lane is free with the goal lane. 0: never.
    losses : int
        Stop when so many robots are lost. 0: never.

    Raises
    ------
    ValueError
        If a number is out of range.

    """

    gain: float = 0.0
    losses: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'gain', cost('stop.gain', self.gain))
        object.__setattr__(self, 'losses', whole_number('stop.losses', self.losses, 0))

    def check(self, goal: Goal | None, robots: int) -> None:
        """Refuse stops that contradict each other or the mission."""
        if self.losses > robots:
            raise ValueError(
                f'stop.losses is {self.losses}, and no more than robots = {robots} are sent: '
                'lower it, or raise robots'
            )
        if goal and goal.confidence and (few := too_few_draws(goal.confidence, DRAWS)):
            raise ValueError(few)

    def why(self, decision: Decision | None, lost: int) -> str:
        """Return why the mission is over now; empty if it is not."""
        if decision is not None and decision.reached:
            return (
                f'the goal {decision.goal} is reached: free of hazards with probability '
                f'{decision.p_free:.3f} (stop.confidence)'
            )
        if 0 < self.losses <= lost:
            return f'{lost} robots are lost (stop.losses)'
        return ''

    def why_not_worth(self, plans: Sequence[Plan]) -> str:
        """Return why the robots of a round are not worth sending; empty if they are."""
        gain = sum(plan.information if plan.gain is None else plan.gain for plan in plans)
        lost = sum(1.0 - plan.survival for plan in plans)
        if gain >= self.gain * lost:
            return ''
        return (
            f'the best deployment gains {gain:.3g} and loses {lost:.3g} robots: less than '
            f'{self.gain:.3g} for each (stop.gain)'
        )
