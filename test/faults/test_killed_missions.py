# SPDX-License-Identifier: Apache-2.0
"""Missions of all kinds, undisturbed or killed, end with the belief of the core."""

from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

from extent import some
from kbnitp_ros.configuration import make_grid
from kbnitp_ros.configuration.mission import earlier_belief
from kbnitp_ros.core import Grid
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.record import RecordedMission
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.maps import read_map
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.nodes.planner import read_planner_record
import numpy as np
from PIL import Image
import pytest
from unbroken import core_mission, NODES, with_defaults

SMALL = {
    'grid.width': 5, 'grid.height': 4, 'max_steps': 8, 'planner': 'relaxed', 'robots': 16,
    'agents': ['scout_1', 'scout_2'], 'sensor.lethality': 0.7, 'world.hazard_density': 0.4,
}  # fmt: skip

TYPES = {
    'team.scout_1.sensor.true_positive': 0.99,
    'team.scout_1.loss_cost': 0.2,
    'team.scout_2.sensor.true_positive': 0.5,
    'team.scout_2.sensor.false_positive': 0.5,
    'team.scout_2.max_steps': 6,
}
FIELD_MAP = {'resolution': 0.25, 'occupied_thresh': 0.65, 'free_thresh': 0.196, 'mode': 'trinary'}
PRIOR_MAP = {'resolution': 2.5, 'occupied_thresh': 1.0, 'free_thresh': 0.0, 'mode': 'scale'}


def write_map(folder, name, gray, values):
    """Write a map, bottom row first, and return its YAML file."""
    Image.fromarray(gray[::-1].astype(np.uint8)).save(folder / f'{name}.png')
    lines = [f'image: {name}.png', 'origin: [-7.5, 2.5, 0.0]', 'negate: 0']
    lines += [f'{key}: {value}' for key, value in values.items()]
    (folder / f'{name}.yaml').write_text('\n'.join(lines))
    return str(folder / f'{name}.yaml')


def on_a_map(folder):
    """Return the parameters of a mission on a map of 120x80 pixels, 60x40 cells of 0.5 m."""
    rng = np.random.default_rng(2)
    gray = np.full((80, 120), 254)
    for row, column in rng.integers((0, 0), (76, 112), (60, 2)):
        gray[slice(row, row + 4), slice(column, column + 8)] = 0
    gray[60:, 100:] = 205
    gray[36:44, 56:64] = 254
    # Darker is likelier: hazards in the east, targets in the north, at a coarser resolution.
    hazard = np.broadcast_to(np.linspace(250, 100, 12), (8, 12))
    target = np.broadcast_to(np.linspace(195, 120, 8)[:, None], (8, 12))
    return {
        'defaults': 'paper',
        'map': write_map(folder, 'field', gray, FIELD_MAP),
        'grid.resolution': 0.5,
        'grid.base_position': [7.5, 12.5],
        'prior.hazard_map': write_map(folder, 'hazard', hazard, PRIOR_MAP),
        'prior.target_map': write_map(folder, 'target', target, PRIOR_MAP),
        'prior.kappa': 0.3,
        'max_steps': 24,
        'team.scout_2.sensor.malfunction': 0.02,
        **TYPES,
    }


# A wall, and bases in two corners of a turned field.
BASES = {
    'grid.width': 9, 'grid.height': 7, 'grid.blocked': [13, 22, 31],
    'grid.origin': [10.0, -5.0, 0.6], 'max_steps': 12, 'sensor.lethality': 0.3,
    'allocation': 'voronoi', 'agents': ['scout_1', 'scout_2', 'scout_3'],
    'team.scout_2.base': 62, 'team.scout_3.base_position': [13.5, 5.3], **TYPES,
}  # fmt: skip
SILENT = {'silent_loss': True, 'return_deadline': 1.0, 'step_period': 0.001}
LEARNING = {'method': 'kappa_bnitp_sampled', 'learn.numbers': ['lethality', 'hazard_density']}


def moves(deployments):
    """Return whether the hazards of a mission changed between robots."""
    return any((each.world.hazard != deployments[0].world.hazard).any() for each in deployments)


def avoids_occupied_cells(deployments, parameters):
    """Return whether no robot touched an occupied or unknown pixel."""
    field, grid = read_map(parameters['map']), make_grid(with_defaults(parameters))
    for deployment in deployments:
        for start, end in pairwise(grid.centers(deployment.observation.path)):
            column, row = (
                np.floor((np.linspace(start, end, 50) - field.origin) / field.resolution)
                .astype(int)
                .T
            )
            if field.data[row, column].any():
                return False
    return True


def shows_will(deployments):
    """Yield whether there were last contacts, detours, early returns, and steps without a look."""
    yield any(deployment.observation.lost_at is not None for deployment in deployments)
    back = [
        (each.observation, each.plan.path) for each in deployments if each.observation.survived
    ]
    yield any(len(seen.path) > len(path) for seen, path in back)
    yield any(len(seen.path) < len(path) for seen, path in back)
    yield any((seen.readings == -1).any() for seen, _ in back)


# Parameters of each kind, and a check that a mission is of this kind.
KINDS = {
    'map': (on_a_map, avoids_occupied_cells),
    'used_up': ({'hazards.dynamics': 'used_up'}, lambda made, _: moves(made)),
    'bases': (BASES, lambda made, _: {int(each.plan.path[0]) for each in made} == {0, 62}),
    'silent': (SILENT, lambda made, _: not all(each.observation.survived for each in made)),
    # Detours, early returns, last contacts and failed cameras, some of each.
    'wilful': (
        {
            'detour_probability': 0.1, 'early_return_probability': 0.05,
            'contact_probability': 0.5, 'camera_failure_probability': 0.1,
        },
        lambda made, _: all(shows_will(made)),
    ),
    'changing': (
        {'hazards.dynamics': 'changing', 'hazards.appear': 0.05, 'hazards.vanish': 0.2},
        lambda made, _: moves(made),
    ),
    'moving': ({'hazards.dynamics': 'moving', 'hazards.move': 0.1}, lambda made, _: moves(made)),
    'banked': (
        {'hazards.dynamics': 'used_up', 'learn.numbers': ['lethality', 'hazard_density']},
        lambda made, _: {*made[-1].parameters} == {'lethality', 'hazard_density'},
    ),
    'kinds_used_up': (
        {'hazards.dynamics': 'learn', 'true.hazards.dynamics': 'used_up'},
        lambda made, _: moves(made),
    ),
    'kinds_moving': (
        {
            'hazards.dynamics': 'learn', 'learn.numbers': ['lethality'],
            'true.hazards.dynamics': 'moving', 'true.hazards.move': 0.1,
        },
        lambda made, _: {*made[-1].parameters} == {'lethality', 'vanish', 'move'},
    ),
    'reach': (
        {
            'sensor.reach': 0.3, 'learn.numbers': ['lethality', 'reach'],
            'goal.kind': 'lane', 'goal.cells': [19],
        },
        lambda made, _: {*made[-1].parameters} == {'lethality', 'reach'},
    ),
    'duds': (
        {
            'sensor.duds': 0.5, 'learn.numbers': ['lethality', 'duds'],
            'world.hazard_density': 0.3, 'goal.kind': 'lane', 'goal.cells': [19],
        },
        lambda made, _: made[-1].parameters['duds'].zero < 1.0 and made[-1].belief.duds.any(),
    ),
    'targets': (
        {
            'targets.dynamics': 'learn', 'learn.numbers': ['true_positive', 'false_positive'],
            'true.targets.dynamics': 'moving', 'true.targets.move': 0.1,
        },
        lambda made, _: 'target_vanish' in made[-1].parameters,
    ),
    'sampled': (LEARNING, lambda made, _: {*made[-1].parameters} == {*LEARNING['learn.numbers']}),
    'clustered': ({'prior.clustering': 'learn', **LEARNING}, lambda made, _: made),
    'eight': (
        {'agents': [f'scout_{number}' for number in range(1, 9)], 'method': 'relaxed_bnitp'},
        lambda made, _: made,
    ),
    'coverage': ({'planner': 'coverage', 'method': 'relaxed_itp'}, lambda made, _: made),
    'published': (
        {
            'grid.base': 14, 'grid.resolution': 0.1, 'grid.origin': [-1.3, 2.7],
            'grid.blocked': [7, 8], 'prior.hazard': 0.3, 'method': 'kappa_bnitp_published',
            'planner': 'beam', 'beam_width': 4, 'max_visits': 2,
        },
        lambda made, _: made,
    ),
    'per_loss': (
        {'hazards.dynamics': 'used_up', 'objective': 'information_per_loss'},
        lambda made, _: moves(made),
    ),
    'area': (
        {'goal.kind': 'area', 'goal.cells': [12, 13], 'agents': ['scout_1']},
        lambda made, _: all(each.decision for each in made),
    ),
    # Compared with the belief of its own log: the order of returns differs.
    'rolling': ({'rolling': True}, lambda made, _: made),
}  # fmt: skip


@pytest.mark.parametrize(
    'kind, killed',
    some(((kind, killed) for killed in ('all', 'each', 'none') for kind in KINDS), 28),
)
def test_a_mission_ends_as_that_of_core(set_out, tmp_path, kind, killed):
    own, is_of_kind = KINDS[kind]
    parameters = {**SMALL, 'seed': 10, **(own(tmp_path) if callable(own) else own)}
    if not with_defaults(parameters)['silent_loss']:
        # Long enough to kill nodes before the mission is over.
        parameters['step_period'] = 0.03
    mission = set_out(parameters)
    mission.start(*NODES)
    reports = mission.onlooker.evidence.reports
    for number, nodes in enumerate(
        {'all': [NODES], 'each': [[n] for n in NODES], 'none': []}[killed]
    ):
        mission.until(lambda number=number: len(reports) >= 2 * number + 3, 'more reports')
        for node in nodes:
            mission.kill(node)
        mission.start(*nodes)
    mission.until_over()
    assert not mission.findings()
    made = core_mission(parameters)
    assert is_of_kind(made, parameters)
    assert '/mission/model' in replay(mission.log).compared or not made[-1].parameters


def test_missions_in_namespaces_within_each_other_do_not_meet(set_out):
    shared = {**SMALL, 'robots': 8, 'step_period': 0.03}
    missions = [
        set_out({**shared, 'seed': seed}, namespace=namespace)
        for seed, namespace in enumerate(('/north', '/north/east/scout_1'))
    ]
    for mission in missions:
        mission.start(*NODES)
    for mission in missions:
        mission.until(lambda m=mission: len(m.onlooker.evidence.reports) >= 3, 'reports')
        for node in NODES:
            mission.kill(node)
    for mission in missions:
        mission.start(*NODES)
    for mission in missions:
        mission.until_over()
    assert [mission.findings() for mission in missions] == [[], []]


# Topic names for all nodes of a mission, inside and outside its namespace.
RENAMED = {'belief': '/shared/belief', 'scout_1/path': 'scout_1/plan', 'decision': 'verdict'}


def test_topics_may_have_other_names_if_all_nodes_have_them(set_out):
    parameters = {**SMALL, 'robots': 4, 'agents': ['scout_1'], 'step_period': 0.03}
    mission = set_out(parameters, remaps=dict.fromkeys(NODES, RENAMED))
    mission.start(*NODES)
    log = mission.log
    mission.until(lambda: log.exists() and len(replayed(log).heard) >= 2, 'robots')
    for node in NODES:
        mission.kill(node)
    mission.start(*NODES)
    mission.until(lambda: len(replayed(log).heard) == 4, 'robots')
    mission.until(lambda: 4 in held(log), 'belief in all of them')
    mission.processes.stop()
    report = replay(log)
    assert report.reproduced
    assert report.compared['/shared/belief'] == len(held(log)) > 1
    assert not report.not_yet_held


def held(log):
    """Return the numbers of deployments in the recorded beliefs."""
    return [each.message.deployments for _, each in MissionLog(log).read('belief')]


@pytest.mark.parametrize('node', some(['agent', 'planner', 'estimator', 'recorder']))
def test_no_robot_leaves_while_a_node_has_another_name_for_a_topic(set_out, node):
    parameters = {**SMALL, 'robots': 3, 'agents': ['scout_1']}
    own = {'scout_1/path': 'scout_1/plan'}
    mission = set_out(parameters, remaps={node: own})
    readers = [each for each in NODES if each != 'recorder']
    mission.start(*readers)
    # A node that reads the log at its start refuses the other name by itself.
    mission.until(lambda: all(map(mission.said, readers)), 'nodes')
    mission.start('recorder')
    other = 'estimator' if node == 'recorder' else node
    differs = 'scout_1/path is /mission/scout_1/'
    mission.until(
        lambda: f'/mission/{other} refused: its {differs}' in mission.said('recorder'), node
    )
    mission.wait(1.5)
    assert not mission.onlooker.evidence.reports
    assert not mission.onlooker.recorded
    mission.kill(node)
    mission.forget_remaps()
    if node == 'recorder':
        mission.log.unlink()
    mission.start(node)
    mission.until_over()
    assert not mission.findings()


def replayed(log):
    with suppress(LogError):
        return replay(log).evidence
    return RecordedMission(Grid(1, 1), 1)


def test_a_mission_resumes_with_its_bases_and_later_missions_may_have_others(set_out):
    parameters = {**SMALL, **BASES, 'robots': 6}
    mission = set_out(parameters)
    mission.start(*NODES)
    mission.until_over()
    assert not mission.findings()
    moved = with_defaults({**parameters, 'team.scout_1.base': 62, 'team.scout_2.base': 0})
    with pytest.raises(ValueError, match=r'the base of scout_1 is 0, .* set 62.*prior\.log'):
        read_planner_record(MissionLog(mission.log), moved, make_grid(moved))
    last = read_belief_maps(mission.onlooker.belief)
    assert [last.agent_base(agent) for agent in parameters['agents']] == [0, 62, 62]
    # A former base stays free of hazards, and a new base is free.
    prior = earlier_belief(str(mission.log), replace(last.grid, base=8, other_bases=(54,)))
    bases = [0, 8, 54, 62]
    assert prior.hazard[bases].tolist() == [0.0] * 4
    assert (last.belief.hazard[[8, 54]] > 0.0).all()
    others = np.delete(np.arange(last.grid.cells), bases)
    assert prior.joint[others].tobytes() == last.belief.joint[others].tobytes()
