# SPDX-License-Identifier: Apache-2.0
"""Report a mission's log as a page, tables and maps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from kbnitp_ros.cli.output import command, complain, say
from kbnitp_ros.cli.replay import with_progress
from kbnitp_ros.log.files import part_note
from kbnitp_ros.log.read import log_size
from kbnitp_ros.nodes.runtime.command_line import add_log, command_parser
from kbnitp_ros.report.folder import check_is_free, write_report
from kbnitp_ros.report.mission import MissionSummary, read_summary
from kbnitp_ros.report.tables import mission_curves

DESCRIPTION = """
Show a mission's log: report.html, a page that works without a network and saves its figures as
PNG; deployments.csv: one row a deployment; said.csv and said.geojson: what people said, one row or
feature each; belief.npz; and the last beliefs as maps of map_server (hazard.yaml, target.yaml,
kappa.yaml), with which a mission can begin.

The exit code is 0 if all is written, and 2 if the log cannot be used or nothing can be written.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros report runs/small --out runs/small/report',
    'python3 -m kbnitp_ros report runs/small/mission.mcap --out shown',
)


@command('report')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = command_parser('report', DESCRIPTION, *EXAMPLES)
    add_log(parser)
    parser.add_argument(
        '--out',
        metavar='DIR',
        type=Path,
        required=True,
        help='folder for the report, new or empty',
    )
    options = parser.parse_args(argv)
    if note := part_note(options.log):
        complain('warning', note)
    try:
        check_is_free(options.out)
        mission = report(options.log, options.out, namespace=options.namespace)
    except (ValueError, OSError) as error:
        complain('report', error)
        return 2
    for broken in mission.corrupt:
        complain('report', broken)
    return 2 if mission.corrupt else 0


def report(log: Path, folder: Path, namespace: str | None = None) -> MissionSummary:
    """Write the report of a log, with a progress bar on a terminal."""
    mission = read_summary(log, partial(with_progress, log_size(log)), namespace)
    left_out = write_report(folder, mission, mission_curves(mission))
    say(f'wrote {folder / "report.html"} and, beside it, tables and maps')
    for note in (*mission.notes, left_out):
        if note:
            say(note)
    return mission
