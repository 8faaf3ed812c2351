# SPDX-License-Identifier: Apache-2.0
"""One table of parameters is declared, checked, documented and configured."""

from dataclasses import fields, replace
from pathlib import Path
import subprocess
import sys

from kbnitp_ros.configuration import (
    agent_names,
    find_parameter,
    make_estimator,
    make_grid,
    node_parameters,
    NODES,
    TABLE,
    value_for,
)
from kbnitp_ros.configuration.agents import (
    make_robot_types,
    make_sensor_model,
    make_unknowns,
    most_distance,
    most_steps,
    own_base,
)
from kbnitp_ros.configuration.known import check_known
from kbnitp_ros.configuration.table import LEARN
from kbnitp_ros.core import Beta, Grid, METHODS, PLANNERS, RobotType, Unknowns
from kbnitp_ros.nodes.runtime.declared import declare
from laws import for_each
import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

ROOT = Path(__file__).parents[2]


@pytest.fixture
def make_node():
    """Make nodes with parameters as on a command line."""
    context = rclpy.Context()
    rclpy.init(context=context)
    nodes = []

    def make(**overrides):
        given = [Parameter(name, value=value) for name, value in overrides.items()]
        nodes.append(Node('given', context=context, parameter_overrides=given))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def test_every_row_is_complete_and_its_default_is_allowed():
    for parameter in TABLE:
        assert parameter.check(parameter.default) == parameter.default
        assert parameter.description.endswith('.')
        assert set(parameter.nodes) <= set(NODES)
    for name in NODES:
        rows = [parameter for parameter in TABLE if name in parameter.nodes]
        assert len(rows) == len(node_parameters(name))


@for_each('node', NODES)
def test_no_name_begins_as_another_ends(node):
    """`ros2 param dump` nests names at dots, so no name can have both a value and parts."""
    table = node_parameters(node).values()
    names = [each.name for each in table]
    names += [f'team.scout_1.{each.of_agent}' for each in table if each.per_agent]
    assert [(a, b) for a in names for b in names if b.startswith(f'{a}.')] == []


@for_each('name', NODES)
def test_nodes_declare_the_table(make_node, name):
    node = make_node()
    values = declare(node, name)
    for parameter in node_parameters(name).values():
        is_chosen = parameter.name == 'defaults'
        assert values[parameter.name] == ('paper' if is_chosen else parameter.default)
        descriptor = node.describe_parameter(parameter.name)
        assert descriptor.description == parameter.description
        assert descriptor.read_only == parameter.read_only
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        limits = [(each.from_value, each.to_value) for each in ranges]
        low, high = parameter.limits or (None, None)
        low = low if parameter.off is None else parameter.off
        assert limits == ([(low, high)] if parameter.limits else [])


@for_each('overrides, told', [
    ({'sensor.lethality': 1.5}, 'sensor.lethality is 1.5: it must be from 0.0 to 1.0'),
    ({'sensor.lethality': float('nan')}, 'sensor.lethality is nan: it must be from 0.0'),
    ({'sensor.lethality': True}, 'sensor.lethality is True: it must be a number'),
    ({'grid.width': 9.0}, 'grid.width is 9.0: it must be a whole number'),
    ({'grid.origin': 3.0}, 'grid.origin is 3.0: it must be a list, each a number'),
    ({'grid.origin': 'ab'}, "grid.origin is 'ab': it must be a list, each a number"),
    ({'grid.blocked': [1.5]}, 'grid.blocked is 1.5: it must be a list, each a whole number'),
    ({'method': 'guess'}, f"method is 'guess': it must be one of {', '.join(METHODS)}"),
    ({'agents': ['a', 'b c']}, "agents is 'b c': it must be of the form [A-Za-z]"),
    ({'team.scout_1.max_step': 9}, 'every node: did you mean team.scout_1.max_steps? '),
    ({'team.scout_1.seed': 3}, 'team.scout_1.seed: all agents have the same seed'),
    ({'team.scuot_1.max_steps': 9}, 'of agent scuot_1, which is not in the team: did you'),
    ({'team.scout_1.sensor.lethality': 2.0}, 'lethality is 2.0: it must be from 0.0 to'),
])  # fmt: skip
def test_bad_values_are_refused_at_start_up(make_node, overrides, told):
    with pytest.raises(ValueError) as refusal:
        declare(make_node(**overrides), 'estimator')
    assert told in str(refusal.value)


DEFAULTS = {parameter.name: parameter.default for parameter in TABLE}


def test_numbers_to_learn_have_intervals_or_distributions():
    given = {'learn.numbers': ('kappa', 'lethality'), 'learn.lethality': (0.2, 0.9)}
    believed = make_unknowns(DEFAULTS | given)
    assert believed == Unknowns(lethality=(0.2, 0.9), kappa=Beta(4.0, 1.5))
    assert make_unknowns(DEFAULTS) == Unknowns()
    assert list(LEARN) == [*(field.name for field in fields(Unknowns)), 'vanish', 'move']


@for_each('learn, given, told', [
    (('lethality', 'lethality'), (0.0, 1.0), 'learn.numbers is .* it must name each number once'),
    ((), (0.7, 0.2), r'learn.lethality is \[0.7, 0.2\]: interval is from 0.7 to'),
    (('lethality',), (0.7, 0.2), r'learn.lethality is \[0.7, 0.2\]: interval is from 0.7 to'),
    (('lethality',), (), r'learn.lethality is \[\]: it must be low and high'),
    (('lethality',), (0.1, 0.5, 2.0), 'it must be low and high, or low, high, a and b'),
])  # fmt: skip
def test_a_bad_distribution_is_refused(learn, given, told):
    with pytest.raises(ValueError, match=told):
        make_unknowns(DEFAULTS | {'learn.numbers': learn, 'learn.lethality': given})


@for_each('agents', [(), ('a', 'b', 'a')])
def test_agents_have_names_of_their_own(agents):
    with pytest.raises(ValueError, match='no two alike'):
        agent_names(DEFAULTS | {'agents': agents}, Grid(9, 9))


def test_a_team_has_a_free_cell_for_each():
    small = Grid(3, 2, blocked=[4])
    five = tuple('abcde')
    assert agent_names(DEFAULTS | {'agents': five}, small) == five
    with pytest.raises(ValueError, match='has 6 names.*5 free cells'):
        agent_names(DEFAULTS | {'agents': (*five, 'f')}, small)


def test_whole_numbers_are_numbers(make_node):
    values = declare(make_node(**{'sensor.lethality': 1, 'grid.origin': [1, -2]}), 'estimator')
    assert values['sensor.lethality'] == 1.0
    assert make_grid(values).origin == (1.0, -2.0)
    assert make_sensor_model(values).lethality == 1.0


def test_an_empty_list_from_a_file_is_a_list(make_node):
    node = make_node()
    node._parameter_overrides['grid.blocked'] = Parameter('grid.blocked')
    assert declare(node, 'planner')['grid.blocked'] == ()
    assert node.get_parameter('grid.blocked').value == []


def test_parameters_of_other_nodes_and_of_ros_are_passed_over(make_node):
    node = make_node(**{'seed': 3, 'use_sim_time': True, 'qos_overrides./a.publisher.depth': 2})
    assert 'seed' not in declare(node, 'planner')


def test_an_agent_has_its_own_and_the_shared_values(make_node):
    given = {
        'agents': ['scout_1', 'scout_2'], 'max_steps': 12, 'max_distance': 9.5, 'robots': 20,
        'team.scout_2.max_steps': 7, 'team.scout_2.max_distance': 5.0,
        'team.scout_2.loss_cost': 2.0, 'team.scout_2.step_period': 3.0,
    }  # fmt: skip
    node = make_node(**given)
    values = declare(node, 'planner')
    assert values['robots'] == 20
    assert [value_for(values, 'max_steps', agent) for agent in values['agents']] == [12, 7]
    assert value_for(values, 'step_period', 'scout_2') == 3.0
    assert most_steps(values) == 12
    assert most_distance(values, values['agents']) == 9.5
    assert most_distance(values | {'max_distance': 0.0}, values['agents']) == 0.0
    own = RobotType(max_steps=7, max_distance=5.0, loss_cost=2.0)
    assert make_robot_types(values, make_grid(values)) == {'scout_1': RobotType(), 'scout_2': own}
    (fixed, free) = node.set_parameters(
        [
            Parameter('team.scout_2.max_steps', value=9),
            Parameter('team.scout_2.loss_cost', value=0.5),
        ]
    )
    assert not fixed.successful
    assert free.successful
    assert make_robot_types(values, make_grid(values))['scout_2'].loss_cost == 0.5


def test_an_agent_s_values_for_other_nodes_are_ignored(make_node):
    values = declare(make_node(**{'team.scout_1.loss_cost': 2.0}), 'estimator')
    assert make_robot_types(values, make_grid(values)) == {'scout_1': RobotType()}
    sensors = make_node(**{'sensor.lethality': 1, 'team.scout_1.sensor.lethality': 0.5})
    assert not [name for name in declare(sensors, 'planner') if 'sensor' in name]


def test_a_number_that_no_robot_shares_cannot_be_learnt():
    own = {'team.scout_1.sensor.lethality': 0.3, 'learn.numbers': ('lethality',)}
    values = DEFAULTS | own | {'method': 'kappa_bnitp_sampled'}
    with pytest.raises(ValueError, match='learn.numbers has lethality, and every agent has a'):
        make_estimator(values, make_grid(values))
    two = values | {'agents': ('scout_1', 'scout_2')}
    assert make_estimator(two, make_grid(two)).unknowns.priors.keys() == {'lethality'}


def test_values_follow_changes(make_node):
    node = make_node()
    values = declare(node, 'planner')
    (result,) = node.set_parameters([Parameter('robots', value=7)])
    assert result.successful
    assert values['robots'] == 7


@for_each('name, value, told', [
    ('grid.width', 5, 'read-only'),
    ('robots', -1, 'out of range'),
    ('planner', 'guess', f"'guess': it must be one of {', '.join(PLANNERS)}"),
    # Others may set parameters, and must not import modules.
    ('planner', 'this:s', "'this:s': a module is imported at the start only"),
    ('beam_width', 2.5, 'type'),
    ('use_sim_time', True, 'use_sim_time cannot change: restart the node with the'),
])  # fmt: skip
def test_bad_values_are_refused_while_running(make_node, name, value, told):
    node = make_node()
    values = declare(node, 'planner')
    before = dict(values)
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert told in result.reason
    assert values == before
    assert 'this' not in sys.modules
    assert not node.get_clock().ros_time_is_active


@pytest.mark.processes
@for_each('file, argument', [('docs/parameters.md', []), ('config/mission.yaml', ['mission'])])
def test_the_files_made_from_the_table_are_up_to_date(file, argument):
    command = [sys.executable, 'tools/parameter_files.py', *argument]
    made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert ROOT.joinpath(file).read_text() == made, f'python3 tools/parameter_files.py > {file}'


@for_each('name, text, value', [
    ('sensor.lethality', '0.3', 0.3),
    ('sensor.lethality', '1', 1.0),
    ('robots', '7', 7),
    ('rolling', 'true', True),
    ('method', 'relaxed_itp', 'relaxed_itp'),
    ('world.file', '7', '7'),
    ('world.file', '', ''),
    ('grid.blocked', '[3, 4]', (3, 4)),
    ('agents', '[a, b]', ('a', 'b')),
])  # fmt: skip
def test_values_are_read_as_they_are_typed(name, text, value):
    row = next(parameter for parameter in TABLE if parameter.name == name)
    assert row.read(text) == value
    assert type(row.read(text)) is type(value)


@for_each(
    'name, text',
    [('robots', '7.5'), ('robots', '['), ('sensor.lethality', 'high'), ('robots', '')],
)
def test_text_without_a_value_is_named(name, text):
    row = next(parameter for parameter in TABLE if parameter.name == name)
    with pytest.raises(ValueError, match=f'parameter {name} is '):
        row.read(text)


def write_map(folder, picture, resolution=0.5):
    """Write a map for map_server, seen from above: # is occupied, ? unknown."""
    rows = '\n'.join(
        ' '.join(str({'#': 0, '?': 205}.get(each, 254)) for each in row) for row in picture
    )
    (folder / 'map.pgm').write_text(f'P2 {len(picture[0])} {len(picture)} 255\n{rows}\n')
    (folder / 'map.yaml').write_text(
        f'image: map.pgm\nresolution: {resolution}\norigin: [1.0, 2.0, 0.0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.196\n'
    )
    return DEFAULTS | {'map': str(folder / 'map.yaml')}


def test_a_map_gives_the_field(tmp_path):
    values = write_map(tmp_path, ['?.##', '....'])
    values['grid.resolution'] = 0.5
    field = {'resolution': 0.5, 'origin': (1.0, 2.0)}
    clear = Grid(4, 2, blocked=(4, 6, 7), through_corners=False, **field)
    assert make_grid(values) == clear
    others = {'grid.width': 30, 'grid.height': 30, 'grid.blocked': (1,), 'grid.origin': (7.0, 7.0)}
    assert make_grid(values | others) == clear
    assert make_grid(values | {'grid.corners': 'cut'}) == replace(clear, through_corners=True)
    assert make_grid(values | {'grid.connectivity': 4}) == replace(clear, connectivity=4)
    assert make_grid(values | {'unknown_blocks': False}) == replace(clear, blocked=(6, 7))
    assert make_grid(values | {'grid.base': 3}).base == 3
    assert make_grid(values | {'grid.base_position': (2.2, 2.1)}).base == 2
    coarse = make_grid(values | {'grid.resolution': 1.0, 'unknown_blocks': False})
    assert (coarse.width, coarse.height, coarse.resolution) == (2, 1, 1.0)
    assert coarse.blocked == {1}
    # Cells of 1 m unless the parameters or a coarser map say otherwise.
    assert make_grid(values | {'grid.resolution': 0.0, 'unknown_blocks': False}) == coarse
    values = write_map(tmp_path, ['....'], resolution=2.0)
    assert make_grid(values).resolution == 2.0


def test_without_a_map_the_base_may_be_a_point_and_steps_keep_off_corners():
    grid = make_grid(DEFAULTS | {'grid.resolution': 0.5, 'grid.base_position': (4.4, 0.6)})
    assert grid == Grid(9, 9, base=17, resolution=0.5)
    assert make_grid(DEFAULTS) == Grid(9, 9)
    assert make_grid(DEFAULTS | {'grid.corners': 'avoid'}) == Grid(9, 9, through_corners=False)


@for_each('given, told', [
    ({'grid.base_position': (1.7, 2.7)}, 'the base, cell 5 around .* is blocked'),
    (
        {'grid.base': 5},
        r'the base, cell 5 .* set grid.base .*_position, .* free cell is 1 around \(1.75, 2.25\)',
    ),
    ({'grid.base_position': (0.9, 2.1)}, 'outside the grid'),
    ({'grid.base_position': (1.0,)}, r'grid.base_position is \[1.0\]: it must be x and y'),
    ({'grid.resolution': 0.25}, 'grid resolution is 0.25: it must be at least that of the map'),
    ({'map_topic': '/map'}, 'map and map_topic are both given'),
    ({'map': 'nowhere.yaml'}, 'nowhere.yaml cannot be read'),
])  # fmt: skip
def test_bad_fields_are_refused(tmp_path, given, told):
    with pytest.raises(ValueError, match=told):
        make_grid(write_map(tmp_path, ['.#..', '....']) | {'grid.resolution': 0.5} | given)


def test_each_agent_may_have_a_base_of_its_own(tmp_path):
    own = {
        'agents': ('scout_1', 'scout_2', 'scout_3'),
        'team.scout_2.base': 3,
        'team.scout_3.base_position': (2.2, 2.1),
    }
    values = write_map(tmp_path, ['....', '....'], resolution=1.0) | own
    grid = make_grid(values)
    bases = [own_base(values, agent, grid) for agent in own['agents']]
    assert bases == [None, 3, int(grid.cells_at([(2.2, 2.1)])[0])]
    assert grid.other_bases == set(bases[1:])
    alone = make_grid({name: value for name, value in values.items() if name not in own})
    assert grid == replace(alone, other_bases=bases[1:])
    types = make_robot_types(values, grid)
    assert [each.base for each in types.values()] == bases
    assert with_base('planner') == with_base('robot') == with_base('agent') == 3
    assert check_known('team.scout_2.base_position', ['estimator']) is None
    with pytest.raises(ValueError, match='did you mean team.scout_2.base'):
        check_known('team.scout_2.grid.base', ['planner'])


def with_base(node):
    return find_parameter(node, 'team.scout_2.base').check(3)


@for_each('given, told', [
    ({'team.scout_2.base': 1}, 'team.scout_2.base: base is 1.*this cell is blocked; choose'),
    ({'team.scout_2.base': 8}, 'team.scout_2.base: base is 8.*from 0 to 7; choose a free'),
    ({'team.scout_2.base': 2}, 'scout_2.base: base is 2, which obstacles cut off.*base 0.*conn'),
    ({'team.scout_2.base_position': (9.0, 1.0)}, r'scout_2.base_position: point \(9.0, 1.0'),
    ({'team.scout_2.base_position': (9.0,)}, r'base_position is \[9.0\]: it must be x and y'),
    (
        {'team.scout_2.base': 4, 'team.scout_2.base_position': (0.0, 0.0)},
        'team.scout_2.base and team.scout_2.base_position are both given',
    ),
])  # fmt: skip
def test_bad_bases_are_refused_by_name(tmp_path, given, told):
    with pytest.raises(ValueError, match=told):
        make_grid(write_map(tmp_path, ['.#..', '.#..'], resolution=1.0) | given)


def test_a_map_of_too_many_cells_is_refused(tmp_path):
    values = write_map(tmp_path, ['.' * 1001], resolution=0.05) | {'grid.resolution': 0.05}
    with pytest.raises(ValueError, match='grid of 1001 x 1 cells: at most 1000 per side'):
        make_grid(values)
    assert make_grid(values | {'grid.resolution': 0.1, 'unknown_blocks': False}).width == 501


def test_a_missing_map_is_no_field():
    with pytest.raises(ValueError, match='no map was received'):
        make_grid(DEFAULTS | {'map_topic': '/map'})
