# SPDX-License-Identifier: Apache-2.0
"""What a replay found in a log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from math import isnan

from kbnitp_ros.bag import LogError
from kbnitp_ros.core import DeploymentKey, ModelCheck
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
class BeliefFinding:
    """What is to be said of a recorded belief, or of a view of one."""

    # Where it was published.
    topic: str
    # Which of the topic's messages it is, from 0.
    index: int
    # The one that it assimilated last; None for a prior.
    deployment: DeploymentKey | None
    # How it differs from what was computed.
    differences: tuple[Difference, ...] = ()
    # Why nothing could be compared, if so.
    reason: str = ''

    def __str__(self) -> str:
        held = 'the prior' if self.deployment is None else f'after {self.deployment}'
        why = self.reason or '; '.join(map(str, self.differences))
        return f'{self.topic} message {self.index} ({held}): {why}'


@dataclass
class ReplayReport:
    """What a replay found."""

    # The deployments on record.
    evidence: Evidence
    # What agents said of their orders.
    departures: Departures = field(default_factory=Departures)
    # What the operator did, in the order on record.
    actions: list[OperatorAction] = field(default_factory=list)
    # How the mission stood last, as far as that is on record.
    standing: Standing = NOT_KNOWN
    # Which parameters of nodes changed, in words.
    changes: list[str] = field(default_factory=list)
    # The last prior on record.
    prior: Snapshot | None = None
    # Probability of each kind of hazard in the end, and the check of the model.
    kinds: Mapping[str, float] = field(default_factory=dict)
    check: ModelCheck | None = None
    # How many messages were compared, by topic: the beliefs and their views.
    compared: Counter[str] = field(default_factory=Counter)
    # Those that are different, and those that are equal to `TOLERANCE` but not identical.
    mismatches: list[BeliefFinding] = field(default_factory=list)
    roundings: list[BeliefFinding] = field(default_factory=list)
    # Beliefs that the log lacks something for, and those that are on record twice.
    not_compared: list[BeliefFinding] = field(default_factory=list)
    repeated: list[BeliefFinding] = field(default_factory=list)
    # Deployments that no belief holds, though later ones are held: lost evidence.
    passed_over: list[DeploymentKey] = field(default_factory=list)
    # Deployments after the last one that is known to be held.
    not_yet_held: list[DeploymentKey] = field(default_factory=list)
    # Whether the log ends as its writer ends it.
    finished: bool = False
    # Where files are corrupt: what comes after is not read.
    corrupt: list[LogError] = field(default_factory=list)

    def add(self, finding: BeliefFinding) -> None:
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
