# SPDX-License-Identifier: Apache-2.0
"""Security policies and Foxglove layouts name exactly what nodes have in the graph."""

from collections import defaultdict
from contextlib import suppress
from fnmatch import fnmatchcase
import json
import os
from pathlib import Path
import re
import subprocess
from threading import Thread
from types import SimpleNamespace
from xml.etree import ElementTree

from extent import some
from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.cli import demo_mission
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.nodes.recorded_topics import message_class
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid
import numpy as np
import pytest
import rclpy
from rclpy._rclpy_pybind11 import NodeNameNonExistentError
from rclpy.action import get_action_client_names_and_types_by_node
from rosgraph_msgs.msg import Clock
from samples import GRID
from tf2_msgs.msg import TFMessage

FOLDER = Path(__file__).parents[2] / 'config/security'
FILES = sorted(FOLDER.glob('*.policy.xml'))

# Query of the graph for each kind of permission.
ASKED = {
    'publish': 'get_publisher_names_and_types_by_node',
    'subscribe': 'get_subscriber_names_and_types_by_node',
    'reply': 'get_service_names_and_types_by_node',
    'request': 'get_client_names_and_types_by_node',
}


def read_policy(path, replaced=('', '')):
    """Return a policy's enclave, its node's full name, and the permissions."""
    root = ElementTree.fromstring(path.read_text().replace(*replaced))
    (enclave,) = root.iter('enclave')
    (profile,) = enclave.findall('profiles/profile')
    return enclave.get('path'), *_allowed(profile)


def _allowed(profile):
    above = profile.get('ns').rstrip('/') + '/'
    node = above + profile.get('node')
    allowed = defaultdict(set)
    for group in profile.iter():
        for verb, rule in group.items():
            if rule == 'ALLOW':
                allowed[verb] |= {_full_name(above, node, each.text) for each in group}
    return node, allowed


def _full_name(above, node, name):
    if name.startswith('~'):
        return node + name[1:]
    return name if name.startswith('/') else above + name


def in_graph(looking, full_name):
    """Return a node's endpoints in the graph as another node sees them, by permission."""
    namespace, _, name = full_name.rpartition('/')
    namespace = namespace or '/'
    found = {
        verb: {each for each, _ in getattr(looking, asked)(name, namespace)}
        for verb, asked in ASKED.items()
    }
    actions = get_action_client_names_and_types_by_node(looking, name, namespace)
    found['call'] = {each for each, _ in actions}
    # An action is several topics and services, covered by its permission.
    return {
        verb: {each for each in names if '/_action/' not in each} for verb, names in found.items()
    }


def not_allowed(found, allowed):
    """Return endpoints of a node that its policy does not allow."""
    return {
        (verb, name)
        for verb, names in found.items()
        for name in names
        if not any(fnmatchcase(name, each) for each in allowed[verb])
    }


def not_used(found, allowed):
    """Return permissions of a policy that its node does not use."""
    return {
        (verb, each)
        for verb, expressions in allowed.items()
        for each in expressions
        if not any(fnmatchcase(name, each) for name in found[verb])
    }


# All topics that parameters enable; the map gives the field.
PARAMETERS = {
    'map_topic': '/map', 'max_steps': 6, 'robots': 4, 'planner': 'relaxed', 'publish_pose': True,
    'publish_truth': True, 'recorded': True, 'seed': 1, 'step_period': 0.05, 'defaults': 'paper',
    'goal.kind': 'lane', 'goal.cells': [2],
}  # fmt: skip
LEARNING = {'method': 'kappa_bnitp_sampled', 'learn.numbers': ['lethality'], 'filter.type': 0}


class Watched:
    """Endpoints of nodes so far, compared with their policies."""

    def __init__(self, node, names, **replaced):
        self._node = node
        self._found = defaultdict(lambda: defaultdict(set))
        self._enclaves = {}
        self._allowed = {}
        for name in names:
            path = FOLDER / f'{name}.policy.xml'
            enclave, full_name, allowed = read_policy(path, replaced.get(name, ('', '')))
            assert enclave == full_name
            self._allowed[full_name] = allowed

    def hears(self, name, topic):
        """Return whether a node subscribed to a topic at the last `is_all_used`."""
        return topic in self._found[name]['subscribe']

    def is_all_used(self):
        """Scan the graph; return whether the nodes have used all permissions."""
        for name in self._allowed:
            # A node that has not started has no endpoints.
            with suppress(NodeNameNonExistentError):
                for verb, names in in_graph(self._node, name).items():
                    self._found[name][verb] |= names
        for name, namespace, enclave in self._node.get_node_names_and_namespaces_with_enclaves():
            self._enclaves[f'{namespace.rstrip("/")}/{name}'] = enclave
        return not any(not_used(self._found[name], rules) for name, rules in self._allowed.items())

    def compare(self):
        """Check that policies and graph agree."""
        for name, rules in self._allowed.items():
            found = self._found[name]
            assert self._enclaves.get(name) == name
            assert not not_used(found, rules), f'{name} is allowed what it does not do'
            assert not not_allowed(found, rules), f'{name} does what it is not allowed'


def publish_map(field):
    publisher = field.node.create_publisher(OccupancyGrid, '/map', qos.LATCHED)
    publisher.publish(occupancy_grid(GRID, np.zeros(GRID.cells), 0))


def watch(field, watched):
    """Wait until the nodes have used all permissions, and compare."""
    with suppress(AssertionError):
        field.until(watched.is_all_used, 'full use of the policies', patience=30.0)
    watched.compare()


@pytest.mark.full
def test_the_policies_allow_exactly_the_endpoints_of_a_mission(field):
    publish_map(field)
    # The recorder asks for a node's parameters until it answers.
    silent = rclpy.create_node(
        'silent', context=field.node.context, start_parameter_services=False
    )
    # It records these too, which a mission alone does not have.
    silent.create_publisher(Clock, '/clock', 1)
    silent.create_publisher(TFMessage, '/tf_static', qos.LATCHED_POSES)
    mission = PARAMETERS | LEARNING | {'agents': ['scout_1', 'scout_2']}
    reports = field.listen(DeploymentReport, '/scout_1/report')
    watched = Watched(
        field.node,
        ['recorder', 'estimator', 'planner', 'agent', 'robot'],
        robot=('scout_1', 'scout_2'),
    )
    field.start('recorder', mission | {'file': str(field.folder / 'mission.mcap')})
    for name in ('estimator', 'planner'):
        field.start(name, mission)
    field.start('agent', mission | {'agent': 'scout_1'}, '/scout_1')
    robot = {'agent': 'scout_2', 'journal': str(field.folder / 'scout_2.journal')}
    own = {f'/{name}': f'/scout_2/{name}' for name in ('tf', 'tf_static')}
    field.start('robot', mission | robot, '/scout_2', own)
    field.until(
        lambda: watched.is_all_used() or watched.hears('/scout_2/robot', '/scout_2/tf_static'),
        'robot that listens to TF',
    )
    # The robot takes its position from either.
    field.kill('/scout_2/robot')
    place = {'position': 'fix', 'datum': [52.0, 5.0, 0.0]}
    field.start('robot', mission | robot | place, '/scout_2', own)
    watch(field, watched)
    field.until(lambda: reports, 'report')
    watched.is_all_used()
    watched.compare()
    silent.destroy_node()


def test_the_policies_allow_exactly_the_endpoints_of_a_team_and_the_demo(field):
    publish_map(field)
    team = PARAMETERS | {'recorded': True, 'agents': ['scout_1', 'scout_2']}
    watched = Watched(field.node, ['all_agents', 'observer', 'planner'])
    for name in ('estimator', 'planner', 'agent'):
        field.start(name, team)
    with demo_mission.observed(int(os.environ['ROS_DOMAIN_ID'])) as observer:
        # Until a node has ended.
        ended = []
        processes = SimpleNamespace(ended=lambda: ended)
        watching = Thread(
            target=pytest.raises,
            args=(RuntimeError, demo_mission.watch, *observer, team['robots'], processes),
        )
        watching.start()
        watch(field, watched)
        ended.append('planner')
        watching.join()


def test_each_node_has_a_policy():
    assert {path.name.partition('.')[0] for path in FILES} == {
        *('planner', 'estimator', 'recorder', 'agent', 'all_agents', 'robot', 'observer'),
        'operator',
    }


@pytest.mark.processes
def test_sros2_signs_permissions_that_are_those_of_the_policies(tmp_path):
    reason = 'sros2 comes with an installation of ROS 2 only'
    artifacts = pytest.importorskip('sros2.api._artifact_generation', reason=reason)
    artifacts.generate_artifacts(tmp_path, policy_files=FILES)
    for path in FILES:
        enclave, _, allowed = read_policy(path)
        grant = signed_grant(tmp_path, enclave)
        assert grant.findtext('default') == 'DENY'
        assert grant.findtext('subject_name') == f'CN={enclave}'
        granted = {
            (verb, topic.text)
            for verb in ('publish', 'subscribe')
            for topic in grant.findall(f'allow_rule/{verb}/topics/topic')
        }
        wanted = {
            each
            for verb, names in allowed.items()
            for name in names
            for each in middleware_topics(verb, name)
        }
        # Nodes announce publishers and subscribers on this topic.
        graph = {(verb, 'ros_discovery_info') for verb in ('publish', 'subscribe')}
        assert granted == wanted | graph


def signed_grant(keystore, enclave):
    """Return the grants of an enclave in the keystore, with a verified signature."""
    verify = ['openssl', 'smime', '-verify']
    verify += ['-in', str(keystore / 'enclaves' / enclave.strip('/') / 'permissions.p7s')]
    verify += ['-CAfile', str(keystore / 'public' / 'permissions_ca.cert.pem')]
    text = subprocess.run(verify, check=True, capture_output=True).stdout.decode()
    # Headers of a mail come before it.
    (grant,) = ElementTree.fromstring(text.partition('\r\n\r\n')[2]).iter('grant')
    return grant


def middleware_topics(verb, name):
    """Yield the middleware topics that a node publishes and subscribes to under a rule."""
    ends = {'request': ('publish', 'subscribe'), 'reply': ('subscribe', 'publish')}
    if verb in ends:
        sends, takes = ends[verb]
        yield sends, f'rq{name}Request'
        yield takes, f'rr{name}Reply'
    elif verb == 'call':
        for service in ('cancel_goal', 'get_result', 'send_goal'):
            yield from middleware_topics('request', f'{name}/_action/{service}')
        for topic in ('feedback', 'status'):
            yield 'subscribe', f'rt{name}/_action/{topic}'
    else:
        yield verb, f'rt{name}'


ROOT = Path(__file__).parents[2]
LAYOUTS = {1: 'kbnitp.json', 8: 'kbnitp_team.json'}
PLACE = {'grid.width': 4, 'grid.height': 4, 'max_steps': 4, 'planner': 'relaxed', 'robots': 8}

# Topics shown by 3D panels, by layout setting.
SHOWN = {
    'colorMode': 'nav_msgs/msg/OccupancyGrid',
    'gradient': 'nav_msgs/msg/Path',
    'visible': 'visualization_msgs/msg/Marker',
}


def panels(tree):
    """Yield the names of the panels in a layout."""
    if isinstance(tree, str):
        yield tree
        return
    assert tree['direction'] in ('row', 'column')
    assert 0 < tree['splitPercentage'] < 100
    for part in ('first', 'second'):
        yield from panels(tree[part])


def named(layout):
    """Return the topics that a layout names, with their types or fields."""
    topics, fields = {}, {}
    for config in layout['configById'].values():
        for topic, settings in config.get('topics', {}).items():
            topics[topic] = next(kind for each, kind in SHOWN.items() if each in settings)
        for series in config.get('paths', ()):
            topic, _, field = series['value'].partition('.')
            fields.setdefault(topic, set()).add(field)
        if 'topicToRender' in config:
            topics[config['topicToRender']] = 'diagnostic_msgs/msg/DiagnosticArray'
    return topics, fields


@pytest.mark.processes
@pytest.mark.parametrize('agents, name', some(LAYOUTS.items(), 2))
def test_a_layout_is_made_of_the_topics_of_a_running_mission(field, agents, name):
    layout = json.loads((ROOT / 'config/foxglove' / name).read_text())
    # Lichtblick refuses a layout without these.
    assert layout.keys() >= {'configById', 'globalVariables', 'playbackConfig', 'layout'}
    assert [*panels(layout['layout'])] == [*layout['configById']]
    kinds = {panel.partition('!')[0] for panel in layout['configById']}
    assert kinds == {'3D', 'Plot', 'DiagnosticSummary'}
    topics, fields = named(layout)
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
        # A subscriber alone does not make a topic one of the mission's.
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
