#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""
Print docs/parameters.md, or with the argument ``mission`` config/mission.yaml.

    python3 tools/parameter_files.py > docs/parameters.md
    python3 tools/parameter_files.py mission > config/mission.yaml
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import groupby
import json
import sys
from textwrap import wrap

from kbnitp_ros.configuration import node_parameters, NODES, Parameter, TABLE
from kbnitp_ros.plugins import Registry


def reference_page() -> str:
    """Return the reference page of all parameters, in Markdown."""
    lines = [
        '# Parameters',
        '',
        'Printed by `python3 tools/parameter_files.py` from the table that the nodes use.',
        'Every node also has `use_sim_time`. A parameter is fixed once its node runs, unless it',
        'says that it can be changed. Other packages may add methods, planners and allocations;',
        '`MODULE:FUNCTION` names one in a file of the working folder. A default *in the field*',
        'counts where the parameter `defaults` is `field`, or `auto` with a map.',
        '',
        'An agent may have its own values, as `team.AGENT.NAME` (see',
        '[Maps](maps.md#robots-that-differ)), of '
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
            f'| `{parameter.name}` | `{json.dumps(parameter.default)}`{parameter.differs} '
            f'| {parameter.must_be} '
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
# agent, such as team.scout_2.max_steps: 10, go under /**; see docs/maps.md. A parameter whose line
# is a comment has another default in the field (parameter defaults).

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
        for parameter in map(of_this_package, members):
            kind = parameter.must_be[0].upper() + parameter.must_be[1:]
            words = wrap(
                f'{parameter.description}{parameter.changeable} {kind}.', 97 - len(indent)
            )
            yield from (f'{indent}# {line}' for line in words)
            off = '# ' if parameter.differs else ''
            in_field = parameter.differs.replace(', ', '  # ', 1)
            own_name = parameter.name.rpartition('.')[2]
            yield f'{indent}{off}{own_name}: {json.dumps(parameter.default)}{in_field}'


if __name__ == '__main__':
    print(mission_file() if sys.argv[1:] == ['mission'] else reference_page(), end='')
