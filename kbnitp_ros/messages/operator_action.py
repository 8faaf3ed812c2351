# SPDX-License-Identifier: Apache-2.0
"""What the message of an action of the operator means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.messages.deployments import path_message, read_path
from kbnitp_ros.messages.headers import check_frame, header, read_name, SECOND, shown
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from kbnitp_msgs import msg


class Action(IntEnum):
    """What an operator can do, as in kbnitp_msgs/OperatorAction."""

    PAUSE = 1
    RESUME = 2
    APPROVE = 3
    REFUSE = 4
    GIVE_UP = 5
    END = 6


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
class OperatorAction:
    """An action of the operator."""

    # When, nanoseconds of ROS time; never twice the same.
    stamp: int
    action: Action
    # How many robots had left by then.
    robots_left: int
    # Of the robots that it is about.
    paths: Mapping[DeploymentKey, NDArray[np.intp]] = field(default_factory=dict)
    # Of a robot that is given up: how many of its steps it is known to have survived.
    steps_survived: int = 0

    def __str__(self) -> str:
        """Return what was done, in words."""
        robots = ', '.join(map(str, self.paths))
        contact = f', heard of last after step {self.steps_survived}'
        return ' '.join(filter(None, [WORDS[self.action], robots])) + (
            contact if self.steps_survived else ''
        )

    @property
    def when(self) -> str:
        """Return its time as names of deployments show it."""
        return f'{self.stamp // SECOND}.{self.stamp % SECOND:09d}'


def operator_action_message(grid: Grid, action: OperatorAction) -> msg.OperatorAction:
    """Return the message of an action on this grid."""
    from kbnitp_msgs import msg

    return msg.OperatorAction(
        header=header(action.stamp),
        action=action.action,
        robots_left=action.robots_left,
        agents=[key.agent for key in action.paths],
        paths=[path_message(grid, path, key.stamp) for key, path in action.paths.items()],
        steps_survived=action.steps_survived,
    )


def read_action_name(message: Any) -> int:
    """Return the time that names an action, in nanoseconds."""
    check_frame('header.frame_id', message.header.frame_id)
    return read_name('header.stamp', message.header.stamp)


def read_operator_action(grid: Grid, message: Any) -> OperatorAction:
    """Return the action that a kbnitp_msgs/OperatorAction states."""
    stamp = read_action_name(message)
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
        grid.check_any_path(path)
    return OperatorAction(
        stamp, action, int(message.robots_left), paths, int(message.steps_survived)
    )
