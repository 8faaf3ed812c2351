# SPDX-License-Identifier: Apache-2.0
"""The ledger: all evidence of a mission, judged, in the order in which it happened."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NamedTuple

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import ORDINARY, RobotType
from kbnitp_ros.core.inference.annotation import Annotation, AnnotationKind
from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.inference.record import (
    Cause,
    deployment_order,
    DeploymentKey,
    ending_key,
    HeardReport,
    is_back,
    is_same_outcome,
    MissionRecord,
    OPEN,
    OrderState,
    outcome_rank,
    Refusal,
    Report,
    Standing,
    Verdict,
)
import numpy as np

# Estimators are kept after each of the last 2 ** DENSE deployments, and after every second,
# fourth, eighth and so on further back; few deployments before a late one are then repeated.
DENSE = 2


# A deployment, or the hash of a finding.
Event = DeploymentKey | int


class Ledger(MissionRecord):
    """
    The record of a mission and its belief, with each deployment judged and counted exactly once.

    What counts of a deployment depends only on what was heard, and not on the order of arrival.
    Deployments are judged in their order, each given the evidence of those before it. Of the
    reports of a deployment the best one that is possible counts: a return before a loss, since the
    robot was only late; of two losses the one with the later contact or, at equal contacts, the
    narrower `lost_at`; of two returns (of robots that share a name) the one with more readings;
    of equal ones the newest. A refused report that shows that its robot is back takes back a loss,
    unless the operator knew of it and gave the robot up all the same (`Report.settled`). A loss
    counts once the departure of its robot is reported, or the operator gave it up.

    Findings of people stand between the deployments, by the time since when they hold; one that
    changed the field takes the cells that it changed from the returns of robots that were out,
    and holds their losses until a person says whether they were before or after. An annotation
    replaces the outcome of the report that it names.

    Parameters
    ----------
    grid, max_steps, robot_types
        As in `MissionRecord`.
    estimator : Estimator
        Estimator before the first deployment.

    Attributes
    ----------
    findings : dict of int to Finding
        Findings in force, by the hash of the message.
    remarks : list of int
        Hashes of all findings, annotations and revocations, in order of arrival.
    outcomes : dict of DeploymentKey to Observation
        Outcomes of the deployments in the belief.
    deployments : list of DeploymentKey
        Deployments in the belief, in deployment order.
    newest : DeploymentKey or None
        Deployment in the belief that was reported last; None before the first.
    newest_stamp : int
        Stamp of its report, or of a later remark, nanoseconds of ROS time; 0 before the first.
    events, changes : int
        Number of standings that changed, and of judgements that changed the evidence.
    assimilations : int
        Number of deployments assimilated, including repetitions after late deployments.

    """

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        estimator: Estimator,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    ) -> None:
        super().__init__(grid, max_steps, robot_types)
        self.outcomes: dict[DeploymentKey, Observation] = {}
        self.deployments: list[DeploymentKey] = []
        self.events = self.changes = 0
        self.assimilations = 0
        self.findings: dict[int, Finding] = {}
        self.remarks: list[int] = []
        self._last_remark = 0
        # Findings that count for nothing, since the other evidence rules them out, and why.
        self.impossible: dict[int, str] = {}
        # Judged deployments and findings, in order.
        self._judged: list[Event] = []
        # Deployments whose standings changed lately.
        self._changed: dict[DeploymentKey, None] = {}
        # Stamps of the reports of the deployments in the belief.
        self._stamps: dict[DeploymentKey, int] = {}
        # Estimators kept, by number of judged events.
        self._estimators = {0: estimator}

    @property
    def estimator(self) -> Estimator:
        """Return the estimator after all assimilated deployments."""
        return self._estimators[len(self._judged)]

    @property
    def belief(self) -> Belief:
        """Return the belief after all assimilated deployments."""
        return self.estimator.belief

    @property
    def newest(self) -> DeploymentKey | None:
        """Return the deployment in the belief that was reported last."""
        return max(self._stamps, key=self._reported, default=None)

    def _reported(self, key: DeploymentKey) -> tuple[int, tuple[int, str]]:
        """Return the sorting key of deployments by their reports."""
        # Of what counts alone, since a resumed estimator may judge reports in another order. If
        # the clock is set back, the stamps of deployments still increase.
        return max(self._stamps[key], key.stamp), deployment_order(key)

    @property
    def newest_stamp(self) -> int:
        """Return the stamp of its report, or of a later remark."""
        newest = self.newest
        return max(self._last_remark, 0 if newest is None else self._stamps[newest])

    def copy(self) -> Ledger:
        """Return an independent copy."""
        other = super().copy()
        other.outcomes = self.outcomes.copy()
        other.deployments = self.deployments.copy()
        other._judged, other._changed = self._judged.copy(), self._changed.copy()
        other._stamps, other.remarks = self._stamps.copy(), self.remarks.copy()
        other.findings, other.impossible = self.findings.copy(), self.impossible.copy()
        return other

    @property
    def judged(self) -> list[DeploymentKey]:
        """Return the deployments of which anything was heard, in order."""
        return [each for each in self._judged if isinstance(each, DeploymentKey)]

    @property
    def changed(self) -> list[DeploymentKey]:
        """Return the deployments whose standings changed since `take_changed`, in order."""
        return sorted(self._changed, key=deployment_order)

    def take_changed(self) -> list[DeploymentKey]:
        """Return the deployments whose standings changed since the last call, in order."""
        changed, self._changed = self.changed, {}
        return changed

    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """
        Record a report; return whether the evidence changes.

        Raises
        ------
        ValueError
            If the report is refused. Its deployment is judged all the same, and may be held.
        PluginError
            If a method of another package breaks the rules; nothing then changes.

        """
        if key not in self.paths:
            return super().record_report(key, report)
        is_equal = report in self.heard.get(key, ())
        if (heard := self._hear(key, report)) is None:
            return False
        before, known = self.changes, self.outcomes.get(key)
        is_lesser = heard.outcome is None or (
            known is not None and outcome_rank(heard.outcome) < outcome_rank(known)
        )
        if known is not None and known.survived and is_lesser:
            refusal = self._add_lesser(key, heard)
        else:
            refusal = self._judge(key).get(report)
        if refusal:
            raise ValueError(refusal.why)
        self.duplicates += is_equal or (is_lesser and self.changes == before)
        return self.changes > before

    def record_status(self, key: DeploymentKey, state: OrderState, stamp: int = 0) -> bool:
        """Record the state of an order, at a time in ns; return whether the evidence changes."""
        before, was_known = self.changes, state in self.statuses.get(key, ())
        super().record_status(key, state, stamp)
        is_heard = key in self.standings or key in self.heard or self.is_refused(key)
        if key in self.paths and not was_known and is_heard:
            self._judge(key)
        return self.changes > before

    def _add_lesser(self, key: DeploymentKey, heard: HeardReport) -> Refusal | None:
        """Add a report beside a return that counts; return its refusal, if any."""
        standing, known = self.standings[key], self.outcomes[key]
        refusal = heard.refusal or contradiction(key, heard, known)
        refusals = [*standing.refusals, *([refusal] if refusal else [])]
        judged = standing.judged | {heard.report.content}
        self._change(key, replace(standing, refusals=in_order(refusals), judged=judged))
        return refusal

    # Remarks of people.

    def record_finding(self, content: int, finding: Finding, stamp: int = 0) -> None:
        """
        Record a finding, said at a time in ns; nothing changes if its hash is known.

        Raises
        ------
        ValueError
            If `since` is missing, or the finding is impossible or not for the method.

        """
        if content in self.remarks:
            return
        if finding.since is None:
            raise ValueError('since is None: a ledger needs the time at which it was so')
        self.findings[content] = finding
        self._remark(content, stamp, finding)
        if why := self.impossible.get(content):
            self._unsay(content, self.findings, finding)
            raise ValueError(why)

    def record_annotation(self, key: DeploymentKey, content: int, annotation: Annotation) -> None:
        """
        Record what a person knows of a deployment; nothing changes if its hash is known.

        Raises
        ------
        ValueError
            If the deployment or its report is not known, or the annotation does not fit it.

        """
        if content in self.remarks:
            return
        heard = self.heard.get(key, {}).values()
        named = [each for each in heard if each.report.content == annotation.report]
        if not named:
            raise ValueError(
                f'report is {annotation.report}: no such report of deployment {key} was heard'
            )
        annotation.applied(self.paths[key], named[0].outcome)
        self.annotations[content] = key, annotation
        self._remark(content, annotation.stamp, key)
        standing = self.standings.get(key, OPEN)
        is_by_it = standing.annotation == content
        if annotation.kind.is_of_order:
            is_by_it = annotation.report == standing.report
        if not is_by_it:
            self._unsay(content, self.annotations, key)
            raise ValueError(standing.why or f'another report of deployment {key} counts')

    def _unsay(
        self, content: int, remarks: dict[int, Any], about: Finding | DeploymentKey
    ) -> None:
        """Take a remark that cannot count out of the record."""
        del remarks[content]
        self.remarks.remove(content)
        self._refold(about)

    def revoke(self, content: int, revoked: int, stamp: int = 0) -> None:
        """
        Take back a finding or an annotation; all is as if it had never been said.

        Raises
        ------
        ValueError
            If nothing with this hash is in force.

        """
        if content in self.remarks:
            return
        if revoked in self.findings:
            self._remark(content, stamp, self.findings.pop(revoked))
        elif revoked in self.annotations:
            key, _ = self.annotations.pop(revoked)
            self._remark(content, stamp, key)
        else:
            state = 'was revoked before' if revoked in self.remarks else 'was never said'
            raise ValueError(f'revokes is {revoked}: it {state}')

    def spanned(self, finding: Finding) -> list[DeploymentKey]:
        """Return the deployments that were out when the field was changed in their cells."""
        return [key for key in self.judged if self._is_spanned(key, finding)]

    def _is_spanned(self, key: DeploymentKey, finding: Finding) -> bool:
        if not finding.changed:
            return False
        assert finding.since is not None
        last = max((each.stamp for each in self.heard.get(key, ())), default=0)
        is_out = key.stamp < finding.since < last
        return is_out and bool(np.isin(self.paths[key], finding.cells).any())

    def _spanned_changes(self, key: DeploymentKey) -> list[Finding]:
        """Return the changes of the field while a robot was out in their cells."""
        return [each for each in self.findings.values() if self._is_spanned(key, each)]

    def _annotation(self, key: DeploymentKey, report: int, *, of_order: bool) -> int:
        """Return the newest annotation of a report, by its hash; 0 without one."""
        named = [
            content
            for content, (other, each) in self.annotations.items()
            if other == key and each.report == report and each.kind.is_of_order == of_order
        ]
        return named[-1] if named else 0

    def _order(self, event: Event) -> tuple[int, int, str, int]:
        """Return the sorting key of events: their time, and deployments before findings."""
        if not isinstance(event, DeploymentKey):
            return self.findings[event].since or 0, 1, '', event
        moved = 0
        if self.annotations and self.findings:
            after = [
                each
                for other, each in self.annotations.values()
                if other == event and each.kind is AnnotationKind.AFTER
            ]
            if after:
                moved = max((each.since or 0 for each in self._spanned_changes(event)), default=0)
        return max(event.stamp, moved), 2 * (moved > event.stamp), event.agent, event.stamp

    def _remark(self, content: int, stamp: int, about: Finding | DeploymentKey) -> None:
        """Note a remark, and judge again what follows it."""
        self.remarks.append(content)
        before = self.changes
        self._refold(about)
        self._last_remark = max(self._last_remark, stamp)
        self.changes, self.events = before + 1, self.events + 1

    def _refold(self, about: Finding | DeploymentKey) -> None:
        """Judge again the deployments that a remark is about, and all events after it."""
        touched = {about} if isinstance(about, DeploymentKey) else {*self.spanned(about)}
        events = self._in_order(self.judged)
        self._fold(events, self._first_new(events, touched), None)

    def _in_order(self, keys: Iterable[DeploymentKey]) -> list[Event]:
        """Return deployments and the findings in force, in order."""
        events: list[Event] = [*keys, *self.findings]
        return sorted(events, key=self._order)

    def _first_new(self, events: list[Event], touched: Collection[DeploymentKey]) -> int:
        """Return the index of the first event that differs, or that is touched."""
        for number, (new, old) in enumerate(zip(events, self._judged)):
            if new != old or new in touched:
                return number
        return min(len(events), len(self._judged))

    def _judge(self, key: DeploymentKey) -> dict[Report, Refusal]:
        """Judge a deployment, and later ones if its evidence changes; return its refusals."""
        if self.findings:
            # A report may say that the robot was still out when the field was changed.
            events = self._in_order({*self.judged, key})
            place = self._first_new(events, {key})
        else:
            place = bisect_left(self._judged, self._order(key), key=self._order)
            later = self._judged[place:]
            events = [*self._judged[:place], key, *(each for each in later if each != key)]
        before = self.changes
        rulings = self._fold(events, place, key if events == self._judged else None)
        self.changes = min(self.changes, before + 1)
        return rulings[key].refused

    def _fold(
        self, events: list[Event], place: int, known: DeploymentKey | None
    ) -> dict[DeploymentKey, Ruling]:
        """Judge the events from a place on, only a known one if its evidence stays the same."""
        start = max(count for count in self._estimators if count <= place)
        estimators = {count: each for count, each in self._estimators.items() if count <= start}
        estimator = estimators[start]
        rulings: dict[DeploymentKey, Ruling] = {}
        for count, each in enumerate(events[start:], start + 1):
            if not isinstance(each, DeploymentKey):
                self.impossible.pop(each, None)
                try:
                    estimator = self._assimilated(estimator, self.findings[each])
                except ValueError as error:
                    self.impossible[each] = str(error)
            elif count <= place:
                if each in self.outcomes:
                    robot_type = self.robot_type(each)
                    estimator = self._assimilated(estimator, self.outcomes[each], robot_type)
            else:
                rulings[each] = ruling = self._rule(each, estimator)
                estimator = ruling.estimator
                if each == known and ruling.outcome == self.outcomes.get(each):
                    # The evidence is the same, so that nothing else can change.
                    self._change(each, ruling.standing)
                    return rulings
            estimators[count] = estimator
            estimators = {
                kept: estimators[kept]
                for kept in estimators
                if kept % 2 ** max(0, (count - kept).bit_length() - DENSE) == 0
            }
        self._estimators, self._judged = estimators, events
        for key, ruling in rulings.items():
            self._change(key, ruling.standing)
            self._count(key, ruling)
        return rulings

    def _change(self, key: DeploymentKey, standing: Standing) -> None:
        """Set what counts of a deployment."""
        if self.standings.get(key, OPEN) != standing:
            self.stand(key, standing)
            self.events += 1
            self._changed[key] = None

    def _count(self, key: DeploymentKey, ruling: Ruling) -> None:
        """Set the outcome of a deployment; None takes it out of the belief."""
        outcome = ruling.outcome
        if outcome == (known := self.outcomes.get(key)):
            return
        self.changes += 1
        if outcome is None:
            del self.outcomes[key], self._stamps[key]
        else:
            self.outcomes[key], self._stamps[key] = outcome, ruling.stamp
        place = bisect_left(self.deployments, deployment_order(key), key=deployment_order)
        if known is None:
            self.deployments.insert(place, key)
        elif outcome is None:
            del self.deployments[place]

    def _assimilated(
        self,
        estimator: Estimator,
        evidence: Observation | Finding,
        robot_type: RobotType = ORDINARY,
    ) -> Estimator:
        """Return an estimator with more evidence; raise ValueError if it is impossible."""
        self.assimilations += 1
        after = estimator.copy()
        after.assimilate(evidence, robot_type)
        return after

    def _rule(self, key: DeploymentKey, estimator: Estimator) -> Ruling:
        """Judge a deployment by what was heard, given the evidence of earlier deployments."""
        heard = self.heard.get(key, {}).values()
        refused = {each.report: each.refusal for each in heard if each.refusal}
        # Refused reports that show that the robot is back.
        signs = {each.content for each in refused if is_back(each, self.grid)}
        waiting: set[int] = set()
        is_void = self.is_refused(key)
        is_awaited = self.is_at_base(key) and not is_void
        counted: Counted | None = None
        closed: HeardReport | None = None
        valid = [each for each in heard if not each.refusal]
        for by_rank in sorted(valid, key=attrgetter('rank'), reverse=True):
            report, outcome = by_rank.report, by_rank.outcome
            assert outcome is not None
            content = self._annotation(key, report.content, of_order=False)
            if content:
                _, annotation = self.annotations[content]
                outcome = annotation.applied(self.paths[key], outcome)
            cause = Cause.NONE
            if not outcome.survived:
                if is_void:
                    cause = Cause.ORDER_REFUSED
                elif is_awaited and report.settled is None:
                    waiting.add(report.content)
                    continue
                elif signs - {*(report.settled or ())}:
                    cause = Cause.IS_BACK
            if changes := self._spanned_changes(key):
                outcome, is_told = self._around(key, report.content, outcome, changes)
                cause = cause or (Cause.NONE if is_told else Cause.CHANGED)
            if cause:
                refused[report] = Refusal(report.content, cause, LOSS_REFUSED[cause].format(key))
                continue
            try:
                estimator = self._assimilated(estimator, outcome, self.robot_type(key))
            except ValueError as error:
                refused[report] = Refusal(report.content, Cause.IMPOSSIBLE, str(error))
                if report.survived:
                    signs.add(report.content)
                elif by_rank.is_settled:
                    closed = closed or by_rank
            else:
                counted = Counted(by_rank.report, outcome, content)
                break
        if counted is None and refused:
            counted = self._carried_home(key, refused.values())
            if counted is not None:
                robot_type = self.robot_type(key)
                estimator = self._assimilated(estimator, counted.outcome, robot_type)
        verdict = Verdict.OPEN
        if counted is not None:
            outcome = counted.outcome
            for other in valid:
                is_other = other.report is not counted.report and not counted.annotation
                if is_other and (refusal := contradiction(key, other, outcome)):
                    refused.setdefault(other.report, refusal)
            verdict = Verdict.RETURN if outcome.survived else Verdict.LOSS
            verdict = Verdict.UNMOVED if outcome.is_unmoved else verdict
            if counted.annotation:
                _, annotation = self.annotations[counted.annotation]
                if annotation.kind is AnnotationKind.WITHDRAW:
                    verdict = Verdict.WITHDRAWN
        elif is_void:
            verdict = Verdict.VOID
        elif closed is not None:
            verdict = Verdict.CLOSED
        elif refused:
            verdict = Verdict.HELD
        stands = counted or closed
        stamp = stands.report.stamp if stands else 0
        judged = frozenset(each.report.content for each in heard)
        standing = Standing(
            verdict,
            stands.report.content if stands else 0,
            in_order(refused.values()),
            judged if stands else judged - waiting,
            frozenset(self.statuses.get(key, ())),
            counted.annotation if counted else 0,
        )
        if verdict is Verdict.OPEN:
            standing = OPEN
        outcome = counted.outcome if counted else None
        return Ruling(standing, outcome, stamp, estimator, refused)

    def _around(
        self, key: DeploymentKey, report: int, outcome: Observation, changes: list[Finding]
    ) -> tuple[Observation, bool]:
        """Return an outcome without the changed cells, and whether its order to them is told."""
        if not outcome.survived:
            return outcome, bool(self._annotation(key, report, of_order=True))
        cells = np.concatenate([each.cells for each in changes])
        entered = outcome.is_entered & ~np.isin(outcome.path[1:], cells)
        return replace(outcome, entered=entered), True

    def _carried_home(self, key: DeploymentKey, refused: Iterable[Refusal]) -> Counted | None:
        """Return the annotated outcome of a deployment whose reports are refused."""
        for refusal in in_order(refused):
            if content := self._annotation(key, refusal.content, of_order=False):
                _, annotation = self.annotations[content]
                if annotation.kind in (AnnotationKind.RECOVERED, AnnotationKind.WITHDRAW):
                    (report,) = (
                        each for each in self.heard[key] if each.content == refusal.content
                    )
                    outcome = annotation.applied(self.paths[key], None)
                    return Counted(report, outcome, content)
        return None


class Counted(NamedTuple):
    """The report by which a deployment stands, its outcome, and the hash of its annotation."""

    report: Report
    outcome: Observation
    annotation: int


class Ruling(NamedTuple):
    """The standing of a deployment, its outcome, and the estimator after it."""

    standing: Standing
    outcome: Observation | None
    # Stamp of the report by which it stands.
    stamp: int
    estimator: Estimator
    refused: dict[Report, Refusal]


# Reasons why a reported loss is refused.
LOSS_REFUSED = {
    Cause.ORDER_REFUSED: 'deployment {} is reported lost, but its agent refused the order',
    Cause.CHANGED: (
        'deployment {} was lost while the field was changed in its cells: say whether it was lost '
        'before or after'
    ),
    Cause.IS_BACK: 'deployment {} is reported lost, but a refused report shows that it is back',
}


def contradiction(key: DeploymentKey, heard: HeardReport, counted: Observation) -> Refusal | None:
    """Return the refusal of a valid report that contradicts the outcome that counts."""
    outcome = heard.outcome
    assert outcome is not None
    if ending_key(outcome) != ending_key(counted) or is_same_outcome(outcome, counted):
        return None
    return Refusal(
        heard.report.content,
        Cause.CONTRADICTED,
        f'reports of deployment {key} differ: the one with more readings counts (do two robots '
        f'have the name {key.agent}?)',
    )


def in_order(refusals: Iterable[Refusal]) -> tuple[Refusal, ...]:
    """Return refusals in the order of their causes: those of robots that are back come last."""
    return tuple(sorted(refusals, key=lambda each: (each.cause, each.content, each.why)))
