# SPDX-License-Identifier: Apache-2.0
"""The page that documents every parameter, docs/parameters.md."""

from __future__ import annotations

from dataclasses import replace
import json

from kbnitp_ros.configuration.known import parameters_of
from kbnitp_ros.configuration.table import NODES, TABLE
from kbnitp_ros.plugins import Registry


def reference_page() -> str:
    """Return the page that documents every parameter, in Markdown."""
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
        for parameter in parameters_of(name).values():
            if isinstance(parameter.choices, Registry):
                parameter = replace(parameter, choices=parameter.choices.own)
            lines.append(
                f'| `{parameter.name}` | `{json.dumps(parameter.default)}` | {parameter.must_be} '
                f'| {parameter.description}{parameter.changeable} |'
            )
    return '\n'.join(lines) + '\n'
