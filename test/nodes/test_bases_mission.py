# SPDX-License-Identifier: Apache-2.0
"""A mission of two bases and three robot types, in a turned field, survives its nodes' death."""

from __future__ import annotations

from dataclasses import replace
import json

from kbnitp_ros.base.resumption import Resumption
from kbnitp_ros.cli.report import main
from kbnitp_ros.configuration import grid_of, robot_types_of
from kbnitp_ros.configuration.prior import earlier_belief
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.report import read_mission
from kbnitp_ros.report.answers import findings_of
from kbnitp_ros.report.plots import map_plot
import numpy as np
from pyproj import Geod
import pytest
from unbroken import core_mission, with_defaults

AGENTS = ('scout_1', 'scout_2', 'scout_3')
BASES = {'scout_1': 0, 'scout_2': 62, 'scout_3': 62}
ROBOTS = 9
# Latitude and longitude in degrees, and the heading of the frame's x axis in rad.
DATUM = [52.0, 5.0, 0.3]


@pytest.fixture
def parameters():
    """Return those of a mission of 9x7 cells with a wall, and a base in two of its corners."""
    return {
        'grid.width': 9,
        'grid.height': 7,
        'grid.blocked': [13, 22, 31],
        'grid.origin': [10.0, -5.0, 0.6],
        'datum': DATUM,
        'max_steps': 12,
        'planner': 'relaxed',
        'allocation': 'voronoi',
        'robots': ROBOTS,
        'agents': list(AGENTS),
        'seed': 6,
        'sensor.lethality': 0.3,
        'contact_probability': 0.2,
        'detour_probability': 0.05,
        'early_return_probability': 0.02,
        # Long enough for the nodes to die before the mission is over.
        'step_period': 0.03,
        # A dear one with a good camera, and a cheap blind one that does not go far.
        'robots.scout_1.sensor.true_positive': 0.99,
        'robots.scout_1.loss_cost': 0.2,
        'robots.scout_2.base': 62,
        'robots.scout_3.base_position': [13.5, 5.3],
        'robots.scout_3.sensor.true_positive': 0.5,
        'robots.scout_3.sensor.false_positive': 0.5,
        'robots.scout_3.max_steps': 6,
        'recorded': True,
    }


@pytest.mark.full
def test_a_mission_of_two_bases_goes_on_after_its_nodes_were_killed(field, parameters):
    log = str(field.folder / 'mission.mcap')
    beliefs = field.run_killed_mission(parameters, log)
    assert_other_bases_are_refused(parameters, log)

    expected = core_mission(parameters)
    last = read_belief_maps(beliefs[-1])
    assert last.grid.bases == {0, 62}
    assert {agent: last.base_of(agent) for agent in AGENTS} == BASES
    assert last.belief.joint.tobytes() == expected[-1].belief.joint.tobytes()
    assert last.belief.hazard[[0, 62]].tolist() == [0.0, 0.0]
    report = replay(log)
    assert report.reproduced
    assert report.evidence.refused == []
    for key in report.evidence.reports:
        seen = report.evidence.observation(key)
        for path in (report.evidence.path(key), seen.path):
            assert path[0] == path[-1] == BASES[key.agent]
    observations = read_history(log).observations
    assert len(observations) == ROBOTS
    assert_page_shows_bases(read_mission(log))
    assert_findings_are_on_the_earth(read_mission(log))
    assert_a_later_mission_may_have_others(log, last)


def assert_page_shows_bases(mission):
    """See both bases on the maps, in metres from the corner, and the paths from each."""
    assert main([str(mission.log), '--out', str(mission.log.parent / 'report')]) == 0
    drawn = json.loads(map_plot(mission.grid))['data'][-1]
    assert drawn['marker']['symbol'] == 'square'
    assert [*zip(drawn['x'], drawn['y'])] == [(0.5, 0.5), (8.5, 6.5)]
    assert {(each.key.agent, int(each.path[0])) for each in mission.deployments} == {
        *BASES.items()
    }


def assert_findings_are_on_the_earth(mission):
    """See that what the page lists is where a geodesic from the datum leads."""
    earth, findings = Geod(ellps='WGS84'), findings_of(mission)
    latitude, longitude, heading = DATUM
    assert findings
    for each in findings:
        ((x, y),) = mission.grid.centers([each.cell]).tolist()
        azimuth = 90.0 - np.degrees(heading + np.arctan2(y, x))
        at = earth.fwd(longitude, latitude, azimuth, np.hypot(x, y))[:2]
        assert earth.inv(each.longitude, each.latitude, *at)[2] < 0.1


def assert_a_later_mission_may_have_others(log, last):
    """See that what was a base stays free of hazard, and what becomes one is."""
    grid = replace(last.grid, base=8, other_bases=(54,))
    prior = earlier_belief(log, grid)
    bases = [0, 8, 54, 62]
    assert prior.hazard[bases].tolist() == [0.0] * 4
    assert (last.belief.hazard[[8, 54]] > 0.0).all()
    others = np.delete(np.arange(grid.cells), bases)
    assert prior.joint[others].tobytes() == last.belief.joint[others].tobytes()


def assert_other_bases_are_refused(parameters, log):
    """See that a mission is not gone on with from other bases, and of which agent that is."""
    moved = with_defaults({**parameters, 'robots.scout_1.base': 62, 'robots.scout_2.base': 0})
    grid = grid_of(moved)
    assert robot_types_of(moved, grid)['scout_1'].base == 62
    with pytest.raises(ValueError, match=r'the base of scout_1 is 0, .* it is 62.*prior\.log'):
        Resumption(log, grid, moved, AGENTS)


def test_a_planner_refuses_beliefs_of_agents_of_other_bases(field, parameters):
    """The same two bases, each that of another agent."""
    swapped = {'robots.scout_1.base': 62, 'robots.scout_2.base': 0}
    awaiting = {'await_nodes': ['planner'], 'recorded': False}
    field.start('estimator', {**parameters, **swapped, **awaiting}, '/m')
    field.start('planner', {**parameters, 'await_nodes': ['estimator'], 'recorded': False}, '/m')
    told = field.until_refused('/m/planner', 1)
    assert 'the base of scout_1 is 62: the parameters say 0' in told
