# SPDX-License-Identifier: Apache-2.0
"""Remarks of people: findings, annotations of deployments, and revocations of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import Annotation, AnnotationKind, DeploymentKey, Finding, Ledger
from kbnitp_ros.messages.headers import (
    check_reason,
    content_hash,
    header,
    in_seconds,
    LAST_NAME,
    read_choice,
    read_header,
    read_name,
    read_stamp,
)
import numpy as np

if TYPE_CHECKING:
    from kbnitp_msgs import msg


class Told(IntEnum):
    """A statement on hazards or targets, as in kbnitp_msgs/Finding."""

    UNTOLD = 0
    ABSENT = 1
    PRESENT = 2


class LossCause(IntEnum):
    """The cause of a loss, as in kbnitp_msgs/Annotation."""

    UNKNOWN = 0
    HAZARD = 1
    OTHER = 2


@dataclass(frozen=True)
class Remark:
    """A remark of a person: what was said, when, and by whom, as stated."""

    # Time at which it was said, nanoseconds of ROS time, different for each remark.
    stamp: int
    author: str
    note: str
    # Hash of the message.
    content: int
    # A finding, a deployment with its annotation, or the hash of what is revoked.
    said: Finding | tuple[DeploymentKey, Annotation] | int

    def __str__(self) -> str:
        """Return a description of the remark."""
        who = self.author or 'a person'
        if isinstance(self.said, int):
            return f'{who} took back remark {self.said}'
        if isinstance(self.said, Finding):
            since = in_seconds(self.said.since or 0)
            size = self.said.cells.size
            return f'{who} said of {size} cell{"s" * (size > 1)} since {since}: {self.words}'
        key, _ = self.said
        return f'{who} said of {key}: {self.words}'

    @property
    def words(self) -> str:
        """Return what is said in words, without cells and times."""
        if isinstance(self.said, int):
            return 'takes a statement back'
        if isinstance(self.said, Finding):
            said = self.said
            words = [f'walked ({said.walked:g})'] if said.walked else []
            words += [
                f'{"a" if is_there else "no"} {what} ({said.confidence:g})'
                for what, is_there in (('hazard', said.hazard), ('target', said.target))
                if is_there is not None
            ]
            return ', '.join(words + ['changed'] * said.changed)
        _, annotation = self.said
        numbers = annotation.steps
        steps = f'step{"s" * (len(numbers) > 1)} {", ".join(map(str, numbers))}'
        match annotation.kind:
            case AnnotationKind.LOCATED:
                by = {None: '', True: ', by a hazard', False: ', not by a hazard'}
                where = f'in {steps}' if numbers else 'anywhere'
                return f'lost {where}{by[annotation.by_hazard]}'
            case AnnotationKind.NO_HAZARD:
                return f'no hazard, survived {numbers[0]} step{"s" * (numbers[0] != 1)}'
            case AnnotationKind.RECOVERED:
                return 'carried home' + f', entered {steps}' * bool(numbers)
            case AnnotationKind.WITHDRAW:
                return 'says nothing'
            case _:
                return f'lost {annotation.kind.name.lower()} the change'

    def record(self, ledger: Ledger) -> None:
        """Record the remark; raise ValueError if it cannot count."""
        if isinstance(self.said, Finding):
            ledger.record_finding(self.content, self.said, self.stamp)
        elif isinstance(self.said, int):
            ledger.revoke(self.content, self.said, self.stamp)
        else:
            key, annotation = self.said
            ledger.record_annotation(key, self.content, annotation)


def stamped(message: Any, stamp: int) -> Any:
    """Return the message of a remark that is said at this time, in nanoseconds."""
    message.header = header(stamp)
    return message


def read_remark(name: str, message: Any) -> Remark:
    """Convert the message of a remark, by the name of its topic."""
    stamp = read_header(message, LAST_NAME)
    check_reason(message.note)
    check_reason(message.author)
    read = READERS[name]
    return Remark(stamp, message.author, message.note, content_hash(message), read(message, stamp))


def read_finding(message: msg.Finding, stamp: int) -> Finding:
    """Convert a kbnitp_msgs/Finding that was said at a time, in nanoseconds."""
    since = read_stamp('since', message.since)
    if since > stamp:
        raise ValueError(f'since is {since} ns: the finding was said before, at {stamp} ns')
    hazard, target = (
        {Told.UNTOLD: None, Told.ABSENT: False, Told.PRESENT: True}[
            read_choice(name, getattr(message, name), Told)
        ]
        for name in ('hazard', 'target')
    )
    cells = np.array(message.cells, dtype=np.intp)
    return Finding(
        cells, hazard, target, message.confidence, message.walked, since, message.changed
    )


def read_annotation(message: msg.Annotation, stamp: int) -> tuple[DeploymentKey, Annotation]:
    """Convert a kbnitp_msgs/Annotation that was said at a time, in nanoseconds."""
    if not message.agent:
        raise ValueError("agent is '': it must name the agent of the deployment")
    key = DeploymentKey(message.agent, read_name('deployment', message.deployment))
    kind = read_choice('kind', message.kind, AnnotationKind)
    cause = read_choice('cause', message.cause, LossCause)
    steps = tuple(int(each) for each in message.steps)
    if kind is AnnotationKind.NO_HAZARD and len(steps) != 1:
        raise ValueError(
            f'steps has {len(steps)} numbers: of NO_HAZARD it must be the number of steps that '
            'the robot survived, such as [0] if it is not known'
        )
    if steps and kind not in (
        AnnotationKind.LOCATED,
        AnnotationKind.NO_HAZARD,
        AnnotationKind.RECOVERED,
    ):
        raise ValueError(f'steps has {len(steps)} numbers: {kind.name} has none')
    if cause is not LossCause.UNKNOWN and kind is not AnnotationKind.LOCATED:
        raise ValueError(f'cause is {cause.name}: only LOCATED has a cause')
    by_hazard = {LossCause.UNKNOWN: None, LossCause.HAZARD: True, LossCause.OTHER: False}[cause]
    return key, Annotation(kind, int(message.report), steps, by_hazard, stamp)


def read_revocation(message: msg.Revocation, _: int) -> int:
    """Return the hash of what a kbnitp_msgs/Revocation takes back."""
    if not message.revokes:
        raise ValueError('revokes is 0: it must be the hash of a finding or an annotation')
    return int(message.revokes)


READERS: Mapping[str, Callable[[Any, int], Any]] = {
    'findings': read_finding,
    'annotations': read_annotation,
    'revocations': read_revocation,
}
