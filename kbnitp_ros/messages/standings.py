# SPDX-License-Identifier: Apache-2.0
"""Standings: what counts of the deployments of a mission, as its estimator says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import DeploymentKey, Ledger
from kbnitp_ros.core.inference.record import Cause, OPEN, OrderState, Refusal, Standing, Verdict
from kbnitp_ros.messages.headers import (
    check_reason,
    Fields,
    filled,
    header_fields,
    MAX_REASON,
    NO_MISSION,
    read_choice,
    read_header,
    read_name,
    read_stamp,
    shown,
    stamp_fields,
)
import numpy as np

if TYPE_CHECKING:
    from kbnitp_msgs import msg


@dataclass(frozen=True)
class Standings:
    """Standings of deployments: all of an estimator, or those that changed lately."""

    # Time of the judgement, nanoseconds.
    stamp: int
    # Full name of the estimator.
    author: str
    # Start of the mission, nanoseconds; 0 if it is not known.
    mission: int
    # Start of the estimator, nanoseconds.
    epoch: int
    # Hash of the prior, the model and the method of the estimator.
    rules: int
    # Numbers of standings that changed, and of judgements that changed the evidence.
    events: int
    changes: int
    # Events of the standings that these add to; 0 if these are complete.
    since: int
    standings: Mapping[DeploymentKey, Standing]
    # Hashes of the remarks of people, in the order in which they were judged.
    remarks: tuple[int, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Return whether these are all standings of the estimator."""
        return not self.since

    @property
    def reports(self) -> set[tuple[DeploymentKey, int]]:
        """Return the deployment and the hash of each report that was judged."""
        return {
            (key, each) for key, standing in self.standings.items() for each in standing.judged
        }

    @property
    def order_states(self) -> set[tuple[DeploymentKey, OrderState]]:
        """Return the deployment and each known state of its order."""
        return {(key, each) for key, standing in self.standings.items() for each in standing.order}


def standings_fields(
    ledger: Ledger,
    keys: Iterable[DeploymentKey],
    stamp: int,
    author: str,
    epoch: int,
    rules: int,
    since: int = 0,
    mission: int = NO_MISSION,
) -> Fields:
    """Return the fields of the standings of some deployments, at a time in nanoseconds."""
    standings = [(key, ledger.standings.get(key, OPEN)) for key in keys]
    return Fields(
        header=header_fields(stamp),
        author=author,
        mission=stamp_fields(mission),
        epoch=stamp_fields(epoch),
        rules=rules,
        events=ledger.events,
        changes=ledger.changes,
        since=since,
        remarks=np.array(ledger.remarks, dtype=np.uint64),
        standings=[
            Fields(
                agent=key.agent,
                deployment=stamp_fields(key.stamp),
                verdict=int(standing.verdict),
                report=standing.report,
                annotation=standing.annotation,
                judged=np.array(sorted(standing.judged), dtype=np.uint64),
                order=np.array(sorted(ledger.statuses.get(key, ())), dtype=np.uint8),
                refused=np.array([each.content for each in standing.refusals], dtype=np.uint64),
                cause=np.array([each.cause for each in standing.refusals], dtype=np.uint8),
                reason=standing.why[:MAX_REASON],
            )
            for key, standing in standings
        ],
    )


def standings_message(fields: Fields) -> msg.Standings:
    """Return the message with the fields of `standings_fields`."""
    from kbnitp_msgs import msg

    message = filled(msg.Standings(), fields)
    message.standings = [filled(msg.Standing(), each) for each in fields.standings]
    return message


def read_standings(message: Any) -> Standings:
    """Convert a kbnitp_msgs/Standings."""
    stamp = read_header(message)
    if not message.author:
        raise ValueError("author is '': it must name the estimator")
    epoch = read_name('epoch', message.epoch)
    if not epoch:
        raise ValueError('epoch is 0: it must be the start of the estimator')
    if not message.since <= message.events or not message.changes <= message.events:
        raise ValueError(
            f'since is {message.since} and changes is {message.changes}: there are only '
            f'{message.events} events'
        )
    standings: dict[DeploymentKey, Standing] = {}
    for number, each in enumerate(message.standings):
        name = f'standings[{number}]'
        if not each.agent:
            raise ValueError(f"{name}.agent is '': it must name the agent")
        key = DeploymentKey(each.agent, read_name(f'{name}.deployment', each.deployment))
        if key in standings:
            raise ValueError(f'{name} is of {key} again: each deployment has one standing')
        standings[key] = read_standing(name, each)
    return Standings(
        stamp=stamp,
        author=message.author,
        mission=read_stamp('mission', message.mission),
        epoch=epoch,
        rules=message.rules,
        events=message.events,
        changes=message.changes,
        since=message.since,
        remarks=tuple(int(each) for each in message.remarks),
        standings=standings,
    )


def read_standing(name: str, message: Any) -> Standing:
    """Convert a kbnitp_msgs/Standing."""
    verdict = read_choice(f'{name}.verdict', message.verdict, Verdict)
    refused = [int(each) for each in message.refused]
    causes = [read_choice(f'{name}.cause', int(each), Cause) for each in message.cause]
    judged = frozenset(int(each) for each in message.judged)
    report = int(message.report)
    if len(refused) != len(causes):
        raise ValueError(f'{name} has {len(refused)} refused reports and {len(causes)} causes')
    if bool(refused) != bool(message.reason):
        raise ValueError(
            f'{name}.reason is {shown(message.reason)}: it must be the reason of the first of '
            f'{len(refused)} refused reports'
        )
    check_reason(message.reason)
    if unknown := {*refused, *([report] if report else [])} - judged:
        raise ValueError(
            f'{name} names the report with hash {min(unknown)}, which is not among those judged'
        )
    has_report = verdict not in (Verdict.OPEN, Verdict.HELD, Verdict.VOID)
    if bool(report) != has_report:
        raise ValueError(f'{name}.report is {report}, and its verdict is {verdict.name}')
    whys = [message.reason, *[''] * len(refused)]
    refusals = tuple(Refusal(*each) for each in zip(refused, causes, whys))
    states = [read_choice(f'{name}.order', int(each), OrderState) for each in message.order]
    annotation = int(message.annotation)
    return Standing(verdict, report, refusals, judged, frozenset(states), annotation)
