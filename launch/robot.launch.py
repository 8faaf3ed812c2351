# SPDX-License-Identifier: Apache-2.0
"""Launch the agent of one real robot, on its own computer."""

from kbnitp_ros.configuration import node_parameters
from kbnitp_ros.configuration.given import read_sections
from kbnitp_ros.launching import (
    check_arguments,
    FINAL,
    launch_argument,
    respawned,
    SHARE,
    TRANSPORT,
)
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import (
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node

# Parameters that are arguments as well.
OPTIONS = ('journal', 'driver', 'base_frame')


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(
            'agent', default_value='scout_1', description='Name of the agent that this robot is.'
        ),
        DeclareLaunchArgument(
            'namespace', default_value='', description='Namespace of the mission, as at its base.'
        ),
        DeclareLaunchArgument(
            'nav_namespace',
            default_value='',
            description="Namespace of the robot's Nav2: of its actions, tf, tf_static, fix and "
            'detections; / for none, empty for the namespace of the agent.',
        ),
        DeclareLaunchArgument(
            'params_file',
            default_value=PathJoinSubstitution([SHARE, 'config', 'mission.yaml']),
            description='YAML file with the parameters, the same as at the base.',
        ),
        *(launch_argument(node_parameters('robot')[name]) for name in OPTIONS),
    ]
    return LaunchDescription([*arguments, TRANSPORT, OpaqueFunction(function=robot)])


def robot(context):
    """Return the node, whose topics depend on the namespaces."""
    names = ('agent', 'namespace', 'nav_namespace', 'params_file', *OPTIONS)
    check_arguments(context, names)
    given = {name: LaunchConfiguration(name).perform(context) for name in names}
    read_sections(given['params_file'])
    above = context.launch_configurations.get('ros_namespace', '')
    spaces = (above.strip('/'), given['namespace'].strip('/'), given['agent'])
    own = '/' + '/'.join(filter(None, spaces))
    nav = given['nav_namespace'] or own
    below = f'/{nav.strip("/")}'.rstrip('/')
    parameters = {'agent': given['agent'], 'nav_namespace': nav}
    parameters |= {name: given[name] for name in OPTIONS if given[name]}

    def end(event, context):
        """Restart the node if it died: it resumes from its journal."""
        is_final = event.returncode in FINAL or context.is_shutdown
        return Shutdown() if is_final else respawned(node)

    def node():
        return Node(
            package='kbnitp_ros',
            executable='robot',
            name='robot',
            namespace=own,
            parameters=[given['params_file'], parameters],
            remappings=[
                ('/tf', f'{below}/tf'),
                ('/tf_static', f'{below}/tf_static'),
                ('detections', f'{below}/detections'),
                ('fix', f'{below}/fix'),
            ],
            ros_arguments=['--enclave', f'{own}/robot'],
            output='screen',
            on_exit=end,
        )

    return [node()]
