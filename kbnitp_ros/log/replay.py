# SPDX-License-Identifier: Apache-2.0
"""
Compute a log's beliefs again from its paths and reports.

A recorded belief names the evidence that was assimilated since the belief before it. A replay
assimilates the same evidence, and compares its belief with the recorded belief, field by field.
After a missing belief, beliefs are not compared until a belief names all of its evidence; likewise
if the log lacks a report that a belief names, but has a later report of the same deployment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

from kbnitp_ros.base.state import MissingError
from kbnitp_ros.core import DeploymentKey, Ledger
from kbnitp_ros.core.inference.record import ending_key
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import Bookmark, is_finished, LoggedMessage, parameter_changes
from kbnitp_ros.log.record import begun, RecordedMission, required_belief
from kbnitp_ros.log.replayed import (
    belief_name,
    BeliefFinding,
    Difference,
    differences,
    ReplayedViews,
    ReplayReport,
    TOLERANCE,
)
from kbnitp_ros.log.replayed_decisions import (
    CONFIDENCE,
    DECISIONS,
    RecordedGoal,
    ReplayedDecisions,
)
from kbnitp_ros.log.roles import MissionLog, VIEWS
from kbnitp_ros.messages.beliefs import belief_fields, read_assimilated, Snapshot
from kbnitp_ros.messages.headers import Fields

# Roles that are computed from the beliefs, and all other roles that are read.
COMPUTED = (*(f'belief/{name}' for name in VIEWS), 'model', *DECISIONS)
READ = ('belief', 'path', 'report', 'status', 'operator', 'progress')


def replay(
    log: str | Path | MissionLog,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
    asked: RecordedGoal | None = None,
) -> ReplayReport:
    """Compute a log's beliefs and decisions again, and compare them with the record."""
    log = log if isinstance(log, MissionLog) else MissionLog(log)
    first = required_belief(log)
    evidence = RecordedMission(first.grid, first.max_steps, first.robot_types)
    report = ReplayReport(evidence, finished=is_finished(log.path))
    fold = Fold(report, asked)
    bookmark = Bookmark()
    # Read first, since a check or decision is computed while the ledger has its evidence.
    for role, logged in log.read(
        *COMPUTED, corrupt=report.corrupt, progress=progress, bookmark=bookmark
    ):
        if role.name in DECISIONS:
            fold.decisions.note(logged)
        else:
            fold.views.note(role, logged)
    fold.decisions.confidences = recorded_confidences(log, bookmark)
    # Index of the first belief that is recorded before evidence that it names.
    left: int | None = None
    for role, logged in log.read(*READ, corrupt=[], progress=progress):
        if role.name == 'progress':
            report.standing = logged.said
            continue
        with log.leaving_out(logged):
            evidence.take(role, logged)
        if role.name == 'belief' and left is None:
            if fold.is_ready(logged.message):
                fold.take(logged)
            else:
                left = logged.index
    if left is not None:
        for _, logged in log.read('belief', corrupt=[], progress=progress):
            if logged.index >= left:
                fold.take(logged)
    report.changes = list(parameter_changes(bookmark.records, log.roles.is_node))
    fold.finish()
    for (topic, index), why in log.left_out.items():
        if log.roles.by_topic[topic].name in ('belief', *COMPUTED):
            report.compared[topic] += 1
            report.mismatches.append(BeliefFinding(topic, index, reason=why))
        else:
            evidence.refused.append(f'{topic}: {why}')
    return report


def recorded_confidences(log: MissionLog, bookmark: Bookmark) -> set[float]:
    """Return all confidences that the estimator of a log had."""
    return {
        values[CONFIDENCE]
        for item in bookmark.records
        for node, values in log.parse_parameters({item.name: item.values}).items()
        if node.endswith('/estimator') and isinstance(values.get(CONFIDENCE), float)
    }


class Fold:
    """The belief recomputed from a log's evidence, compared with each recorded belief in turn."""

    def __init__(self, report: ReplayReport, asked: RecordedGoal | None) -> None:
        self.report = report
        self._ledger: Ledger | None = None
        # Evidence that the ledger has assimilated, as the hashes of path and report.
        self._assimilated: dict[DeploymentKey, tuple[int, int]] = {}
        # Digest of the last belief if it was recomputed, else empty; and digest of the last belief
        # read.
        self._held = self._last = b''
        self._seen: set[bytes] = set()
        self.views = ReplayedViews()
        self.decisions = ReplayedDecisions(report, asked)

    def is_ready(self, belief: Any) -> bool:
        """Return whether the log has, up to here, all evidence that a belief names."""
        has = self.report.evidence.has
        with suppress(ValueError):
            return all(has(key, *hashes) for key, hashes in read_assimilated(belief).items())
        return True

    def take(self, logged: LoggedMessage) -> None:
        """Assimilate the evidence that a belief names, and compare the beliefs."""
        said, report = logged.said, self.report
        find = partial(BeliefFinding, logged.topic, logged.index, belief_name(said.newest))
        self.decisions.note_belief(said, logged.message.since)
        digest = blake2b(logged.data, digest_size=16).digest()
        # Equal counts do not suffice, since a restarted estimator counts from 0 again.
        follows = self._held == self._last and logged.message.since == len(self._assimilated)
        self._last = digest
        if digest in self._seen:
            report.repeated.append(find(reason='the same belief was recorded before'))
            return
        if said.newest is None:
            # A restarted estimator may publish the same beliefs again, which are not reported as
            # repeated.
            self._seen.clear()
        self._seen.add(digest)
        self._held = b''
        try:
            ledger = self._assimilate(said, logged.message, follows)
            self._held = digest
            report.compared[logged.topic] += 1
            if found := self._compare(ledger, said, logged.message):
                report.add(find(found))
        except LogError:
            raise
        except MissingError as error:
            report.not_compared.append(find(reason=str(error)))
            self.views.unknown[said.stamp] += 1
        except ValueError as error:
            report.compared[logged.topic] += 1
            report.mismatches.append(find(reason=str(error)))

    def _begin(self, prior: Snapshot) -> Ledger:
        """Begin with the prior of an estimator."""
        self._ledger = begun(prior)
        self.report.evidence.prior = prior
        self._assimilated = {}
        return self._ledger

    def _assimilate(self, said: Snapshot, belief: Any, follows: bool) -> Ledger:
        """Return the ledger with the evidence that a belief names; `follows`: it has the rest."""
        newest, prior = said.newest, self.report.evidence.prior
        if newest is None:
            return self._begin(said)
        if self._ledger is None or prior is None:
            raise ValueError('the prior of its estimator is not on record')
        missing = f'the belief before it, which holds {belief.since} deployments, is missing'
        if belief.since and not follows:
            raise MissingError(missing)
        named = read_assimilated(belief)
        if newest not in named:
            raise ValueError(f'taken_in does not name {newest}, the deployment assimilated last')
        ledger = self._ledger
        if not belief.since and self._assimilated.items() - named.items():
            # A restarted estimator may have assimilated less evidence, or other reports.
            ledger = self._begin(prior)
        for key, hashes in named.items():
            if key != newest and self._assimilated.get(key) == hashes:
                continue
            path, report = self.report.evidence.named(key, *hashes, said.stamp)
            ledger.record_path(key, path, hashes[0])
            if not ledger.record_report(key, report) and belief.since:
                raise MissingError(missing)
            self._assimilated[key] = hashes
            if key == newest:
                newest_stamp = report.stamp
        ledger.newest, ledger.newest_stamp = newest, newest_stamp
        return ledger

    def _compare(self, ledger: Ledger, said: Snapshot, belief: Any) -> tuple[Difference, ...]:
        """Return the differences of a belief from the ledger's; compute the belief's views."""
        prior = self.report.evidence.prior
        assert prior is not None
        computed = belief_fields(ledger, said.stamp, prior.mission, assimilated=())
        # These fields name the evidence, and are not compared.
        del computed.since, computed.taken_in
        learnt = ledger.estimator.unknowns.priors
        found = tuple(differences(belief, computed, TOLERANCE, learnt))
        is_equal = all(each.is_rounding for each in found)
        if found and is_equal:
            # The maps are sums and quotients of the joint, which all processors round alike.
            maps = said.belief
            own = Fields(hazard=maps.hazard, target=maps.target, kappa=maps.kappa)
            found += tuple(differences(belief, own, 0.0))
        # Grids were made from the recorded belief, so they have the same rounding difference.
        seen = belief if all(each.is_rounding for each in found) else ledger.belief
        self.views.expect(ledger, seen, said)
        if not found:
            self.decisions.compare(ledger, said)
        return found

    def finish(self) -> None:
        """Compare views with their beliefs, and report decisions and deployments left over."""
        report = self.report
        if self._ledger is not None:
            estimator = self._ledger.estimator
            report.kinds = estimator.kinds
            if self.views.checked:
                report.check = estimator.check
        self.views.compare(report)
        self.decisions.finish()
        for key in report.evidence.reports:
            if (
                self._ledger
                and key in self._assimilated
                and ending_key(self._ledger.outcomes[key])
                >= ending_key(report.evidence.outcomes[key])
            ):
                report.passed_over += report.not_yet_held
                report.not_yet_held = []
            else:
                report.not_yet_held.append(key)
        if self._held != self._last:
            # The last belief was not compared, and may hold the deployments passed over.
            report.not_yet_held[:0] = report.passed_over
            report.passed_over = []
