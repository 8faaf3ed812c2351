# SPDX-License-Identifier: Apache-2.0
"""
Compute a log's standings, beliefs and decisions again from its paths and reports.

Standings on record say which reports the estimator had judged by then. A replay judges the same
reports, and compares each standing; then it compares the belief that names the same evidence,
field by field, with the decision, model and maps that go with it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from hashlib import blake2b
from pathlib import Path

from kbnitp_ros.core import DeploymentKey, Ledger
from kbnitp_ros.core.inference.record import OPEN, OrderState, Standing, Verdict
from kbnitp_ros.log.read import Bookmark, is_finished, LoggedMessage, parameter_changes
from kbnitp_ros.log.record import (
    begun,
    is_of_mission,
    read_no_go,
    record,
    RecordedMission,
    required_belief,
)
from kbnitp_ros.log.replayed import (
    ACKNOWLEDGED,
    belief_name,
    BeliefFinding,
    Difference,
    differences,
    ReplayedAcknowledgements,
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
from kbnitp_ros.log.roles import MAX_SHOWN, MissionLog, Role
from kbnitp_ros.messages.beliefs import belief_fields, Snapshot
from kbnitp_ros.messages.headers import Fields, MAX_REASON, NO_MISSION
from kbnitp_ros.messages.remarks import Remark
from kbnitp_ros.messages.standings import Standings
from kbnitp_ros.messages.topics import REMARKS, VIEWS

# Roles that are computed from the beliefs, and all other roles that are read.
COMPUTED = (*(f'belief/{name}' for name in VIEWS), 'model', *DECISIONS)
READ = (
    'belief', 'mission', 'operator', 'path', 'report', 'standings', 'state', 'status', *REMARKS,
)  # fmt: skip
ACKNOWLEDGEMENTS = 'recorded', 'operator/recorded'

# Maximum number of standings and beliefs that wait for evidence recorded after them.
MAX_WAITING = 100


def replay(
    log: str | Path | MissionLog,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
    asked: RecordedGoal | None = None,
) -> ReplayReport:
    """Compute a log's standings, beliefs and decisions again, and compare them with the record."""
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
    fold.decisions.no_go = read_no_go(log, first.grid)
    for role, logged in log.read(*READ, *ACKNOWLEDGEMENTS, corrupt=[], progress=progress):
        if role.name == 'mission':
            report.standing = logged.said
        elif role.name == 'state':
            own = first.grid.at(first.agent_base(role.agent)) if role.agent else first.grid
            if differs := logged.said.difference(own):
                evidence.refused.append(f'{logged.topic}: {differs}')
        else:
            if role.name not in ACKNOWLEDGEMENTS:
                with log.leaving_out(logged):
                    evidence.take(role, logged)
            fold.take(role, logged)
    report.changes = list(parameter_changes(bookmark.records, log.roles.is_node))
    fold.finish()
    for (topic, index), why in log.left_out.items():
        if log.roles.by_topic[topic].name in ('belief', 'standings', *COMPUTED):
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
    """The judgement of a log's evidence, compared with each recorded standing and belief."""

    def __init__(self, report: ReplayReport, asked: RecordedGoal | None) -> None:
        self.report = report
        self.views = ReplayedViews(report)
        self.acknowledgements = ReplayedAcknowledgements(report)
        self.decisions = ReplayedDecisions(report, asked)
        self._ledger: Ledger | None = None
        # Paths, reports and statuses on record, in order, and the indices of reports and statuses.
        self._said: list[tuple[Role, LoggedMessage]] = []
        self._places: dict[tuple[DeploymentKey, int], int] = {}
        self._statuses: dict[tuple[DeploymentKey, OrderState], int] = {}
        # Remarks of people on record, by the hash of the message.
        self._remarks: dict[int, Remark] = {}
        # Reports that were judged, by deployment.
        self._judged: dict[DeploymentKey, frozenset[int]] = {}
        # Standings and beliefs that wait for evidence, in order.
        self._queue: deque[tuple[Role, LoggedMessage]] = deque()
        # Evidence and events of the ledger; the epoch of its prior; the first standings of an
        # epoch whose prior was not read yet.
        self._evidence, self._events, self._epoch = (0, 0), 0, 0
        self._first: tuple[LoggedMessage, Standings] | None = None
        # Whether the belief with this evidence was compared.
        self._is_compared = False
        # Priors by the rules of their estimators.
        self._priors: dict[int, Snapshot] = {}
        # Whether standings are missing, so that the evidence of beliefs is not known.
        self._is_lost = False
        # Digests of the standings and beliefs so far.
        self._seen: set[bytes] = set()
        self._is_forced = False
        # The prior of the ledger.
        self._prior: Snapshot | None = None
        # Author and rules of the standings of this epoch.
        self._author, self._rules = '', 0

    def take(self, role: Role, logged: LoggedMessage) -> None:
        """Take evidence, or standings and beliefs, which may wait for evidence."""
        if role.name in (*ACKNOWLEDGED, *ACKNOWLEDGEMENTS):
            self.acknowledgements.take(role, logged)
        if role.name in ('path', 'report', 'status'):
            if not is_of_mission(role, logged, self.report.evidence.mission):
                return
            if role.name == 'report':
                key, report = logged.said
                self._places.setdefault((key, report.content), len(self._said))
            elif role.name == 'status':
                key, status = logged.said
                self._statuses.setdefault((key, status.state), len(self._said))
            self._said.append((role, logged))
        elif role.name in REMARKS:
            self._remarks.setdefault(logged.said.content, logged.said)
        elif role.name in ('standings', 'belief'):
            if role.name == 'belief':
                self.report.beliefs.note(logged.said)
            self._queue.append((role, logged))
        self._drain()

    def _drain(self) -> None:
        """Take what waits, as far as its evidence is on record."""
        while self._queue:
            self._is_forced |= len(self._queue) > MAX_WAITING
            role, logged = self._queue[0]
            take = self._take_standings if role.name == 'standings' else self._take_belief
            if not take(logged):
                return
            self._is_forced &= len(self._queue) > MAX_WAITING
            self._remove(logged)

    def _remove(self, taken: LoggedMessage) -> None:
        """Remove a message from the queue."""
        self._queue = deque(each for each in self._queue if each[1] is not taken)

    def _finding(self, logged: LoggedMessage, belief: str = '') -> Callable[..., BeliefFinding]:
        return partial(BeliefFinding, logged.topic, logged.index, belief)

    # Standings.

    def _take_standings(self, logged: LoggedMessage) -> bool:
        """Judge what standings judged; return False if they have to wait."""
        said: Standings = logged.said
        digest = blake2b(logged.data, digest_size=16).digest()
        if digest in self._seen:
            # A recorder that was restarted receives the last ones again.
            return True
        self.report.beliefs.note_standings(said.epoch, said.changes)
        epoch, changes = self._evidence
        if said.epoch < epoch:
            return self._refuse_numbers(logged, 'epoch', said.epoch, epoch)
        if said.epoch > epoch:
            self._evidence, self._events = (said.epoch, said.changes), said.events
            self._is_lost, self._is_compared = not said.is_complete, False
            self._author, self._rules = said.author, said.rules
            self._seen.add(digest)
            # The estimator publishes its prior next, unless an earlier one had the same.
            self._first = (logged, said) if said.is_complete else None
            if prior := self._priors.get(said.rules):
                self._begin(prior, said.epoch)
            return True
        if said.events < self._events:
            return self._refuse_numbers(logged, 'events', said.events, self._events)
        if said.changes < changes:
            return self._refuse_numbers(logged, 'changes', said.changes, changes)
        if said.epoch != self._epoch and not (
            self._begin_like_before(epoch) or self._take_waiting((epoch, 0))
        ):
            return False
        is_next = said.changes > changes and not self._is_compared
        if is_next and not self._take_waiting(self._evidence):
            return False
        if is_next and not self._is_compared:
            self._take_missing()
        is_gap = self._is_lost or said.since != self._events
        self._is_lost = said.epoch != self._epoch or (is_gap and not said.is_complete)
        if self._is_lost:
            why = f'standings between events {self._events} and {said.since} are missing'
            self.report.not_compared.append(self._finding(logged)(reason=why))
        elif self._is_on_record(said) or self._is_forced:
            self._judge(logged, said)
        else:
            return False
        self._is_compared &= said.changes == changes
        self._seen.add(digest)
        self._evidence, self._events = (said.epoch, said.changes), said.events
        return True

    def _take_waiting(self, evidence: tuple[int, int]) -> bool:
        """Take a belief that was received after later standings; return False to wait for it."""
        for role, logged in self._queue:
            if role.name == 'belief' and logged.said.evidence == evidence:
                if self._take_belief(logged):
                    self._remove(logged)
                    return True
                return self._is_forced
        # Otherwise it may be missing.
        return self._is_forced

    def _refuse_numbers(self, logged: LoggedMessage, name: str, number: int, last: int) -> bool:
        """Report standings whose numbers go back."""
        self.report.compared[logged.topic] += 1
        found = Difference(name, f'is {number}, after {last}')
        self.report.add(self._finding(logged)((found,)))
        return True

    def _is_on_record(self, said: Standings) -> bool:
        """Return whether the paths, reports and statuses of standings were read."""
        paths = self.report.evidence.places.keys()
        return (
            said.standings.keys() <= paths
            and said.reports <= self._places.keys()
            and said.order_states <= self._statuses.keys()
            and self._remarks.keys() >= {*said.remarks}
        )

    def _judge(self, logged: LoggedMessage, said: Standings) -> None:
        """Judge the reports that standings judged, in the order of the log; compare them."""
        ledger, prior = self._ledger, self._prior
        assert ledger is not None
        assert prior is not None
        origin = Fields(author=self._author, rules=self._rules)
        if said.mission != NO_MISSION:
            origin.mission = prior.mission
        found = [*differences(said, origin, TOLERANCE)]
        places = []
        for key, standing in said.standings.items():
            new = standing.judged - self._judged.get(key, frozenset())
            self._judged[key] = standing.judged
            known = [self._places[key, each] for each in new if (key, each) in self._places]
            states = [self._statuses.get((key, state)) for state in standing.order]
            places += [*known, *(each for each in states if each is not None)]
            if len(known) < len(new) or None in states:
                text = 'judges reports or states of the order that are not on record'
                found.append(Difference(f'standing of {key}', text))
        before = ledger.changes
        for place in sorted(places):
            key = self._said[place][1].said[0]
            if key not in ledger.paths and (path := self._path(key)) is not None:
                self._record(path)
            self._record(place)
        for content in said.remarks:
            with suppress(KeyError, ValueError):
                self._remarks[content].record(ledger)
        if ledger.remarks != [*said.remarks]:
            text = f'has {len(said.remarks)} hashes, computed are {len(ledger.remarks)}'
            found.append(Difference('remarks', text))
        # The first standings of an epoch may hold judgements of earlier ones.
        is_change = said.changes > self._evidence[1]
        if said.events > self._events and is_change != (ledger.changes > before):
            words = 'more' if is_change else 'as before'
            found.append(Difference('changes', f'is {words}, unlike the computed evidence'))
        for key, standing in said.standings.items():
            if text := standing_difference(standing, ledger.standings.get(key, OPEN)):
                found.append(Difference(f'standing of {key}', text))
        self.report.compared[logged.topic] += 1
        if found:
            self.report.add(self._finding(logged)(tuple(found)))

    def _path(self, key: DeploymentKey) -> int | None:
        """Return the index of the path of a deployment; None if it is not on record."""
        return self.report.evidence.places.get(key)

    def _record(self, place: int) -> None:
        """Record a message of evidence; what is refused is refused in the standings as well."""
        assert self._ledger is not None
        role, logged = self._said[place]
        try:
            record(self._ledger, role, logged)
        except ValueError as error:
            text = f'{logged.topic}: {error}'[:MAX_SHOWN]
            if text not in self.report.evidence.refused:
                self.report.evidence.refused.append(text)

    # Beliefs.

    def _take_belief(self, logged: LoggedMessage) -> bool:
        """Compare a belief with the ledger; return False if it has to wait for its standings."""
        said: Snapshot = logged.said
        find = self._finding(logged, belief_name(said.newest))
        digest = blake2b(logged.data, digest_size=16).digest()
        if digest in self._seen:
            self.report.repeated.append(find(reason='the same belief was recorded before'))
            return True
        if not said.deployments and not said.changes:
            return self._take_prior(logged, digest)
        if said.evidence > self._evidence and not self._is_forced:
            return self._take_later_standings(logged, said.evidence)
        if said.epoch == self._evidence[0] != self._epoch:
            self._begin_like_before(said.epoch)
        if said.epoch != self._epoch or self._ledger is None:
            self._miss(logged, 'the prior of its estimator is not on record')
            return True
        if self._is_lost or said.evidence != self._evidence:
            self._leave(logged, 'no standings on record are those of its evidence')
            return True
        self._seen.add(digest)
        self._is_compared = True
        self._compare(logged, self._ledger)
        return True

    def _take_later_standings(self, belief: LoggedMessage, evidence: tuple[int, int]) -> bool:
        """Take the standings of a belief that was received before them; return whether it may."""
        for role, logged in self._queue:
            if role.name == 'standings':
                if (logged.said.epoch, logged.said.changes) <= evidence:
                    if self._take_standings(logged):
                        self._remove(logged)
                        return self._evidence > evidence or self._retry(belief)
                    return False
                # The standings in between are missing.
                self._is_forced = True
                return self._retry(belief)
        return False

    def _retry(self, belief: LoggedMessage) -> bool:
        """Take a belief, unless it was taken with the standings before it."""
        is_taken = all(each is not belief for _, each in self._queue)
        return is_taken or self._take_belief(belief)

    def _take_prior(self, logged: LoggedMessage, digest: bytes) -> bool:
        """Compare the prior of an estimator; return False if its standings have to come first."""
        said: Snapshot = logged.said
        if said.epoch < self._epoch:
            self._miss(logged, 'its estimator began before the last one')
            return True
        if said.epoch > self._evidence[0] and not self._is_forced:
            # Its first standings are received after it.
            if not any(role.name == 'standings' for role, _ in self._queue):
                return False
            return self._take_later_standings(logged, (said.epoch, 2**32))
        if said.epoch > self._epoch:
            self._begin(said, said.epoch)
        self._seen.add(digest)
        self._is_compared |= said.evidence == self._evidence
        self._compare(logged, begun(said))
        return True

    def _begin_like_before(self, epoch: int) -> bool:
        """Begin with the last prior if that of an epoch is missing; return whether it does."""
        beliefs = [
            logged.said
            for role, logged in self._queue
            if role.name == 'belief' and logged.said.epoch == epoch
        ]
        prior = self._prior
        is_missing = bool(beliefs) and all(each.changes for each in beliefs)
        if prior is None or not is_missing or beliefs[0].rules() != prior.rules():
            return False
        self._begin(prior, epoch)
        return True

    def _begin(self, prior: Snapshot, epoch: int) -> None:
        """Begin with the prior of an estimator, and judge what it judged at its start."""
        self._ledger, self._epoch, self._prior = begun(prior), epoch, prior
        self.report.evidence.prior = self.report.evidence.prior or prior
        self._judged = {}
        first, self._first = self._first, None
        if first is not None:
            self._priors[first[1].rules] = prior
            judged, states = first[1].reports, first[1].order_states
            for place, (role, each) in enumerate(self._said):
                key, said = each.said
                is_judged = (
                    role.name == 'path'
                    or (role.name == 'report' and (key, said.content) in judged)
                    or (role.name == 'status' and (key, said.state) in states)
                )
                if is_judged:
                    self._record(place)
            self._judged = {key: each.judged for key, each in first[1].standings.items()}
            self._judge(*first)

    def _miss(self, logged: LoggedMessage, why: str) -> None:
        """Report a belief that nothing on record explains."""
        belief = belief_name(logged.said.newest)
        self.report.compared[logged.topic] += 1
        self.report.mismatches.append(self._finding(logged, belief)(reason=why))
        self._expect_views(logged)

    def _expect_views(self, logged: LoggedMessage) -> None:
        """Expect the grids of a belief that cannot be computed."""
        self.views.expect(logged.said.grid, logged.message, logged.said)
        self.views.unknown.add(logged.said.stamp)

    def _take_missing(self) -> None:
        """Expect what goes with a belief that is not on record: the next may have its stamp."""
        ledger, prior = self._ledger, self._prior
        if ledger is None or prior is None or self._is_lost or self._evidence[0] != self._epoch:
            return
        # The stamp of a belief without evidence is the start of its estimator.
        if ledger.deployments or ledger.remarks:
            epoch, changes = self._evidence
            said = replace(
                prior,
                author=self._author,
                epoch=epoch,
                changes=changes,
                stamp=ledger.newest_stamp,
                newest=ledger.newest,
                deployments=len(ledger.deployments),
            )
            self.views.expect(ledger.grid, ledger.belief, said)
            self.views.expect_model(ledger, said)
            self.decisions.compare(ledger, said)

    def _leave(self, logged: LoggedMessage, why: str) -> None:
        """Report a belief that cannot be computed."""
        belief = belief_name(logged.said.newest)
        self.report.not_compared.append(self._finding(logged, belief)(reason=why))
        self._expect_views(logged)

    def _compare(self, logged: LoggedMessage, ledger: Ledger) -> None:
        """Compare a belief with that of a ledger; compute its views."""
        said: Snapshot = logged.said
        self.report.compared[logged.topic] += 1
        mission = self._prior.mission if self._prior else said.mission
        author = self._author if said.epoch == self._evidence[0] else said.author
        computed = belief_fields(ledger, said.stamp, mission, author, said.epoch, said.changes)
        learnt = ledger.estimator.unknowns.priors
        found = tuple(differences(logged.message, computed, TOLERANCE, learnt))
        is_equal = all(each.is_rounding for each in found)
        if found and is_equal:
            # The maps are sums and quotients of the joint, which all processors round alike.
            maps = said.belief
            own = Fields(hazard=maps.hazard, target=maps.target, kappa=maps.kappa)
            found += tuple(differences(logged.message, own, 0.0))
        # Grids were made from the recorded belief, so they have the same rounding difference.
        is_same = all(each.is_rounding for each in found)
        self.views.expect(ledger.grid, logged.message if is_same else ledger.belief, said)
        self.views.expect_model(ledger, said)
        if found:
            self.report.add(self._finding(logged, belief_name(said.newest))(found))
        else:
            self.decisions.compare(ledger, said)

    def finish(self) -> None:
        """Take what still waits; compare views and decisions, and report what is left over."""
        while self._queue:
            self._is_forced = True
            self._drain()
        report, ledger = self.report, self._ledger
        if not self._is_compared:
            self._take_missing()
        if ledger is not None:
            report.kinds = ledger.estimator.kinds
            if self.views.checked:
                report.check = ledger.estimator.model_check
        self.views.compare()
        self.decisions.finish(ledger)
        self.acknowledgements.compare()
        judged = [
            place
            for (key, content), place in self._places.items()
            if content in self._judged.get(key, ())
        ]
        report.passed_over = [
            key
            for key in report.evidence.unjudged
            # A loss may wait for its departure.
            if not report.evidence.is_at_base(key)
            and any(
                place < max(judged, default=-1) and content not in self._judged.get(key, ())
                for (other, content), place in self._places.items()
                if other == key
            )
        ]
        held = {} if ledger is None else ledger.outcomes
        report.not_yet_held = [
            key
            for key, standing in report.evidence.standings.items()
            if standing.verdict.is_evidence and key not in held
        ]


def standing_difference(theirs: Standing, ours: Standing) -> str:
    """Return how a recorded standing differs from the computed one; '' if it does not."""
    if theirs.verdict is not ours.verdict:
        return f'is {theirs.verdict.name}, computed is {ours.verdict.name}'
    if theirs.report != ours.report:
        return f'names the report {theirs.report}, computed is {ours.report}'
    if theirs.judged != ours.judged:
        return f'judges {len(theirs.judged)} reports, computed are {len(ours.judged)}'
    if theirs.order != ours.order and theirs.verdict is not Verdict.OPEN:
        return f'has {len(theirs.order)} states of the order, computed are {len(ours.order)}'
    refused = [(each.content, each.cause) for each in theirs.refusals]
    if refused != [(each.content, each.cause) for each in ours.refusals]:
        return f'refuses {len(theirs.refusals)} reports otherwise than computed'
    if theirs.annotation != ours.annotation:
        return f'stands by the annotation {theirs.annotation}, computed is {ours.annotation}'
    if theirs.why != ours.why[:MAX_REASON]:
        return f'has the reason {theirs.why!r}, computed is {ours.why!r}'
    return ''
