# SPDX-License-Identifier: Apache-2.0
"""The decisions on record, compared with those that the evidence gives."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

from kbnitp_ros.bag import LoggedMessage
from kbnitp_ros.core import Goal, HazardDraws, Ledger
from kbnitp_ros.log.compare import differences
from kbnitp_ros.log.replay_report import BeliefFinding, ReplayReport, TOLERANCE
from kbnitp_ros.messages.decisions import decision_fields
from kbnitp_ros.messages.fields import Fields
from kbnitp_ros.messages.headers import from_stamp

# Numbers that another processor may round otherwise.
ROUNDED = ('probability', 'independent_draws', 'survival', 'hazards_mean')


@dataclass(frozen=True)
class RecordedGoal:
    """What a mission was to make sure of."""

    goal: Goal
    # The most steps of a lane.
    max_steps: int


class ReplayedDecisions:
    """The decisions on record that were not compared yet."""

    def __init__(self, asked: RecordedGoal | None) -> None:
        self._asked = asked
        # The index and the message of each, by its topic, the stamp of its belief and the
        # deployments in that.
        self._recorded: dict[tuple[int, int], list[tuple[str, int, Any]]] = defaultdict(list)

    def note(self, logged: LoggedMessage) -> None:
        """Keep a decision until the belief that it is made with is computed."""
        message = logged.message
        key = from_stamp(message.header.stamp), message.deployments
        self._recorded[key].append((logged.topic, logged.index, message))

    def compare(self, ledger: Ledger, stamp: int, report: ReplayReport) -> None:
        """Compare the decisions that were made with the belief of a ledger, of this stamp."""
        key = stamp, len(ledger.deployments)
        if self._asked is None or key not in self._recorded:
            return
        draws = HazardDraws.of(ledger.estimator, len(ledger.deployments))
        decision = self._asked.goal.decide(
            ledger.grid, draws, ledger.estimator.model, self._asked.max_steps
        )
        computed = decision_fields(decision, len(ledger.deployments))
        computed.path = Fields(
            poses=[
                Fields(pose=Fields(position=Fields(x=x, y=y)))
                for x, y in ledger.grid.centers(decision.path).tolist()
            ]
        )
        for topic, index, message in self._recorded.pop(key):
            report.compared[topic] += 1
            if found := tuple(differences(message, computed, TOLERANCE, ROUNDED)):
                report.add(BeliefFinding(topic, index, ledger.newest, found))

    def finish(self, report: ReplayReport) -> None:
        """Take note of the decisions that are left."""
        reason = (
            'the goal is not on record'
            if self._asked is None
            else 'the belief that it is made with is not reproduced or not on record'
        )
        for left in self._recorded.values():
            for topic, index, _ in left:
                report.not_compared.append(BeliefFinding(topic, index, None, reason=reason))
