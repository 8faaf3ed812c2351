# SPDX-License-Identifier: Apache-2.0
"""A mission of two kinds of robots, on a map, survives the death of all its nodes."""

from __future__ import annotations

from itertools import pairwise

from kbnitp_ros.configuration import robot_types_of
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
from kbnitp_ros.maps import read_map
from kbnitp_ros.messages.beliefs import read_belief_maps
import numpy as np
from PIL import Image
import pytest
from unbroken import core_mission, with_defaults

AGENTS = ('scout_1', 'scout_2')
ROBOTS = 8
YAML = """
image: {name}.png
resolution: {resolution}
origin: [-7.5, 2.5, 0.0]
negate: 0
occupied_thresh: {occupied}
free_thresh: {free}
mode: {mode}
"""


def write(folder, name, gray, resolution, occupied, free, mode):
    """Write a map, its bottom row first, and return its YAML file."""
    Image.fromarray(gray[::-1].astype(np.uint8)).save(folder / f'{name}.png')
    file = folder / f'{name}.yaml'
    file.write_text(
        YAML.format(name=name, resolution=resolution, occupied=occupied, free=free, mode=mode)
    )
    return str(file)


@pytest.fixture
def parameters(tmp_path):
    """Return those of a mission on a map of 120x80 pixels, 60x40 cells of 0.5 m."""
    rng = np.random.default_rng(2)
    gray = np.full((80, 120), 254)
    for row, column in rng.integers((0, 0), (76, 112), (60, 2)):
        gray[slice(row, row + 4), slice(column, column + 8)] = 0
    gray[60:, 100:] = 205
    gray[36:44, 56:64] = 254
    # Darker is likelier: hazards in the east, targets in the north, known more coarsely.
    hazard = np.broadcast_to(np.linspace(250, 100, 12), (8, 12))
    target = np.broadcast_to(np.linspace(195, 120, 8)[:, None], (8, 12))
    return {
        'map': write(tmp_path, 'field', gray, 0.25, 0.65, 0.196, 'trinary'),
        'grid.resolution': 0.5,
        'grid.base_position': [7.5, 12.5],
        'prior.hazard_map': write(tmp_path, 'hazard', hazard, 2.5, 1.0, 0.0, 'scale'),
        'prior.target_map': write(tmp_path, 'target', target, 2.5, 1.0, 0.0, 'scale'),
        'prior.kappa': 0.3,
        'max_steps': 7,
        'planner': 'relaxed',
        'robots': ROBOTS,
        'agents': list(AGENTS),
        'seed': 4,
        'sensor.lethality': 0.3,
        'sensor.malfunction': 0.01,
        'contact_probability': 0.2,
        'detour_probability': 0.05,
        # Long enough for the nodes to die before the mission is over.
        'step_period': 0.02,
        # A dear one with a good camera, and a cheap blind one that is slow and does not go far.
        'robots.scout_1.sensor.true_positive': 0.99,
        'robots.scout_1.sensor.false_positive': 0.01,
        'robots.scout_1.loss_cost': 0.2,
        'robots.scout_1.max_steps': 24,
        'robots.scout_2.sensor.true_positive': 0.5,
        'robots.scout_2.sensor.false_positive': 0.5,
        'robots.scout_2.sensor.malfunction': 0.02,
        'robots.scout_2.max_steps': 6,
        'robots.scout_2.step_period': 0.04,
        'recorded': True,
    }


def test_a_mission_on_a_map_goes_on_after_all_its_nodes_were_killed(field, parameters):
    log = str(field.folder / 'mission.mcap')
    beliefs = field.run_killed_mission(parameters, log)

    expected = core_mission(parameters)
    last = read_belief_maps(beliefs[-1])
    assert (last.grid.width, last.grid.height) == (60, 40)
    assert last.belief.joint.tobytes() == expected[-1].belief.joint.tobytes()
    for agent, kind in robot_types_of(with_defaults(parameters), last.grid).items():
        assert last.robot_types[agent].sensors == kind.sensors
    report = replay(log)
    assert report.reproduced
    assert report.evidence.refused == []
    steps = dict.fromkeys(AGENTS, 0)
    for key in report.evidence.paths:
        steps[key.agent] = max(steps[key.agent], report.evidence.path(key).size - 1)
    assert steps['scout_2'] <= 6
    assert steps['scout_1'] > 7
    observations = read_history(log).observations
    assert len(observations) == ROBOTS
    assert any(not each.survived for each in observations)
    assert_keeps_off_what_is_occupied(parameters, last.grid, observations)


def assert_keeps_off_what_is_occupied(parameters, grid, observations):
    """See on the pixels that no robot touched what is occupied or unknown."""
    field = read_map(parameters['map'])
    for observation in observations:
        for start, end in pairwise(grid.centers(observation.path)):
            along = np.linspace(start, end, 50)
            column, row = np.floor((along - field.origin) / field.resolution).astype(int).T
            assert (field.data[row, column] == 0).all()
