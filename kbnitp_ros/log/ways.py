# SPDX-License-Identifier: Apache-2.0
"""
What an estimator may have taken in between two beliefs on record.

A belief says how many deployments it holds and which it took in last. If one belief after another
is on record, nothing else is needed. Where some are missing, or the estimator was restarted and
took in everything again, DDS keeps the order of each publisher: a belief holds the first of what
each of them said. How many of whose that are is bounded by the beliefs that come later.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from typing import NamedTuple

from kbnitp_ros.core import DeploymentKey, Ending
from kbnitp_ros.log.evidence import Evidence, Reported
from kbnitp_ros.log.trial import TrialLedger


class Head(NamedTuple):
    """
    What a belief says of the deployments it holds.

    Attributes
    ----------
    held : int
        How many.
    newest : DeploymentKey or None
        Which it took in last; None for a prior.
    stamp : int
        When the base learnt of that, in nanoseconds.

    """

    held: int
    newest: DeploymentKey | None
    stamp: int


class Span(NamedTuple):
    """
    How many of what a publisher said an estimator may have taken in.

    Attributes
    ----------
    said : sequence of (DeploymentKey, Report)
        All of it.
    known : int
        How many of these are held already.
    least, most : int
        Between which numbers it is.

    """

    said: Sequence[Reported]
    known: int
    least: int
    most: int


class Publishers:
    """
    What was said by each publisher, and when it is heard of in the beliefs on record.

    Parameters
    ----------
    evidence : Evidence
        All of the log.
    heads : sequence of Head
        Of all beliefs on record, in their order.
    publisher_of : callable
        Says who said what.

    """

    def __init__(
        self,
        evidence: Evidence,
        heads: Sequence[Head],
        publisher_of: Callable[[Reported], Hashable],
    ) -> None:
        self.publisher_of = publisher_of
        self.said: dict[Hashable, list[Reported]] = defaultdict(list)
        self._index: dict[tuple[DeploymentKey, Ending], int] = {}
        for reported in evidence.said:
            said = self.said[publisher_of(reported)]
            self._index[reported[0], reported[1].ending] = len(said)
            said.append(reported)
        # Of each publisher, the beliefs that took in something of it last, and what.
        self._seen_in: dict[Hashable, list[int]] = defaultdict(list)
        self._seen: dict[Hashable, list[int]] = defaultdict(list)
        # Which life of the estimator a belief is of, and how many beliefs are missing before it.
        self._life: list[int] = []
        self._missing: list[int] = []
        before = Head(0, None, 0)
        life = missing = 0
        for number, head in enumerate(heads):
            if head.held < before.held or head.newest is None:
                life += 1
            else:
                missing += max(0, head.held - before.held - 1)
            before = head
            self._life.append(life)
            self._missing.append(missing)
            if head.newest is None:
                continue
            with suppress(ValueError):
                last = head.newest, evidence.report_of(head.newest, head.stamp)
                index = self.index_of(last)
                if index is not None:
                    self._seen_in[publisher_of(last)].append(number)
                    self._seen[publisher_of(last)].append(index)

    def index_of(self, reported: Reported) -> int | None:
        """Return which of what its publisher said it is; None if it is not among that."""
        key, report = reported
        return self._index.get((key, report.ending))

    def span(self, publisher: Hashable, known: int, number: int) -> Span:
        """Return how many of a publisher's reports a belief may hold besides those known."""
        said = self.said[publisher]
        least, most = known, len(said)
        seen_in = self._seen_in[publisher]
        later = bisect_right(seen_in, number)
        if later < len(seen_in) and self._life[seen_in[later]] == self._life[number]:
            index = self._seen[publisher][later]
            most = max(known, index)
            least = max(known, index - (self._missing[seen_in[later]] - self._missing[number]))
        return Span(said, known, least, most)


class Ways:
    """
    Finds what may have been taken in.

    Parameters
    ----------
    evidence : Evidence
        All of the log.
    heads : sequence of Head
        Of all beliefs on record, in their order.

    Attributes
    ----------
    steps : int
        How many reports were looked at so far: what the finding costs.
    limit : int
        At how many steps it ends.

    """

    def __init__(self, evidence: Evidence, heads: Sequence[Head]) -> None:
        self.steps = 0
        self.limit = 0
        self._orders = {
            'record': evidence.said,
            'time': sorted(evidence.said, key=lambda reported: reported[1].stamp),
        }
        # Of an agent whose losses are silent the planner reports these, and itself its returns.
        self._agents = Publishers(evidence, heads, lambda said: said[0].agent)
        self._silent = Publishers(evidence, heads, lambda said: (said[0].agent, said[1].survived))

    def certain(
        self, ledger: TrialLedger, head: Head, last: Reported, number: int
    ) -> list[Reported] | None:
        """
        Return what else was taken in since what a ledger holds, if it can be nothing else.

        It is looked for in a time that does not grow with the gap.

        Parameters
        ----------
        ledger : TrialLedger
            Holds what was taken in before.
        head : Head
            What the belief says.
        last : tuple of DeploymentKey and Report
            What it took in last.
        number : int
            Which of the beliefs on record it is, from 0.

        Returns
        -------
        list of (DeploymentKey, Report) or None
            Without the last one; None if it is not certain.

        """
        held = len(ledger.deployments)
        if head.held == held + (not ledger.knows(last[0])):
            return []
        if head.held < held:
            return None
        spans = self._spans(self._agents, ledger, last, number)
        need = head.held - held - 1
        for counts in ([span.least for span in spans], [span.most for span in spans]):
            if sum(counts) - sum(span.known for span in spans) == need:
                parts = (span.said[slice(span.known, n)] for span, n in zip(spans, counts))
                return [*chain(*parts)]
        return None

    def possible(
        self, ledger: TrialLedger, head: Head, last: Reported, number: int
    ) -> Iterator[list[Reported]]:
        """Yield what else may have been taken in, the likeliest first; arguments as `certain`."""
        for publishers in (self._agents, self._silent):
            before, *spans = self._spans(publishers, ledger, last, number)
            own = before.said[slice(before.known, before.least)]
            self.steps += len(own)
            taken = {last[0], *keys_of(own)}
            new = sum(not ledger.knows(key) for key in taken)
            need = head.held - len(ledger.deployments) - new
            if need < 0:
                continue
            for name in self._orders:
                yield [*own, *self._earliest(name, ledger, taken.copy(), need)]
            anyhow = [Span(each.said, each.known, each.known, len(each.said)) for each in spans]
            for bounds in (spans, anyhow):
                for more in self._fill(bounds, need, taken, ledger):
                    yield [*own, *more]

    def _spans(
        self, publishers: Publishers, ledger: TrialLedger, last: Reported, number: int
    ) -> list[Span]:
        """Return how much of each publisher is held, first of the one that the last one is of."""
        own = publishers.publisher_of(last)
        said = publishers.said[own]
        known = self._known(own, said, ledger)
        end = max(known, publishers.index_of(last) or 0)
        return [
            Span(said, known, end, end),
            *(
                publishers.span(publisher, self._known(publisher, said, ledger), number)
                for publisher, said in publishers.said.items()
                if publisher != own
            ),
        ]

    def _known(self, name: Hashable, said: Sequence[Reported], ledger: TrialLedger) -> int:
        """Return how many reports of a list are held, from the first on."""
        known = ledger.known.get(name, 0)
        while known < len(said) and ledger.holds(*said[known]):
            self.steps += 1
            known += 1
        ledger.known[name] = known
        return known

    def _earliest(
        self, name: str, ledger: TrialLedger, taken: set[DeploymentKey], need: int
    ) -> Iterator[Reported]:
        """Yield what was said first, in one order, of so many deployments more."""
        said = self._orders[name]
        for index in range(self._known(name, said, ledger), len(said)):
            self.steps += 1
            key, report = said[index]
            if need == 0:
                return
            if key not in taken and not ledger.knows(key):
                need -= 1
                taken.add(key)
                yield key, report

    def _fill(
        self, spans: Sequence[Span], need: int, taken: set[DeploymentKey], ledger: TrialLedger
    ) -> Iterator[list[Reported]]:
        """Yield what may have been taken in of each span, of so many deployments in all."""
        if not spans:
            if need == 0:
                yield []
            return
        span, *rest = spans
        room = sum(each.most - each.known for each in rest)
        new: list[DeploymentKey] = []
        for count in range(span.known, span.most + 1):
            self.steps += 1
            if self.steps > self.limit:
                break
            if count >= span.least and need - len(new) <= room:
                for more in self._fill(rest, need - len(new), taken, ledger):
                    yield [*span.said[slice(span.known, count)], *more]
            if count < span.most:
                key, _ = span.said[count]
                if key not in taken and not ledger.knows(key):
                    if len(new) == need:
                        break
                    taken.add(key)
                    new.append(key)
        taken.difference_update(new)


def keys_of(said: Iterable[Reported]) -> Iterator[DeploymentKey]:
    """Yield whose reports these are."""
    return (key for key, _ in said)
