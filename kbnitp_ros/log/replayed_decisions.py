# SPDX-License-Identifier: Apache-2.0
"""Recorded decisions and lanes compared with the decisions on the computed beliefs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from kbnitp_ros.core import Decision, Goal, Ledger
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.core.decision.told import with_told
from kbnitp_ros.core.planning.regions import without
from kbnitp_ros.log.read import LoggedMessage
from kbnitp_ros.log.replayed import (
    belief_name,
    BeliefFinding,
    Difference,
    differences,
    NO_BELIEF,
    NOT_COMPUTED,
    ReplayReport,
    TOLERANCE,
)
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import Fields, from_stamp, shown
from kbnitp_ros.messages.progress import decision_fields
from kbnitp_ros.messages.topics import PATH

# Roles of decisions.
DECISIONS = 'decision', 'decision/lane'

# Fields of a decision that processors may round differently.
ROUNDED = (
    'probability', 'error', 'survival', 'hazards_mean',
    'told_other', 'told_probability', 'told_survival',
)  # fmt: skip

# The parameter by which an estimator judges its decisions.
CONFIDENCE = 'stop.confidence'

# Why a decision is not compared.
NO_GOAL = 'the goal is not on record, or is not valid'


class RecordedGoal(NamedTuple):
    """The goal of a mission, the maximum number of steps of a lane, and the cells of the goal."""

    goal: Goal
    max_steps: int
    cells: Sequence[int]


class ReplayedDecisions:
    """The recorded decisions and lanes, and the decisions on the computed beliefs."""

    def __init__(self, report: ReplayReport, asked: RecordedGoal | None) -> None:
        self._report = report
        self._asked = asked
        # All confidences of the estimator on record.
        self.confidences: set[float] = set()
        # The no-go cells, at first none, after each action of the operator on record.
        self.no_go: list[tuple[int, ...]] = [()]
        # Recorded decisions that are not compared yet, by the evidence of their belief.
        self._decisions = defaultdict[tuple[int, int], list[LoggedMessage]](list)
        # Recorded lanes by stamp; computed lanes by stamp, belief, evidence and no-go cells.
        self._lanes = defaultdict[int, list[LoggedMessage]](list)
        self._computed_lanes = defaultdict[int, dict[tuple[Any, ...], Fields]](dict)

    def note(self, logged: LoggedMessage) -> None:
        """Keep a decision or its lane until its belief is computed."""
        if logged.type_name == PATH:
            self._lanes[from_stamp(logged.message.header.stamp)].append(logged)
        else:
            evidence = from_stamp(logged.message.epoch), logged.message.changes
            self._decisions[evidence].append(logged)

    def compare(self, ledger: Ledger, said: Snapshot) -> None:
        """Compare the recorded decisions on the ledger's belief, which is identical to `said`."""
        key, belief = said.evidence, belief_name(said.newest)
        if self._asked is None or not (key in self._decisions or said.stamp in self._lanes):
            return
        recorded = self._decisions.pop(key, [])
        named = {tuple(logged.message.no_go) for logged in recorded} & {*self.no_go}
        decisions = {no_go: self._decide(ledger, no_go) for no_go in named or {*self.no_go}}
        for no_go, decision in decisions.items():
            lane = decision_fields(ledger.grid, decision, 0, said.stamp, said.mission).path
            self._computed_lanes[said.stamp][belief, key, no_go] = lane
        for logged in recorded:
            no_go = tuple(logged.message.no_go)
            if no_go not in named:
                self._add(
                    logged, belief, [Difference('no_go', 'has cells that were never on record')]
                )
                continue
            decision = decisions[no_go]
            # Without a confidence on record a decision may be reached by any.
            is_told = logged.message.reached and (self.confidences or logged.message.told)
            if is_told and not decision.told:
                decision = with_told(decision, ledger.estimator, said.deployments)
                decisions[no_go] = decision
            stated = decision if is_told else replace(decision, told={})
            of_belief = said.deployments, said.stamp, said.mission
            computed = decision_fields(
                ledger.grid,
                stated,
                *of_belief,
                self._asked.cells,
                said.author,
                *said.evidence,
                no_go,
            )
            # These follow from the numbers of the message, which may be rounded differently.
            del computed.reached, computed.reason
            found = [*differences(logged.message, computed, TOLERANCE, ROUNDED)]
            found += self._misjudged(decision, logged.message)
            self._add(logged, belief, found)

    def _decide(self, ledger: Ledger, no_go: tuple[int, ...]) -> Decision:
        """Return the decision on the ledger's belief, without ways through the no-go cells."""
        assert self._asked is not None
        hazards = joint_hazards(ledger.estimator, len(ledger.deployments))
        model = ledger.estimator.model
        grid = without(ledger.grid, no_go)
        return self._asked.goal.decide(grid, hazards, model, self._asked.max_steps)

    def _misjudged(self, decision: Decision, message: Any) -> Iterator[Difference]:
        """Yield a difference if `reached` and `reason` follow from no confidence on record."""
        seen = replace(decision, p_free=message.probability, error=message.error)
        judged = [seen.judged(confidence or None) for confidence in self.confidences]
        stated = message.reached, message.reason
        if judged and stated not in [(each.reached, each.reason) for each in judged]:
            known = ', '.join(map(str, sorted(self.confidences)))
            yield Difference(
                'reached',
                f'is {message.reached} with the reason {shown(message.reason)}, which follows '
                f'from no {CONFIDENCE} on record ({known})',
            )

    def finish(self, ledger: Ledger | None) -> None:
        """Compare lanes, report the decisions and lanes left over, and decide on a ledger."""
        if self._asked and ledger is not None:
            self._report.decision = self._decide(ledger, self.no_go[-1])
        for stamp in self._lanes.keys() & self._computed_lanes.keys():
            for logged in self._lanes.pop(stamp):
                found = {
                    name: [*differences(logged.message, lane, TOLERANCE)]
                    for name, lane in self._computed_lanes[stamp].items()
                }
                # Beliefs may share a stamp.
                name = min(found, key=lambda each: len(found[each]))
                self._add(logged, name[0], found[name])
        stamps, missing = self._report.beliefs.stamps, self._report.beliefs.missing
        for evidence, decisions in self._decisions.items():
            self._leave(decisions, evidence in stamps or evidence in missing)
        for stamp, lanes in self._lanes.items():
            self._leave(lanes, bool(missing) or stamp in stamps.values())

    def _leave(self, left: Sequence[LoggedMessage], may_have_belief: bool) -> None:
        """Report decisions or lanes left over: they differ if they can have no belief."""
        for logged in left:
            reason = (NOT_COMPUTED if self._asked else NO_GOAL) if may_have_belief else NO_BELIEF
            finding = BeliefFinding(logged.topic, logged.index, reason=reason)
            if may_have_belief:
                self._report.not_compared.append(finding)
            else:
                self._report.compared[logged.topic] += 1
                self._report.mismatches.append(finding)

    def _add(self, logged: LoggedMessage, belief: str, found: Sequence[Difference]) -> None:
        """Count a compared message, and report its differences."""
        self._report.compared[logged.topic] += 1
        if found:
            self._report.add(BeliefFinding(logged.topic, logged.index, belief, tuple(found)))
