# SPDX-License-Identifier: Apache-2.0
"""The recorder keeps on record which parameters the nodes of its mission have."""

from kbnitp_ros.configuration import parameters_of
from kbnitp_ros.log.configuration import read_parameters, RUN
from kbnitp_ros.log.read import read_metadata
import pytest
import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import String


@pytest.fixture
def log(field):
    """Start a recorder, and return the file it writes."""
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    field.until(lambda: field.told('/m/recorder', 'log'), 'log')
    return log


def until_known(field, log, node, **values):
    """Wait until a node's parameters on record have these values, and return them all."""

    def known():
        return read_parameters(log).get(node, {}).items() >= values.items()

    field.until(known, f'{values} of {node}')
    return read_parameters(log)[node]


def test_every_node_of_the_mission_is_asked(field, log):
    field.start('agent', {'seed': 2**40, 'grid.blocked': [5, 6], 'sensor.lethality': 1.0}, '/m')
    agent = until_known(field, log, '/m/agent', seed=2**40)
    assert agent['grid.blocked'] == [5, 6]
    assert (agent['sensor.lethality'], type(agent['sensor.lethality'])) == (1.0, float)
    assert agent.keys() >= parameters_of('agent').keys()
    recorder = until_known(field, log, '/m/recorder', file=str(log))
    assert recorder.keys() >= parameters_of('recorder').keys()
    assert read_parameters(log).keys() == {'/m/agent', '/m/recorder'}
    assert read_metadata(log)[RUN]['rmw_implementation'] == 'rmw_fastrtps_cpp'


def test_a_change_and_a_restart_are_on_record(field, log):
    planner = field.start('planner', {'robots': 5}, '/m')
    until_known(field, log, '/m/planner', robots=5)
    client = AsyncParameterClient(field.node, '/m/planner')
    field.until(client.services_are_ready, 'parameter services')
    client.set_parameters([Parameter('robots', value=6)])
    until_known(field, log, '/m/planner', robots=6, max_visits=3)
    planner.kill()
    planner.wait()
    field.start('planner', {'robots': 7, 'max_visits': 2}, '/m')
    until_known(field, log, '/m/planner', robots=7, max_visits=2)


def test_a_node_that_does_not_answer_holds_nothing_up_and_is_left_alone(field, log):
    silent = rclpy.create_node('silent', context=field.node.context, namespace='/m')
    talker = field.talk(String, '/m/chatter')

    def asked():
        services = field.node.get_client_names_and_types_by_node('recorder', '/m')
        return '/m/silent/get_parameters' in dict(services)

    field.until(asked, 'question to the silent node')
    for number in range(20):
        talker.publish(String(data=str(number)))
    field.until(lambda: field.count('/m/recorder', 'accepted') > 20, 'messages')
    assert asked()
    field.until(lambda: not asked(), 'end of the questions')
    assert '/m/silent' not in read_parameters(log)
    silent.destroy_node()
