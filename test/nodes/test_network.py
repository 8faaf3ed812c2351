# SPDX-License-Identifier: Apache-2.0
"""Messages, topics and types from outside the mission."""

import os

from apart import apart
from bare_dds import BareParticipant, HOSTILE, not_utf8
from base import Base
from base import GRID as BASE_GRID
from extent import FULL
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded, Standings
from kbnitp_ros.core import Observation
from kbnitp_ros.log.read import is_finished, read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import path_message, read_path, read_report, report_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import content_hash, from_stamp, SECOND, to_stamp
from kbnitp_ros.messages.topics import PATH
from kbnitp_ros.nodes.recorded_topics import message_class
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid, Path
import pytest
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
import samples
from samples import (
    changed,
    FIELD,
    GRID,
    HOME,
    key,
    lost,
    new_ledger,
    on_disk,
    path,
    prior,
    standings,
)
from std_msgs.msg import String

NODES = ('recorder', 'estimator', 'agent', 'planner')


def start_all(field, parameters):
    log = field.folder / 'mission.mcap'
    field.start_mission({**FIELD, **parameters}, '/', log)
    return log


def test_a_cell_whose_side_is_no_float32_is_no_obstacle(field):
    start_all(field, {'grid.resolution': 0.3333333333333333, 'robots': 2})
    field.until(lambda: field.state('/planner').startswith('done: 2 of 2'), 'end')
    field.until(lambda: all(field.state(f'/{node}') for node in NODES), 'word of every node')
    assert [field.count(f'/{node}', 'refused') for node in NODES] == [0] * 4


def test_a_negative_clock_is_refused_by_every_node(field):
    clock = field.node.create_publisher(Clock, '/clock', 1)
    start_all(field, {'use_sim_time': True, 'robots': 1})

    def tick(seconds):
        message = Clock()
        message.clock.sec = seconds
        clock.publish(message)
        return True

    for node in NODES:
        field.until(lambda node=node: tick(-5) and field.count(f'/{node}', 'refused') > 0, node)
        assert 'Seconds value must not be negative' in field.diagnosed(f'/{node}').message
    field.until(lambda: tick(7) and field.state('/planner').startswith('done'), 'end')


def test_a_text_on_the_topic_of_paths_keeps_no_path_from_being_recorded(field):
    log = field.folder / 'mission.mcap'
    talker = field.node.create_publisher(String, '/m/scout_1/path', qos.EVIDENCE)
    field.start('recorder', {'file': str(log)}, '/m')
    told = field.until_refused('/m/recorder', 1)
    assert 'type is std_msgs/msg/String: on this topic it must be nav_msgs/msg/Path' in told
    talker.publish(String(data='x'))
    field.node.destroy_publisher(talker)
    paths = field.talk(Path, '/m/scout_1/path')
    paths.publish(path(1))
    field.until(lambda: list(read_log(log, ['nav_msgs/msg/Path'])), 'path')


def test_the_belief_of_another_estimator_is_refused_and_named(field):
    beliefs = field.listen(BeliefMaps, '/belief')
    field.start('estimator', {**FIELD, 'await_nodes': ['planner']})
    field.start('planner', {**FIELD, 'await_nodes': ['estimator']})
    field.until(lambda: field.count('/planner', 'accepted') == 2, 'standings and prior')
    other = field.talk(BeliefMaps, '/belief', qos.LATCHED)
    told = field.until_refused('/planner', 1)
    assert '2 nodes publish beliefs' in told
    for number, (name, value, expected) in enumerate(
        (
            ('lethality', 0.25, 'model changed from '),
            ('seed', 9, "seed changed from '0' to '9'"),
            ('method', 'relaxed_itp', "method changed from 'kappa_bnitp' to 'relaxed_itp'"),
            ('deployments', 4_000_000_000, 'deployments is 4000000000: a mission has at most'),
        )
    ):
        forged = BeliefMaps()
        for field_name in forged.get_fields_and_field_types():
            setattr(forged, field_name, getattr(beliefs[0], field_name))
        forged.agent = 'scout_1'
        setattr(forged, name, value)
        other.publish(forged)
        told = field.until_refused('/planner', number + 2)
        assert told.startswith('belief refused: ')
        assert expected in told
        assert told in field.said('/planner')
    field.node.destroy_publisher(other)
    # When it has left, the belief of the remaining estimator is requested again.
    field.until(lambda: field.count('/planner', 'accepted') > 2, 'belief')


def test_a_robot_whose_report_does_not_fit_is_not_given_up(field):
    silent = {**FIELD, 'silent_loss': True, 'return_deadline': 0.5, 'robots': 1}
    silent |= {'presume_departure': True, 'step_period': 0.001, 'use_sim_time': True}
    field.start_clock()
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    agent = field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    field.start('estimator', {**FIELD, 'await_nodes': ['planner']})
    field.start('planner', {**silent, 'await_nodes': ['estimator']})
    field.until(lambda: paths, 'path')
    sent, cells = read_path(GRID, 'scout_1', paths[0])
    unfit = report_message(sent, Observation(cells, True, [True] * (len(cells) - 1)), 1)
    unfit.readings = unfit.readings[:-1]
    agent.publish(unfit)
    for node in ('planner', 'estimator'):
        field.until_refused(f'/{node}', 1)
    field.until(lambda: 'the operator to decide on' in field.state('/planner'), 'held deployment')
    for _ in range(2):
        field.advance(2)
    assert [report.survived for report in reports] == [True]


def test_a_report_of_50_megabytes_is_shown_in_a_line(field):
    field.start('estimator', {**FIELD, 'await_nodes': ['estimator']})
    reports = field.talk(DeploymentReport, '/scout_1/report')
    report = lost(1)
    report.agent = 'x' * 50_000_000
    reports.publish(report)
    told = field.until_refused('/estimator', 1)
    assert '(50000000 characters)' in told
    assert len(told) < 200


@pytest.mark.parametrize('recorded', [False, True])
def test_paths_of_another_mission_are_refused(field, recorded):
    beliefs = field.listen(BeliefMaps, '/belief')
    field.start('estimator', {**FIELD, 'await_nodes': ['test'], 'recorded': recorded})
    field.until(lambda: beliefs, 'prior')
    paths = field.talk(Path, '/scout_1/path')
    first = path_message(GRID, HOME, key(2).stamp, key(1).stamp)
    paths.publish(first)
    if recorded:
        # Other paths are not acknowledged.
        field.talk(Recorded, '/scout_1/recorded').publish(on_disk(first))
    field.until(lambda: field.count('/estimator', 'accepted') == 1, 'path')
    paths.publish(path_message(GRID, HOME, key(4).stamp, key(3).stamp))
    told = field.until_refused('/estimator', 1)
    assert 'belongs to the mission begun at 3.000000000, and not to the mission begun at 1' in told
    paths.publish(path(5))
    assert 'a mission without a start time' in field.until_refused('/estimator', 2)


def test_a_path_states_the_start_of_its_belief_s_mission(field):
    paths, beliefs = field.listen(Path, '/scout_1/path'), field.listen(BeliefMaps, '/belief')
    start_all(field, {'robots': 2})
    field.until(lambda: field.state('/planner').startswith('done'), 'end')
    (begun,) = {from_stamp(pose.header.stamp) for each in paths for pose in each.poses}
    assert {from_stamp(each.mission) for each in beliefs} == {begun}
    assert begun == from_stamp(beliefs[0].header.stamp)
    assert all(from_stamp(each.header.stamp) > begun for each in paths)


@pytest.mark.full
def test_a_node_repeats_that_it_waits(field):
    field.start('planner', {**FIELD, 'await_nodes': ['estimator']})
    field.until(lambda: field.said('/planner').count('waiting for the belief') == 2, 'two words')


def test_a_map_that_no_other_reader_can_read_is_not_recorded(field):
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    maps = field.talk(OccupancyGrid, '/m/belief/hazard')
    sound = occupancy_grid(GRID, [0.5] * GRID.cells, 1)
    data = serialize_message(sound)
    before, _, after = data.partition(b'map\0')
    maps.publish(before + b'm\xffp\0' + after)
    assert 'readers of logs cannot decode it: frame_id' in field.until_refused('/m/recorder', 1)
    # rclpy reads a text up to its first zero.
    maps.publish(before + b'\0\xc0p\0' + after)
    assert "header.frame_id is ''" in field.until_refused('/m/recorder', 2)
    maps.publish(sound)
    field.until(lambda: len(list(read_log(log, ['nav_msgs/msg/OccupancyGrid']))) == 1, 'map')


WALKS = (HOME, [0, 4, 8, 4, 0])


def test_of_two_paths_with_one_stamp_the_recorded_one_counts(field):
    log = field.folder / 'mission.mcap'
    told = field.listen(Recorded, '/scout_1/recorded')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    beliefs = field.listen(BeliefMaps, '/belief')
    parameters = {**FIELD, 'recorded': True, 'file': str(log)}
    field.start('recorder', parameters)
    field.start('estimator', {**parameters, 'await_nodes': ['recorder']})
    field.start('agent', {**parameters, 'await_nodes': ['estimator', 'recorder']})
    field.until(lambda: beliefs, 'prior')
    begun = from_stamp(beliefs[0].header.stamp)
    field.let_depart()
    planners = [field.talk(Path, '/scout_1/path') for _ in WALKS]
    for number in range(1, 4):
        sent = [path_message(GRID, walk, begun + number * SECOND, begun) for walk in WALKS]
        for planner, message in zip(planners, sent):
            planner.publish(message)
        field.until(lambda n=number: len(reports) == n, f'report {number}')
        by_content = {content_hash(message): walk for message, walk in zip(sent, WALKS)}

        def counted(by_content=by_content):
            return [by_content[each.content] for each in told if each.content in by_content]

        field.until(counted, f'acknowledgement {number}')
        walked = counted()[0]
        report = read_report(reports[-1])[1]
        assert not report.survived or [cell for cell, _ in report.readings] == walked[1:]
    field.until(lambda: beliefs and beliefs[-1].deployments == 3, 'belief')
    field.processes.stop()
    assert len(list(read_log(log, [PATH]))) == 3
    assert replay(log).reproduced


def test_forged_acknowledgements_keep_no_robot_at_home(field):
    reports = field.listen(DeploymentReport, '/scout_1/report')
    recorder, forger = (
        field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE) for _ in range(2)
    )
    # Received before the path, and then displaced by forged ones.
    recorder.publish(on_disk(path(1)))
    for number in range(5200):
        forger.publish(Recorded(stamp=to_stamp(number + 1)))
    field.start('agent', {**FIELD, 'recorded': True, 'await_nodes': ['test']})
    field.let_depart()
    field.record_departures('scout_1')
    field.talk(Path, '/scout_1/path').publish(path(1))
    field.until(lambda: reports, 'report')
    assert read_report(reports[0])[0] == key(1)


def judged():
    """Return the standings before the first deployment, by the node of the test."""
    return standings(new_ledger(), author='/test/test')


def test_a_planner_confirms_its_own_paths_only_and_gives_up_departed_robots(field):
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    recorder, forger = (
        field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE) for _ in range(2)
    )
    field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    silent = {'silent_loss': True, 'return_deadline': 0.5, 'recorded': True}
    silent |= {'presume_departure': True, 'step_period': 0.001}
    field.start('planner', {**FIELD, **silent, 'robots': 1, 'await_nodes': ['test']})
    field.talk(Standings, '/standings', qos.STANDINGS).publish(judged())
    field.talk(BeliefMaps, '/belief', qos.LATCHED).publish(prior())
    field.until(lambda: paths, 'path')
    recorder.publish(on_disk(paths[0]))
    for number in range(5200):
        forger.publish(Recorded(stamp=to_stamp(number + 10**12)))
    field.until(lambda: reports, 'loss')
    assert not reports[0].survived


def test_a_second_planner_is_named(field):
    field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    field.start('planner', {**FIELD, 'await_nodes': ['test']})
    field.talk(Path, '/scout_1/path')
    told = field.until_refused('/planner', 1)
    assert '2 planners publish it, nodes /planner, /test/test: ' in told
    assert told in field.said('/planner')


def test_paths_of_other_missions_are_never_acknowledged(field):
    log = field.folder / 'mission.mcap'
    told = field.listen(Recorded, '/scout_1/recorded')
    field.start('recorder', {'file': str(log)})
    paths = field.talk(Path, '/scout_1/path')
    for mission in range(1, 101):
        paths.publish(path_message(GRID, HOME, key(mission).stamp + 1, mission))
    beliefs = field.talk(BeliefMaps, '/belief', qos.LATCHED)
    beliefs.publish(prior(5 * SECOND))
    own = path_message(GRID, HOME, key(200).stamp, 5 * SECOND)
    paths.publish(own)
    field.until(lambda: told, 'acknowledgement')
    of_path = {'agent': 'scout_1', 'kind': Recorded.PATH, 'mission': to_stamp(5 * SECOND)}
    assert told == [changed(on_disk(own), **of_path)]


def test_a_planner_does_not_take_itself_for_the_agent_that_it_awaits(field):
    """It publishes reports (of losses), and subscribes to paths (of other planners)."""
    field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    field.start('planner', {**FIELD, 'await_nodes': ['agent']})
    field.talk(Standings, '/standings', qos.STANDINGS).publish(judged())
    field.talk(BeliefMaps, '/belief', qos.LATCHED).publish(prior())
    wait = 'waiting for agent to subscribe to /scout_1/path'
    field.until(lambda: field.state('/planner').startswith(wait), wait)


PLANTED = 'open({ran!r}, "w").close()\nraise SystemExit(7)\n'


@pytest.fixture
def planted(tmp_path, monkeypatch):
    """Plant modules where nodes are started; return the file that importing them makes."""
    folder = tmp_path / 'started_here'
    folder.joinpath('planted/msg').mkdir(parents=True)
    ran = tmp_path / 'ran'
    for module in ('planted/__init__', 'planted/x', 'planted/srv', 'planted/msg/__init__'):
        folder.joinpath(f'{module}.py').write_text(PLANTED.format(ran=str(ran)))
    monkeypatch.chdir(folder)
    return ran


@pytest.mark.parametrize('name', ['unittest/__main__/X', 'planted/msg/X', '../msg/X', 'a', ''])
def test_no_module_is_imported_for_a_missing_type(planted, monkeypatch, name):
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
    field.until(lambda: '/m/latched' in {message.topic for message in read_log(log)}, 'message')
    assert field.count('/m/recorder', 'refused') == len(HOSTILE)
    assert field.processes.stop() == {'/m/recorder': 0}
    assert is_finished(log)
    assert not any('hostile' in message.topic for message in read_log(log))
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


def test_a_topic_of_a_refused_type_is_recorded_when_one_of_another_type_comes(field):
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    topics = ('/m/unknown', '/m/awaited')
    # Its type is in the graph before its publisher.
    field.listen(String, '/m/awaited')
    bare = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
    for number, topic in enumerate(topics, 1):
        bare.announce(f'rt{topic}', 'strangers::msg::dds_::Unknown_')
        field.until_refused('/m/recorder', number)
    for topic in topics:
        field.node.create_publisher(String, topic, qos.LATCHED).publish(String(data='x'))
    field.until(lambda: len([*read_log(log, ['std_msgs/msg/String'])]) == 2, 'messages')
    assert field.count('/m/recorder', 'refused') == 2


def differing(key):
    """Return messages about two different returns of one deployment."""
    return (
        f'reports of deployment {key} differ: the one with more readings counts '
        f'(do two robots have the name {key.agent}?)'
    )


@pytest.mark.processes
def test_of_two_robots_on_one_path_the_one_with_more_readings_counts(field):
    base = Base(field)
    base.until_sent(1)
    key, cells = read_path(BASE_GRID, 'scout_1', base.paths['scout_1'][-1])
    other = field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    # The three nodes of the base, and the test.
    field.until(lambda: other.get_subscription_count() == 4, 'whole base')
    base.come_back()
    base.until_held(1)
    base.until_sent(2)
    # The other robot turned back half way.
    half = cells[: cells.size // 2]
    walk = [*half, *half[-2::-1]]
    home = Observation(walk, True, [True] * (len(walk) - 1))
    other.publish(report_message(key, home, key.stamp + 2))
    told = field.until_refused('/estimator', 1)
    assert told == f'scout_1/report refused: {differing(key)}'
    if FULL:
        base.crash()
        base.until_held(1)
    # It does not end the deployment that has its name now either.
    base.until_state('waiting for the report of scout_1 at ')
    base.come_back()
    base.until_held(2)
    report = base.replayed(has_refused=True)
    assert len(report.evidence.standings) == 2
    # A restarted recorder received it again.
    (refused,) = set(report.evidence.refused)
    assert refused == told.replace('scout_1/report refused', '/scout_1/report')


@pytest.mark.processes
@pytest.mark.full
@pytest.mark.campaign
def test_of_two_robots_of_one_name_only_one_moves(tmp_path):
    robots = 4
    with apart(tmp_path, robots, namesakes=2) as mission:
        mission.until(lambda: len(mission.reports()) == robots, 'reports')
        mission.until(lambda: mission.count('acknowledge the departure of scout_1 at'), 'wait')
        assert mission.count('leaving on') == robots
    told = replay(mission.log)
    assert told.reproduced
    assert len(told.evidence.standings) == robots
    assert not told.evidence.refused
