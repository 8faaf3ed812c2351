# SPDX-License-Identifier: Apache-2.0
"""Compute the beliefs of a mission's log again and say which of them are not reproduced."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
import sys

from kbnitp_ros.log.reader import LogError, LoggedMessage
from kbnitp_ros.log.replay import replay, ReplayReport
from tqdm import tqdm


def main(argv: Sequence[str] | None = None) -> int:
    """
    Run the command.

    Returns
    -------
    int
        0 if all beliefs are reproduced, 1 if not, 2 if the file cannot be used.

    """
    parser = argparse.ArgumentParser(prog='replay', description=__doc__)
    parser.add_argument('file', metavar='FILE.mcap', type=Path, help='the log of one mission')
    path = parser.parse_args(argv).file

    def progress(messages: Iterator[LoggedMessage]) -> Iterator[LoggedMessage]:
        size = path.stat().st_size if path.is_file() else None
        with tqdm(total=size, unit='B', unit_scale=True, disable=None) as bar:
            for message in messages:
                yield message
                bar.update(message.position - bar.n)

    try:
        report = replay(path, progress)
    except LogError as error:
        print(f'replay: {error}', file=sys.stderr)
        return 2
    print('\n'.join(lines(report)))
    return 0 if report.reproduced else 1


def lines(report: ReplayReport) -> Iterator[str]:
    """Yield what a replay found: a summary, then what is not reproduced, then what is missing."""
    evidence = report.evidence
    deployments, survived = len(evidence.complete), evidence.survived
    yield (
        f'{deployments} deployments, {survived} survived, {deployments - survived} lost; '
        f'method {report.method or "not on record"}'
    )
    missed = Counter(mismatch.topic for mismatch in report.mismatches)
    for topic, compared in sorted(report.compared.items()):
        yield f'{topic}: {compared - missed[topic]} of {compared} reproduced'
    for mismatch in report.mismatches:
        yield f'not reproduced: {mismatch}'
    for key in report.passed_over:
        yield f'not reproduced: deployment {key} is in no belief, though later ones are'
    for key in report.not_yet_held:
        yield f'deployment {key} is in no belief yet'
    for key in evidence.without_report:
        yield f'deployment {key} has no report on record: the robot was still out'
    for key in evidence.without_path:
        yield f'deployment {key} has no path on record'
    for refusal in evidence.refused:
        yield f'refused: {refusal}'
    if not report.finished:
        yield 'the log is unfinished: it was still being written, or its end is missing'
