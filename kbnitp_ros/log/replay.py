# SPDX-License-Identifier: Apache-2.0
"""
Compute a log's beliefs again from its paths and reports.

A belief on record says how many deployments it holds and which of them came last. This gives the
order in which the estimator took them in, whatever the order in which a recorder heard of them.
What the estimator should have published is then compared with what is on record, field by field
and bit for bit.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kbnitp_ros.core import DeploymentKey, Estimator, Ledger
from kbnitp_ros.log.compare import Difference, differences
from kbnitp_ros.log.evidence import Evidence
from kbnitp_ros.log.reader import is_finished, LogError, LoggedMessage, read_log
from kbnitp_ros.messages.beliefs import belief_maps, newest_deployment, read_belief_maps, Snapshot
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import from_stamp

BELIEF = 'kbnitp_msgs/msg/BeliefMaps'
GRID = 'nav_msgs/msg/OccupancyGrid'
PATH = 'nav_msgs/msg/Path'
REPORT = 'kbnitp_msgs/msg/DeploymentReport'

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
    fold = Fold()
    try:
        for logged in progress(read_log(path, (BELIEF, GRID, PATH, REPORT))):
            fold.take(logged)
        fold.finish()
    except AttributeError as error:
        raise LogError(f'{path} has messages of another version of their type: {error}') from error
    if not fold.topic:
        raise LogError(f'{path} has no beliefs on record: it must have messages of type {BELIEF}')
    return ReplayReport(
        method=fold.prior.method if fold.prior else '',
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
    """

    def __init__(self) -> None:
        self.evidence = Evidence()
        self.topic = ''
        self.prior: Snapshot | None = None
        self.ledger: Ledger | None = None
        self.held: set[DeploymentKey] = set()
        self.passed_over: list[DeploymentKey] = []
        self.not_yet_held: list[DeploymentKey] = []
        self.mismatches: list[Mismatch] = []
        self.compared: Counter[str] = Counter()
        self._seen: Counter[str] = Counter()
        self._beliefs: deque[Recorded] = deque()
        self._views: dict[tuple[str, int], Recorded] = {}
        self._computed_views: dict[tuple[str, int], tuple[DeploymentKey | None, Any]] = {}

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
            self._views[view] = recorded
            self.compare_view(view)
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
        """Compare the beliefs whose deployments never came, and find deployments in no belief."""
        while self._beliefs:
            self.compare_belief(self._beliefs.popleft())
        for key in self.evidence.complete:
            if key in self.held:
                self.passed_over += self.not_yet_held
                self.not_yet_held = []
            elif self.ledger is not None and (refusal := self.evidence.tell(self.ledger, key)):
                self.evidence.refused.append(refusal)
            else:
                self.not_yet_held.append(key)

    def can_compute(self, belief: Any) -> bool:
        """Return whether the deployments that a recorded belief holds have been read."""
        newest = newest_deployment(belief)
        complete = self.evidence.complete
        return newest is None or (newest in complete and len(complete) >= belief.deployments)

    def compare_belief(self, recorded: Recorded) -> None:
        """Compute a recorded belief and its views, and compare."""
        newest = newest_deployment(recorded.message)
        stamp = from_stamp(recorded.message.header.stamp)
        try:
            ledger = self.advance(recorded.message)
            computed = belief_maps(ledger, stamp)
        except ValueError as error:
            self.compared[recorded.topic] += 1
            mismatch = Mismatch(recorded.topic, recorded.index, newest, reason=str(error))
            self.mismatches.append(mismatch)
            return
        self.compare(recorded, newest, computed)
        for name in VIEWS:
            view = f'{recorded.topic}/{name}', stamp
            shown = occupancy_grid(ledger.grid, getattr(ledger.belief, name), stamp)
            self._computed_views[view] = newest, shown
            self.compare_view(view)

    def compare_view(self, view: tuple[str, int]) -> None:
        """Compare a view, named by topic and stamp, once it is both recorded and computed."""
        if view in self._views and view in self._computed_views:
            self.compare(self._views.pop(view), *self._computed_views[view])

    def compare(self, recorded: Recorded, newest: DeploymentKey | None, computed: Any) -> None:
        """Compare a recorded message with the computed one."""
        self.compared[recorded.topic] += 1
        different = tuple(differences(recorded.message, computed))
        if different:
            mismatch = Mismatch(recorded.topic, recorded.index, newest, different)
            self.mismatches.append(mismatch)

    def advance(self, belief: Any) -> Ledger:
        """
        Return the ledger with the deployments that a recorded belief holds.

        Raises
        ------
        ValueError
            If the belief is a prior that cannot be one, or there is no prior, or a deployment is
            not on record or cannot be taken in.

        """
        newest = newest_deployment(belief)
        if newest is None:
            self.prior = read_belief_maps(belief)
            self.ledger = started(self.prior)
            return self.ledger
        if self.prior is None or self.ledger is None:
            raise ValueError('the prior it started from is not on record')
        ledger = self.ledger
        if len(ledger.held) == belief.deployments and ledger.held[-1] == newest:
            return ledger
        if len(ledger.held) >= belief.deployments:
            # The estimator was restarted and took in everything again.
            ledger = self.ledger = started(self.prior)
        # Of beliefs that are not on record only the number is known: the order is the evidence's.
        others = (
            key for key in self.evidence.complete if key != newest and key not in ledger.held
        )
        while len(ledger.held) < belief.deployments - 1 and (key := next(others, None)):
            if not self.evidence.tell(ledger, key):
                self.held.add(key)
        if refusal := self.evidence.tell(ledger, newest):
            raise ValueError(refusal)
        self.held.add(newest)
        return ledger


def started(prior: Snapshot) -> Ledger:
    """
    Return the ledger of an estimator with this prior.

    Raises
    ------
    ValueError
        If the method is unknown.

    """
    estimator = Estimator(prior.belief, prior.model, prior.method)
    return Ledger(prior.grid, prior.max_steps, estimator)
