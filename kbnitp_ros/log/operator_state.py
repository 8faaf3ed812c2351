# SPDX-License-Identifier: Apache-2.0
"""What holds by the actions of the operator of a mission, and which are on record."""

from __future__ import annotations

from collections.abc import Mapping

from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.operator_action import Action, OperatorAction
import numpy as np
from numpy.typing import NDArray

# How often a mission goes on after a pause, and how often proposals are refused, at the most:
# whoever calls these services for ever fills neither the memory of the planner nor the disk.
MOST_TIMES = 1000
REPEATED = (Action.RESUME, Action.REFUSE)

Paths = Mapping[DeploymentKey, NDArray[np.intp]]


class OperatorState:
    """What holds by the actions of the operator so far."""

    def __init__(self) -> None:
        # All actions by the times that name them, in order.
        self.actions: dict[int, OperatorAction] = {}
        # Whether no robot leaves for now.
        self.is_paused = False
        # Whether none leaves any more.
        self.is_ended = False
        # The robots that were given up, and how many steps each is known to have survived.
        self.given_up: dict[DeploymentKey, int] = {}

    @property
    def is_holding(self) -> bool:
        """Whether robots that were sent and have not departed stay at the base."""
        return self.is_paused or self.is_ended

    def apply(self, action: OperatorAction) -> bool:
        """Have an action hold; return whether it was not known."""
        if action.stamp in self.actions:
            return False
        self.actions[action.stamp] = action
        if action.action in (Action.PAUSE, Action.RESUME):
            self.is_paused = action.action == Action.PAUSE
        elif action.action == Action.GIVE_UP:
            self.given_up |= dict.fromkeys(action.paths, action.steps_survived)
        elif action.action == Action.END:
            self.is_ended = True
        return True

    def check_times(self, what: Action) -> None:
        """Check that an action was not taken too often."""
        times = sum(each.action == what for each in self.actions.values())
        if what in REPEATED and times >= MOST_TIMES:
            raise ValueError(
                f'{what.name} was taken {times} times, and is not again: the service end_mission '
                'ends this mission; begin another one'
            )

    def refused(self, robots_left: int) -> list[list[NDArray[np.intp]]]:
        """Return the rounds of paths that were refused since the last robot left."""
        return [
            list(each.paths.values())
            for each in self.actions.values()
            if each.action == Action.REFUSE and each.robots_left == robots_left
        ]

    def is_approved(self, robots_left: int, paths: Paths) -> bool:
        """Return whether paths were approved since the last robot left."""
        return any(
            each.action == Action.APPROVE
            and each.robots_left == robots_left
            and are_same(each.paths, paths)
            for each in self.actions.values()
        )


def are_same(ones: Paths, others: Paths) -> bool:
    """Return whether robots of the same agents go the same paths."""
    cells = [{key.agent: path.tolist() for key, path in paths.items()} for paths in (ones, others)]
    return cells[0] == cells[1]
