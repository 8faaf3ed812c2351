# SPDX-License-Identifier: Apache-2.0
"""
Make the layout of Foxglove and Lichtblick for a mission with so many agents.

``python3 tools/foxglove_layout.py AGENTS`` prints it, in the form that both export and import;
those of one agent and of eight are in config/foxglove/.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from kbnitp_ros.styles import SERIES

LINES = {'solid': 'solid', 'dash': 'dashed', 'dot': 'dotted', 'dashdot': 'dashed'}

# What a map is white and full of.
COLOURS = {'hazard': '#67000d', 'target': '#00441b', 'kappa': '#3f007d'}

# The safest lane of a mission with such a goal.
LANE = '#009e73'

# Fields of the topic progress, by the title of their plot.
PLOTS = {
    'entropy (nats)': ('hazard_entropy', 'target_entropy', 'joint_entropy'),
    'robots': ('lost', 'out'),
    'information (nats)': ('information_expected', 'information_gained'),
}


def layout(agents: int) -> dict[str, Any]:
    """Return the layout of a mission: the maps, what is known, and how the nodes are."""
    maps = {f'3D!{name}': map_panel(name, agents) for name in COLOURS}
    below = {f'Plot!{fields[0]}': plot(title, fields) for title, fields in PLOTS.items()}
    below['DiagnosticSummary!nodes'] = {
        'topicToRender': '/diagnostics',
        'hardwareIdFilter': 'kbnitp_ros',
        'foxglovePanelTitle': 'nodes',
    }
    return {
        'configById': maps | below,
        'globalVariables': {},
        'userNodes': {},
        'playbackConfig': {'speed': 1},
        'layout': {
            'direction': 'column',
            'first': in_a_row([*maps]),
            'second': in_a_row([*below]),
            'splitPercentage': 66,
        },
    }


def in_a_row(panels: list[str]) -> Any:
    """Return panels of equal width: each split is in two."""
    first, *rest = panels
    if not rest:
        return first
    share = 100 / len(panels)
    return {
        'direction': 'row',
        'first': first,
        'second': in_a_row(rest),
        'splitPercentage': round(share, 2),
    }


def map_panel(name: str, agents: int) -> dict[str, Any]:
    """Return a panel with one of the grids, and on it paths, readings and poses."""
    topics: dict[str, Any] = {
        f'/belief/{name}': {
            'visible': True,
            'colorMode': 'custom',
            'minColor': '#ffffff',
            'maxColor': COLOURS[name],
            'unknownColor': '#999999',
        }
    }
    for number in range(1, agents + 1):
        colour = SERIES[(number - 1) % len(SERIES)].colour
        topics[f'/scout_{number}/path'] = path_line(colour, 0.1)
        topics[f'/scout_{number}/readings'] = {'visible': True}
    if name == 'hazard':
        topics['/decision/lane'] = path_line(LANE, 0.2)
    return {
        'topics': topics,
        'followTf': 'map',
        'followMode': 'follow-none',
        'foxglovePanelTitle': name,
    }


def path_line(colour: str, width: float) -> dict[str, Any]:
    """Return how a path is drawn."""
    return {'visible': True, 'type': 'line', 'lineWidth': width, 'gradient': [colour, colour]}


def plot(title: str, fields: tuple[str, ...]) -> dict[str, Any]:
    """Return a panel with curves of fields of the topic progress."""
    series = [
        {
            'value': f'/progress.{field}',
            'label': field.replace('_', ' '),
            'color': style.colour,
            'lineStyle': LINES[style.plotly_dash],
            'enabled': True,
            'timestampMethod': 'receiveTime',
        }
        for field, style in zip(fields, SERIES)
    ]
    return {'paths': series, 'showLegend': True, 'foxglovePanelTitle': title}


if __name__ == '__main__':
    print(json.dumps(layout(int(sys.argv[1])), indent=1))
