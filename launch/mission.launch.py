# SPDX-License-Identifier: Apache-2.0
"""Launch a mission, recorded unless told not to, and in RViz if told to."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, SetEnvironmentVariable, Shutdown
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
            'params_file',
            default_value=PathJoinSubstitution([SHARE, 'config', 'mission.yaml']),
            description='YAML file with the parameters of the nodes.',
        ),
        DeclareLaunchArgument(
            'record',
            default_value='true',
            choices=SWITCH,
            description='Whether to record the mission, to the file that the parameters name.',
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
    nodes = [
        # First, so that nothing runs yet when it turns out not to be installed.
        Node(
            package='rviz2',
            executable='rviz2',
            arguments=['-d', PathJoinSubstitution([SHARE, 'rviz', 'mission.rviz'])],
            condition=IfCondition(LaunchConfiguration('rviz')),
        ),
        mission_node('recorder', RESUME, condition=IfCondition(LaunchConfiguration('record'))),
        mission_node('estimator', awaits=['planner']),
        mission_node('agent', RESUME | RECORDED, awaits=['planner', 'estimator']),
        mission_node('planner', RESUME, awaits=['agent', 'estimator']),
    ]
    mission = GroupAction([PushROSNamespace(LaunchConfiguration('namespace')), *nodes])
    return LaunchDescription([*arguments, discovery, mission])


def mission_node(name, own=None, awaits=(), condition=None):
    """Return a node that the mission cannot go on without; it also awaits the recorder, if any."""
    own = dict(own or {})
    if awaits:
        recorded, alone = str([*awaits, 'recorder']), str(awaits)
        nodes = IfElseSubstitution(LaunchConfiguration('record'), recorded, alone)
        own['await_nodes'] = ParameterValue(nodes, value_type=list[str])
    return Node(
        package='kbnitp_ros',
        executable=name,
        name=name,
        parameters=[LaunchConfiguration('params_file'), own],
        condition=condition,
        output='screen',
        on_exit=Shutdown(),
    )
