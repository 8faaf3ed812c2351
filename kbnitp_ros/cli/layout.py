# SPDX-License-Identifier: Apache-2.0
"""Write views of a mission: RViz's configuration, and a layout of Foxglove and Lichtblick."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import json
from pathlib import Path
from typing import Any

from kbnitp_ros.cli.output import command, complain, say
from kbnitp_ros.configuration import node_parameters
from kbnitp_ros.files import yaml_text
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.nodes.runtime.command_line import add_namespace, command_parser
from kbnitp_ros.styles import SERIES

DESCRIPTION = """
Write the views of a mission for its namespace and agents: RViz's configuration (rviz2 -d
mission.rviz), and a layout that Foxglove and Lichtblick import (mission.json).

The exit code is 0 if both are written, and 2 if the log cannot be used or nothing can be written.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros layout runs/small',
    'python3 -m kbnitp_ros layout --namespace /north --agents scout_1 scout_2 --folder views',
)

LINES = {'solid': 'solid', 'dash': 'dashed', 'dot': 'dotted', 'dashdot': 'dashed'}

# What a map is white and full of.
COLOURS = {'hazard': '#67000d', 'target': '#00441b', 'kappa': '#3f007d'}

# The safest lane of a mission with such a goal.
LANE = '#009e73'

# A path that waits for approval, in RViz.
PROPOSED = '#ffaa00'

# Fields of the topic progress, by the title of their plot.
PLOTS = {
    'entropy (nats)': ('hazard_entropy', 'target_entropy', 'joint_entropy'),
    'robots': ('lost', 'out'),
    'information (nats)': ('information_expected', 'information_gained'),
}


@command('layout')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = command_parser('layout', DESCRIPTION, *EXAMPLES)
    parser.add_argument(
        'log',
        metavar='LOG',
        type=Path,
        nargs='?',
        help='log of a mission, or its folder, that has the names; default none, with --agents',
    )
    add_namespace(parser)
    parser.add_argument(
        '--agents', metavar='AGENT', nargs='+', help='agents of the mission; default those of LOG'
    )
    parser.add_argument(
        '--folder',
        metavar='DIR',
        type=Path,
        default=Path(),
        help='folder for mission.rviz and mission.json; default the working folder',
    )
    options = parser.parse_args(argv)
    if (options.log is None) == (options.agents is None):
        parser.error('name either a log or --agents')
    try:
        if options.log:
            roles = MissionLog(options.log, options.namespace).roles
            namespace, agents = roles.namespace, roles.agents
        else:
            namespace, agents = (
                options.namespace or '',
                node_parameters('planner')['agents'].check(options.agents),
            )
        options.folder.mkdir(parents=True, exist_ok=True)
        files = write_views(options.folder / 'mission', namespace, agents)
    except (ValueError, OSError) as error:
        complain('layout', error)
        return 2
    say(f'wrote {files[0]} for RViz, and {files[1]} for Foxglove and Lichtblick')
    return 0


def write_views(stem: Path, namespace: str, agents: Iterable[str]) -> tuple[Path, Path]:
    """Write the views of a mission, and return their files."""
    root, team = f'/{namespace.strip("/")}'.rstrip('/'), [*agents]
    files = stem.with_suffix('.rviz'), stem.with_suffix('.json')
    files[0].write_text(yaml_text(rviz(root, team)))
    files[1].write_text(f'{json.dumps(foxglove(root, team), indent=1)}\n')
    return files


def foxglove(root: str, agents: Sequence[str]) -> dict[str, Any]:
    """Return the layout of a mission: the maps, what is known, and how the nodes are."""
    maps = {f'3D!{name}': map_panel(name, root, agents) for name in COLOURS}
    below = {f'Plot!{fields[0]}': plot(title, root, fields) for title, fields in PLOTS.items()}
    below['DiagnosticSummary!nodes'] = panel(
        'nodes', topicToRender='/diagnostics', hardwareIdFilter='kbnitp_ros'
    )
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


def panel(title: str, **settings: Any) -> dict[str, Any]:
    """Return a panel with its title, which the two viewers read from keys of their own."""
    return {**settings, 'foxglovePanelTitle': title, 'lichtblickPanelTitle': title}


def map_panel(name: str, root: str, agents: Sequence[str]) -> dict[str, Any]:
    """Return a panel with one of the grids, and on it paths, readings and poses."""
    topics: dict[str, Any] = {
        f'{root}/belief/{name}': {
            'visible': True,
            'colorMode': 'custom',
            'minColor': '#ffffff',
            'maxColor': COLOURS[name],
            'unknownColor': '#999999',
        }
    }
    for number, agent in enumerate(agents):
        topics[f'{root}/{agent}/path'] = path_line(colour(number), 0.1)
        topics[f'{root}/{agent}/readings'] = {'visible': True}
    if name == 'hazard':
        topics[f'{root}/decision/lane'] = path_line(LANE, 0.2)
    return panel(name, topics=topics, followTf='map', followMode='follow-none')


def colour(number: int) -> str:
    """Return the colour of an agent."""
    return SERIES[number % len(SERIES)].colour


def path_line(shade: str, width: float) -> dict[str, Any]:
    """Return the style of a path."""
    return {'visible': True, 'type': 'line', 'lineWidth': width, 'gradient': [shade, shade]}


def plot(title: str, root: str, fields: tuple[str, ...]) -> dict[str, Any]:
    """Return a panel with curves of fields of the topic progress."""
    series = [
        {
            'value': f'{root}/progress.{field}',
            'label': field.replace('_', ' '),
            'color': style.colour,
            'lineStyle': LINES[style.plotly_dash],
            'enabled': True,
            'timestampMethod': 'receiveTime',
        }
        for field, style in zip(fields, SERIES)
    ]
    return panel(title, paths=series, showLegend=True)


def rviz(root: str, agents: Sequence[str]) -> dict[str, Any]:
    """Return RViz's configuration of a mission: maps, paths, proposals, readings and poses."""
    displays = [
        rviz_map('Kappa, P(target if hazard)', f'{root}/belief/kappa', 0.2),
        rviz_map('Target, P(target)', f'{root}/belief/target', 0.6),
        rviz_map('Hazard, P(hazard)', f'{root}/belief/hazard', 0.6, 'costmap'),
        rviz_path('Safest lane (goal lane)', f'{root}/decision/lane', LANE),
    ]
    for number, agent in enumerate(agents):
        displays += [
            rviz_path(f'Path of {agent}', f'{root}/{agent}/path', colour(number)),
            rviz_path(f'Proposed to {agent}', f'{root}/{agent}/proposal', PROPOSED),
            display(
                'Marker',
                f'Readings of {agent}',
                Topic=rviz_topic(f'{root}/{agent}/readings'),
                Namespaces={'readings': True},
            ),
        ]
    displays.append(
        display(
            'TF',
            'Robots that are out, with publish_pose',
            **{'Show Arrows': False, 'Frame Timeout': 5, 'Frames': {'All Enabled': True}},
        )
    )
    return {
        'Panels': [{'Class': 'rviz_common/Displays', 'Name': 'Displays', 'Tree Height': 700}],
        'Visualization Manager': {
            'Class': '',
            'Displays': displays,
            'Enabled': True,
            'Global Options': {
                'Background Color': '48; 48; 48',
                'Fixed Frame': 'map',
                'Frame Rate': 30,
            },
            'Name': 'root',
            'Tools': [
                {'Class': f'rviz_default_plugins/{tool}'} for tool in ('MoveCamera', 'Measure')
            ],
            'Transformation': {'Current': {'Class': 'rviz_default_plugins/TF'}},
            'Value': True,
            'Views': {
                'Current': {
                    'Class': 'rviz_default_plugins/TopDownOrtho',
                    'Name': 'Current View',
                    'Scale': 70,
                    'Target Frame': '<Fixed Frame>',
                    'X': 4.5,
                    'Y': 4.5,
                },
            },
        },
        'Window Geometry': {'Displays': {'collapsed': False}, 'Height': 900, 'Width': 1300},
    }


def display(kind: str, name: str, **settings: Any) -> dict[str, Any]:
    """Return a display of RViz."""
    shown = {'Class': f'rviz_default_plugins/{kind}', 'Name': name, 'Enabled': True}
    return {**shown, **settings, 'Value': True}


def rviz_topic(name: str, durability: str = 'Transient Local') -> dict[str, Any]:
    """Return how RViz subscribes to a topic: as a late joiner, but to updates."""
    policies = {'History': 'Keep Last', 'Reliability': 'Reliable', 'Durability': durability}
    return {
        'Value': name,
        'Depth': 1,
        **{f'{policy} Policy': value for policy, value in policies.items()},
    }


def rviz_map(name: str, topic: str, alpha: float, scheme: str = 'map') -> dict[str, Any]:
    """Return RViz's display of a map; one in the scheme costmap lies above the others."""
    updates = rviz_topic(f'{topic}_updates', 'Volatile')
    settings = {'Update Topic': updates, 'Color Scheme': scheme, 'Draw Behind': scheme == 'map'}
    return display('Map', name, Topic=rviz_topic(topic), Alpha=alpha, **settings)


def rviz_path(name: str, topic: str, shade: str) -> dict[str, Any]:
    """Return RViz's display of a path."""
    rgb = '; '.join(map(str, bytes.fromhex(shade[1:])))
    line = {'Line Style': 'Billboards', 'Line Width': 0.08, 'Offset': {'X': 0, 'Y': 0, 'Z': 0.05}}
    return display('Path', name, Topic=rviz_topic(topic), Color=rgb, Alpha=1, **line)
