# SPDX-License-Identifier: Apache-2.0
"""Run a command or a node: ``python3 -m kbnitp_ros NAME [ARGUMENTS]``."""

from collections.abc import Sequence
import sys

if __name__ == '__main__' and not getattr(sys.flags, 'safe_path', False):
    # The working folder comes last: a yaml.py there must not hide PyYAML.
    sys.path.append(sys.path.pop(0))

from kbnitp_ros.cli.output import command, complain, say
from kbnitp_ros.files import installed, nearest
from kbnitp_ros.starting import EXECUTABLES, start

USAGE = f'usage: python3 -m kbnitp_ros NAME [ARGUMENTS], with NAME one of {", ".join(EXECUTABLES)}'

HELP = f"""{USAGE}

demo runs a whole mission, study runs many missions without ROS, replay checks a log, report shows
a log, watch shows a running mission, forecast predicts a mission, preflight checks robots and base
before the first departure, and layout writes views of a mission for RViz, Foxglove and Lichtblick.
The other names are nodes. Use `python3 -m kbnitp_ros NAME --help` for each. --version shows the
version and the folder in which it is installed.

example: python3 -m kbnitp_ros demo --robots 20 --out runs/small"""


@command('kbnitp_ros')
def main(argv: Sequence[str] | None = None) -> int:
    name, *arguments = (sys.argv[1:] if argv is None else argv) or ['']
    if name in ('-h', '--help'):
        say(HELP)
        return 0
    if name == '--version':
        say(installed())
        return 0
    if name not in EXECUTABLES:
        unknown = f'{name!r} is no command. {nearest(name, EXECUTABLES)}' if name else ''
        complain('kbnitp_ros', f'{unknown}{USAGE}')
        return 2
    return start(name, arguments)


if __name__ == '__main__':
    sys.exit(main())
