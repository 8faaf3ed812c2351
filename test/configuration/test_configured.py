# SPDX-License-Identifier: Apache-2.0
"""Goals, priors and worlds follow parameters and files, or are refused."""

from dataclasses import replace
from math import inf, pi
from pathlib import Path
import re

from kbnitp_ros.configuration import (
    find_parameter,
    make_goal,
    make_grid,
    node_parameters,
    TABLE,
    with_defaults,
)
from kbnitp_ros.configuration.agents import true_dynamics
from kbnitp_ros.configuration.checks import check_parking
from kbnitp_ros.configuration.field import make_datum, parking_place, read_world
from kbnitp_ros.configuration.mission import (
    check_goal,
    make_estimator,
    make_prior,
    make_stop,
    search_options,
)
from kbnitp_ros.configuration.starts import (
    awaited_nodes,
    FIXED,
    OPTIONS,
    parameters_for,
)
from kbnitp_ros.configuration.starts import (
    DEFAULTS as STARTED,
)
from kbnitp_ros.configuration.table import FIELD_LEARNT, LEARNT
from kbnitp_ros.core import Area, Belief, Grid, Lane, Stop
from laws import for_each
from mission_log import GRID, Mission, mission, record
import numpy as np
from PIL import Image
import pytest

DEFAULTS = {parameter.name: parameter.default for parameter in TABLE}
SMALL = {
    'grid.width': 3, 'grid.height': 2, 'grid.resolution': 0.5, 'max_steps': 2, 'robots': 4,
}  # fmt: skip


def checked(**given):
    changed = {name.replace('__', '.'): value for name, value in given.items()}
    values = DEFAULTS | SMALL | changed
    grid = make_grid(values)
    goal = make_goal(values, grid)
    check_goal(values, grid, [search_options(values)])
    return goal, make_stop(values)


def mask(folder, occupied, resolution=0.5):
    """Write a map with these pixels occupied, top row first; return its file."""
    pixels = np.where(np.array(occupied, dtype=bool), 0, 254).astype(np.uint8)
    Image.fromarray(pixels).save(folder / 'mask.png')
    file = folder / 'mask.yaml'
    file.write_text(
        f'image: mask.png\nresolution: {resolution}\norigin: [0, 0, 0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.2\n'
    )
    return str(file)


def test_cells_are_given_by_number_by_position_or_by_a_mask(tmp_path):
    assert checked() == (None, Stop())
    assert checked(goal__kind='lane', goal__cells=[4]) == (Lane(4), Stop())
    assert checked(goal__kind='lane', goal__position=[0.6, 0.9]) == (Lane(4), Stop())
    assert checked(goal__kind='area', goal__cells=[4, 1]) == (Area([1, 4]), Stop())
    drawn = mask(tmp_path, [[0, 1, 0], [0, 1, 0]])
    assert checked(goal__kind='area', goal__mask=drawn) == (Area([1, 4]), Stop())


@for_each(
    'given, why',
    [
        ({'grid.origin': (0.0, 0.0, 90.0)}, 'in rad, .* 90.0 degrees are 1.5708 rad'),
        ({'grid.origin': (0.0, 0.0, -6.3)}, 'third number of parameter grid.origin is -6.3'),
        ({'grid.base': 4, 'grid.base_position': (0.5, 0.5)}, 'both name the base: give one'),
    ],
)
def test_a_field_that_is_meant_otherwise_is_refused(given, why):
    with pytest.raises(ValueError, match=why):
        make_grid({**DEFAULTS, **given})


# A field of 4 x 3 cells of 0.5 m, turned by a right angle, with two bases and an obstacle.
PARKED = {
    **DEFAULTS, 'grid.width': 4, 'grid.height': 3, 'grid.resolution': 0.5, 'grid.blocked': (5,),
    'grid.origin': (2.0, 1.0, pi / 2), 'agents': ('a', 'b', 'c'), 'team.c.base': 2,
}  # fmt: skip


def homes(**given):
    values = PARKED | {name.replace('__', '.'): place for name, place in given.items()}
    grid = make_grid(values)
    check_parking(grid, values)
    return [parking_place(values, agent, grid) for agent in values['agents']]


def test_robots_park_in_the_middle_of_their_base_or_at_a_place_of_their_own():
    middles = [(1.75, 1.25), (1.75, 1.25), (1.75, 2.25)]
    assert homes() == [pytest.approx(each) for each in middles]
    own = homes(team__a__parking=(1.6, 1.4, -3.0), team__c__parking=(1.8, 2.1))
    assert own == [(1.6, 1.4, -3.0), pytest.approx(middles[1]), (1.8, 2.1)]


@for_each(
    'place, why',
    [
        ((1.75, 1.75), 'in cell 1, and the base is cell 0: park there, or set team.a.base to 1'),
        ((1.25, 1.75), 'in cell 5, which is blocked: park in cell 0'),
        ((2.25, 1.25), r'parameter team.a.parking: point \(2.25, 1.25\) is outside the grid'),
        ((1.75,), r'is \[1.75\]: it must be \[x, y\] or \[x, y, yaw\], finite, or empty'),
        ((1.75, inf), 'finite, or empty'),
        ((1.75, 1.25, 90.0), 'third number of parameter team.a.parking is 90.0: .* in rad'),
        ((1.75, 1.25), 'parameter parking of a and b: the places are 0.00 m apart'),
    ],
)
def test_a_place_where_no_robot_can_park_is_refused(place, why):
    with pytest.raises(ValueError, match=why):
        homes(team__a__parking=place)


def test_robots_park_farther_apart_than_they_are_wide():
    values = PARKED | {'robot_radius': 0.1, 'team.a.parking': (1.6, 1.1)}
    grid = make_grid(values | {'robot_radius': 0.0})
    for x, is_apart in ((1.75, False), (1.79, False), (1.81, True), (1.9, True)):
        wide = values | {'team.b.parking': (x, 1.1)}
        if is_apart:
            check_parking(grid, wide)
            continue
        with pytest.raises(ValueError, match=r'more than 0.2 m are needed \(twice robot_radius'):
            check_parking(grid, wide)


def test_angles_in_degrees_of_maps_and_datums_are_refused(tmp_path):
    drawn = mask(tmp_path, [[0, 0], [0, 0]])
    file = Path(drawn)
    file.write_text(re.sub(r'origin: .*', 'origin: [0.0, 0.0, 45.0]', file.read_text()))
    with pytest.raises(ValueError, match='the yaw of the origin of map .* 45.0 degrees are 0.785'):
        make_grid({**DEFAULTS, 'map': drawn})
    with pytest.raises(ValueError, match='third number of parameter datum is 180.0'):
        make_datum({'datum': (55.0, -3.0, 180.0)})


@for_each('given, why', [
    ({'targets.dynamics': 'moving', 'targets.move': 0.1}, 'targets that move are learnt as'),
    ({'targets.vanish': 0.1}, 'parameter targets.vanish is 0.1 and targets are static'),
    ({'targets.dynamics': 'learn', 'method': 'kappa_bnitp_sampled'}, 'does not take targets'),
])  # fmt: skip
def test_targets_that_an_estimator_cannot_learn_are_refused(given, why):
    with pytest.raises(ValueError, match=why):
        make_estimator({**DEFAULTS, **given}, GRID)


@for_each('given, why', [
    ({'hazards.dynamics': 'used_up'}, 'and hazards.dynamics is used_up: duds are static'),
    ({'targets.dynamics': 'learn'}, 'and targets.dynamics is learn: duds are static'),
    ({'method': 'kappa_bnitp_sampled'}, 'and method kappa_bnitp_sampled does not take them: use'),
    ({'method': 'relaxed_bnitp'}, 'and method relaxed_bnitp does not take them: use .*itp'),
])  # fmt: skip
def test_duds_are_refused_by_the_name_of_their_parameter(given, why):
    for duds, name in (
        ({'sensor.duds': 0.5}, 'parameter sensor.duds is 0.5, '),
        ({'learn.numbers': ('duds',)}, 'parameter learn.numbers has duds, '),
    ):
        with pytest.raises(ValueError, match=name + why):
            make_estimator({**DEFAULTS, **given, **duds}, GRID)


def test_duds_of_simulated_hazards_that_change_are_refused():
    agent = with_defaults('agent', {'sensor.duds': 0.5, 'hazards.dynamics': 'used_up'})
    with pytest.raises(ValueError, match='parameter sensor.duds is 0.5, and hazards.dynamics is'):
        true_dynamics(agent)
    still = {'hazards.dynamics': 'static', 'targets.dynamics': 'changing', 'targets.vanish': 0.1}
    assert true_dynamics({**agent, **still})[0].effect == 'static'


def test_duds_are_learnt_with_kappa_and_the_background_which_told_ones_are_not():
    learning = make_estimator({**DEFAULTS, 'learn.numbers': ('lethality', 'duds')}, GRID)
    assert {*learning.parameters} == {'lethality', 'duds', 'kappa', 'target_background'}
    assert not make_estimator({**DEFAULTS, 'sensor.duds': 0.5}, GRID).parameters
    # Only kappa and the background tell duds.
    with pytest.raises(ValueError, match='has duds, and method relaxed_itp does not take them'):
        make_estimator({**DEFAULTS, 'learn.numbers': ('duds',), 'method': 'relaxed_itp'}, GRID)
    make_estimator({**DEFAULTS, 'sensor.duds': 0.5, 'method': 'relaxed_itp'}, GRID)


@for_each('given, learnt, targets', [
    ({}, FIELD_LEARNT, 'learn'),
    ({'sensor.duds': 0.5}, FIELD_LEARNT, 'static'),
    ({'learn.numbers': ('kappa',)}, ('kappa',), 'static'),
    ({'targets.dynamics': 'static'}, FIELD_LEARNT, 'static'),
    ({'hazards.dynamics': 'used_up'}, FIELD_LEARNT[:-1], 'learn'),
    ({'method': 'kappa_bnitp_sampled'}, LEARNT, 'static'),
    ({'method': 'relaxed_bnitp'}, (), 'static'),
    ({'team.a.sensor.false_positive': 0.1}, (*FIELD_LEARNT[:3], 'reach'), 'static'),
    ({'defaults': 'paper'}, (), 'static'),
])  # fmt: skip
def test_in_the_field_reach_detector_and_changing_targets_are_learnt(given, learnt, targets):
    values = with_defaults('estimator', {'defaults': 'field', 'agents': ('a',), **given})
    assert (values['learn.numbers'], values['targets.dynamics']) == (learnt, targets)
    estimator = make_estimator({**values, 'grid.width': 5}, GRID)
    named = {*learnt, *(['target_vanish'] if targets == 'learn' else [])}
    assert {*estimator.parameters} == named


def test_a_large_field_learns_fewer_numbers():
    values = with_defaults('estimator', {'defaults': 'field'})
    assert {*make_estimator(values, Grid(200, 160)).parameters} == {*LEARNT}


def test_a_sensor_worse_than_chance_is_refused_unless_it_is_learnt():
    given = {**DEFAULTS, 'sensor.true_positive': 0.1, 'sensor.false_positive': 0.4}
    with pytest.raises(ValueError, match=r'true_positive is 0.1, below .*are they swapped\?'):
        make_estimator(given, GRID)
    make_estimator({**given, 'learn.numbers': ('true_positive',)}, GRID)


def test_stops_are_those_of_the_parameters():
    sure = checked(goal__kind='lane', goal__cells=[4], stop__confidence=0.9, stop__losses=2)
    assert sure == (Lane(4, 0.9), Stop(losses=2))
    assert checked(stop__gain=0.3) == (None, Stop(gain=0.3))


@for_each('given, complaint', [
    ({'goal__cells': [4]}, 'goal map takes no cells'),
    ({'stop__confidence': 0.9}, 'goal map takes no confidence'),
    ({'goal__kind': 'lane'}, 'goal lane has 0 cells'),
    ({'goal__kind': 'lane', 'goal__cells': [1, 4]}, 'goal lane has 2 cells'),
    ({'goal__kind': 'lane', 'goal__cells': [5], 'max_steps': 1}, 'at most max_steps = 1'),
    ({'goal__kind': 'lane', 'goal__position': [9.0, 0.1]}, 'is outside the grid'),
    ({'goal__kind': 'lane', 'goal__position': [0.6]}, 'it must be x and y'),
    ({'goal__kind': 'lane', 'goal__cells': [4], 'goal__position': [0.6, 0.9]}, 'give one of'),
    ({'stop__losses': 5}, 'stop.losses is 5'),
])  # fmt: skip
def test_a_goal_out_of_reach_is_refused(given, complaint):
    with pytest.raises(ValueError, match=complaint):
        checked(**given)


@for_each('occupied, resolution, complaint', [
    ([[0, 1]], 0.5, '2 x 1 pixels of 0.5 m, but the field has 3 x 2 cells'),
    ([[0, 1], [0, 1], [0, 0]], 0.5, '2 x 3 pixels'),
    ([[0, 1, 0], [0, 1, 0]], 0.25, 'pixels of 0.25 m, .* cells of 0.5 m'),
    ([[0, 0, 0], [0, 0, 0]], 0.5, 'without cells'),
])  # fmt: skip
def test_a_mask_of_another_field_is_refused(occupied, resolution, complaint, tmp_path):
    drawn = mask(tmp_path, occupied, resolution)
    with pytest.raises(ValueError, match=complaint):
        checked(goal__kind='area', goal__mask=drawn)


VALUES = {parameter.name: parameter.default for parameter in TABLE}
FIELD = {
    'grid.width': 5, 'grid.height': 4, 'grid.base': 2, 'grid.resolution': 0.1,
    'grid.origin': [-1.3, 0.7], 'grid.blocked': [8, 9],
}  # fmt: skip


def write(path, values):
    np.save(path, np.asarray(values, dtype=float))
    return str(path)


@pytest.fixture
def log(tmp_path):
    """Return a mission's log and its last belief, which is not the last message."""
    whole = mission()
    known = whole.ledger.belief
    whole.start_estimator()
    return str(record(tmp_path / 'mission.mcap', whole.sent)), known


def test_numbers_hold_for_all_cells():
    prior = make_prior(VALUES, GRID)
    assert prior.joint.tobytes() == Belief.prior(GRID, 0.5, 0.45, 0.8).joint.tobytes()


def test_maps_hold_cell_by_cell_and_numbers_elsewhere(tmp_path):
    # Seen from above, a map of two by one cells of 0.2 m over the lower left of the grid.
    Image.fromarray(np.array([[255, 51]], dtype=np.uint8)).save(tmp_path / 'hazard.png')
    (tmp_path / 'hazard.yaml').write_text(
        'image: hazard.png\nresolution: 0.2\norigin: [-1.3, 0.7, 0.0]\nnegate: 0\n'
        'occupied_thresh: 1.0\nfree_thresh: 0.0\nmode: scale\n'
    )
    target = np.linspace(0.4, 0.59, 20)
    given = {
        'prior.hazard': 0.3,
        'prior.hazard_map': str(tmp_path / 'hazard.yaml'),
        'prior.target_map': write(tmp_path / 'target.npy', target.reshape(4, 5)),
        'prior.kappa': 0.5,
    }
    hazard = np.full(20, 0.3)
    hazard[[0, 1, 5, 6]] = 0.0
    hazard[[2, 3, 7, 8]] = 0.8
    prior = make_prior(VALUES | given, GRID)
    expected = Belief.prior(GRID, hazard, target, 0.5)
    assert prior.joint == pytest.approx(expected.joint, abs=1e-7)
    assert prior.hazard[GRID.base] == 0.0
    assert prior.joint[8].tolist() == [[1.0, 0.0], [0.0, 0.0]]


def test_a_map_of_hazards_alone_leaves_kappa_and_the_targets_without_hazards(tmp_path):
    hazard = np.linspace(0.0, 0.99, 20)
    given = {'prior.hazard_map': write(tmp_path / 'hazard.npy', hazard.reshape(4, 5))}
    prior = make_prior(VALUES | given, GRID)
    free = GRID.may_be_hazardous & (hazard > 0.0)
    assert prior.hazard[free] == pytest.approx(hazard[free])
    assert prior.kappa[free] == pytest.approx(0.8)
    # The numbers 0.5, 0.45 and 0.8 leave 0.1 for targets where no hazard is.
    background = prior.joint[free, 0, 1] / prior.joint[free, 0].sum(axis=1)
    assert background == pytest.approx(0.1)


@for_each('name, values, told', [
    ('hazard', [[0.5, 1.5]], '1.5 in row 0, column 1: a probability must be from 0 to 1'),
    ('target', np.zeros((4, 5)), 'no joint distribution at cell 0: .*; likewise at cells 1, 2'),
    ('hazard', np.ones((4, 5)), 'hazard of cell 2 is 1: that is a base'),
    ('kappa', np.full((5, 4), 0.8), 'has 5 rows and 4 columns.*: transpose it'),
])  # fmt: skip
def test_a_bad_prior_is_refused(tmp_path, name, values, told):
    given = {f'prior.{name}_map': write(tmp_path / 'prior.npy', values)}
    with pytest.raises(ValueError, match=told):
        make_prior(VALUES | given, GRID)


def test_an_earlier_mission_is_a_prior(log):
    path, known = log
    prior = make_prior(VALUES | {'prior.log': path}, GRID)
    assert prior.joint == pytest.approx(known.joint, abs=1e-15)
    moved = make_prior(VALUES | {'prior.log': path}, replace(GRID, base=12))
    assert moved.hazard[12] == 0.0
    assert moved.target[12] == pytest.approx(known.joint[12, 0, 1] / known.joint[12, 0].sum())
    others = np.arange(20) != 12
    assert moved.joint[others] == pytest.approx(known.joint[others], abs=1e-15)


@pytest.mark.parametrize(
    'change', [{'blocked': (8,)}, {'resolution': 0.2}, {'origin': (0.0, 0.7)}]
)
def test_a_mission_in_another_field_is_no_prior(log, change):
    with pytest.raises(
        ValueError, match=r'is of a mission on Grid\(.*, but the parameters set Grid'
    ):
        make_prior(VALUES | {'prior.log': log[0]}, replace(GRID, **change))


def test_logs_without_a_belief_are_refused(log, tmp_path):
    path, _ = log
    bare = Mission()
    bare.sent.clear()
    bare.send_out([2, 7, 2])
    silent = str(record(tmp_path / 'silent.mcap', bare.sent))
    for file, told in (('nowhere.mcap', 'nowhere.mcap'), (silent, 'no belief on record')):
        with pytest.raises((ValueError, OSError), match=told):
            make_prior(VALUES | {'prior.log': file}, GRID)
    with pytest.raises(ValueError, match='prior.log is given with a map'):
        make_prior(VALUES | {'prior.log': path, 'prior.kappa_map': 'kappa.npy'}, GRID)


SMALL_GRID = Grid(3, 2, blocked=[5])


@pytest.fixture
def write_world(tmp_path):
    def write_world(text):
        path = tmp_path / 'world.yaml'
        path.write_text(text)
        return path

    return write_world


def test_the_first_row_is_the_top_row(write_world):
    world = read_world(write_world('hazard: [x.., ..x]\ntarget: ["...", .x.]'), SMALL_GRID)
    assert world.hazard.tolist() == [False, False, True, True, False, False]
    assert world.target.tolist() == [False, True, False, False, False, False]


@for_each('text, told', [
    ('hazard: ["...", "..."', 'is not YAML'),
    ('hazard: []\ntarget: []\nhazard: []', "the key 'hazard' appears in line 3 and in line 1"),
    ('', 'must have hazard and target and nothing else'),
    ('hazard: ["...", 100]\ntarget: []', "hazard is ['...', 100]: it must be a list of texts"),
    ('hazard: ["..."]\ntarget: []', 'hazard has 1 rows: the grid has 2'),
    ('hazard: ["...", "...."]\ntarget: []', 'hazard has 4 cells in row 2 from the top: the'),
    ('hazard: ["...", "..#"]\ntarget: []', "hazard has '..#' in row 2 from the top: cells"),
    ('hazard: ["...", "x.."]\ntarget: ["...", "..."]', 'hazard at the base 0'),
    ('hazard: ["..x", "..."]\ntarget: ["...", "..."]', 'cell 5: that cell is blocked'),
])  # fmt: skip
def test_a_bad_world_is_refused(write_world, text, told):
    path = write_world(text)
    with pytest.raises(ValueError) as refusal:
        read_world(path, SMALL_GRID)
    assert str(path) in str(refusal.value)
    assert told in str(refusal.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(OSError, match=r'nowhere\.yaml'):
        read_world(tmp_path / 'nowhere.yaml', SMALL_GRID)


STARTED_NODES = ('recorder', 'estimator', 'planner', 'agent')


FILES = {'map', 'goal.mask', 'world.file', 'journal', 'resume', 'file'}
FILES |= {f'prior.{name}_map' for name in ('hazard', 'target', 'kappa')}


def test_a_tilde_is_the_home_folder_in_every_parameter_that_names_a_file(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    for parameter in TABLE:
        if isinstance(parameter.default, str) and not (parameter.choices or parameter.pattern):
            wanted = str(tmp_path / 'a.yaml') if parameter.name in FILES else '~/a.yaml'
            assert parameter.check('~/a.yaml') == parameter.read('~/a.yaml') == wanted
            FILES.discard(parameter.name)
    assert not FILES
    Image.fromarray(np.array([[254, 0]], np.uint8)).save(tmp_path / 'a.png')
    (tmp_path / 'a.yaml').write_text(
        'image: a.png\nresolution: 1.0\norigin: [0, 0, 0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.2\n'
    )
    given = find_parameter('planner', 'map').check('~/a.yaml')
    assert make_grid(with_defaults('planner', {'map': given})).blocked == {1}


def test_options_and_defaults_of_starts_are_of_the_table():
    # A robot and a simulated agent have different parameters `agent`.
    known = {
        name: each
        for node in ('robot', *STARTED_NODES)
        for name, each in node_parameters(node).items()
    }
    assert all(name in known for names in OPTIONS.values() for name in names)
    for values in (*STARTED.values(), FIXED):
        for name, value in values.items():
            known[name].check(value)


@for_each('node, awaited', [
    ('recorder', []),
    ('estimator', ['planner', 'recorder']),
    ('agent', ['planner', 'estimator', 'recorder']),
    ('planner', ['agent', 'estimator', 'recorder']),
])  # fmt: skip
def test_nodes_of_a_recorded_mission_await_its_recorder_as_well(node, awaited):
    assert awaited_nodes(node, is_recorded=True) == awaited
    assert awaited_nodes(node, is_recorded=False) == awaited[:-1]


def test_a_node_is_given_those_parameters_that_it_has():
    given = {'robots': 3, 'seed': 4, 'team.scout_1.max_steps': 9, 'use_sim_time': True}
    assert parameters_for('agent', given).keys() == given.keys() - {'robots'}
