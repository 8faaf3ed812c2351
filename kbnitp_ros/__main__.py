# SPDX-License-Identifier: Apache-2.0
"""Run a command or a node: ``python3 -m kbnitp_ros NAME [ARGUMENTS]``."""

from importlib import import_module
import sys

from kbnitp_ros.cli.output import command, complain, say

# Each module has main(argv=None), whose result is the exit status.
COMMANDS = {
    'demo': 'kbnitp_ros.cli.demo',
    'study': 'kbnitp_ros.cli.study',
    'replay': 'kbnitp_ros.cli.replay',
    'planner': 'kbnitp_ros.nodes.planner',
    'agent': 'kbnitp_ros.nodes.agent',
    'team': 'kbnitp_ros.nodes.team',
    'estimator': 'kbnitp_ros.nodes.estimator',
    'recorder': 'kbnitp_ros.nodes.recorder',
}

USAGE = f'usage: python3 -m kbnitp_ros NAME [ARGUMENTS], with NAME one of {", ".join(COMMANDS)}'


@command('kbnitp_ros')
def main(argv: list[str] | None = None) -> int:
    name, *arguments = (sys.argv[1:] if argv is None else argv) or ['']
    if name in ('-h', '--help'):
        say(USAGE)
        return 0
    if name not in COMMANDS:
        complain('kbnitp_ros', f'{name!r} is no command. {USAGE}' if name else USAGE)
        return 2
    return import_module(COMMANDS[name]).main(arguments)


if __name__ == '__main__':
    sys.exit(main())
