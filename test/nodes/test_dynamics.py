# SPDX-License-Identifier: Apache-2.0
"""Missions with each kind of hazards, and heard losses, are killed, go on, and are of core."""

from kbnitp_msgs.msg import BeliefMaps
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.beliefs import read_belief_maps
import pytest
from unbroken import core_mission

PARAMETERS = {
    'grid.width': 5,
    'grid.height': 4,
    'max_steps': 8,
    'planner': 'relaxed',
    'robots': 24,
    'seed': 3,
    'agents': ['scout_1', 'scout_2'],
    'sensor.lethality': 0.7,
    'world.hazard_density': 0.4,
    'step_period': 0.05,
}
NODES = ('recorder', 'estimator', 'agent', 'planner')


@pytest.mark.full
@pytest.mark.interpreter
@pytest.mark.parametrize(
    'hazards',
    [
        {'contact_probability': 0.5},
        {'hazards.dynamics': 'used_up'},
        {'hazards.dynamics': 'changing', 'hazards.appear': 0.05, 'hazards.vanish': 0.2},
        {'hazards.dynamics': 'moving', 'hazards.move': 0.1},
        {
            'hazards.dynamics': 'used_up',
            'learn': ['lethality', 'hazard_density'],
            'method': 'kappa_bnitp',
        },
        {'prior.clustering': 'learn', 'method': 'kappa_bnitp_sampled', 'learn': ['lethality']},
    ],
    ids=['heard', 'used_up', 'changing', 'moving', 'learnt', 'clustered'],
)
def test_a_mission_that_was_killed_is_that_of_core(field, hazards):
    log = field.folder / 'mission.mcap'
    parameters = PARAMETERS | hazards
    beliefs = field.listen(BeliefMaps, '/m/belief')

    def start(place):
        awaited = {'estimator': ['planner'], 'agent': ['planner', 'estimator'], 'recorder': []}
        for name in NODES:
            nodes = awaited.get(name, ['agent', 'estimator', 'recorder'])
            is_new = place == 'file'
            given = {} if is_new and name != 'recorder' else {place: str(log)}
            field.start(
                name, {**parameters, **given, 'recorded': True, 'await_nodes': nodes}, '/m'
            )

    start('file')
    field.until(lambda: beliefs and beliefs[-1].deployments >= 9, 'nine robots', patience=180)
    for name in NODES:
        field.kill(f'/m/{name}')
    start('resume')
    held = parameters['robots']
    field.until(lambda: beliefs[-1].deployments == held, 'last belief', patience=180)
    expected = core_mission(parameters)
    assert {each.observation.survived for each in expected} == {True, False}
    changes = any((each.world.hazard != expected[0].world.hazard).any() for each in expected)
    assert changes == ('hazards.dynamics' in hazards)
    heard = any(each.observation.lost_at is not None for each in expected)
    assert heard == ('contact_probability' in hazards)
    believed = read_belief_maps(beliefs[-1]).belief.joint.tobytes()
    assert believed == expected[-1].belief.joint.tobytes()
    assert set(field.processes.stop().values()) == {0}
    report = replay(log)
    assert report.finished
    assert report.reproduced
