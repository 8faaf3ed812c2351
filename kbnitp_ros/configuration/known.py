# SPDX-License-Identifier: Apache-2.0
"""The parameters of each node, and the page that documents them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
import json
from textwrap import wrap
from typing import Any

from kbnitp_ros.configuration.parameter import nearest, own_name, Parameter
from kbnitp_ros.configuration.table import NODES, TABLE
from kbnitp_ros.log.read import current_name
from kbnitp_ros.plugins import Registry

# Parameters that rclpy gives every node.
ROS_PARAMETERS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')


def node_parameters(name: str) -> dict[str, Parameter]:
    """Return the parameters of a node by name."""
    return {parameter.name: parameter for parameter in TABLE if name in parameter.nodes}


def find_parameter(node: str, name: str) -> Parameter | None:
    """Return a node's parameter of this name, or of one agent; None if there is none."""
    known = node_parameters(node)
    own = own_name(name)
    if own is None:
        return known.get(name)
    of_agents = {each.of_agent: each for each in known.values() if each.per_agent}
    common = of_agents.get(own[1])
    return replace(common, name=name) if common else None


def check_known(name: str, nodes: Sequence[str]) -> None:
    """Check that a name is a parameter of one of these nodes."""
    if (now := current_name(name)) != name:
        raise ValueError(f'parameter {name} is called {now} now')
    if name.split('.')[0] in ROS_PARAMETERS or any(find_parameter(node, name) for node in nodes):
        return
    whose = f'the {nodes[0]}' if len(nodes) == 1 else 'every node'
    if others := [node for node in NODES if find_parameter(node, name)]:
        raise ValueError(
            f'parameter {name} is unknown to {whose}: it is one of {", ".join(others)}'
        )
    table = [parameter for node in nodes for parameter in node_parameters(node).values()]
    known = {parameter.name for parameter in table}
    if own := own_name(name):
        agent, meant = own
        known = {f'team.{agent}.{each.of_agent}' for each in table if each.per_agent}
        if meant in {parameter.name for parameter in table if not parameter.per_agent}:
            raise ValueError(f'parameter {name}: all agents have the same {meant}')
    raise ValueError(
        f'parameter {name} is unknown to {whose}: {nearest(name, known)}'
        f'{nodes[0]} --help tells which it has'
    )


def check_own(values: Mapping[str, Any]) -> None:
    """Check that every agent with own parameters is in the team."""
    for name in values:
        own = own_name(name)
        if own and own[0] not in values['agents']:
            agents = values['agents']
            raise ValueError(
                f'parameter {name} is for {own[0]}: {nearest(own[0], agents)}the parameter agents '
                f'names {", ".join(agents)}'
            )


def reference_page() -> str:
    """Return the reference page of all parameters, in Markdown."""
    lines = [
        '# Parameters',
        '',
        'Printed by `python3 -m kbnitp_ros.configuration` from the table that the nodes use.',
        'Every node also has `use_sim_time`. A parameter is fixed once its node runs, unless it',
        'says that it can be changed. Other packages may add methods, planners and allocations.',
        '',
        'Of these an agent may have others than the rest, as `team.AGENT.NAME`; see',
        '[Maps](maps.md#robots-that-differ): '
        f'{", ".join(dict.fromkeys(f"`{each.of_agent}`" for each in TABLE if each.per_agent))}.',
    ]
    for name in NODES:
        lines += [
            '',
            f'## {name}',
            '',
            '| parameter | default | must be | meaning |',
            '|---|---|---|---|',
        ]
        lines += [
            f'| `{parameter.name}` | `{json.dumps(parameter.default)}` | {parameter.must_be} '
            f'| {parameter.description}{parameter.changeable} |'
            for parameter in map(of_this_package, node_parameters(name).values())
        ]
    return '\n'.join(lines) + '\n'


def of_this_package(parameter: Parameter) -> Parameter:
    """Return a parameter without the choices that other packages add."""
    own = parameter.choices.own if isinstance(parameter.choices, Registry) else parameter.choices
    return replace(parameter, choices=own)


MISSION_FILE = """\
# Every parameter of the nodes, each with its default. To change some, give a mission a copy, which
# needs no more than what is changed:
#   ros2 launch kbnitp_ros mission.launch.py params_file:=mine.yaml
#   python3 -m kbnitp_ros demo --params mine.yaml
# A parameter is fixed once its node runs, unless it says that it can be changed. Values of one
# agent, such as team.scout_2.max_steps: 10, go under /**; see docs/maps.md.

# Parameters of several nodes. A section further down may differ: give the agent a sensor.lethality
# of its own, and its world is not what the estimator believes.
/**:
  ros__parameters:
    # Whether to follow /clock instead of the clock of the machine.
    use_sim_time: false
"""


def mission_file() -> str:
    """Return config/mission.yaml: all parameters by node, with their defaults."""
    rows = Counter(each.name for each in TABLE)
    shared = [each for each in TABLE if len(each.nodes) > 1 and rows[each.name] == 1]
    lines = [*section_lines(shared)]
    for name in NODES:
        own = [each for each in node_parameters(name).values() if each not in shared]
        lines += ['', f'/**/{name}:', '  ros__parameters:', *section_lines(own)]
    return MISSION_FILE + '\n'.join(lines) + '\n'


def section_lines(parameters: Iterable[Parameter]) -> Iterator[str]:
    """Yield the lines of parameters in a section, groups such as `grid` nested."""
    ordered = sorted(parameters, key=lambda each: '.' in each.name)
    for group, members in groupby(ordered, lambda each: each.name.rpartition('.')[0]):
        if group:
            yield f'    {group}:'
        indent = ' ' * (6 if group else 4)
        for each in map(of_this_package, members):
            kind = each.must_be[0].upper() + each.must_be[1:]
            words = wrap(f'{each.description}{each.changeable} {kind}.', 97 - len(indent))
            yield from (f'{indent}# {line}' for line in words)
            yield f'{indent}{each.name.rpartition(".")[2]}: {json.dumps(each.default)}'
