# SPDX-License-Identifier: Apache-2.0
"""What the message means that tells what the operator of a mission decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from kbnitp_msgs.msg import OperatorAction
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.messages.deployments import path_message, read_path
from kbnitp_ros.messages.headers import check_frame, header, read_name, SECOND, shown
import numpy as np
from numpy.typing import NDArray


class Action(IntEnum):
    """What an operator can do."""

    PAUSE = OperatorAction.PAUSE
    RESUME = OperatorAction.RESUME
    APPROVE = OperatorAction.APPROVE
    REFUSE = OperatorAction.REFUSE
    GIVE_UP = OperatorAction.GIVE_UP
    END = OperatorAction.END


# What is done, and whether it is done to robots.
WORDS = {
    Action.PAUSE: 'paused the mission',
    Action.RESUME: 'ended the pause',
    Action.APPROVE: 'approved of the paths of',
    Action.REFUSE: 'refused the paths of',
    Action.GIVE_UP: 'gave up',
    Action.END: 'ended the mission',
}
OF_ROBOTS = (Action.APPROVE, Action.REFUSE, Action.GIVE_UP)


@dataclass(frozen=True, eq=False)
class Decision:
    """
    What the operator decided.

    Attributes
    ----------
    stamp : int
        When, nanoseconds of ROS time; never twice the same.
    action : Action
        What.
    robots_left : int
        How many robots had left by then.
    paths : dict of DeploymentKey to ndarray of int
        Of the robots that it is about.
    steps_survived : int
        Of a robot that is given up: how many of its steps it is known to have survived.

    """

    stamp: int
    action: Action
    robots_left: int
    paths: Mapping[DeploymentKey, NDArray[np.intp]] = field(default_factory=dict)
    steps_survived: int = 0

    def __str__(self) -> str:
        """Return what was decided, in words."""
        robots = ', '.join(map(str, self.paths))
        contact = f', heard of last after step {self.steps_survived}'
        return ' '.join(filter(None, [WORDS[self.action], robots])) + (
            contact if self.steps_survived else ''
        )

    @property
    def when(self) -> str:
        """Return its time as names of deployments show it."""
        return f'{self.stamp // SECOND}.{self.stamp % SECOND:09d}'


def decision_message(grid: Grid, decision: Decision) -> OperatorAction:
    """Return the message of a decision on this grid."""
    return OperatorAction(
        header=header(decision.stamp),
        action=decision.action,
        robots_left=decision.robots_left,
        agents=[key.agent for key in decision.paths],
        paths=[path_message(grid, path, key.stamp) for key, path in decision.paths.items()],
        steps_survived=decision.steps_survived,
    )


def read_decision_name(message: Any) -> int:
    """
    Return the time that names a decision, in nanoseconds.

    Raises
    ------
    ValueError
        If that is none, or it is in another frame.

    """
    check_frame('header.frame_id', message.header.frame_id)
    return read_name('header.stamp', message.header.stamp)


def read_decision(grid: Grid, message: Any) -> Decision:
    """
    Return what a kbnitp_msgs/OperatorAction tells.

    Parameters
    ----------
    grid : Grid
        Where its paths are.
    message : kbnitp_msgs/OperatorAction
        As received, or as decoded from a log.

    Raises
    ------
    ValueError
        If its time or its action is none, a path is none on this grid, or there is not one of each
        agent of an action that is about robots, and of no other.

    """
    stamp = read_decision_name(message)
    if message.action not in list(Action):
        raise ValueError(f'action is {message.action}: it must be from 1 to {len(Action)}')
    action = Action(message.action)
    if len(message.agents) != len(message.paths):
        raise ValueError(f'agents has {len(message.agents)} names: paths has {len(message.paths)}')
    if bool(message.agents) != (action in OF_ROBOTS):
        raise ValueError(f'agents is {shown(", ".join(message.agents))}: action is {action.name}')
    paths = dict(
        read_path(grid, agent, path) for agent, path in zip(message.agents, message.paths)
    )
    for path in paths.values():
        grid.check_path(path)
    return Decision(stamp, action, int(message.robots_left), paths, int(message.steps_survived))
