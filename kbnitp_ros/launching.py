# SPDX-License-Identifier: Apache-2.0
"""Common parts of the launch files: arguments, nodes that are restarted, and the mission's end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import os
from pathlib import Path
import signal
from tempfile import mkdtemp
from types import MappingProxyType
from typing import Any

from kbnitp_ros.cli.layout import write_views
from kbnitp_ros.configuration import node_parameters, with_defaults
from kbnitp_ros.configuration.given import check_counts, read_sections, values_for
from kbnitp_ros.configuration.starts import awaited_nodes, DEFAULTS, OPTIONS, parameters_for
from kbnitp_ros.files import nearest, share
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
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, PushROSNamespace

# Exit codes of processes stopped by ros2 launch: negative if the signal arrived before the process
# handled signals; 255, from asyncio, if the process had just ended.
ENDED = (0, -signal.SIGINT, -signal.SIGTERM, 255)

# Exit codes of nodes that are not restarted: their work is done, or they cannot start.
FINAL = (0, 2)

RESPAWN_DELAY = 2.0  # Seconds.

# Arguments besides parameters, of all launch files and of those of missions: default, description.
ARGUMENTS = {
    'namespace': ('', 'Namespace of the mission, the same for its base and its robots.'),
    'params_file': (
        str(share('config/mission.yaml')),
        'YAML file with the parameters of the nodes, the same for a base and its robots.',
    ),
}
OF_MISSIONS = {
    'record': ('true', 'Whether to record the mission.'),
    'file': (
        '',
        'Log to write. Empty: the file named in params_file, or else runs/TIME/mission.mcap.',
    ),
    'resume': ('', 'Log of an interrupted mission to resume; empty for a new mission.'),
    'rviz': ('false', 'Whether to show the mission in RViz.'),
}
SWITCHES = {'record': ['true', 'false'], 'rviz': ['true', 'false']}

PARAMETERS = node_parameters('robot') | node_parameters('estimator') | node_parameters('planner')


def description(
    kind: str,
    own: Mapping[str, tuple[str, str]],
    nodes: Callable[[Launch], Iterable[Action]],
    **defaults: str,
) -> LaunchDescription:
    """Return the description of a launch file of a kind, with arguments of its own."""
    # Launch handles SIGINT itself.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: None)
    empty = 'Empty: the value in params_file.'
    arguments = {
        **own,
        **ARGUMENTS,
        **({} if kind == 'robot' else OF_MISSIONS),
        **{
            name: (defaults.get(name, ''), f'{PARAMETERS[name].description} {empty}')
            for name in OPTIONS[kind]
        },
    }

    def start(context: LaunchContext) -> list[Action]:
        check_arguments(context, arguments)
        return list(nodes(Launch(kind, context, arguments)))

    space = PushROSNamespace(LaunchConfiguration('namespace'))
    # DDS over UDP without shared memory, unless the user has a Fast DDS profile.
    transport = udp_only(os.environ, share('config'))
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    name, default_value=default, choices=SWITCHES.get(name), description=what
                )
                for name, (default, what) in arguments.items()
            ),
            *(SetEnvironmentVariable(*each) for each in transport.items()),
            GroupAction([space, OpaqueFunction(function=start)]),
        ]
    )


def check_arguments(context: LaunchContext, names: Iterable[str]) -> None:
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


class Launch:
    """The nodes that the arguments of a launch file describe."""

    def __init__(self, kind: str, context: LaunchContext, names: Iterable[str]) -> None:
        self._kind = kind
        self.given = {name: LaunchConfiguration(name).perform(context) for name in names}
        # Evaluated here, since a restarted node is outside the groups of launch files.
        self._namespace = context.launch_configurations.get('ros_namespace', '').strip('/')
        self._sections = read_sections(self.given['params_file'])
        self._options = {
            name: PARAMETERS[name].read(text)
            for name in OPTIONS[kind]
            if (text := self.given[name])
        }
        self._failures: list[str] = []
        self.agents = agents_named(self.given.get('agents', '')) or list(
            self._values('planner').get('agents', PARAMETERS['agents'].default)
        )
        # The log that restarted nodes resume.
        self._log: Path | None = None
        if self.given.get('record') == 'true':
            file = self.given['file'] or self._values('recorder').get('file')
            self._log = Path(self.given['resume'] or file or new_log())

    def _values(self, node: str) -> dict[str, Any]:
        """Return the values of the parameter file for a node of this mission."""
        return values_for(self._sections, self.full_name(node))

    def full_name(self, *names: str) -> str:
        """Return the full name of something in the namespace of the mission."""
        return '/' + '/'.join(filter(None, [self._namespace, *names]))

    @property
    def poses(self) -> list[tuple[str, str]]:
        """Return the remapping of poses, which separates equally named robots of two teams."""
        return [('/tf', self.full_name('tf'))] if self._namespace else []

    def base(self) -> list[Action]:
        """Return the nodes of the base, and RViz."""
        said, log = self._values('estimator') | self._values('planner'), self._log
        added = DEFAULTS[self._kind]
        # As many numbers as the method learns. In the field the estimator has defaults of its own.
        values = with_defaults('estimator', said | self._options, added)
        learnt = (
            {} if values['defaults'] == 'field' else {'learn.numbers': values['learn.numbers']}
        )
        added = {name: value for name, value in added.items() if name != 'learn.numbers'} | learnt
        # The shipped file has all defaults, which its users need not mean.
        self._options = {
            name: value
            for name, value in added.items()
            if said.get(name) in (None, PARAMETERS[name].default)
        } | self._options
        if log:
            views = log / 'mission' if log.is_dir() else log.with_suffix('')
        else:
            views = Path(mkdtemp()) / 'mission'
        views.parent.mkdir(parents=True, exist_ok=True)
        view, _ = write_views(views, self._namespace, self.agents)
        rviz = Node(
            package='rviz2', executable='rviz2', arguments=['-d', str(view)], remappings=self.poses
        )
        return [
            # RViz first, so that no node has started if RViz is not installed.
            *([rviz] if self.given['rviz'] == 'true' else []),
            *([LogInfo(msg=f'recording to {log}')] if log else []),
            *([self.node('recorder', {'file': str(log)})] if log else []),
            self.node('estimator'),
            self.node('planner'),
        ]

    def node(
        self,
        name: str,
        own: Mapping[str, Any] = MappingProxyType({}),
        *,
        namespace: str = '',
        remappings: Sequence[tuple[str, str]] = (),
        ends_mission: bool = True,
    ) -> Node:
        """Return a node, which is restarted if it can resume; its executable has the same name."""
        log, params_file = self._log, self.given['params_file']
        full_name = self.full_name(namespace, name)
        given = (
            {}
            if self._kind == 'robot'
            else {
                'agents': self.agents,
                'resume': self.given['resume'],
                'recorded': log is not None,
                'await_nodes': awaited_nodes(name, is_recorded=log is not None),
            }
        )
        given = parameters_for(name, given | self._options) | {**own}
        check_counts(self._sections, full_name, full_name, given)
        # Launch takes no empty lists as values of parameters.
        empty = [each for each, value in given.items() if value in ((), [])]
        rules = [word for each in empty for word in ('-p', f'{name}:{each}:=[]')]
        filled = {each: value for each, value in given.items() if each not in empty}

        def make(again: dict[str, str]) -> Node:
            return Node(
                package='kbnitp_ros',
                executable=name,
                name=name,
                namespace=self.full_name(namespace),
                parameters=[params_file, filled | again],
                remappings=remappings,
                ros_arguments=['--enclave', full_name, *rules],
                output='screen',
                on_exit=end,
            )

        def restart(_: LaunchContext) -> list[Node]:
            return [make({'resume': str(log) if log.exists() else ''} if log else {})]

        def end(event: Any, context: LaunchContext) -> Shutdown | TimerAction | None:
            """Handle the node's end: restart it or end the mission; raise if a node failed."""
            may_restart = (log or self._kind == 'robot') and not context.is_shutdown
            if may_restart and event.returncode not in FINAL:
                actions = [OpaqueFunction(function=restart)]
                return TimerAction(period=RESPAWN_DELAY, actions=actions)
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

        return make({})


def agents_named(given: str) -> list[str]:
    """Return the agents of an argument, which is their number, their names, or empty."""
    if given.isdecimal() and int(given):
        return [f'scout_{number}' for number in range(1, int(given) + 1)]
    try:
        return list(PARAMETERS['agents'].check(given.split(',') if given else []))
    except ValueError as error:
        raise ValueError(
            f'agents is {given!r}: it must be a whole number, at least 1, or names with commas '
            'between them'
        ) from error
