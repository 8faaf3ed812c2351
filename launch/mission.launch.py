# SPDX-License-Identifier: Apache-2.0
"""Launch a mission of one agent or a team, recorded unless told not to, in RViz if told to."""

import signal

from kbnitp_ros.nodes.given import read_sections
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.conditions import IfCondition
from launch.substitutions import (
    EnvironmentVariable,
    EqualsSubstitution,
    IfElseSubstitution,
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node, PushROSNamespace
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare('kbnitp_ros')
SWITCH = ['true', 'false']
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'

# How processes may end that launch was told to end: one that did not listen yet was killed, and of
# one that ended while launch was about to signal it, asyncio says 255.
ENDED = (0, -signal.SIGINT, -signal.SIGTERM, 255)

RESUME = {'resume': ParameterValue(LaunchConfiguration('resume'), value_type=str)}
RECORDED = {'recorded': ParameterValue(LaunchConfiguration('record'), value_type=bool)}


def generate_launch_description():
    hear_interrupts_once()
    arguments = [
        DeclareLaunchArgument(
            'namespace', default_value='', description='Namespace of all nodes and topics.'
        ),
        DeclareLaunchArgument(
            'agents',
            default_value='1',
            description='How many agents, each a process of its own: scout_1 and so on, whatever '
            'the parameters name.',
        ),
        DeclareLaunchArgument(
            'params_file',
            default_value=PathJoinSubstitution([SHARE, 'config', 'mission.yaml']),
            description='YAML file with the parameters of the nodes.',
        ),
        DeclareLaunchArgument(
            'record',
            default_value='true',
            choices=SWITCH,
            description='Whether to record the mission.',
        ),
        DeclareLaunchArgument(
            'file',
            default_value='',
            description='The log to write; empty for the one that the parameters name, or if they '
            'name none, runs/TIME/mission.mcap.',
        ),
        DeclareLaunchArgument(
            'resume',
            default_value='',
            description='Log of a dead mission to go on with; empty for a new mission.',
        ),
        DeclareLaunchArgument(
            'rviz',
            default_value='false',
            choices=SWITCH,
            description='Whether to show the mission in RViz.',
        ),
    ]
    # Nodes find each other at once and give memory back, unless the user has a Fast DDS profile of
    # their own.
    memory = SetEnvironmentVariable(
        'RMW_FASTRTPS_USE_QOS_FROM_XML',
        '1',
        condition=IfCondition(
            EqualsSubstitution(EnvironmentVariable(PROFILES, default_value=''), '')
        ),
    )
    discovery = SetEnvironmentVariable(
        PROFILES,
        EnvironmentVariable(
            PROFILES, default_value=PathJoinSubstitution([SHARE, 'config', 'fastdds.xml'])
        ),
    )
    mission = GroupAction(
        [PushROSNamespace(LaunchConfiguration('namespace')), OpaqueFunction(function=nodes)]
    )
    return LaunchDescription([*arguments, memory, discovery, mission])


def hear_interrupts_once():
    """
    Keep Python from raising KeyboardInterrupt, too, on signals that launch handles by itself.

    It would strike whichever task of launch runs at that moment, such as one that waits for the
    end of a node, and launch would wait for that task for ever.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: None)


def nodes(context):
    """Return the nodes, which depend on how many agents there are."""
    agents, namespace, file, params_file = (
        LaunchConfiguration(name).perform(context)
        for name in ('agents', 'namespace', 'file', 'params_file')
    )
    read_sections(params_file)
    if not agents.isdecimal() or not int(agents):
        raise ValueError(f'agents is {agents!r}: it must be a whole number, at least 1')
    count = int(agents)
    # Robots of one name in two teams are not the same one.
    poses = [('/tf', f'/{namespace.strip("/")}/tf')] if namespace else []
    names = [f'scout_{number}' for number in range(1, count + 1)]
    team = {'agents': names}
    view = 'team.rviz' if count > 1 else 'mission.rviz'
    failures = []
    return [
        # First, so that nothing runs yet when it turns out not to be installed.
        Node(
            package='rviz2',
            executable='rviz2',
            arguments=['-d', PathJoinSubstitution([SHARE, 'rviz', view])],
            condition=IfCondition(LaunchConfiguration('rviz')),
            remappings=poses,
        ),
        mission_node(
            failures,
            'recorder',
            RESUME | ({'file': file} if file else {}),
            condition=IfCondition(LaunchConfiguration('record')),
        ),
        mission_node(failures, 'estimator', team | RESUME, awaits=['planner']),
        mission_node(failures, 'planner', team | RESUME | RECORDED, awaits=['agent', 'estimator']),
        *(
            mission_node(
                failures,
                'agent',
                team | RESUME | RECORDED | {'agent': name},
                awaits=['planner', 'estimator'],
                namespace=name,
                remappings=poses,
                # The others of a team carry on.
                ends_mission=count == 1,
            )
            for name in names
        ),
    ]


def mission_node(
    failures, name, own, awaits=(), condition=None, namespace='', remappings=(), ends_mission=True
):
    """Return a node with these parameters of its own; it also awaits the recorder, if any."""
    own = dict(own)
    if awaits:
        recorded, alone = str([*awaits, 'recorder']), str(awaits)
        listeners = IfElseSubstitution(LaunchConfiguration('record'), recorded, alone)
        own['await_nodes'] = ParameterValue(listeners, value_type=list[str])

    def end(event, context):
        """End the mission with this node; with an error if any node has failed by then."""
        if event.returncode not in (ENDED if context.is_shutdown else (0,)):
            failures.append(f'{event.process_name} ended with exit code {event.returncode}')
        if failures and (ends_mission or context.is_shutdown):
            # Nothing else makes the exit code of launch another one than 0.
            told = ', '.join(failures)
            failures.clear()
            raise RuntimeError(f'the mission failed: {told}; see above what was said')
        return Shutdown() if ends_mission else None

    return Node(
        package='kbnitp_ros',
        executable=name,
        name=name,
        namespace=namespace,
        parameters=[LaunchConfiguration('params_file'), own],
        condition=condition,
        remappings=remappings,
        output='screen',
        on_exit=end,
    )
