# SPDX-License-Identifier: Apache-2.0
"""
Compute a log's beliefs again from its paths and reports.

A belief on record says how many deployments it holds and whose evidence was taken in last. This
gives what the estimator knew, whatever a recorder had heard of by then. What the estimator should
have published is then compared with what is on record, field by field and bit for bit.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice, product
from pathlib import Path
from typing import Any

from kbnitp_ros.core import DeploymentKey, Estimator, Ledger, METHODS, versions
from kbnitp_ros.log.bag import is_finished, LogError, LoggedMessage, read_log, same_types
from kbnitp_ros.log.compare import Difference, differences
from kbnitp_ros.log.evidence import Evidence, Reported
from kbnitp_ros.messages.beliefs import belief_maps, newest_deployment, read_belief_maps, Snapshot
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import from_stamp

BELIEF = 'kbnitp_msgs/msg/BeliefMaps'
GRID = 'nav_msgs/msg/OccupancyGrid'
PATH = 'nav_msgs/msg/Path'
REPORT = 'kbnitp_msgs/msg/DeploymentReport'

# A view's topic and its stamp, which may be that of several beliefs.
View = tuple[str, int]

# How many ways to fill a gap between recorded beliefs are looked at, and how many of them tried.
WAYS = 200_000
TRIALS = 1000

VIEWS = ('hazard', 'target', 'kappa')


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
    passed_over : list of DeploymentKey
        Deployments that no recorded belief holds, though later ones are held: lost evidence.
    not_yet_held : list of DeploymentKey
        Deployments after the last one that a recorded belief holds.
    finished : bool
        Whether the log ends as its writer ends it.

    """

    method: str
    version: int | None
    evidence: Evidence
    compared: dict[str, int]
    mismatches: list[Mismatch]
    passed_over: list[DeploymentKey]
    not_yet_held: list[DeploymentKey]
    finished: bool

    @property
    def reproduced(self) -> bool:
        """
        Whether the beliefs on record are what the deployments on record give.

        A mission may end before the last deployments are in a belief.
        """
        return not self.mismatches and not self.passed_over


def replay(
    path: str | Path,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
) -> ReplayReport:
    """
    Compute a log's beliefs again and compare them with those on record.

    A log does not say which version of its method it was recorded with. It is replayed with the
    last one, and with those before it until one reproduces it.

    Parameters
    ----------
    path : str or Path
        The log of one mission, from its own recorder or from ``ros2 bag record``.
    progress : callable
        Passes the log's messages on; may show how far the reading has come.

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
    fold = Fold(version)
    with same_types(path):
        for logged in progress(read_log(path, (BELIEF, GRID, PATH, REPORT))):
            fold.take(logged)
        fold.finish()
    if not fold.topic:
        raise LogError(f'{path} has no beliefs on record: it must have messages of type {BELIEF}')
    return ReplayReport(
        method=fold.prior.method if fold.prior else '',
        version=fold.ledger.estimator.version if fold.ledger else None,
        evidence=fold.evidence,
        compared=dict(fold.compared),
        mismatches=fold.mismatches,
        passed_over=fold.passed_over,
        not_yet_held=fold.not_yet_held,
        finished=is_finished(path),
    )


@dataclass(frozen=True)
class Recorded:
    """A message and which of its topic's messages it is, from 0."""

    topic: str
    index: int
    message: Any


class Fold:
    """
    What has been read of a log so far and what has been computed from it.

    Topics may be interleaved in any way: a belief waits until the deployments it holds have been
    read, and a view until its belief has been computed.

    Parameters
    ----------
    version : int, optional
        Which of the method's `versions` to compute with; the last unless given.

    """

    def __init__(self, version: int | None = None) -> None:
        self.version = version
        self.evidence = Evidence()
        self.topic = ''
        self.prior: Snapshot | None = None
        self.ledger: Ledger | None = None
        # With whether their robots came back: a late return is more than the loss it replaces.
        self.held: set[tuple[DeploymentKey, bool]] = set()
        self.passed_over: list[DeploymentKey] = []
        self.not_yet_held: list[DeploymentKey] = []
        self.mismatches: list[Mismatch] = []
        self.compared: Counter[str] = Counter()
        self._seen: Counter[str] = Counter()
        self._beliefs: deque[Recorded] = deque()
        self._is_astray = False
        self._views: dict[View, list[Recorded]] = {}
        self._computed_views: dict[View, list[tuple[DeploymentKey | None, Any]]] = {}

    def take(self, logged: LoggedMessage) -> None:
        """
        Read a message and compare what can be compared with it.

        Raises
        ------
        LogError
            If beliefs are on record from two topics.

        """
        recorded = Recorded(logged.topic, self._seen[logged.topic], logged.message)
        self._seen[logged.topic] += 1
        if logged.type_name == PATH:
            self.evidence.take_path(logged.topic, logged.message)
        elif logged.type_name == REPORT:
            self.evidence.take_report(logged.topic, logged.message)
        elif logged.type_name == GRID:
            view = logged.topic, from_stamp(logged.message.header.stamp)
            self._views.setdefault(view, []).append(recorded)
            self.match_views(view)
        else:
            if self.topic not in ('', logged.topic):
                raise LogError(
                    f'beliefs are on record from {self.topic} and {logged.topic}: '
                    'a log to replay holds one mission'
                )
            self.topic = logged.topic
            self._beliefs.append(recorded)
        while self._beliefs and self.can_compute(self._beliefs[0].message):
            self.compare_belief(self._beliefs.popleft())

    def finish(self) -> None:
        """Compare what still waits, and find deployments in no belief."""
        while self._beliefs:
            self.compare_belief(self._beliefs.popleft())
        # What is left has another value, or belongs to a belief that is not on record.
        for view, recorded in self._views.items():
            for each, (newest, shown) in zip(recorded, self._computed_views.get(view, ())):
                self.compared[each.topic] += 1
                different = tuple(differences(each.message, shown))
                self.mismatches.append(Mismatch(each.topic, each.index, newest, different))
        for key in self.evidence.complete:
            report = self.evidence.report(key)
            if (key, report.survived) in self.held:
                self.passed_over += self.not_yet_held
                self.not_yet_held = []
                continue
            try:
                if self.ledger is not None:
                    self.evidence.tell(self.ledger, key, report)
            except ValueError as error:
                self.evidence.refused.append(str(error))
            else:
                self.not_yet_held.append(key)

    def can_compute(self, belief: Any) -> bool:
        """Return whether the deployments that a recorded belief holds have been read."""
        newest = newest_deployment(belief)
        return newest is None or (
            self.evidence.has(newest, from_stamp(belief.header.stamp))
            and len(self.evidence.complete) >= belief.deployments
        )

    def compare_belief(self, recorded: Recorded) -> None:
        """Compute a recorded belief and its views, and compare."""
        self.compared[recorded.topic] += 1
        newest = newest_deployment(recorded.message)
        stamp = from_stamp(recorded.message.header.stamp)
        try:
            ledger = self.ledger = self.ledger_of(recorded.message)
        except ValueError as error:
            mismatch = Mismatch(recorded.topic, recorded.index, newest, reason=str(error))
            self.mismatches.append(mismatch)
            return
        computed = belief_maps(ledger, stamp)
        different = tuple(differences(recorded.message, computed))
        self._is_astray = bool(different)
        if different:
            self.mismatches.append(Mismatch(recorded.topic, recorded.index, newest, different))
        self.held.update((key, ledger.returned(key)) for key in ledger.deployments)
        for name in VIEWS:
            view = f'{recorded.topic}/{name}', stamp
            shown = occupancy_grid(ledger.grid, getattr(ledger.belief, name), stamp)
            self._computed_views.setdefault(view, []).append((newest, shown))
            self.match_views(view)

    def match_views(self, view: View) -> None:
        """Strike out recorded views of a topic and stamp that are as computed."""
        computed = self._computed_views.get(view, [])
        for recorded in self._views.get(view, []).copy():
            for index, (_, shown) in enumerate(computed):
                if not any(differences(recorded.message, shown)):
                    self.compared[recorded.topic] += 1
                    self._views[view].remove(recorded)
                    del computed[index]
                    break

    def ledger_of(self, belief: Any) -> Ledger:
        """
        Return the ledger that gives a recorded belief; if there is none, the likeliest.

        Raises
        ------
        ValueError
            As `candidates`.

        """
        ledgers = self.candidates(belief)
        likeliest = next(ledgers)
        # After a belief that is not reproduced others seldom are, and looking for them takes long.
        if self._is_astray:
            return likeliest
        stamp = from_stamp(belief.header.stamp)
        for ledger in chain([likeliest], ledgers):
            if not any(differences(belief, belief_maps(ledger, stamp))):
                return ledger
        return likeliest

    def candidates(self, belief: Any) -> Iterator[Ledger]:
        """
        Yield ledgers that a recorded belief may be of, the likeliest first.

        It says how many deployments it holds and whose evidence was taken in last. Where the
        beliefs before it are not on record, what else it holds is to be found out: DDS keeps the
        order of each publisher, so it holds the first of what each said.

        Raises
        ------
        ValueError
            If the belief is a prior that cannot be one, or there is no prior, or a deployment is
            not on record or cannot be taken in.

        """
        newest, stamp = newest_deployment(belief), from_stamp(belief.header.stamp)
        if newest is None:
            self.prior = read_belief_maps(belief)
            yield started(self.prior, self.version)
            return
        if self.prior is None or self.ledger is None:
            raise ValueError('the prior it started from is not on record')
        last = newest, self.evidence.report_of(newest, stamp)
        # It may be the same belief again, go on from the one before, or be of an estimator that
        # was restarted and took in everything again.
        count = belief.deployments
        starts = self.ledger, started(self.prior, self.version)
        said = [(start, self.evidence.news(start)) for start in starts]
        # Of an agent whose losses are silent the planner reports these, and itself its returns.
        said += [(start, list(chain(*map(by_outcome, news)))) for start, news in said]
        ways = (self.after(start, last, count, news) for start, news in said)
        for ledger in chain([self.ledger], *ways):
            if (len(ledger.deployments), ledger.newest, ledger.newest_stamp) == (
                count,
                newest,
                stamp,
            ):
                yield ledger
        ledger = self.ledger.copy()
        self.evidence.tell(ledger, *last)
        yield ledger

    def after(
        self, start: Ledger, last: Reported, count: int, news: list[list[Reported]]
    ) -> Iterator[Ledger]:
        """
        Yield ledgers that go on from `start`, hold `count` deployments and took in `last`.

        They take in the first ones of each list of news.
        """
        own = next((said for said in news if last in said), None)
        if own is None:
            return
        before = own[: own.index(last)]
        others = [said for said in news if said is not own]
        held = {*start.deployments, last[0], *keys_of(before)}
        yield self.told(start, last)
        in_time = sorted(chain(*others), key=lambda said: said[1].stamp)
        yield self.told(start, *before, *in_time[: max(0, count - len(held))], last)
        ways = islice(product(*(range(len(said) + 1) for said in others)), WAYS)
        firsts = ([*chain(*map(islice, others, counts))] for counts in ways)
        fitting = (taken for taken in firsts if len(held.union(keys_of(taken))) == count)
        for taken in islice(fitting, TRIALS):
            yield self.told(start, *before, *taken, last)

    def told(self, ledger: Ledger, *news: Reported) -> Ledger:
        """Return a ledger that was told more and took in what an estimator would."""
        ledger = ledger.copy()
        for key, report in news:
            with suppress(ValueError):
                self.evidence.tell(ledger, key, report)
        return ledger


def keys_of(said: Iterable[Reported]) -> Iterator[DeploymentKey]:
    """Yield whose reports these are."""
    return (key for key, _ in said)


def by_outcome(said: list[Reported]) -> list[list[Reported]]:
    """Return apart what was said of robots that were lost and of those that came back."""
    return [[each for each in said if each[1].survived == outcome] for outcome in (False, True)]


def started(prior: Snapshot, version: int | None) -> Ledger:
    """
    Return the ledger of an estimator with this prior and this version of its method.

    Raises
    ------
    ValueError
        If the method or the version is unknown.

    """
    estimator = Estimator(prior.belief, prior.model, prior.method, version=version)
    return Ledger(prior.grid, prior.max_steps, estimator)
