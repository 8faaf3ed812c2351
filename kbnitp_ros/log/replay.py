# SPDX-License-Identifier: Apache-2.0
"""
Compute a log's beliefs again from its paths and reports.

A belief on record says how many deployments it holds and whose evidence was taken in last. This
gives what the estimator knew, whatever a recorder had heard of by then. What the estimator should
have published is then compared with what is on record, field by field and bit for bit.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any, TypeVar

from kbnitp_msgs.msg import ModelBelief
from kbnitp_ros.core import DeploymentKey, Ending, Estimator, Grid, METHODS, Report, versions
from kbnitp_ros.log.bag import is_finished, LogError, LoggedMessage, read_log, same_types
from kbnitp_ros.log.compare import content, Difference, differences
from kbnitp_ros.log.decisions import Decisions, is_decision, OPERATOR
from kbnitp_ros.log.evidence import (
    BELIEF,
    Evidence,
    first_belief,
    GRID,
    LONGEST,
    MODEL,
    PATH,
    REPORT,
    Reported,
)
from kbnitp_ros.log.trial import TrialLedger
from kbnitp_ros.log.ways import Head, Ways
from kbnitp_ros.messages.beliefs import (
    belief_maps,
    newest_deployment,
    read_belief_maps,
    read_kinds,
    Snapshot,
)
from kbnitp_ros.messages.decisions import Decision, read_decision
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.models import model_belief
from nav_msgs.msg import OccupancyGrid

# A view's topic and its stamp, which may be that of several beliefs.
View = tuple[str, int]

S = TypeVar('S')
T = TypeVar('T')

# How many steps a replay may take, for each message and besides: deployments taken in, and reports
# looked at. An estimator that goes back for late reports takes a few dozen for a message.
WORK = 50
LEAST_WORK = 50_000

# How many of them may be guesses of what came between two beliefs, and how many of one gap.
GUESSES = 10
LEAST_GUESSES = 20_000
GAP = 5_000

# What the paths of a log without a belief would be judged by.
NO_RULES = Grid(1, 1), 1

VIEWS = ('hazard', 'target', 'kappa')

# A message of each type that shows something of a belief.
LIKE = {GRID: OccupancyGrid(), MODEL: ModelBelief()}


@dataclass(frozen=True)
class Mismatch:
    """
    A recorded belief, or a view of one, that was not reproduced.

    Attributes
    ----------
    topic : str
        Where it was published.
    index : int
        Which of the topic's messages it is, from 0.
    deployment : DeploymentKey or None
        The newest one it holds; None for a prior.
    differences : tuple of Difference
        How it differs from what was computed.
    reason : str
        Why nothing could be computed, if so.

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


@dataclass(frozen=True)
class ReplayReport:
    """
    What a replay found.

    Attributes
    ----------
    method : str
        The estimator's; empty if no prior is on record.
    version : int or None
        Which of the method's `versions` computed what was compared; None if there was nothing.
    evidence : Evidence
        The deployments on record.
    compared : dict
        How many messages were compared, by topic: the beliefs and their views.
    mismatches : list of Mismatch
        Those that were not reproduced.
    undecided : list of Mismatch
        Those of which it was not found out what they hold.
    passed_over : list of DeploymentKey
        Deployments that no recorded belief holds, though later ones are held: lost evidence.
    not_yet_held : list of DeploymentKey
        Deployments after the last one that a recorded belief holds.
    finished : bool
        Whether the log ends as its writer ends it.
    work : int
        How many deployments were taken in and reports looked at.
    decisions : list of Decision
        What the operator decided, in the order on record.

    """

    method: str
    version: int | None
    evidence: Evidence
    compared: dict[str, int]
    mismatches: list[Mismatch]
    undecided: list[Mismatch]
    passed_over: list[DeploymentKey]
    not_yet_held: list[DeploymentKey]
    finished: bool
    work: int
    decisions: list[Decision]

    @property
    def reproduced(self) -> bool:
        """
        Whether the beliefs on record are what the deployments on record give.

        A mission may end before the last deployments are in a belief.
        """
        return not self.mismatches and not self.undecided and not self.passed_over


def replay(
    path: str | Path,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
) -> ReplayReport:
    """
    Compute a log's beliefs again and compare them with those on record.

    The log is read twice: for its evidence, then for its beliefs. The steps that this may take
    are so many for each message, see `WORK`; what they do not suffice for is `undecided`.

    A log does not say which version of its method it was recorded with. It is replayed with the
    last one, and with those before it until one reproduces it.

    Parameters
    ----------
    path : str or Path
        The log of one mission, from its own recorder or from ``ros2 bag record``.
    progress : callable
        Passes the log's messages on, twice; may show how far the reading has come.

    Raises
    ------
    LogError
        If the file cannot be read, is no MCAP file or a damaged one, or does not hold the beliefs
        of one mission.

    """
    report = replay_with(None, path, progress)
    known = versions(report.method) if report.method in METHODS else range(0)
    for version in reversed(known[:-1]):
        if report.reproduced:
            break
        earlier = replay_with(version, path, progress)
        if earlier.reproduced:
            report = earlier
    return report


def replay_with(
    version: int | None,
    path: str | Path,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]],
) -> ReplayReport:
    """Do what `replay` does with one version of the method, the last one if None."""
    first = first_belief(path)
    evidence = Evidence(*((first.grid, first.max_steps, first.kinds) if first else NO_RULES))
    heads: list[Head] = []
    decisions = Decisions()
    topic = ''
    with same_types(path):
        for logged in progress(read_log(path, (BELIEF, PATH, REPORT, OPERATOR))):
            if logged.type_name == OPERATOR:
                take_decision(logged, decisions, evidence)
                continue
            if logged.type_name != BELIEF:
                evidence.take(logged)
                continue
            if topic not in ('', logged.topic):
                raise LogError(
                    f'beliefs are on record from {topic} and {logged.topic}: '
                    'a log to replay holds one mission'
                )
            topic = logged.topic
            heads.append(head_of(logged.message))
            with suppress(ValueError):
                own = read_kinds(getattr(logged.message, 'own', ()))
                evidence.allow(logged.message.max_steps, own)
        if not topic:
            raise LogError(
                f'{path} has no beliefs on record: it must have messages of type {BELIEF}'
            )
        fold = Fold(evidence, heads, topic, version)
        for logged in progress(read_log(path, (BELIEF, *LIKE))):
            fold.take(logged)
        fold.finish()
    return ReplayReport(
        method=fold.prior.method if fold.prior else '',
        version=fold.version_used,
        evidence=evidence,
        compared=dict(fold.compared),
        mismatches=fold.mismatches,
        undecided=fold.undecided,
        passed_over=fold.passed_over,
        not_yet_held=fold.not_yet_held,
        finished=is_finished(path),
        work=fold.work,
        decisions=list(decisions.taken.values()),
    )


def take_decision(logged: LoggedMessage, decisions: Decisions, evidence: Evidence) -> None:
    """Take note of what the operator decided, or of why it is refused."""
    if is_decision(logged):
        try:
            decisions.take(read_decision(evidence.grid, logged.message))
        except ValueError as error:
            evidence.refused.append(f'{logged.topic}: {error}'[:LONGEST])


def head_of(belief: Any) -> Head:
    """Return what a recorded belief says of the deployments it holds."""
    newest = newest_deployment(belief)
    return Head(belief.deployments, newest, from_stamp(belief.header.stamp))


@dataclass(frozen=True)
class Recorded:
    """A message and which of its topic's messages it is, from 0."""

    topic: str
    index: int
    message: Any


class Fold:
    """
    What has been computed of a log's beliefs, and what has been found in comparing.

    Topics may be interleaved in any way: a view waits until its belief has been computed.

    Parameters
    ----------
    evidence : Evidence
        All of the log.
    heads : sequence of Head
        Of the log's beliefs.
    topic : str
        Theirs.
    version : int, optional
        Which of the method's `versions` to compute with; the last unless given.

    """

    def __init__(
        self,
        evidence: Evidence,
        heads: Sequence[Head],
        topic: str,
        version: int | None = None,
    ) -> None:
        self.evidence = evidence
        self.version = version
        self.prior: Snapshot | None = None
        self.passed_over: list[DeploymentKey] = []
        self.not_yet_held: list[DeploymentKey] = []
        self.mismatches: list[Mismatch] = []
        self.undecided: list[Mismatch] = []
        self.compared: Counter[str] = Counter()
        self._heads = heads
        self._ways = Ways(evidence, heads)
        messages = len(heads) + len(evidence.said)
        self._limit = LEAST_WORK + WORK * messages
        self._guesses = LEAST_GUESSES + GUESSES * messages
        self._assimilations = 0
        self._ledger: TrialLedger | None = None
        # As it was before the estimator was restarted.
        self._before_restart: TrialLedger | None = None
        # Whether the last belief was not reproduced, or not decided.
        self._is_astray = False
        self._is_undecided = False
        # With their endings: a late return is more than the loss it replaces.
        self._held: set[tuple[DeploymentKey, Ending]] = set()
        self._seen: Counter[str] = Counter()
        self._model_topic = f'{topic.rpartition("/")[0]}/model'
        self._view_types = {f'{topic}/{name}': GRID for name in VIEWS} | {self._model_topic: MODEL}
        self._views: dict[View, Views] = defaultdict(Views)

    @property
    def version_used(self) -> int | None:
        """Which version computed the beliefs; None if there was no prior."""
        return None if self._ledger is None else self._ledger.estimator.version

    @property
    def work(self) -> int:
        """How many deployments were taken in and reports looked at so far."""
        return self._assimilations + self._ways.steps

    def take(self, logged: LoggedMessage) -> None:
        """Compare a belief or a view."""
        recorded = Recorded(logged.topic, self._seen[logged.topic], logged.message)
        self._seen[logged.topic] += 1
        if logged.type_name != BELIEF:
            if self._view_types.get(logged.topic) != logged.type_name:
                return
            view = logged.topic, from_stamp(logged.message.header.stamp)
            if self._views[view].is_matched_by_recorded(recorded, LIKE[logged.type_name]):
                self.compared[logged.topic] += 1
        elif recorded.index < len(self._heads):
            # The log may have grown since its evidence was read.
            self._compare_belief(recorded, self._heads[recorded.index])

    def finish(self) -> None:
        """Compare what still waits, and find deployments in no belief."""
        # What is left has another value, or belongs to a belief that is not on record.
        for views in self._views.values():
            for each, (newest, shown) in views.unmatched():
                self.compared[each.topic] += 1
                different = tuple(differences(each.message, shown))
                self.mismatches.append(Mismatch(each.topic, each.index, newest, different))
        for key, report in self.evidence.reports.items():
            if (key, report.ending) in self._held:
                self.passed_over += self.not_yet_held
                self.not_yet_held = []
                continue
            try:
                if self._ledger is not None:
                    self._ledger.tell((), (key, report))
            except ValueError as error:
                self.evidence.refused.append(str(error))
            else:
                self.not_yet_held.append(key)

    def _compare_belief(self, recorded: Recorded, head: Head) -> None:
        """Compute a recorded belief and its views, and compare."""
        self.compared[recorded.topic] += 1
        found = partial(Mismatch, recorded.topic, recorded.index, head.newest)
        try:
            if head.newest is None:
                ledger = self._begin(recorded.message)
                different = [*self._differences(ledger, head, recorded.message)]
            else:
                different = self._search(recorded, head, head.newest)
        except UndecidedError as error:
            self._is_undecided = True
            self.undecided.append(found(reason=str(error)))
            return
        except ValueError as error:
            self.mismatches.append(found(reason=str(error)))
            return
        self._is_astray, self._is_undecided = bool(different), False
        if different:
            self.mismatches.append(found(tuple(different)))
        self._show(recorded.topic, head)

    def _begin(self, belief: Any) -> TrialLedger:
        """Begin with the prior of an estimator."""
        prior = read_belief_maps(belief)
        ledger = started(prior, self.version, self.evidence)
        if self._ledger is not None and self._ledger.deployments:
            self._before_restart = self._ledger
        self.prior, self._ledger = prior, ledger
        return ledger

    def _started(self) -> TrialLedger:
        """Return the ledger of an estimator that holds nothing yet."""
        assert self.prior is not None
        return started(self.prior, self.version, self.evidence)

    def _search(self, recorded: Recorded, head: Head, newest: DeploymentKey) -> list[Difference]:
        """
        Find the deployments that give a belief, and keep them.

        Returns
        -------
        list of Difference
            Empty if they are found; otherwise of the likeliest.

        Raises
        ------
        UndecidedError
            If there are too many ways to fill a gap.
        ValueError
            If the prior or the deployment is not on record, or cannot be taken in.

        """
        if self._ledger is None:
            raise ValueError('the prior it started from is not on record')
        reports = self.evidence.reports_at(newest, head.stamp)
        if self.work > self._limit:
            raise UndecidedError(f'the whole log takes more than {self._limit} steps to compute')
        starts = self._starts(head)
        likeliest: tuple[TrialLedger, list[Reported], Report] | None = None
        # After a belief that is not reproduced others seldom are, and looking for them takes long.
        is_lost = self._is_astray or self._is_undecided
        for ledger, report in product(starts, reports):
            last = newest, report
            taken = self._ways.certain(ledger, head, last, recorded.index)
            if taken is None:
                continue
            gives = self._try(ledger, taken, last, head, recorded.message)
            if gives:
                return []
            if gives is not None:
                likeliest = likeliest or (ledger, taken, report)
                if is_lost:
                    break
        is_certain = likeliest is not None
        if not is_lost and any(
            self._guess(starts, (newest, report), head, recorded, is_certain) for report in reports
        ):
            return []
        if likeliest is None and self._is_undecided:
            raise UndecidedError('it is not known what the belief before it holds')
        ledger, taken, report = likeliest or (self._ledger, [], reports[0])
        self._tell(ledger, taken, (newest, report))
        self._keep(ledger)
        return [*self._differences(ledger, head, recorded.message)]

    def _starts(self, head: Head) -> list[TrialLedger]:
        """
        Return what a belief may go on from, the fullest first.

        That is the belief before, what an estimator that was restarted held before and has had
        again at once, or the prior.
        """
        known = [self._ledger, self._before_restart]
        starts = [each for each in known if each and len(each.deployments) <= head.held]
        assert self.prior is not None
        return [
            *sorted(starts, key=lambda each: len(each.deployments), reverse=True),
            started(self.prior, self.version, self.evidence),
        ]

    def _guess(
        self,
        starts: Sequence[TrialLedger],
        last: Reported,
        head: Head,
        recorded: Recorded,
        is_certain: bool,
    ) -> bool:
        """
        Try what may have come between a belief and the one before, and keep what gives it.

        Returns
        -------
        bool
            Whether something does.

        Raises
        ------
        UndecidedError
            If there is more to try than may be, and it is not certain what should have come.

        """
        begun = self.work
        end = begun + min(GAP, self._guesses)
        self._ways.limit = end - self._assimilations
        try:
            for ledger in starts:
                for taken in self._ways.possible(ledger, head, last, recorded.index):
                    if self._try(ledger, taken, last, head, recorded.message):
                        return True
                    if self.work > end:
                        break
        finally:
            self._guesses -= self.work - begun
        if self.work > end and not is_certain:
            raise UndecidedError(
                'what came between it and the belief before is not among the likeliest that were '
                f'tried in {end - begun} steps'
            )
        return False

    def _try(
        self, ledger: TrialLedger, taken: list[Reported], last: Reported, head: Head, belief: Any
    ) -> bool | None:
        """Return whether a ledger gives a belief after this; None if that cannot have been."""
        try:
            self._tell(ledger, taken, last)
        except ValueError:
            return None
        can_be = len(ledger.deployments) == head.held
        if can_be and not any(self._differences(ledger, head, belief)):
            self._keep(ledger)
            return True
        ledger.take_back()
        return False if can_be else None

    def _tell(self, ledger: TrialLedger, taken: list[Reported], last: Reported) -> None:
        before = ledger.assimilations
        try:
            ledger.tell(taken, last)
        except ValueError:
            ledger.take_back()
            raise
        finally:
            self._assimilations += ledger.assimilations - before

    def _differences(self, ledger: TrialLedger, head: Head, belief: Any) -> Iterator[Difference]:
        mission = from_stamp(belief.info.map_load_time)
        return differences(belief, belief_maps(ledger, head.stamp, mission))

    def _keep(self, ledger: TrialLedger) -> None:
        """Go on from a ledger with what it was told."""
        self._ledger = ledger
        self._held.update((key, ledger.ending(key)) for key in ledger.keep())

    def _show(self, topic: str, head: Head) -> None:
        """Compute the views of a belief."""
        assert self._ledger is not None
        grid, belief = self._ledger.grid, self._ledger.belief
        views: dict[str, Any] = {
            f'{topic}/{name}': occupancy_grid(grid, getattr(belief, name), head.stamp)
            for name in VIEWS
        }
        if self._ledger.estimator.unknowns.priors:
            views[self._model_topic] = model_belief(self._ledger, head.stamp)
        for name, shown in views.items():
            if self._views[name, head.stamp].is_matched_by_computed(head.newest, shown):
                self.compared[name] += 1


class Views:
    """The views of one topic and stamp that are recorded and not computed, or the other way."""

    def __init__(self) -> None:
        self._recorded: dict[Hashable, list[Recorded]] = {}
        self._computed: dict[Hashable, list[tuple[DeploymentKey | None, Any]]] = {}

    def is_matched_by_recorded(self, recorded: Recorded, like: Any) -> bool:
        """
        Return whether a recorded view has been computed, and strike both out.

        `like` is a message of its type.
        """
        key = content(recorded.message, like)
        return strike_out(key, self._computed, self._recorded, recorded)

    def is_matched_by_computed(self, newest: DeploymentKey | None, shown: Any) -> bool:
        """Return whether a computed view has been recorded, and strike both out."""
        return strike_out(content(shown, shown), self._recorded, self._computed, (newest, shown))

    def unmatched(self) -> Iterator[tuple[Recorded, tuple[DeploymentKey | None, Any]]]:
        """Yield what was recorded in the place of something else."""
        recorded = sorted(chain(*self._recorded.values()), key=lambda each: each.index)
        return zip(recorded, chain(*self._computed.values()))


def strike_out(
    key: Hashable, others: dict[Hashable, list[S]], own: dict[Hashable, list[T]], view: T
) -> bool:
    """Remove one of the others that has the same content, or keep this one if there is none."""
    if key not in others:
        own.setdefault(key, []).append(view)
        return False
    others[key].pop()
    if not others[key]:
        del others[key]
    return True


class UndecidedError(Exception):
    """It takes too long to find out what a belief holds."""


def started(prior: Snapshot, version: int | None, evidence: Evidence) -> TrialLedger:
    """
    Return the ledger of an estimator with this prior and this version of its method.

    Raises
    ------
    ValueError
        If the method or the version is unknown.

    """
    estimator = Estimator(
        prior.prior, prior.model, prior.method, prior.unknowns, prior.seed, version=version
    )
    return TrialLedger(prior.grid, prior.max_steps, estimator, evidence, prior.kinds)
