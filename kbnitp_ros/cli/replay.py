# SPDX-License-Identifier: Apache-2.0
"""Compute the beliefs of a mission's log again and say which of them are not reproduced."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from kbnitp_ros.cli.output import command, complain, say
from kbnitp_ros.core import versions
from kbnitp_ros.log.bag import log_size, LogError, LoggedMessage, Recorded, repair
from kbnitp_ros.log.replay import replay, ReplayReport
from kbnitp_ros.nodes.command_line import add_log, command_parser
from tqdm import tqdm

DESCRIPTION = """
Compute the beliefs of a mission's log again from the evidence in it, and say which of them are not
reproduced bit for bit.

The exit code is 0 if all are, 1 if not, and 2 if the log cannot be used or repaired.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros replay runs/small',
    'python3 -m kbnitp_ros replay runs/small/mission.mcap --repair runs/whole/mission.mcap',
)

# How many messages that nobody took are told of one by one.
REFUSALS = 20

T = TypeVar('T', LoggedMessage, Recorded)


@command('replay')
def main(argv: Sequence[str] | None = None) -> int:
    """
    Run the command.

    Returns
    -------
    int
        0 if all beliefs are reproduced, 1 if not, 2 if the log cannot be used or repaired.

    """
    parser = command_parser('replay', DESCRIPTION, *EXAMPLES)
    add_log(parser)
    parser.add_argument(
        '--repair',
        metavar='OUT.mcap',
        type=Path,
        help='write what is intact of an unfinished or damaged log to a new file, best in a new '
        'folder, which is made; and replay that',
    )
    options = parser.parse_args(argv)
    log = options.log
    try:
        if options.repair:
            options.repair.parent.mkdir(parents=True, exist_ok=True)
            repaired = repair(log, options.repair, partial(with_progress, log_size(log)))
            say(f'{repaired.messages} messages of {log} are saved in {options.repair}')
            say(*([f'lost: {loss}' for loss in repaired.lost] or ['nothing was lost']))
            log = options.repair
        report = replay(log, partial(with_progress, log_size(log)))
    except (LogError, OSError) as error:
        complain('replay', error)
        return 2
    say(*lines(report))
    return 0 if report.reproduced else 1


def with_progress(size: int, items: Iterator[T]) -> Iterator[T]:
    """Pass on what is read of a log of so many bytes, showing on a terminal how far that is."""
    with tqdm(total=size, unit='B', unit_scale=True, disable=None) as bar:
        for item in items:
            yield item
            bar.update(item.position - bar.n)


def lines(report: ReplayReport) -> Iterator[str]:
    """Yield what a replay found: a summary, then what is not reproduced, then what is missing."""
    evidence = report.evidence
    deployments, survived = len(evidence.reports), evidence.survived
    is_earlier = report.version and report.version < versions(report.method)[-1]
    yield (
        f'{deployments} deployments, {survived} survived, {deployments - survived} lost; '
        f'method {report.method or "not on record"}'
        f'{f", version {report.version}" if is_earlier else ""}'
    )
    for decision in report.decisions:
        yield f'the operator {decision}, at {decision.when}'
    missed = Counter(each.topic for each in (*report.mismatches, *report.undecided))
    for topic, compared in sorted(report.compared.items()):
        yield f'{topic}: {compared - missed[topic]} of {compared} reproduced'
    for mismatch in report.mismatches:
        yield f'not reproduced: {mismatch}'
    for belief in report.undecided:
        yield f'not decided: {belief}'
    for key in report.passed_over:
        yield f'not reproduced: deployment {key} is in no belief, though later ones are'
    for key in report.not_yet_held:
        yield f'deployment {key} is in no belief yet'
    for key in evidence.without_report:
        yield f'deployment {key} has no report on record: the robot was still out'
    for key in evidence.without_path:
        yield f'deployment {key} has no path on record'
    for refusal in evidence.refused[:REFUSALS]:
        yield f'refused: {refusal}'
    if len(evidence.refused) > REFUSALS:
        yield f'refused: {len(evidence.refused) - REFUSALS} more'
    if not report.finished:
        yield 'the log is unfinished: it was still being written, or its end is missing'
