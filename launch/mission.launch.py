# SPDX-License-Identifier: Apache-2.0
"""Launch a mission of one agent or a team, recorded unless told not to, in RViz if told to."""

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

RESUME = {'resume': ParameterValue(LaunchConfiguration('resume'), value_type=str)}
RECORDED = {'recorded': ParameterValue(LaunchConfiguration('record'), value_type=bool)}


def generate_launch_description():
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
            description='The log to write; empty for the one that the parameters name.',
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
    # Nodes find each other at once, unless the user has a Fast DDS profile of their own.
    discovery = SetEnvironmentVariable(
        PROFILES,
        EnvironmentVariable(
            PROFILES, default_value=PathJoinSubstitution([SHARE, 'config', 'fastdds.xml'])
        ),
    )
    mission = GroupAction(
        [PushROSNamespace(LaunchConfiguration('namespace')), OpaqueFunction(function=nodes)]
    )
    return LaunchDescription([*arguments, discovery, mission])


def nodes(context):
    """Return the nodes, which depend on how many agents there are."""
    agents, namespace, file = (
        LaunchConfiguration(name).perform(context) for name in ('agents', 'namespace', 'file')
    )
    if not agents.isdecimal() or not int(agents):
        raise ValueError(f'agents is {agents!r}: it must be a whole number, at least 1')
    count = int(agents)
    # Robots of one name in two teams are not the same one.
    poses = [('/tf', f'/{namespace.strip("/")}/tf')] if namespace else []
    names = [f'scout_{number}' for number in range(1, count + 1)]
    team = {'agents': names}
    view = 'team.rviz' if count > 1 else 'mission.rviz'
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
            'recorder',
            RESUME | ({'file': file} if file else {}),
            condition=IfCondition(LaunchConfiguration('record')),
        ),
        mission_node('estimator', team, awaits=['planner']),
        mission_node('planner', team | RESUME | RECORDED, awaits=['agent', 'estimator']),
        *(
            mission_node(
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
    name, own, awaits=(), condition=None, namespace='', remappings=(), ends_mission=True
):
    """Return a node with these parameters of its own; it also awaits the recorder, if any."""
    own = dict(own)
    if awaits:
        recorded, alone = str([*awaits, 'recorder']), str(awaits)
        listeners = IfElseSubstitution(LaunchConfiguration('record'), recorded, alone)
        own['await_nodes'] = ParameterValue(listeners, value_type=list[str])
    return Node(
        package='kbnitp_ros',
        executable=name,
        name=name,
        namespace=namespace,
        parameters=[LaunchConfiguration('params_file'), own],
        condition=condition,
        remappings=remappings,
        output='screen',
        on_exit=Shutdown() if ends_mission else None,
    )
