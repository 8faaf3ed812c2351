# SPDX-License-Identifier: Apache-2.0
"""Parameters from users: a value without effect is refused."""

from array import array
from itertools import product
from pathlib import Path
import re

from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.configuration import NODES
from kbnitp_ros.configuration.given import (
    check_given,
    check_sections,
    read_sections,
    rules_last,
    values_for,
)
from kbnitp_ros.configuration.known import foreign_note
from kbnitp_ros.configuration.ros_yaml import read_parameter_file
from kbnitp_ros.nodes.runtime.declared import declare, state
from laws import for_each, spoilt
import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
import yaml

SHIPPED = Path(__file__).parents[2] / 'config' / 'mission.yaml'


def section(name, **values):
    return {name: {'ros__parameters': values}}


def written(folder, content):
    path = folder / 'given.yaml'
    path.write_text(
        content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False)
    )
    return str(path)


@for_each('config, told', [
    (section('/**/plannr', robots=3), "'/**/plannr' names no node: did you mean planner?"),
    ({'planner': {'robots': 3}}, "'planner/robots' must hold ros__parameters"),
    ({'planner': {'ros__parameters': {}, 'robots': 3}}, "'planner' must hold ros__parameters"),
    ({'planner': {'ros__parameters': 3}}, "'planner' holds 3: it must hold parameters"),
    ([], 'it holds []: it must hold sections'),
    (section('planner', seed=3), 'seed is unknown to the planner: it is a parameter of agent'),
    (section('recorder', step_period=1.0), 'step_period is unknown to the recorder: it is a'),
    (section('/**', sensor={'lethal': 1.0}), "'/**': parameter sensor.lethal is unknown to"),
    (section('/**', seed='x'), "seed is 'x': it must be a whole number"),
    (section('/a/agent', seed=-1), 'seed is -1: it must be from 0'),
])  # fmt: skip
def test_a_bad_file_is_refused(tmp_path, config, told):
    path = written(tmp_path, config)
    with pytest.raises(ValueError) as refusal:
        read_sections(path)
    assert str(refusal.value).startswith(f'parameter file {path}: ')
    assert told in str(refusal.value)
    assert len(str(refusal.value)) < len(path) + 200


@for_each('text, told', [
    ('/**: {', 'it is not YAML'),
    ('/**: {ros__parameters: {seed: 1, seed: 2}}', "the key 'seed' appears in line 1"),
    ('/**: {ros__parameters: {team.scout_1.max_step: 9}}', 'did you mean team.scout_1.max_st'),
])  # fmt: skip
def test_bad_yaml_and_duplicate_keys_are_refused(tmp_path, text, told):
    with pytest.raises(ValueError, match=told):
        read_sections(written(tmp_path, text))


NAV2 = """
planner_server: {ros__parameters: {planner_plugins: [GridBased], GridBased: {tolerance: 0.5}}}
robots: {ros__parameters: {max_steps_per_s: 3}}
/north/planner: {ros__parameters: {max_steps: 7}}
/scout_1/global_costmap:
  global_costmap: {ros__parameters: {robot_radius: 0.22, plugins: [static_layer]}}
"""
PAGE = SHIPPED.parents[1].joinpath('docs', 'robots.md').read_text()


@for_each('text, own', [
    (NAV2, {'/north/planner': {'max_steps': 7}}),
    *(
        (text, {'/mission/estimator': {f'filter.{name}': value for name, value in given.items()}})
        for text, given in zip(
            re.findall(r'```yaml\n(/mission/estimator:\n.*?)```', PAGE, re.DOTALL),
            [
                {'type': 0, 'base': 0.0, 'multiplier': 1.0},
                {'type': 1, 'base': 100.0, 'multiplier': -0.9},
            ],
            strict=True,
        )
    ),
])  # fmt: skip
def test_sections_of_other_nodes_are_ignored(tmp_path, text, own):
    path = written(tmp_path, text)
    assert read_sections(path) == own
    check_given('planner', ['--ros-args', '-r', '__ns:=/north', '--params-file', path])
    assert given_by_ros(['--ros-args', '--params-file', path], '/north') == own.get(
        '/north/planner', {}
    )


@pytest.mark.slow
@given(st.data())
def test_a_corrupt_file_is_read_or_refused_in_a_line(tmp_path_factory, data):
    path = tmp_path_factory.mktemp('given') / 'given.yaml'
    path.write_bytes(data.draw(spoilt(SHIPPED.read_bytes())))
    try:
        sections = read_sections(path)
        assert all(values_for(sections, f'/{node}') is not None for node in NODES)
        return
    except ValueError as error:
        said = str(error)
    assert said.startswith(f'parameter file {path}: ')
    assert '\n' not in said


def test_a_missing_file_is_named():
    with pytest.raises(ValueError, match=r'^parameter file no/where.yaml: No such file or dir'):
        read_sections('no/where.yaml')


def given_by_ros(arguments, namespace=None):
    """Return the parameters of a planner with these arguments."""
    context = rclpy.Context()
    rclpy.init(context=context, args=arguments)
    node = Node('planner', namespace=namespace, context=context)
    given = {name: each.value for name, each in node._parameter_overrides.items()}
    node.destroy_node()
    context.try_shutdown()
    return given


def test_tuples_by_launch_are_lists(tmp_path):
    values = {'agents': ('a', 'b'), 'grid.blocked': (3,)}
    text = yaml.dump({'/planner': {'ros__parameters': values}}, default_flow_style=False)
    assert 'python/tuple' in text
    assert read_sections(written(tmp_path, text)) == {
        '/planner': {'agents': ['a', 'b'], 'grid.blocked': [3]}
    }


def test_parameters_of_agents_stand_beside_the_number_of_robots(tmp_path):
    text = """
    /**:
      ros__parameters:
        robots: 20
        team.scout_1.max_steps: 9
        team:
          scout_2:
            max_steps: 7
            sensor: {lethality: 0.3}
    """
    expected = {
        'robots': 20,
        'team.scout_1.max_steps': 9,
        'team.scout_2.max_steps': 7,
        'team.scout_2.sensor.lethality': 0.3,
    }
    path = written(tmp_path, text)
    assert read_sections(path) == {'/**': expected}
    assert given_by_ros(['--ros-args', '--params-file', path]) == expected


@for_each('name', NODES)
def test_files_by_ros2_param_dump_are_read(tmp_path, name):
    context = rclpy.Context()
    rclpy.init(context=context)
    own = [Parameter(f'team.scout_1.{each}', value=9) for each in ('max_steps', 'base')]
    node = Node(name, context=context, parameter_overrides=own)
    values = declare(node, name)
    tree = {}
    for parameter in values:
        *path, last = parameter.split('.')
        inner = tree
        for key in path:
            inner = inner.setdefault(key, {})
        inner[last] = node.get_parameter(parameter).value
    node.destroy_node()
    context.try_shutdown()
    path = written(tmp_path, {f'/{name}': {'ros__parameters': tree}})
    check_given(name, ['--ros-args', '--params-file', path])
    given = values_for(read_sections(path), f'/{name}')
    assert given == {key: list(v) if type(v) is tuple else v for key, v in values.items()}


def test_the_shared_section_may_have_parameters_of_any_node():
    given = {'robots': 3, 'seed': 4, 'file': 'a.mcap', 'use_sim_time': True}
    assert check_sections(section('/**', **given), {}) == {'/**': given}


ORDERS = [
    {**section('/**', max_steps=1), **section('planner', max_steps=2)},
    {**section('planner', max_steps=2), **section('/**', max_steps=1)},
    {**section('/**', max_steps=1), **section('/**/planner', max_steps=2)},
    {**section('/*', max_steps=1), **section('/north/*', max_steps=2)},
    {**section('/**', max_steps=1), 'north': section('planner', max_steps=2)},
    {**section('/**', max_steps=1), **section('agent', max_steps=2)},
    {**section('/*/planner', max_steps=1), **section('/north/planner', max_steps=2)},
    section('planner', grid={'width': 4, 'height': 3}, await_nodes=['agent']),
]


SCALARS = [
    '1', '-3', '+4', '0x1F', '010', '1_0', '1:30', '1e-3', '1.', '.5', '-.5e2', '1.5',
    '.nan', '.inf', '-.inf', 'true', 'Yes', 'off', 'N', 'text', '"3"', "'true'", '!!int "3"',
    '!!str 3', '1e', '0x',
    '[1, 2]', '[1.0, 2.5]', '[a, b]', '[true, false]', '2026-11-28',
]  # fmt: skip


@for_each('text', SCALARS)
def test_values_have_the_types_of_ros(tmp_path, text):
    path = tmp_path / 'given.yaml'
    path.write_text(f'planner:\n  ros__parameters:\n    x: {text}\n')
    (theirs,) = given_by_ros(['--ros-args', '--params-file', str(path)], '/').values()
    ours = read_parameter_file(path)['planner']['ros__parameters']['x']
    ours = tuple(ours) if isinstance(ours, list) else ours
    theirs = (
        tuple(theirs) if not isinstance(theirs, str) and hasattr(theirs, '__iter__') else theirs
    )
    assert type(ours) is type(theirs)
    assert str(ours) == str(theirs)


@for_each(
    'lines, told',
    [
        (
            ['a: &x {b: 0.3}', 'c: *x'],
            'line 4 has the alias \\*x, which ROS does not take: write the',
        ),
        (
            ['grid: {base_position: [1, 2.5]}'],
            r'line 3: base_position is \[1, 2.5\], a whole number and',
        ),
        ([''], 'line 2: ros__parameters is empty, which ROS does not take: leave the section out'),
    ],
)
def test_what_the_parser_of_ros_refuses_is_told_with_line_key_and_remedy(tmp_path, lines, told):
    path = tmp_path / 'given.yaml'
    path.write_text(
        '\n'.join(['planner:', '  ros__parameters:', *(f'    {each}' for each in lines)])
    )
    with pytest.raises(ValueError, match=f'parameter file {path}: {told}'):
        read_sections(path)
    with pytest.raises(RuntimeError, match="Couldn't parse params file"):
        given_by_ros(['--ros-args', '--params-file', str(path)], '/')


@for_each('config, namespace', product(ORDERS, ['/', '/north']))
def test_values_equal_those_of_ros(tmp_path, config, namespace):
    path = written(tmp_path, config)
    given = given_by_ros(['--ros-args', '--params-file', path], namespace)
    assert values_for(read_sections(path), f'{namespace.rstrip("/")}/planner') == given


@for_each('name, rule, told', [
    ('recorder', 'flie:=a.mcap', 'flie is unknown to the recorder: did you mean file?'),
    *(
        ('planner', f'{name}:=3', 'the planner: did you mean robots?')
        for name in ('robts', 'robtos', 'robotss', 'tobots', 'xrobots', 'robot')
    ),
    ('recorder', 'recorder:xyz:=1', 'xyz is unknown to the recorder: see recorder --help'),
    ('planner', 'planer:robots:=3', "this node is not 'planer': did you mean planner?"),
    ('planner', 'recorder:robots:=3', 'robots is unknown to the recorder: it is a'),
])  # fmt: skip
def test_a_bad_rule_is_refused(name, rule, told):
    for flag in ('-p', '--param'):
        with pytest.raises(ValueError) as refusal:
            check_given(name, ['--ros-args', flag, rule])
        assert told in str(refusal.value)
        assert len(str(refusal.value)) < 150


@for_each('rule, note', [
    # Launch gives every node what SetParameter sets.
    ('publish_frequency:=50.0', r'did you mean publish_truth\? .*ignored, since a launch file'),
    ('robot_description:=x', 'unknown to every node: .*ignored'),
    *(
        (f'{name}:=1', 'ignored, since a launch file')
        for name in (
            'robot_base_frame', 'base_frame_id', 'global_frame', 'map_frame', 'resolution',
            'height', 'goal_tolerance', 'xy_goal_tolerance', 'bond_timeout', 'scan_topic',
            'lethality',
        )
    ),
    ('sensor.lethality:=0.3', '^$'),
    ('use_sim_time:=true', '^$'),
])  # fmt: skip
def test_parameters_of_other_nodes_are_ignored_with_a_note(rule, note):
    for name in NODES:
        check_given(name, ['--ros-args', '-p', rule])
    assert re.search(note, foreign_note(rule.partition(':=')[0]))


@for_each('in_section', [None, False, True])
def test_a_clock_by_a_rule_counts_or_is_refused(tmp_path, in_section):
    config = section('/**', use_sim_time=False)
    if in_section is not None:
        config |= section('/**/planner', use_sim_time=in_section)
    given = ['--ros-args', '--params-file', written(tmp_path, config), '-p', 'use_sim_time:=true']
    if in_section is False:
        with pytest.raises(ValueError, match=r'-p use_sim_time:=True has no effect'):
            check_given('planner', given)
    else:
        check_given('planner', given)
        assert given_by_ros(rules_last(given))['use_sim_time'] is True


@for_each('is_before', [True, False])
def test_a_rule_counts_rather_than_the_wildcard_of_a_file(tmp_path, is_before):
    path = written(tmp_path, section('/**', use_sim_time=False, robots=9))
    file = ['--params-file', path]
    rules = ['-p', 'use_sim_time:=true', '--param', 'robots:=3']
    arguments = ['--ros-args', *(rules + file if is_before else file + rules), '--', 'x']
    check_given('planner', arguments)
    assert given_by_ros(rules_last(arguments)) == {'use_sim_time': True, 'robots': 3}


def test_a_node_starts_from_its_own_dump(tmp_path):
    topics = {'belief': '/belief', 'path': '/scout_1/path'}
    context = rclpy.Context()
    rclpy.init(context=context, args=[])

    def started(names, *arguments):
        node = Node('planner', context=context, cli_args=arguments)
        values = declare(node, 'planner')
        state(node, names)
        found = {each.name: each.value for each in node.get_parameters([*node._parameters])}
        node.destroy_node()
        return values, found

    _, found = started(topics)
    assert {'topics', 'use_sim_time', 'start_type_description_service'} <= found.keys()
    # rcl reads no empty lists, and `ros2 param dump` writes them.
    dumped = {name: list(v) if isinstance(v, array | list) else v for name, v in found.items()}
    path = written(tmp_path, section('/planner', **dumped))
    given = ['--ros-args', '--params-file', path]
    check_given('planner', given)
    values, again = started(topics, *given)
    assert values['robots'] == found['robots']
    assert again.keys() == found.keys()
    # Topics are stated and not set.
    _, other = started({'belief': '/other'}, *given)
    assert [*other['topics']] == ['belief=/other']
    context.try_shutdown()


@for_each('arguments', [
    ['-p', 'flie:=a.mcap'],
    ['--ros-args', '-r', 'path:=way', '-p', 'file:=a.mcap', '--log-level', 'info'],
    ['--ros-args', '--', '-p', 'flie:=a.mcap'],
    ['--ros-args', '-p', 'use_sim_time:=true', '-p', 'qos_overrides./a.publisher.depth:=2'],
    ['--ros-args', '-p', 'planner:robots:=3'],
    ['--ros-args', '-r', '__node:=scribe', '-p', 'scribe:file:=a.mcap'],
])  # fmt: skip
def test_arguments_that_only_ros_reads_pass(arguments):
    check_given('recorder', arguments)


def test_a_renamed_node_has_a_section_of_its_own(tmp_path):
    path = written(tmp_path, section('/**/scribe', file='a.mcap'))
    given = ['--ros-args', '--params-file', path]
    check_given('recorder', [*given, '--remap', '__node:=scribe'])
    path = written(tmp_path, section('/**/scribe', robots=3))
    with pytest.raises(ValueError, match='robots is unknown to the recorder'):
        check_given('recorder', [*given, '--remap', '__node:=scribe'])


@for_each('config, namespace', product(ORDERS, ['/', '/north']))
def test_an_ineffective_rule_is_refused(tmp_path, config, namespace):
    given = ['--ros-args', '-r', f'__ns:={namespace}', '--params-file', written(tmp_path, config)]
    given += ['-p', 'max_steps:=5']
    if given_by_ros(given)['max_steps'] == 5:
        check_given('planner', given)
    else:
        with pytest.raises(ValueError, match='-p max_steps:=5 has no effect.*change max_'):
            check_given('planner', given)
