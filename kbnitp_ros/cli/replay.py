# SPDX-License-Identifier: Apache-2.0
"""Compute the beliefs of a log again, and report beliefs that differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import isnan
from pathlib import Path
from typing import Any

from kbnitp_ros.cli.output import command, complain, say
from kbnitp_ros.cli.parameters import asked_on_record, recorded_planner
from kbnitp_ros.configuration.mission import make_stop
from kbnitp_ros.core import Verdict
from kbnitp_ros.files import counted
from kbnitp_ros.log.configuration import numerical_environment
from kbnitp_ros.log.files import LogError, part_note
from kbnitp_ros.log.read import log_size, LoggedMessage, read_metadata, RUN
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replayed import Grade, ReplayReport, TOLERANCE
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.headers import in_seconds
from kbnitp_ros.messages.progress import MissionState, NOT_KNOWN
from kbnitp_ros.nodes.runtime.command_line import add_log, command_parser
from tqdm import tqdm

DESCRIPTION = """
Compute the beliefs of a mission's log again from the evidence in it, and say whether they are
identical, equal within 1e-9 as on another kind of processor, or different.

The exit code is 0 if no belief is different, 1 if any is different, and 2 if the log is corrupt
or cannot be used.
"""

EXAMPLES = ('python3 -m kbnitp_ros replay runs/small',)

# Maximum number of refused messages listed.
REFUSALS = 20

# Maximum number of findings of a kind listed.
FINDINGS = 3


@command('replay')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = command_parser('replay', DESCRIPTION, *EXAMPLES)
    add_log(parser)
    options = parser.parse_args(argv)
    if note := part_note(options.log):
        complain('warning', note)
    try:
        report = replayed(options.log, options.namespace)
    except (LogError, OSError) as error:
        complain('replay', error)
        return 2
    say(*lines(report))
    if report.roundings:
        say(*computed_with(options.log, report))
    if report.corrupt:
        complain('replay', report.corrupt[0])
        return 2
    return 1 if report.grade == Grade.DIFFERENT else 0


def replayed(log: Path, namespace: str | None = None) -> ReplayReport:
    """Replay a log, with a progress bar on a terminal."""
    mission, progress = MissionLog(log, namespace), partial(with_progress, log_size(log))
    report = replay(mission, progress, asked_on_record(mission))
    with suppress(ValueError):
        report.computed = state_by_evidence(report, recorded_planner(mission))
    return report


def state_by_evidence(report: ReplayReport, planner: Mapping[str, Any]) -> MissionState:
    """Return the state of a mission by its evidence and the parameters of its planner."""
    evidence, decision = report.evidence, report.decision
    values = {**planner, **evidence.operator.settings}
    if evidence.operator.is_ended:
        return MissionState.ENDED
    if decision is not None:
        decision = decision.judged(values['stop.confidence'] or None)
    if evidence.operator.is_goal_lost:
        return MissionState.PAUSED
    # Robots that came back without a step are sent again.
    is_over = evidence.ended >= values['robots'] + len(evidence.unmoved)
    # Plans are not computed again, so that the planner alone knows whether one is worth a robot.
    is_worthless = values['stop.gain'] > 0.0 and report.standing.state is MissionState.DONE
    if is_over or is_worthless or make_stop(values).why(decision, evidence.lost):
        return MissionState.DONE
    return MissionState.PAUSED if evidence.operator.is_paused else MissionState.RUNNING


def with_progress(size: int, items: Iterator[LoggedMessage]) -> Iterator[LoggedMessage]:
    """Yield the messages of a log, with a progress bar on a terminal."""
    with tqdm(total=size, unit='B', unit_scale=True, desc='reading', disable=None) as bar:
        for item in items:
            yield item
            bar.update(item.position - bar.n)
        # The rest of the file is its index.
        bar.update(size - bar.n)


def lines(report: ReplayReport) -> Iterator[str]:
    """Yield the findings of a replay: summary, differences, and what is missing."""
    evidence = report.evidence
    survived, lost = evidence.survived, evidence.lost
    verdicts = [each.verdict for each in evidence.standings.values()]
    withdrawn = verdicts.count(Verdict.WITHDRAWN)
    yield (
        f'{survived + lost + withdrawn} deployments, {survived} survived, {lost} lost'
        f'{f", {withdrawn} withdrawn" * bool(withdrawn)}; '
        f'method {report.method or "not on record"}'
    )
    for action in evidence.actions:
        yield f'{action}, at {in_seconds(action.stamp)}'
    for remark in evidence.said.values():
        yield f'{remark}, at {in_seconds(remark.stamp)}'
    yield from report.changes
    if report.standing is not NOT_KNOWN:
        state, reason = report.standing.state, report.standing.reason
        yield f'the mission was {state.name} when the log ended{": " * bool(reason)}{reason}'
        if report.computed not in (None, state):
            yield f'by its evidence the mission was {report.computed.name}'
    if len(report.kinds) > 1:
        yield 'hazards: ' + ', '.join(
            f'{kind.replace("_", " ")} {probability:.2f}'
            for kind, probability in report.kinds.items()
        )
    if report.check is not None and report.check.alternatives:
        yield f'model check: {report.check.reason}'
    missed = Counter(each.topic for each in report.mismatches)
    rounded = Counter(each.topic for each in report.roundings)
    left = Counter(each.topic for each in report.not_compared)
    for topic, compared in sorted(report.compared.items()):
        equal = f', {rounded[topic]} of them within {TOLERANCE:g}' if rounded[topic] else ''
        gap = f', {left[topic]} not compared' if left[topic] else ''
        yield f'{topic}: {compared - missed[topic]} of {compared} messages reproduced{equal}{gap}'
    yield from first_few('not reproduced', report.mismatches)
    yield from first_few('not compared', report.not_compared)
    yield from first_few('repeated', report.repeated)
    if missing := report.beliefs.missing:
        yield (
            f'not on record: {counted(len(missing), "belief")}, the first after '
            f'{counted(missing[0][1], "change")} of the evidence'
        )
    for key in report.not_yet_held:
        yield f'deployment {key} is in no belief yet'
    for key in report.passed_over:
        yield f'not reproduced: a report of deployment {key} is not judged, but a later one is'
    for key in evidence.unjudged.keys() - {*report.passed_over}:
        yield f'deployment {key} is not judged: its last report came when the log ended'
    for key in evidence.without_report:
        where = 'the robot was in flight'
        if evidence.is_at_base(key):
            status = evidence.status(key)
            where = 'the robot was at the base'
            where += f', and refused: {status.reason}' if status and status.reason else ''
        yield f'deployment {key} has no report on record: {where}'
    for key in evidence.without_path:
        yield f'deployment {key} has no path on record'
    yield from first_few('refused', evidence.refused, REFUSALS)
    if not report.finished:
        yield 'the log is unfinished: it was still being written, or its end is missing'


def first_few(what: str, found: Sequence[object], most: int = FINDINGS) -> Iterator[str]:
    """Yield the first findings, and a line with the number of further findings."""
    for finding in found[:most]:
        yield f'{what}: {finding}'
    if len(found) > most:
        yield f'{what}: {len(found) - most} more'


def computed_with(log: str | Path, report: ReplayReport) -> Iterator[str]:
    """Yield the largest difference of the beliefs, and the versions that recorded them."""
    gaps = (each.largest for found in report.roundings for each in found.differences)
    largest = max((gap for gap in gaps if not isnan(gap)), default=0.0)
    yield f'equal within {TOLERANCE:g}, not identical: the largest difference is {largest:.2g}'
    here = numerical_environment()
    run = read_metadata(log, []).get(RUN, {})
    for name in ('kbnitp_ros', *here):
        recorded = run.get(name, 'not on record')
        if name not in here or here[name] != recorded:
            is_other = f', here {here[name]}' if name in here else ''
            yield f'made with {name.replace("_", " ")} {recorded}{is_other}'
