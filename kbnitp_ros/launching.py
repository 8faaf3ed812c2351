# SPDX-License-Identifier: Apache-2.0
"""Common parts of the launch files: arguments, the nodes of the base, and the end of a mission."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import os
from pathlib import Path
import signal
from typing import Any

from kbnitp_ros.configuration import node_parameters, Parameter
from kbnitp_ros.configuration.given import check_counts, read_sections, values_for
from kbnitp_ros.configuration.mission import learnt_by_default
from kbnitp_ros.files import nearest
from kbnitp_ros.log.files import new_log
from kbnitp_ros.nodes.runtime.graph import udp_only
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    LogInfo,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
    TimerAction,
)
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, PushROSNamespace
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare('kbnitp_ros')
SWITCH = ['true', 'false']

# Exit codes of processes stopped by ros2 launch: negative if the signal arrived before the process
# handled signals; 255, from asyncio, if the process had just ended.
ENDED = (0, -signal.SIGINT, -signal.SIGTERM, 255)

# Exit codes of nodes that are not restarted: their work is done, or they cannot start.
FINAL = (0, 2)

RESPAWN_DELAY = 2.0  # Seconds.

# Parameters that are launch arguments as well, passed to all nodes that have them.
OPTIONS = (
    'robots', 'max_steps', 'max_distance', 'planner', 'beam_width', 'max_visits', 'allocation',
    'objective', 'alpha', 'loss_cost', 'rolling', 'step_period', 'silent_loss', 'return_deadline',
    'method', 'learn.numbers', 'seed', 'approval', 'keep_running', 'defaults', 'minimum_reach',
)  # fmt: skip


def transport(context: LaunchContext) -> list[SetEnvironmentVariable]:
    """Return the actions that set the transport of the nodes."""
    config = Path(SHARE.perform(context), 'config')
    return [SetEnvironmentVariable(*each) for each in udp_only(os.environ, config).items()]


# DDS over UDP without shared memory, unless the user has a Fast DDS profile.
TRANSPORT = OpaqueFunction(function=transport)


# Arguments that all launch files of missions take: name, default, choices and description.
ARGUMENTS = (
    ('namespace', '', None, 'Namespace of all nodes and topics.'),
    (
        'params_file',
        PathJoinSubstitution([SHARE, 'config', 'mission.yaml']),
        None,
        'YAML file with the parameters of the nodes.',
    ),
    ('record', 'true', SWITCH, 'Whether to record the mission.'),
    (
        'file',
        '',
        None,
        'Log to write. Empty: the file named in params_file, or else runs/TIME/mission.mcap.',
    ),
    ('resume', '', None, 'Log of an interrupted mission to resume; empty for a new mission.'),
    ('rviz', 'false', SWITCH, 'Whether to show the mission in RViz.'),
)


def arguments_of_missions(**defaults: str) -> list[DeclareLaunchArgument]:
    """Return the arguments that all launch files of missions take, with these defaults."""
    known = node_parameters('estimator') | node_parameters('planner')
    return [
        *(
            DeclareLaunchArgument(name, default_value=default, choices=choices, description=what)
            for name, default, choices, what in ARGUMENTS
        ),
        *(launch_argument(known[name], defaults.get(name, '')) for name in OPTIONS),
    ]


def launch_argument(parameter: Parameter, default: str = '') -> DeclareLaunchArgument:
    """Return the launch argument that sets a parameter."""
    description = f'{parameter.description} Empty: the value in params_file.'
    return DeclareLaunchArgument(parameter.name, default_value=default, description=description)


def mission_description(
    arguments: Sequence[DeclareLaunchArgument],
    nodes: Callable[[MissionArguments], Iterable[Action]],
) -> LaunchDescription:
    """Return the description of a launch file, whose nodes are made from its arguments."""
    # Launch handles SIGINT itself.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: None)
    names = [argument.name for argument in arguments]

    def start(context: LaunchContext) -> list[Action]:
        check_arguments(context, names)
        return list(nodes(MissionArguments(context)))

    mission = GroupAction(
        [PushROSNamespace(LaunchConfiguration('namespace')), OpaqueFunction(function=start)]
    )
    return LaunchDescription([*arguments, TRANSPORT, mission])


def respawned(make: Callable[[], Node]) -> TimerAction:
    """Return an action that restarts a node after a pause."""
    start = OpaqueFunction(function=lambda _: [make()])
    return TimerAction(period=RESPAWN_DELAY, actions=[start])


def check_arguments(context: LaunchContext, names: Sequence[str]) -> None:
    """Check that no argument of this file is misspelt; files that include it may have more."""
    known = context.get_locals_as_dict()
    ours = Path(known['current_launch_file_path']).resolve()
    for entity in getattr(known['event'], 'launch_description', LaunchDescription()).entities:
        if not isinstance(entity, IncludeLaunchDescription):
            continue
        is_ours = Path(entity.launch_description_source.location).resolve() == ours
        for name in (str(name) for name, _ in entity.launch_arguments if is_ours):
            if name not in names and (meant := nearest(name, names)):
                raise ValueError(f'launch argument {name} is unknown: {meant}see --show-args')


class MissionArguments:
    """A mission as described by the arguments of a launch file."""

    def __init__(self, context: LaunchContext) -> None:
        self._context = context
        self._failures: list[str] = []
        # Evaluated here, since a restarted node is outside the groups of launch files.
        self._namespace = context.launch_configurations.get('ros_namespace', '').strip('/')
        self._sections = read_sections(self.argument('params_file'))
        self._options = {name: text for name in OPTIONS if (text := self.argument(name))}
        self.agents = agents_named(self.argument('agents')) or list(
            self._values('planner').get('agents', node_parameters('planner')['agents'].default)
        )
        # The log that restarted nodes resume.
        self._log: Path | None = None
        if self.argument('record') == 'true':
            file = self.argument('file') or self._values('recorder').get('file')
            self._log = Path(self.argument('resume') or file or new_log())

    def argument(self, name: str) -> str:
        """Return the value of an argument."""
        return str(LaunchConfiguration(name).perform(self._context))

    def _values(self, node: str) -> dict[str, Any]:
        """Return the values of the parameter file for a node of this mission."""
        return values_for(self._sections, self._full_name(node))

    def _full_name(self, *names: str) -> str:
        return '/' + '/'.join(filter(None, [self._namespace, *names]))

    @property
    def poses(self) -> list[tuple[str, str]]:
        """Return the remapping of poses, which separates equally named robots of two teams."""
        return [('/tf', self._full_name('tf'))] if self._namespace else []

    def base(self, **of_real_robots: str) -> list[Action]:
        """Return the nodes of the base, and RViz."""
        said, known, log = self._values('planner'), node_parameters('planner'), self._log
        self._options = {
            name: text
            for name, text in of_real_robots.items()
            if said.get(name, known[name].default) == known[name].default
        } | self._options
        numbers = self._values('estimator').get('learn.numbers')
        method = self._options.get('method') or self._values('estimator').get('method')
        learnt = learnt_by_default(method or node_parameters('estimator')['method'].default)
        if numbers is None and learnt:
            self._options = {'learn.numbers': f'[{", ".join(learnt)}]'} | self._options
        view = 'team.rviz' if len(self.agents) > 1 else 'mission.rviz'
        rviz = Node(
            package='rviz2',
            executable='rviz2',
            arguments=['-d', PathJoinSubstitution([SHARE, 'config', 'rviz', view])],
            remappings=self.poses,
        )
        return [
            # RViz first, so that no node has started if RViz is not installed.
            *([rviz] if self.argument('rviz') == 'true' else []),
            *([LogInfo(msg=f'recording to {log}')] if log else []),
            *([self.node('recorder', {'file': str(log)})] if log else []),
            self.node('estimator', awaits=['planner']),
            self.node('planner', awaits=['agent', 'estimator']),
        ]

    def node(
        self,
        name: str,
        own: dict[str, Any] | None = None,
        *,
        awaits: Sequence[str] = (),
        namespace: str = '',
        ends_mission: bool = True,
    ) -> Node:
        """Return a node of the mission; its executable has the same name."""
        known, log = node_parameters(name), self._log
        values = {
            'agents': self.agents,
            'resume': self.argument('resume'),
            'recorded': log is not None,
            'await_nodes': [*awaits, *(['recorder'] if log else [])],
        } | {each: known[each].read(text) for each, text in self._options.items() if each in known}
        given = {each: value for each, value in values.items() if each in known} | (own or {})
        # Launch takes no empty lists as values of parameters.
        filled = {each: value for each, value in given.items() if value != ()}
        empty = given.keys() - filled.keys()
        rules = [word for each in empty for word in ('-p', f'{name}:{each}:=[]')]
        full_name = self._full_name(namespace, name)
        check_counts(self._sections, full_name, full_name, given)
        params_file = self.argument('params_file')

        def end(event: Any, context: LaunchContext) -> Shutdown | TimerAction | None:
            """Handle the node's end: restart it or end the mission; raise if a node failed."""
            if log and event.returncode not in FINAL and not context.is_shutdown:
                return respawned(lambda: make(str(log) if log.exists() else ''))
            if event.returncode not in (ENDED if context.is_shutdown else (0,)):
                self._failures.append(
                    f'{event.process_name} ended with exit code {event.returncode}'
                )
            if self._failures and (ends_mission or context.is_shutdown):
                # Launch has an exit code other than 0 only after an exception.
                failures = ', '.join(self._failures)
                self._failures.clear()
                raise RuntimeError(f'the mission failed: {failures}; see the output above')
            return Shutdown() if ends_mission else None

        def make(resume: str) -> Node:
            return Node(
                package='kbnitp_ros',
                executable=name,
                name=name,
                namespace=self._full_name(namespace),
                parameters=[params_file, filled | {'resume': resume}],
                remappings=self.poses if name == 'agent' else [],
                ros_arguments=['--enclave', full_name, *rules],
                output='screen',
                on_exit=end,
            )

        return make(self.argument('resume'))


def agents_named(given: str) -> list[str]:
    """Return the agents of an argument, which is their number, their names, or empty."""
    if given.isdecimal() and int(given):
        return [f'scout_{number}' for number in range(1, int(given) + 1)]
    names = given.split(',') if given else []
    try:
        return list(node_parameters('planner')['agents'].check(names))
    except ValueError as error:
        raise ValueError(
            f'agents is {given!r}: it must be a whole number, at least 1, or names with commas '
            'between them'
        ) from error
