# SPDX-License-Identifier: Apache-2.0
"""Actions of the operator, and the state that they set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import takewhile
from math import inf
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.messages.deployments import path_message, read_path
from kbnitp_ros.messages.headers import (
    header,
    LAST_NAME,
    MAX_REASON,
    read_choice,
    read_header,
    shown,
)
import numpy as np
from numpy.typing import NDArray
import yaml

if TYPE_CHECKING:
    from kbnitp_msgs import msg


class Action(IntEnum):
    """The kind of an operator's action, as in kbnitp_msgs/OperatorAction."""

    PAUSE = 1
    RESUME = 2
    APPROVE = 3
    REFUSE = 4
    GIVE_UP = 5
    END = 6
    SET = 7
    START = 8
    REACHED = 9
    GOAL_LOST = 10
    NO_GO = 11
    LIFT = 12
    TAKE_BACK = 13


# Description of each action.
WORDS = {
    Action.PAUSE: 'the operator paused the mission',
    Action.RESUME: 'the operator ended the pause',
    Action.APPROVE: 'the operator approved of the paths of',
    Action.REFUSE: 'the operator refused the paths of',
    Action.GIVE_UP: 'the operator gave up',
    Action.END: 'the operator ended the mission',
    Action.SET: 'the operator set',
    Action.START: 'the operator started the planner with',
    Action.REACHED: 'the goal was reached:',
    Action.GOAL_LOST: 'the goal no longer held',
    Action.NO_GO: 'the operator closed cells',
    Action.LIFT: 'the operator opened cells',
    Action.TAKE_BACK: 'the operator took back the order of',
}
OF_ROBOTS = (Action.APPROVE, Action.REFUSE, Action.GIVE_UP, Action.TAKE_BACK)
# Maximum number of cells that a description names.
MAX_NAMED = 10
OF_CELLS = (Action.NO_GO, Action.LIFT)
OF_PARAMETERS = (Action.SET, Action.START, Action.REACHED)


@dataclass(frozen=True, eq=False)
class OperatorAction:
    """An action of the operator."""

    # Time of the action, nanoseconds of ROS time, different for each action.
    stamp: int
    action: Action
    # Number of robots sent before the action.
    robots_left: int
    # Paths of the robots concerned.
    paths: Mapping[DeploymentKey, NDArray[np.intp]] = field(default_factory=dict)
    # Minimum number of steps survived, for a robot that is given up.
    steps_survived: int = 0
    # Hashes of the reports that were heard of a robot that is given up.
    settled: tuple[int, ...] = ()
    # Values of parameters of the planner, by name; of REACHED those of the goal.
    parameters: Mapping[str, Any] = field(default_factory=dict)
    # Cells that are closed or opened.
    cells: tuple[int, ...] = ()
    # Why cells are closed or opened, or an order is taken back, and who says so.
    reason: str = ''
    author: str = ''

    def __str__(self) -> str:
        """Return a description of the action."""
        robots = ', '.join(map(str, self.paths))
        contact = f', last contact after step {self.steps_survived}'
        link = 'is' if self.action == Action.REACHED else 'to'
        values = ', '.join(f'{name} {link} {value!r}' for name, value in self.parameters.items())
        said = ', '.join(map(shown, filter(None, [self.reason, self.author])))
        cells = ', '.join(map(str, self.cells[:MAX_NAMED]))
        cells += ' ...' * (len(self.cells) > MAX_NAMED)
        parts = [WORDS[self.action], robots, values, cells, f'({said})' * bool(said)]
        return ' '.join(filter(None, parts)) + (contact if self.steps_survived else '')

    @property
    def refusal(self) -> str:
        """Return the reason with which an agent refuses an order that is taken back."""
        said = f': {self.reason}' if self.reason else ''
        return f'taken back by {self.author or "the operator"}{said}'[:MAX_REASON]


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
        settled=[*action.settled],
        parameters=[
            yaml.safe_dump({name: value}, default_flow_style=True, width=inf).strip()
            for name, value in action.parameters.items()
        ],
        cells=[*action.cells],
        reason=action.reason,
        author=action.author,
    )


def read_action_name(message: Any) -> int:
    """Return the stamp of an action, which identifies the action, in nanoseconds."""
    return read_header(message, LAST_NAME)


def read_operator_action(grid: Grid, message: Any) -> OperatorAction:
    """Convert a kbnitp_msgs/OperatorAction."""
    stamp = read_action_name(message)
    action = read_choice('action', message.action, Action)
    if len(message.agents) != len(message.paths):
        raise ValueError(f'agents has {len(message.agents)} names for {len(message.paths)} paths')
    if bool(message.agents) != (action in OF_ROBOTS):
        needed = 'agents' if action in OF_ROBOTS else 'no agents'
        raise ValueError(
            f'agents is {shown(", ".join(message.agents))}: {action.name} must have {needed}'
        )
    paths = dict(
        read_path(grid, agent, path) for agent, path in zip(message.agents, message.paths)
    )
    for path in paths.values():
        grid.check_any_path(path)
    settled = tuple(int(each) for each in message.settled)
    if settled and action is not Action.GIVE_UP:
        raise ValueError(
            f'settled names {len(settled)} reports, and action is {action.name}: only GIVE_UP '
            'settles a deployment'
        )
    if bool(message.parameters) != (action in OF_PARAMETERS):
        raise ValueError(
            f'parameters has {len(message.parameters)} values, and action is {action.name}'
        )
    if bool(message.cells) != (action in OF_CELLS):
        raise ValueError(f'cells has {len(message.cells)} cells, and action is {action.name}')
    cells = tuple(map(int, message.cells))
    if max(cells, default=0) >= grid.cells:
        raise ValueError(f'cells has {max(cells)}, off the map of {grid.cells} cells')
    return OperatorAction(
        stamp,
        action,
        int(message.robots_left),
        paths,
        int(message.steps_survived),
        settled,
        read_parameters(message.parameters),
        cells,
        message.reason,
        message.author,
    )


def read_parameters(texts: Iterable[str]) -> dict[str, Any]:
    """Return the values of parameters in 'NAME: VALUE' texts."""
    values: dict[str, Any] = {}
    for text in texts:
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ValueError(f'parameters has {shown(text)}: it must be YAML: {error}') from error
        if not isinstance(value, dict) or len(value) != 1 or value.keys() & values.keys():
            raise ValueError(f'parameters has {shown(text)}: it must be NAME: VALUE, each once')
        values |= value
    return values


# Maximum number of resumed pauses, of refused proposals, of changed no-go areas, and of orders
# taken back, in a mission, so that endless calls fill neither the planner's memory nor the disk.
MAX_TIMES = 1000
REPEATED = (Action.RESUME, Action.REFUSE, *OF_CELLS, Action.TAKE_BACK)

Paths = Mapping[DeploymentKey, NDArray[np.intp]]


class OperatorState:
    """The state set by the operator's actions so far."""

    def __init__(self) -> None:
        # All actions by time, in order.
        self.actions: dict[int, OperatorAction] = {}
        # Whether departures are paused.
        self.is_paused = False
        # Parameters of the goal that was reached; empty without one. A goal with other ones is
        # another goal, which a person chose.
        self.reached: Mapping[str, Any] = {}
        # Whether the goal was reached and no longer is, and nobody has resumed the mission since.
        self.is_goal_lost = False
        # Cells that no robot is sent into, in order.
        self.no_go: tuple[int, ...] = ()
        # Whether the operator has ended the mission.
        self.is_ended = False
        # Robots given up, each with the action.
        self.given_up: dict[DeploymentKey, OperatorAction] = {}
        # Orders taken back, each with the action: void once their agents have refused them.
        self.taken_back: dict[DeploymentKey, OperatorAction] = {}
        # Values of parameters that the operator set, and those given at the last start.
        self.settings: dict[str, Any] = {}
        self.given: dict[str, Any] = {}

    @property
    def is_holding(self) -> bool:
        """Return whether departures are held."""
        return self.is_paused or self.is_goal_lost or self.is_ended

    def apply(self, action: OperatorAction) -> bool:
        """Apply an action; return whether it is new."""
        if action.stamp in self.actions:
            return False
        self.actions[action.stamp] = action
        if action.action in (Action.PAUSE, Action.RESUME):
            self.is_paused = action.action == Action.PAUSE
            self.is_goal_lost &= self.is_paused
        elif action.action == Action.GIVE_UP:
            self.given_up |= dict.fromkeys(action.paths, action)
        elif action.action == Action.TAKE_BACK:
            self.taken_back |= dict.fromkeys(action.paths, action)
        elif action.action == Action.SET:
            self.settings |= action.parameters
        elif action.action == Action.START:
            # A value that a later start gives anew outranks what was set before.
            for name, value in action.parameters.items():
                if name in self.given and self.given[name] != value:
                    self.settings.pop(name, None)
            self.given = dict(action.parameters)
        elif action.action in (Action.REACHED, Action.GOAL_LOST):
            self.reached = action.parameters
            self.is_goal_lost = action.action == Action.GOAL_LOST
        elif action.action == Action.NO_GO:
            self.no_go = tuple(sorted({*self.no_go, *action.cells}))
        elif action.action == Action.LIFT:
            self.no_go = tuple(sorted({*self.no_go} - {*action.cells}))
        elif action.action == Action.END:
            self.is_ended, self.is_goal_lost, self.reached = True, False, {}
        return True

    def refused(self, robots_left: int) -> list[list[NDArray[np.intp]]]:
        """Return the paths of each round that was refused since the last robot left."""
        return [
            list(each.paths.values())
            for each in self.actions.values()
            if each.action == Action.REFUSE and each.robots_left == robots_left
        ]

    def is_approved(self, robots_left: int, paths: Paths) -> bool:
        """Return whether paths were approved since the last robot left."""
        # Paths are compared without stamps, which differ if a search found the same plan again.
        sent = {key.agent: path.tolist() for key, path in paths.items()}
        # An order that was taken back is approved anew.
        actions = reversed(self.actions.values())
        return any(
            each.action == Action.APPROVE
            and each.robots_left == robots_left
            and sent == {key.agent: path.tolist() for key, path in each.paths.items()}
            for each in takewhile(lambda each: each.action != Action.TAKE_BACK, actions)
        )
