# SPDX-License-Identifier: Apache-2.0
"""What nodes do about messages that no node of their mission sends."""

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.core import Observation
from kbnitp_ros.log.read import read_log
from kbnitp_ros.messages.deployments import path_message, read_path, report_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid, Path
import pytest
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from samples import FIELD, GRID, HOME, key, lost, on_disk, path
from std_msgs.msg import String

NODES = ('recorder', 'estimator', 'agent', 'planner')


def start_all(field, parameters):
    """Start a mission with a recorder, and return its log."""
    log = field.folder / 'mission.mcap'
    field.start_mission({**FIELD, **parameters}, '/', log)
    return log


def test_a_cell_whose_side_is_no_float32_is_no_obstacle(field):
    start_all(field, {'grid.resolution': 0.3333333333333333, 'robots': 2})
    field.until(lambda: field.state('/planner').startswith('done: 2 of 2'), 'end')
    field.until(lambda: all(field.state(f'/{node}') for node in NODES), 'word of every node')
    assert [field.count(f'/{node}', 'refused') for node in NODES] == [0] * 4


def test_a_clock_before_all_times_is_refused_by_every_node(field):
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
    field.until(lambda: field.count('/planner', 'accepted') == 1, 'prior')
    other = field.talk(BeliefMaps, '/belief', qos.LATCHED)
    told = field.until_refused('/planner', 1)
    assert '2 nodes publish beliefs' in told
    for number, (name, value, expected) in enumerate(
        (
            ('lethality', 0.25, 'model is '),
            ('seed', 9, "seed is '9': it was '0' before"),
            ('method', 'relaxed_itp', "method is 'relaxed_itp': it was 'kappa_bnitp' before"),
            ('deployments', 5, 'deployments is 5: the paths of only 0 are known'),
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
    # When it has left, the belief of the one that stays is asked for again.
    field.until(lambda: field.count('/planner', 'accepted') == 2, 'belief')


def test_a_report_that_does_not_fit_leaves_a_silent_robot_to_be_given_up(field):
    silent = {**FIELD, 'silent_loss': True, 'return_deadline': 0.5, 'robots': 1}
    silent |= {'presume_departure': True, 'step_period': 0.001}
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
    field.until(lambda: field.state('/planner').startswith('done: 1 of 1'), 'end')
    field.until(lambda: len(reports) == 2, 'loss')
    assert [report.survived for report in reports] == [True, False]
    for node in ('planner', 'estimator'):
        field.until_refused(f'/{node}', 1)


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
        # Nobody acknowledges the others.
        field.talk(Recorded, '/scout_1/recorded').publish(on_disk(first))
    field.until(lambda: field.count('/estimator', 'accepted') == 1, 'path')
    paths.publish(path_message(GRID, HOME, key(4).stamp, key(3).stamp))
    told = field.until_refused('/estimator', 1)
    assert 'belongs to the mission begun at 3.000000000, and not to the mission begun at 1' in told
    paths.publish(path(5))
    assert 'a mission that tells no time' in field.until_refused('/estimator', 2)


def test_a_path_tells_when_the_mission_of_its_belief_began(field):
    paths, beliefs = field.listen(Path, '/scout_1/path'), field.listen(BeliefMaps, '/belief')
    start_all(field, {'robots': 2})
    field.until(lambda: field.state('/planner').startswith('done'), 'end')
    (begun,) = {from_stamp(pose.header.stamp) for each in paths for pose in each.poses}
    assert {from_stamp(each.mission) for each in beliefs} == {begun}
    assert begun == from_stamp(beliefs[0].header.stamp)
    assert all(from_stamp(each.header.stamp) > begun for each in paths)


@pytest.mark.full
def test_a_node_that_still_waits_says_so_again(field):
    field.start('planner', {**FIELD, 'await_nodes': ['estimator']})
    field.until(lambda: field.said('/planner').count('waiting for the belief') == 2, 'two words')


def test_a_map_that_no_other_reader_can_read_is_not_recorded(field):
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    maps = field.talk(OccupancyGrid, '/m/belief/hazard')
    sound = occupancy_grid(GRID, [0.5] * GRID.cells, 1)
    data = serialize_message(sound)
    before, _, after = data.partition(b'map\0')
    for text in (b'm\xffp\0', b'\0\xc0p\0'):
        maps.publish(before + text + after)
    assert 'readers of logs cannot decode it' in field.until_refused('/m/recorder', 2)
    maps.publish(sound)
    field.until(lambda: len(list(read_log(log, ['nav_msgs/msg/OccupancyGrid']))) == 1, 'map')
