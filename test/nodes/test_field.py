# SPDX-License-Identifier: Apache-2.0
"""All nodes of a mission take their field from one map, in a file or on a topic."""

from array import array
from cmath import exp
from dataclasses import replace
import math

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import Grid
from kbnitp_ros.log.replay import replay
from kbnitp_ros.maps import read_map
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid, Path
import pytest
from tf2_msgs.msg import TFMessage
from unbroken import core_mission

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
    'grid.resolution': 1.0, 'grid.base_position': [-1.5, 3.5], 'max_steps': 9, 'robots': 8,
    'seed': 5, 'defaults': 'paper',
}  # fmt: skip
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
    read = read_map(file)
    message = OccupancyGrid()
    message.header.frame_id = 'map'
    message.info.height, message.info.width = read.data.shape
    message.info.resolution = read.resolution
    message.info.origin.position.x, message.info.origin.position.y = read.origin
    message.info.origin.orientation.z = math.sin(read.yaw / 2)
    message.info.origin.orientation.w = math.cos(read.yaw / 2)
    message.data = array('b', read.data.tobytes())
    return message


BAD_MAPS = (
    (lambda bad: setattr(bad.header, 'frame_id', 'odom'), "header.frame_id is 'odom': it must be"),
    (lambda bad: setattr(bad.info, 'resolution', math.nan), 'info.resolution is nan'),
    (lambda bad: setattr(bad.info.origin.orientation, 'x', 0.7), 'info.origin.orientation'),
    (lambda bad: setattr(bad, 'data', bad.data[:-1]), 'data has 95 values'),
    (lambda bad: bad.data.__setitem__(7, 101), 'data of cell 7 is 101'),
    (lambda bad: bad.data.__setitem__(0, 100), 'the base, cell 0 around'),
    (lambda bad: setattr(bad.info.origin.position, 'x', 8.0), 'is outside the grid'),
    (lambda bad: setattr(bad.info, 'resolution', 1.5), 'it must be at least that of the map'),
)


def heard(field):
    """Return lists for a mission's paths, reports and beliefs."""
    return (
        field.listen(Path, '/m/scout_1/path'),
        field.listen(DeploymentReport, '/m/scout_1/report'),
        field.listen(BeliefMaps, '/m/belief'),
    )


def test_a_mission_waits_for_a_map_that_can_be_and_may_be_turned(field, file):
    """Cells and beliefs equal those of the straight map; positions turn with the map."""
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
        **PARAMETERS, 'grid.base_position': [base.real, base.imag], 'map_topic': 'map',
        'publish_pose': True, 'step_period': 0.01,
    }  # fmt: skip
    field.start_mission(parameters, '/m', log)
    names = [f'/m/{name}' for name in ('planner', 'agent', 'estimator')]
    for name in names:
        field.until(lambda name=name: field.state(name) == WAITING, f'waiting {name}')
    server = field.node.create_publisher(OccupancyGrid, '/m/map', qos.LATCHED)
    for number, (spoil, told) in enumerate(BAD_MAPS, 1):
        bad = served(turned)
        spoil(bad)
        server.publish(bad)
        for name in names:
            assert told in field.until_refused(name, number)
    server.publish(served(turned))
    field.until(lambda: min(map(len, messages)) >= PARAMETERS['robots'], 'end', patience=180)
    field.until(lambda: len(messages[2]) > PARAMETERS['robots'], 'last belief')
    paths, reports, beliefs = messages
    expected = core_mission(straight)
    assert len(paths) == len(reports) == len(expected)
    for belief, deployment in zip(beliefs[1:], expected):
        snapshot = read_belief_maps(belief)
        assert snapshot.grid == replace(GRID, yaw=turn)
        assert snapshot.belief.joint.tobytes() == deployment.belief.joint.tobytes()
    for rotation in (
        shown[-1].info.origin.orientation,
        poses[-1].transforms[0].transform.rotation,
        paths[-1].poses[0].pose.orientation,
    ):
        assert complex(rotation.w, rotation.z) ** 2 == pytest.approx(exp(1j * turn))
    x, y = (getattr(paths[0].poses[0].pose.position, axis) for axis in 'xy')
    assert complex(x, y) == pytest.approx(base)
    assert set(field.processes.stop().values()) == {0}
    assert replay(log).reproduced


def test_walls_below_100_block_cells_and_grey_pixels_are_named(field, file):
    """As a SLAM publishes them, which states probabilities."""
    graded = served(file)
    graded.data = array(
        'b', [86 if value == 100 else 40 if value == 0 else -1 for value in graded.data]
    )
    given = {**PARAMETERS, 'map_topic': '/map', 'minimum_reach': 0.0, 'await_nodes': ['test']}
    server = field.node.create_publisher(OccupancyGrid, '/map', qos.LATCHED)
    server.publish(graded)
    field.start('planner', given)
    field.until(lambda: '5 of them blocked' in field.said('/planner'), 'warning')
    assert '78 of 96 pixels of the map have values above 0 and below 65, and count' in (
        field.said('/planner')
    )


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
