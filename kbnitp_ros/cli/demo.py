# SPDX-License-Identifier: Apache-2.0
"""Run a whole mission, or resume an interrupted mission: four nodes in four processes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from kbnitp_ros.cli.output import command, complain
from kbnitp_ros.configuration import node_parameters
from kbnitp_ros.configuration.starts import DEFAULTS, FIXED, OPTIONS
from kbnitp_ros.configuration.table import MAX_AGENTS
from kbnitp_ros.nodes.runtime.command_line import command_parser

DESCRIPTION = """
Run a whole mission with real nodes, each a process of its own: deploy the robots, record the
mission, compute every belief of the recording again, and write the report. Or resume a mission
that was killed.

Estimator and planner know neither the lethality nor the hazard density. They learn both, unless
you name a method that learns nothing or give --set learn.numbers=[].

--set overrides the other options, and all options override the file of --params.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros demo --robots 20 --lethality 0.3 --size 7 --seed 3 --out runs/small',
    'python3 -m kbnitp_ros demo --set sensor.malfunction=0.01 --set agent:sensor.lethality=0.9',
    'python3 -m kbnitp_ros demo --agents 2 --set team.scout_2.sensor.true_positive=0.99',
    'python3 -m kbnitp_ros demo --params config/mission.yaml --set loss_cost=2',
    'python3 -m kbnitp_ros demo --robots 20 --set objective=information_per_loss',
    'python3 -m kbnitp_ros demo --resume runs/small/mission.mcap',
)


@command('demo')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    try:
        options = parse(argv)
        # Imported here, since it takes a second and the help does not need it.
        from kbnitp_ros.cli.demo_mission import prepare, run

        log, parameters = prepare(options)
    except (ValueError, OSError) as error:
        complain('demo', error)
        return 2
    return run(log, parameters, has_page=bool(options.page))


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Return the options; options that were not given are None."""
    table = node_parameters('estimator') | node_parameters('agent') | node_parameters('planner')
    parser = command_parser('demo', DESCRIPTION, *EXAMPLES)
    for name in OPTIONS['demo']:
        parameter = replace(table[name], default=DEFAULTS['demo'].get(name, table[name].default))
        flag = f'--{name.removeprefix("sensor.").replace("_", "-")}'
        if parameter.default is False:
            words = f'{parameter.description} Default false.'
            parser.add_argument(flag, dest=name, action='store_true', default=None, help=words)
        else:
            parser.add_argument(
                flag,
                dest=name,
                metavar='FILE' if name == 'map' else 'X',
                type=type(parameter.default),
                help=parameter.summary,
            )
    parser.add_argument(
        '--size',
        help='size of the field in cells: N or WIDTHxHEIGHT, from 1 to 1000 each; default 9',
    )
    parser.add_argument(
        '--agents',
        metavar='N',
        type=int,
        help=f'number of agents, whose robots leave together, from 1 to {MAX_AGENTS}; default 1',
    )
    parser.add_argument(
        '--params',
        metavar='FILE',
        help='YAML file with parameters of the nodes, such as config/mission.yaml. The demo '
        f'sets these itself: {", ".join(FIXED)}',
    )
    parser.add_argument(
        '--set',
        metavar='[NODE:]NAME=VALUE',
        action='append',
        default=[],
        help='set a parameter of every node that has it, or of one NODE: planner, estimator, '
        'recorder or agent. Sensor parameters of agent are the truth; sensor parameters of '
        'planner and estimator are the belief. Can be repeated; `python3 -m kbnitp_ros NODE '
        '--help` lists the parameters with their defaults and ranges',
    )
    parser.add_argument(
        '--page',
        action='store_true',
        default=None,
        help='serve the page of the mission while it runs, as watch does, on a free port',
    )
    parser.add_argument(
        '--out', metavar='FOLDER', type=Path, help='folder for the results; default runs/TIME'
    )
    parser.add_argument(
        '--resume',
        type=Path,
        metavar='FILE',
        help='log, or its folder, of the mission to resume; takes no other options but --page',
    )
    options = parser.parse_args(argv)
    others = vars(options).keys() - {'resume', 'page'}
    if options.resume and any(vars(options)[name] not in (None, []) for name in others):
        raise ValueError('--resume takes no other options but --page: the log has their values')
    return options
