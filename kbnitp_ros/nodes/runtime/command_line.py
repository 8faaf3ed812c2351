# SPDX-License-Identifier: Apache-2.0
"""Help and common options of commands and nodes."""

from __future__ import annotations

import argparse
from inspect import cleandoc
from pathlib import Path
from textwrap import fill
from typing import Any

from kbnitp_ros.configuration import node_parameters
from kbnitp_ros.files import installed, writing

WIDTH = 90
INDENT = ' ' * 6

# A parameter of each node for the example in its help.
EXAMPLES = {
    'planner': 'robots:=20',
    'agent': 'seed:=3',
    'robot': 'agent:=scout_1',
    'estimator': 'method:=kappa_bnitp_sampled',
    'recorder': 'file:=mission.mcap',
}


class Parser(argparse.ArgumentParser):
    """An argument parser that raises an OutputError if its help cannot be printed."""

    def format_help(self) -> str:
        """Return the help without its last newline."""
        return super().format_help().rstrip('\n')

    def print_help(self, file: Any = None) -> None:
        """Print the help, and its last newline apart, since argparse ignores an OSError."""
        with writing():
            super().print_help(file)
            print(file=file)


def command_parser(name: str, description: str, *examples: str) -> argparse.ArgumentParser:
    """Return a parser that knows --help and --version."""
    paragraphs = cleandoc(description).split('\n\n')
    parser = Parser(
        prog=name,
        description='\n\n'.join(fill(each, WIDTH) for each in paragraphs),
        epilog='\n  '.join(['examples:', *examples]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'{name} of {installed()}')
    return parser


def add_log(parser: argparse.ArgumentParser) -> None:
    """Add the option for the log of a mission."""
    parser.add_argument(
        'log',
        metavar='LOG',
        type=Path,
        help='the log of a mission: its first file, or its folder if that holds no other log',
    )
    add_namespace(parser)


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Add the option that selects one of several missions in a log."""
    parser.add_argument(
        '--namespace',
        help='namespace of the mission; default the namespace of the only mission in the log',
    )


def node_parser(name: str, description: str) -> argparse.ArgumentParser:
    """Return the parser of a node, whose help lists its parameters."""
    table = node_parameters(name).values()
    parser = command_parser(
        name,
        description,
        f'ros2 run kbnitp_ros {name} --ros-args --params-file config/mission.yaml',
        f'ros2 run kbnitp_ros {name} --ros-args -p {EXAMPLES[name]}',
    )
    parser.usage = '%(prog)s [-h] [--version] [--ros-args [-p NAME:=VALUE] [--params-file FILE]]'
    parameters = [
        f'  {each.name}\n'
        + fill(
            each.summary + each.changeable,
            WIDTH,
            initial_indent=INDENT,
            subsequent_indent=INDENT,
        )
        for each in table
    ]
    parser.epilog = '\n'.join(
        ['parameters, given with --ros-args -p NAME:=VALUE:', *parameters, '', str(parser.epilog)]
    )
    return parser
