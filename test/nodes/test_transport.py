# SPDX-License-Identifier: Apache-2.0
"""Nodes use no shared memory, which a killed process leaves behind."""

from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import sys

from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.nodes.runtime.graph import deaf_to_server, PROFILES, udp_only
import pytest

CONFIG = Path(__file__).parents[2] / 'config'

pytestmark = pytest.mark.processes

PROGRAM = """
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node('told')
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_{what}
print('ready', flush=True)
rclpy.spin(node)
"""
TALKER = PROGRAM.format(what="publisher(String, 'told', qos).publish(String(data='{word}'))")
LISTENER = PROGRAM.format(
    what="subscription(String, 'told', lambda message: print(message.data, flush=True), qos)"
)

LOCAL = [{'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}, {'ROS_LOCALHOST_ONLY': '1'}]


def of_user(domain, **variables):
    """Return the environment of a user who has set these variables for ROS."""
    others = {name: value for name, value in os.environ.items() if not name.startswith('ROS_')}
    others.pop(PROFILES, None)
    return {**others, 'ROS_DOMAIN_ID': str(domain), **variables}


@contextmanager
def started(program, variables):
    """Yield a process that is ready, and kill it in the end."""
    process = subprocess.Popen(
        [sys.executable, '-c', program], env=variables, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == 'ready\n'
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def shared_memory(process):
    """Return which shared memory of Fast DDS a process has mapped."""
    lines = Path(f'/proc/{process.pid}/maps').read_text().splitlines()
    return {line.split()[-1] for line in lines if '/dev/shm/fastrtps' in line}


@pytest.mark.parametrize('said', LOCAL)
def test_robots_that_are_killed_leave_no_shared_memory_and_are_found_again(said):
    with free_domain() as domain:
        user = of_user(domain, **said)
        nodes = user | udp_only(user, CONFIG)
        with started(LISTENER, nodes) as listener:
            for word in ('first', 'second', 'third'):
                with started(TALKER.format(word=word), nodes) as talker:
                    assert listener.stdout.readline() == f'{word}\n'
                    assert shared_memory(talker) == set()
                    talker.send_signal(signal.SIGKILL)
            assert shared_memory(listener) == set()


def test_the_demo_uses_none_whatever_the_user_has_set(monkeypatch):
    for variables in LOCAL:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
    with free_domain() as domain, started(TALKER.format(word='a'), environment(domain)) as talker:
        assert shared_memory(talker) == set()


def test_a_tool_on_localhost_hears_nodes_without_shared_memory():
    with free_domain() as domain:
        user = of_user(domain, **LOCAL[0])
        nodes = user | udp_only(user, CONFIG)
        with started(LISTENER, user) as tool, started(TALKER.format(word='heard'), nodes):
            assert tool.stdout.readline() == 'heard\n'


def test_what_the_user_decides_is_left_alone():
    assert udp_only({PROFILES: 'mine.xml', **LOCAL[0]}, CONFIG) == {}
    for far in (
        {},
        {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'},
        LOCAL[0] | {'ROS_STATIC_PEERS': 'base'},
    ):
        assert udp_only(far, CONFIG) == {
            PROFILES: str(CONFIG / 'fastdds.xml'),
            'RMW_FASTRTPS_USE_QOS_FROM_XML': '1',
        }


def test_a_node_says_when_a_discovery_server_would_have_it_wait_for_ever(tmp_path):
    server = {'ROS_DISCOVERY_SERVER': '127.0.0.1:11811'}
    told = deaf_to_server(server)
    for client in ({}, server | {'ROS_SUPER_CLIENT': 'TRUE'}, {'ROS_SUPER_CLIENT': 'FALSE'}):
        assert not deaf_to_server(client)
    with free_domain() as domain:
        recorder = subprocess.Popen(
            [sys.executable, '-m', 'kbnitp_ros', 'recorder'],
            env=environment(domain) | server,
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert told in recorder.stderr.readline()
        finally:
            recorder.kill()
            recorder.communicate()
