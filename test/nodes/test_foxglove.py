# SPDX-License-Identifier: Apache-2.0
"""The layouts of Foxglove name what a running mission has, and nothing else."""

import json
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_ros.nodes.heard import message_class
import pytest

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[2]
LAYOUTS = {1: 'kbnitp.json', 8: 'kbnitp_team.json'}
PLACE = {'grid.width': 4, 'grid.height': 4, 'max_steps': 4, 'planner': 'relaxed', 'robots': 8}

# What panels of 3D show, by how the layout sets it.
SHOWN = {
    'colorMode': 'nav_msgs/msg/OccupancyGrid',
    'gradient': 'nav_msgs/msg/Path',
    'visible': 'visualization_msgs/msg/Marker',
}


def panels(content):
    """Yield the panels of a layout."""
    if content['type'] == 'panel':
        yield content
    for item in content.get('items', ()):
        yield from panels(item['content'])


def named(layout):
    """Return the topics that a layout names with their types or fields."""
    topics, fields = {}, {}
    for panel in panels(layout['content']):
        config = panel['config']
        for topic, settings in config.get('topics', {}).items():
            topics[topic] = next(kind for each, kind in SHOWN.items() if each in settings)
        for series in config.get('paths', ()):
            topic, _, field = series['value'].partition('.')
            fields.setdefault(topic, set()).add(field)
        if 'topicToRender' in config:
            topics[config['topicToRender']] = 'diagnostic_msgs/msg/DiagnosticArray'
    return topics, fields


@pytest.mark.parametrize('agents, name', LAYOUTS.items())
def test_a_layout_is_made_of_the_topics(agents, name):
    made = subprocess.run(
        [sys.executable, ROOT / 'tools/foxglove_layout.py', str(agents)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert made == (ROOT / 'foxglove' / name).read_text()


@pytest.mark.parametrize('agents, name', LAYOUTS.items())
def test_a_layout_names_only_what_a_running_mission_has(field, agents, name):
    topics, fields = named(json.loads((ROOT / 'foxglove' / name).read_text()))
    team = [f'scout_{number}' for number in range(1, agents + 1)]
    assert set(topics) == {
        *(f'/belief/{each}' for each in ('hazard', 'target', 'kappa')),
        *(f'/{agent}/{each}' for agent in team for each in ('path', 'readings')),
        '/decision/lane',
        '/diagnostics',
    }
    parameters = {**PLACE, 'agents': team}
    for node, awaited in (
        ('estimator', ['planner']),
        ('agent', ['planner', 'estimator']),
        ('planner', ['agent', 'estimator']),
    ):
        field.start(node, {**parameters, 'await_nodes': awaited})

    def graph():
        known = field.node.get_topic_names_and_types()
        # Who only listens to a topic does not make it one that a mission has.
        return {topic: types for topic, types in known if field.node.count_publishers(topic)}

    wanted = {*topics, *fields}
    field.until(lambda: wanted <= graph().keys(), f'topics of a mission with {agents} agents')
    types = graph()
    for topic, kind in topics.items():
        assert types[topic] == [kind]
    for topic, of_topic in fields.items():
        (kind,) = types[topic]
        assert of_topic <= message_class(kind).get_fields_and_field_types().keys()
    assert all(re.fullmatch(r'\w+', each) for of_topic in fields.values() for each in of_topic)
