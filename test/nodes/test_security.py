# SPDX-License-Identifier: Apache-2.0
"""The security policies allow each node what it does in the graph, and nothing else."""

from collections import defaultdict
from contextlib import suppress
import os
import subprocess
from xml.etree import ElementTree

from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.cli.demo import observed
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid
import numpy as np
from policies import FILES, FOLDER, in_graph, not_allowed, not_used, read_policy
import pytest
import rclpy
from rclpy._rclpy_pybind11 import NodeNameNonExistentError
from rosgraph_msgs.msg import Clock
from samples import GRID
from tf2_msgs.msg import TFMessage

# All that a parameter can have a node publish or listen to; the map tells the field.
PARAMETERS = {
    'map_topic': '/map', 'max_steps': 6, 'robots': 4, 'planner': 'relaxed', 'publish_pose': True,
    'publish_truth': True, 'recorded': True, 'seed': 1, 'step_period': 0.05,
}  # fmt: skip
LEARNING = {'method': 'kappa_bnitp_sampled', 'learn.numbers': ['lethality'], 'filter.type': 0}


class Watched:
    """What nodes have had in the graph so far, beside what their policies allow."""

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
        """Say whether a node has listened to a topic when `is_all_used` looked."""
        return topic in self._found[name]['subscribe']

    def is_all_used(self):
        """Look at the graph once more; say whether the nodes have had all that is allowed."""
        for name in self._allowed:
            # One that has not started yet has nothing.
            with suppress(NodeNameNonExistentError):
                for verb, names in in_graph(self._node, name).items():
                    self._found[name][verb] |= names
        for name, namespace, enclave in self._node.get_node_names_and_namespaces_with_enclaves():
            self._enclaves[f'{namespace.rstrip("/")}/{name}'] = enclave
        return not any(not_used(self._found[name], rules) for name, rules in self._allowed.items())

    def compare(self):
        """See that policies and graph agree."""
        for name, rules in self._allowed.items():
            found = self._found[name]
            assert self._enclaves.get(name) == name
            assert not not_used(found, rules), f'{name} is allowed what it does not do'
            assert not not_allowed(found, rules), f'{name} does what it is not allowed'


def publish_map(field):
    """Publish the map that the nodes wait for."""
    publisher = field.node.create_publisher(OccupancyGrid, '/map', qos.LATCHED)
    publisher.publish(occupancy_grid(GRID, np.zeros(GRID.cells), 0))


def watch(field, watched):
    """Wait until the nodes have had in the graph what their policies allow, and compare."""
    with suppress(AssertionError):
        field.until(watched.is_all_used, 'full use of the policies', patience=30.0)
    watched.compare()


@pytest.mark.full
def test_the_policies_allow_what_the_nodes_of_a_mission_do_and_nothing_else(field):
    publish_map(field)
    # The recorder is to ask for the parameters of a node, as long as that has no answer.
    silent = rclpy.create_node(
        'silent', context=field.node.context, start_parameter_services=False
    )
    # It records these as well, of which a mission alone has none.
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
    # It takes its place from the one or the other.
    field.kill('/scout_2/robot')
    place = {'position': 'fix', 'datum': [52.0, 5.0, 0.0]}
    field.start('robot', mission | robot | place, '/scout_2', own)
    watch(field, watched)
    field.until(lambda: reports, 'report')
    watched.is_all_used()
    watched.compare()
    silent.destroy_node()


def test_the_policies_allow_what_a_team_and_the_demo_do_and_nothing_else(field):
    publish_map(field)
    team = PARAMETERS | {'recorded': True, 'agents': ['scout_1', 'scout_2']}
    watched = Watched(field.node, ['all_agents', 'observer', 'planner'])
    for name in ('estimator', 'planner', 'agent'):
        field.start(name, team)
    with observed(int(os.environ['ROS_DOMAIN_ID']), team['agents']):
        watch(field, watched)


def test_each_node_has_a_policy():
    assert {path.name.partition('.')[0] for path in FILES} == {
        *('planner', 'estimator', 'recorder', 'agent', 'all_agents', 'robot', 'observer')
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
            for each in topics_of(verb, name)
        }
        # By this topic nodes tell each other what they publish and listen to.
        graph = {(verb, 'ros_discovery_info') for verb in ('publish', 'subscribe')}
        assert granted == wanted | graph


def signed_grant(keystore, enclave):
    """Return what the keystore grants an enclave, once its signature is verified."""
    verify = ['openssl', 'smime', '-verify']
    verify += ['-in', str(keystore / 'enclaves' / enclave.strip('/') / 'permissions.p7s')]
    verify += ['-CAfile', str(keystore / 'public' / 'permissions_ca.cert.pem')]
    text = subprocess.run(verify, check=True, capture_output=True).stdout.decode()
    # The headers of a mail come before it.
    (grant,) = ElementTree.fromstring(text.partition('\r\n\r\n')[2]).iter('grant')
    return grant


def topics_of(verb, name):
    """Yield what of the middleware's topics a node publishes and subscribes to, by a rule."""
    ends = {'request': ('publish', 'subscribe'), 'reply': ('subscribe', 'publish')}
    if verb in ends:
        sends, takes = ends[verb]
        yield sends, f'rq{name}Request'
        yield takes, f'rr{name}Reply'
    elif verb == 'call':
        for service in ('cancel_goal', 'get_result', 'send_goal'):
            yield from topics_of('request', f'{name}/_action/{service}')
        for topic in ('feedback', 'status'):
            yield 'subscribe', f'rt{name}/_action/{topic}'
    else:
        yield verb, f'rt{name}'
