# SPDX-License-Identifier: Apache-2.0
"""Launch the agent of one real robot, on its own computer; it resumes from its journal."""

from kbnitp_ros.launching import description


def generate_launch_description():
    arguments = {
        'agent': ('scout_1', 'Name of the agent that this robot is.'),
        'nav_namespace': (
            '',
            "Namespace of the robot's Nav2: of its actions, tf, tf_static, fix and detections; / "
            'for none, empty for the namespace of the agent.',
        ),
    }
    return description('robot', arguments, nodes)


def nodes(robot):
    """Return the node, whose topics depend on the namespaces."""
    agent = robot.given['agent']
    nav = robot.given['nav_namespace'] or robot.full_name(agent)
    below = f'/{nav.strip("/")}'.rstrip('/')
    topics = {'/tf': 'tf', '/tf_static': 'tf_static', 'detections': 'detections', 'fix': 'fix'}
    return [
        robot.node(
            'robot',
            {'agent': agent, 'nav_namespace': nav},
            namespace=agent,
            remappings=[(topic, f'{below}/{name}') for topic, name in topics.items()],
        )
    ]
