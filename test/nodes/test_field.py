# SPDX-License-Identifier: Apache-2.0
"""All nodes of a mission take their field from one map, in a file or on a topic."""

from __future__ import annotations

from array import array
from cmath import exp
from copy import deepcopy
from dataclasses import replace
from itertools import product
from math import cos, sin

from extent import some
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import Grid
from kbnitp_ros.log.replay import replay
from kbnitp_ros.maps import read_map
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_path
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid, Path
import pytest
from tf2_msgs.msg import TFMessage
from unbroken import core_mission

# Seen from above, at 0.5 m a pixel: # is occupied, ? unknown.
PICTURE = (
    '..........??',
    '..........??',
    '..####....??',
    '..####......',
    '..........##',
    '..........##',
    '............',
    '............',
)
GRAY = {'.': 254, '#': 0, '?': 205}
YAML = """
image: map.pgm
resolution: 0.5
origin: [-2.0, 3.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
PARAMETERS = {
    'grid.resolution': 1.0,
    'grid.base_position': [-1.5, 3.5],
    'max_steps': 9,
    'robots': 8,
    'seed': 5,
}
GRID = Grid(
    6,
    4,
    base=0,
    resolution=1.0,
    origin=(-2.0, 3.0),
    blocked=[11, 13, 14, 17, 23],
    through_corners=False,
)


WAITING = 'waiting for a map on /m/map (parameter map_topic)'


@pytest.fixture
def file(tmp_path):
    """Return the map's file."""
    rows = '\n'.join(' '.join(str(GRAY[pixel]) for pixel in row) for row in PICTURE)
    (tmp_path / 'map.pgm').write_text(f'P2 12 8 255\n{rows}\n')
    (tmp_path / 'map.yaml').write_text(YAML)
    return tmp_path / 'map.yaml'


def served(file):
    """Return the map as map_server publishes it."""
    read = read_map(file)
    message = OccupancyGrid()
    message.header.frame_id = 'map'
    message.info.height, message.info.width = read.data.shape
    message.info.resolution = read.resolution
    message.info.origin.position.x, message.info.origin.position.y = read.origin
    message.info.origin.orientation.z = sin(read.yaw / 2)
    message.info.origin.orientation.w = cos(read.yaw / 2)
    message.data = array('b', read.data.tobytes())
    return message


def spoiled(message, what):
    """Return a map that none can be."""
    bad = deepcopy(message)
    if what == 'frame':
        bad.header.frame_id = 'odom'
    elif what == 'resolution':
        bad.info.resolution = float('nan')
    elif what == 'rotated':
        bad.info.origin.orientation.z = 0.7
    elif what == 'size':
        bad.data = bad.data[:-1]
    elif what == 'value':
        bad.data[7] = 101
    elif what == 'base':
        bad.data[0] = 100
    elif what == 'off':
        bad.info.origin.position.x = 8.0
    elif what == 'fine':
        bad.info.resolution = 1.5
    elif what == 'empty':
        bad.info.width = bad.info.height = 0
        bad.data = array('b')
    return bad


BAD_MAPS = {
    'frame': "header.frame_id is 'odom': it must be 'map'",
    'resolution': 'info.resolution is nan',
    'rotated': 'info.origin.orientation',
    'size': 'data has 95 values',
    'value': 'data of cell 7 is 101',
    'base': 'the base, cell 0 around (-1.5, 3.5), is blocked',
    'off': 'point (-1.5, 3.5) is outside the grid',
    'fine': 'grid resolution is 1.0: it must be at least that of the map, 1.5 m',
    'empty': 'grid width is 0',
}


def assert_is_mission_on_the_map(parameters, paths, reports, beliefs, grid=GRID):
    """See that a mission's messages are those that core makes on the grid."""
    expected = core_mission(parameters)
    assert len(paths) == len(reports) == len(expected)
    for path, belief, deployment in zip(paths, beliefs[1:], expected):
        snapshot = read_belief_maps(belief)
        assert snapshot.grid == grid
        assert read_path(grid, 'scout_1', path)[1].tolist() == deployment.plan.path.tolist()
        assert snapshot.belief.joint.tobytes() == deployment.belief.joint.tobytes()


def heard(field):
    """Return what a mission's paths, reports and beliefs will be."""
    return (
        field.listen(Path, '/m/scout_1/path'),
        field.listen(DeploymentReport, '/m/scout_1/report'),
        field.listen(BeliefMaps, '/m/belief'),
    )


def until_over(field, messages):
    """Wait until a mission has made all its deployments."""
    field.until(lambda: min(map(len, messages)) >= PARAMETERS['robots'], 'end', patience=180)
    field.until(lambda: len(messages[2]) > PARAMETERS['robots'], 'last belief')


def test_a_mission_on_a_map_in_a_file(field, file):
    parameters = {**PARAMETERS, 'map': str(file)}
    log = field.folder / 'mission.mcap'
    messages = heard(field)
    field.start_mission(parameters, '/m', log)
    until_over(field, messages)
    assert_is_mission_on_the_map(parameters, *messages)
    assert set(field.processes.stop().values()) == {0}
    assert replay(log).reproduced


def test_a_mission_on_a_map_that_is_served(field, file):
    messages = heard(field)
    field.start_mission({**PARAMETERS, 'map_topic': 'map'}, '/m')
    names = [f'/m/{name}' for name in ('planner', 'agent', 'estimator')]
    for name in names:
        field.until(lambda name=name: field.state(name) == WAITING, f'waiting {name}')
    server = field.node.create_publisher(OccupancyGrid, '/m/map', qos.LATCHED)
    for number, (what, told) in enumerate(BAD_MAPS.items(), 1):
        server.publish(spoiled(served(file), what))
        for name in names:
            assert told in field.until_refused(name, number)
    server.publish(served(file))
    until_over(field, messages)
    assert_is_mission_on_the_map({**PARAMETERS, 'map': str(file)}, *messages)


def test_a_mission_on_a_map_that_is_turned(field, file):
    """Its cells, and so all beliefs, are those of the straight map; positions turn with it."""
    straight = {**PARAMETERS, 'map': str(file)}
    turn, begin = 0.7, complex(-2.0, 3.0)
    base = begin + exp(1j * turn) * 0.5 * (1 + 1j)
    turned = file.with_name('turned.yaml')
    turned.write_text(YAML.replace('3.0, 0.0]', f'3.0, {turn}]'))
    log = field.folder / 'mission.mcap'
    messages = heard(field)
    shown = field.listen(OccupancyGrid, '/m/belief/hazard')
    poses = field.listen(TFMessage, '/tf', volatile=True)
    parameters = {
        **PARAMETERS,
        'grid.base_position': [base.real, base.imag],
        'map_topic': 'map',
        'publish_pose': True,
        'step_period': 0.01,
    }
    field.start_mission(parameters, '/m', log)
    field.talk(OccupancyGrid, '/m/map', qos.LATCHED).publish(served(turned))
    until_over(field, messages)
    assert_is_mission_on_the_map(straight, *messages, grid=replace(GRID, yaw=turn))
    orientations = [
        shown[-1].info.origin.orientation,
        poses[-1].transforms[0].transform.rotation,
        messages[0][-1].poses[0].pose.orientation,
    ]
    for each in orientations:
        assert complex(each.w, each.z) ** 2 == pytest.approx(exp(1j * turn))
    x, y = (getattr(messages[0][0].poses[0].pose.position, axis) for axis in 'xy')
    assert complex(x, y) == pytest.approx(base)
    assert set(field.processes.stop().values()) == {0}
    assert replay(log).reproduced


def test_a_map_that_changes_changes_no_mission(field, file):
    field.start('estimator', {**PARAMETERS, 'map_topic': '/map', 'await_nodes': ['test']})
    beliefs = field.listen(BeliefMaps, '/belief')
    server = field.talk(OccupancyGrid, '/map', qos.LATCHED)
    server.publish(served(file))
    field.until(lambda: beliefs, 'prior')
    assert read_belief_maps(beliefs[0]).grid == GRID
    server.publish(served(file))
    other = served(file)
    other.data[40] = 100
    server.publish(other)
    assert 'the map has changed' in field.until_refused('/estimator', 1)
    assert len(beliefs) == 1


def test_who_waits_for_a_map_can_be_ended(field):
    field.start('planner', {**PARAMETERS, 'map_topic': '/map'})
    field.until(
        lambda: 'waiting for a map on /map (param' in field.state('/planner'), 'waiting planner'
    )
    assert field.processes.stop() == {'/planner': 0}


@pytest.mark.parametrize(
    'corners, connectivity', some(product(['auto', 'avoid', 'cut'], [4, 8]), 2)
)
def test_steps_past_corners_are_a_choice(field, file, connectivity, corners):
    field.start(
        'estimator',
        {
            **PARAMETERS,
            'map': str(file),
            'grid.connectivity': connectivity,
            'grid.corners': corners,
            'await_nodes': ['test'],
        },
    )
    beliefs = field.listen(BeliefMaps, '/belief')
    field.until(lambda: beliefs, 'prior')
    grid = read_belief_maps(beliefs[0]).grid
    assert grid == replace(GRID, connectivity=connectivity, through_corners=corners == 'cut')


def test_no_node_starts_on_a_map_that_is_none(field, file):
    (file.parent / 'map.pgm').unlink()
    for name in ('planner', 'agent', 'estimator'):
        process = field.start(name, {**PARAMETERS, 'map': str(file)})
        assert process.wait(60) == 2
        (said,) = field.said(f'/{name}').splitlines()
        assert (
            said
            == f'{name}: image {file.parent / "map.pgm"} cannot be read: No such file or directory'
        )


def test_a_mission_is_not_gone_on_with_on_another_map(field, file):
    log = field.folder / 'mission.mcap'
    messages = heard(field)
    field.start_mission({**PARAMETERS, 'map': str(file)}, '/m', log)
    until_over(field, messages)
    field.processes.stop()
    # The block on the map is gone.
    picture = (file.parent / 'map.pgm').read_text()
    (file.parent / 'map.pgm').write_text(picture.replace('254 254 0 0 0 0', '254 ' * 6))
    parameters = {**PARAMETERS, 'map': str(file), 'resume': str(log)}
    process = field.start('estimator', parameters)
    assert process.wait(60) == 2
    said = field.said('/estimator')
    assert 'blocked=[11, 13, 14, 17, 23]): the parameters say' in said
    assert 'blocked=[11, 17, 23])' in said
