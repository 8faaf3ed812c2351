# SPDX-License-Identifier: Apache-2.0
"""What a replay found in a log."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import IntEnum
from math import isnan

from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.compare import Difference
from kbnitp_ros.log.departures import Departures
from kbnitp_ros.log.evidence import Evidence
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.operator_action import OperatorAction
from kbnitp_ros.messages.progress import NOT_KNOWN, Standing

# How far numbers may be from those computed by another processor or another version of numpy,
# which round otherwise; of numbers above 1, relative to them.
TOLERANCE = 1e-9


class Grade(IntEnum):
    """How well the beliefs of a log are reproduced."""

    IDENTICAL = 0
    EQUAL = 1
    DIFFERENT = 2


@dataclass(frozen=True)
class Finding:
    """
    What is to be said of a recorded belief, or of a view of one.

    Attributes
    ----------
    topic : str
        Where it was published.
    index : int
        Which of the topic's messages it is, from 0.
    deployment : DeploymentKey or None
        The one that it assimilated last; None for a prior.
    differences : tuple of Difference
        How it differs from what was computed.
    reason : str
        Why nothing could be compared, if so.

    """

    topic: str
    index: int
    deployment: DeploymentKey | None
    differences: tuple[Difference, ...] = ()
    reason: str = ''

    def __str__(self) -> str:
        held = 'the prior' if self.deployment is None else f'after {self.deployment}'
        why = self.reason or '; '.join(map(str, self.differences))
        return f'{self.topic} message {self.index} ({held}): {why}'


@dataclass
class ReplayReport:
    """
    What a replay found.

    Attributes
    ----------
    evidence : Evidence
        The deployments on record.
    departures : Departures
        What agents said of their orders.
    actions : list of OperatorAction
        What the operator did, in the order on record.
    standing : Standing
        How the mission stood last, as far as that is on record.
    changes : list of str
        Which parameters of nodes changed, in words.
    prior : Snapshot or None
        The last prior on record.
    compared : Counter of str
        How many messages were compared, by topic: the beliefs and their views.
    mismatches, roundings : list of Finding
        Those that are different, and those that are equal to `TOLERANCE` but not identical.
    not_compared, repeated : list of Finding
        Beliefs after one that is missing, and those that are on record twice.
    passed_over : list of DeploymentKey
        Deployments that no belief holds, though later ones are held: lost evidence.
    not_yet_held : list of DeploymentKey
        Deployments after the last one that is known to be held.
    finished : bool
        Whether the log ends as its writer ends it.

    """

    evidence: Evidence
    departures: Departures = field(default_factory=Departures)
    actions: list[OperatorAction] = field(default_factory=list)
    standing: Standing = NOT_KNOWN
    changes: list[str] = field(default_factory=list)
    prior: Snapshot | None = None
    compared: Counter[str] = field(default_factory=Counter)
    mismatches: list[Finding] = field(default_factory=list)
    roundings: list[Finding] = field(default_factory=list)
    not_compared: list[Finding] = field(default_factory=list)
    repeated: list[Finding] = field(default_factory=list)
    passed_over: list[DeploymentKey] = field(default_factory=list)
    not_yet_held: list[DeploymentKey] = field(default_factory=list)
    finished: bool = False

    def add(self, finding: Finding) -> None:
        """Note a message that is not identical."""
        is_equal = all(each.is_rounding for each in finding.differences)
        (self.roundings if is_equal else self.mismatches).append(finding)

    @property
    def method(self) -> str:
        """Return the method of the estimator; empty if no prior is on record."""
        return '' if self.prior is None else self.prior.method

    @property
    def grade(self) -> Grade:
        """How well the deployments on record give the beliefs on record that were compared."""
        if self.mismatches or self.passed_over:
            return Grade.DIFFERENT
        return Grade.EQUAL if self.roundings else Grade.IDENTICAL

    @property
    def reproduced(self) -> bool:
        """Whether they give them bit for bit."""
        return self.grade == Grade.IDENTICAL

    @property
    def largest_rounding(self) -> float:
        """Return the largest difference of numbers that are equal to `TOLERANCE`."""
        gaps = (each.largest for found in self.roundings for each in found.differences)
        return max((gap for gap in gaps if not isnan(gap)), default=0.0)
