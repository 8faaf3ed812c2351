# SPDX-License-Identifier: Apache-2.0
"""Nothing is imported, opened or run by the name of a type that somebody announces."""

import os

from bare_dds import BareParticipant, HOSTILE, not_utf8
from kbnitp_ros.log.read import is_finished, read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.nodes.heard import message_class
from kbnitp_ros.nodes.runtime import qos
import pytest
import samples
from std_msgs.msg import String

PLANTED = 'open({ran!r}, "w").close()\nraise SystemExit(7)\n'


@pytest.fixture
def planted(tmp_path, monkeypatch):
    """Have modules lie where nodes are started; return the file that they make when imported."""
    folder = tmp_path / 'started_here'
    folder.joinpath('planted/msg').mkdir(parents=True)
    ran = tmp_path / 'ran'
    for module in ('planted/__init__', 'planted/x', 'planted/srv', 'planted/msg/__init__'):
        folder.joinpath(f'{module}.py').write_text(PLANTED.format(ran=str(ran)))
    monkeypatch.chdir(folder)
    return ran


@pytest.mark.parametrize('name', ['unittest/__main__/X', 'planted/msg/X', '../msg/X', 'a', ''])
def test_no_class_is_looked_for_under_a_name_that_is_not_installed(planted, monkeypatch, name):
    monkeypatch.syspath_prepend(planted.parent / 'started_here')
    with pytest.raises(LookupError, match='is not installed'):
        message_class(name)
    assert not planted.exists()


def test_types_of_hostile_names_are_refused_and_the_rest_goes_on(field, planted):
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    bare = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
    for number, type_name in enumerate(HOSTILE):
        bare.announce(f'rt/m/hostile_{number}', type_name)
        if number == 0:
            told = "/m/hostile_0 refused: type 'unittest/__main__/X' is not installed"
            assert told in field.until_refused('/m/recorder', 1)
    field.until(lambda: field.count('/m/recorder', 'refused') >= len(HOSTILE), 'refusals')
    field.node.create_publisher(String, '/m/latched', qos.LATCHED).publish(String(data='x'))
    field.until(lambda: '/m/latched' in {each.topic for each in read_log(log)}, 'message')
    assert field.count('/m/recorder', 'refused') == len(HOSTILE)
    assert field.processes.stop() == {'/m/recorder': 0}
    assert is_finished(log)
    assert not any('hostile' in each.topic for each in read_log(log))
    assert not planted.exists()


def test_topics_of_invalid_names_are_refused_and_the_mission_goes_on(field):
    log = field.folder / 'mission.mcap'
    bare = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
    bare.announce('rt/m/2bad', 'std_msgs::msg::dds_::String_')
    bare.announce('rt/m/2bad/report', 'kbnitp_msgs::msg::dds_::DeploymentReport_')
    field.start_mission({**samples.FIELD, 'robots': 3, 'recorded': True}, '/m', log)
    field.until(lambda: field.state('/m/planner').startswith('done'), 'end')
    for node in ('/m/recorder', '/m/planner'):
        assert "the graph refused: '/m/2bad" in field.said(node)
    assert set(field.processes.stop().values()) == {0}
    assert replay(log).reproduced


def test_nodes_wait_while_a_name_is_not_utf8_and_say_so(field):
    log = field.folder / 'mission.mcap'
    bare = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
    bare.announce('rt/m/other', not_utf8('std_msgs::msg::é'))
    field.start_mission({**samples.FIELD, 'robots': 3, 'recorded': True}, '/m', log)
    told = r"the graph refused: the name b'std_msgs::msg::\xff\xff' is not UTF-8"
    field.until(lambda: told in field.said('/m/recorder'), 'refusal')
    bare.leave()
    field.until(lambda: field.state('/m/planner').startswith('done'), 'end')
    assert set(field.processes.stop().values()) == {0}
    assert replay(log).reproduced


@pytest.mark.parametrize('is_awaited', [False, True], ids=['unknown', 'awaited'])
def test_a_topic_of_a_refused_type_is_recorded_when_one_of_another_type_comes(field, is_awaited):
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    if is_awaited:
        # Its type is in the graph before anybody publishes it.
        field.listen(String, '/m/text')
    bare = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
    bare.announce('rt/m/text', 'strangers::msg::dds_::Unknown_')
    field.until_refused('/m/recorder', 1)
    field.node.create_publisher(String, '/m/text', qos.LATCHED).publish(String(data='x'))
    field.until(lambda: list(read_log(log, ['std_msgs/msg/String'])), 'message')
    assert field.count('/m/recorder', 'refused') == 1
