# SPDX-License-Identifier: Apache-2.0
"""Findings of a replay: recorded views and models compared with computed views and models."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from hashlib import blake2b
from math import nan
from operator import attrgetter
from typing import Any

from kbnitp_ros.core import Decision, DeploymentKey, Grid, Ledger
from kbnitp_ros.core.inference.model_check import ModelCheck
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import LoggedMessage
from kbnitp_ros.log.record import RecordedMission
from kbnitp_ros.log.roles import Role
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.deployments import Acknowledged, STATUS_KINDS
from kbnitp_ros.messages.grids import occupancy_fields
from kbnitp_ros.messages.headers import content_hash, Fields, from_stamp, NO_MISSION, shown
from kbnitp_ros.messages.progress import (
    check_fields,
    Checked,
    checked_belief,
    MissionState,
    MissionStatus,
    model_fields,
    NOT_CHECKED,
    NOT_KNOWN,
)
from kbnitp_ros.messages.topics import REMARKS, VIEWS
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Array fields that are maps, and their number of values for each cell.
VALUES_PER_CELL = {'hazard': 1, 'target': 1, 'kappa': 1, 'joint': 4, 'dud_joint': 2, 'data': 1}


@dataclass(frozen=True)
class Difference:
    """The difference between a recorded field and the computed field."""

    # Name, such as 'info.width'.
    field: str
    # The difference in words.
    text: str
    # Largest absolute difference of the field's numbers; NaN without numbers.
    largest: float = nan
    # Whether the rounding of different processors can explain the difference.
    is_rounding: bool = False
    # Cell with the largest difference; None if the field is no map.
    cell: int | None = None

    def __str__(self) -> str:
        return f'{self.field} {self.text}'


def differences(
    theirs: Any, ours: Any, tolerance: float, rounded: Collection[str] = (), name: str = ''
) -> Iterator[Difference]:
    """Yield the fields in which a recorded message differs from the computed message."""
    if isinstance(ours, Fields):
        for field_name, value in vars(ours).items():
            # The map kappa has the name of the learnt number kappa, which is a scalar.
            if field_name in rounded and np.ndim(value) == 0:
                value = np.array([value])
            full_name = f'{name}.{field_name}' if name else field_name
            yield from differences(getattr(theirs, field_name), value, tolerance, name=full_name)
    elif isinstance(ours, np.ndarray):
        yield from _array_differences(name, theirs, ours, tolerance)
    elif isinstance(ours, list) and len(theirs) != len(ours):
        yield Difference(name, f'has {len(theirs)} values, the computed field has {len(ours)}')
    elif isinstance(ours, list):
        for index, (their, our) in enumerate(zip(theirs, ours)):
            yield from differences(their, our, tolerance, name=f'{name}[{index}]')
    # NaN differs from itself.
    elif theirs != ours and (theirs == theirs or ours == ours):
        yield Difference(name, f'is {describe_value(theirs)}, computed is {describe_value(ours)}')


def describe_value(value: object) -> str:
    """Return a value in words, cut if it is a long text."""
    return shown(value) if isinstance(value, str) else repr(value)


def _array_differences(
    name: str, theirs: ArrayLike, ours: NDArray[Any], tolerance: float
) -> Iterator[Difference]:
    """Yield the largest difference of two arrays, if there is any."""
    recorded = np.atleast_1d(np.asarray(theirs, dtype=ours.dtype))
    if recorded.size != ours.size:
        yield Difference(name, f'has {recorded.size} values, the computed field has {ours.size}')
        return
    differ = recorded.view(np.uint8) != ours.view(np.uint8)
    differ = differ.reshape(ours.size, ours.itemsize).any(axis=1)
    if not differ.any():
        return
    # A corrupt log may hold infinities.
    with np.errstate(invalid='ignore', over='ignore'):
        gap = np.abs(np.subtract(recorded, ours, dtype=np.float64))
        is_rounded = gap <= tolerance * np.maximum(1.0, np.abs(ours))
    # A NaN difference counts as the largest.
    worst = int(np.argmax(np.where(differ, np.where(np.isnan(gap), np.inf, gap), -1.0)))
    cell = worst // VALUES_PER_CELL[name] if name in VALUES_PER_CELL else None
    place = f'value {worst}' if cell is None else f'cell {cell}'
    yield Difference(
        name,
        f'differs in {differ.sum()} values, by up to {gap[worst]:.3g} in {place} '
        f'({recorded[worst]}, computed is {ours[worst]})',
        float(gap[worst]),
        tolerance > 0.0 and bool(is_rounded[differ].all()),
        cell,
    )


# Tolerance for rounding by other processors and versions of numpy; relative for numbers above 1.
TOLERANCE = 1e-9


# Reasons why a message differs or is not compared.
NO_BELIEF = 'no standings on record have its evidence'
NOT_COMPUTED = 'its belief is not on record, or differs from the computed belief'
NOT_ON_RECORD = 'the message that it acknowledges is not on record'

# Kinds of messages that a recorder acknowledges, by role.
ACKNOWLEDGED = {
    'path': Acknowledged.PATH,
    # By its state, as in `STATUS_KINDS`.
    'status': Acknowledged.DEPARTURE,
    'report': Acknowledged.REPORT,
    'operator': Acknowledged.ACTION,
    **dict.fromkeys(REMARKS, Acknowledged.REMARK),
}


class Grade(IntEnum):
    """The result of comparing a log's beliefs with computed beliefs."""

    IDENTICAL = 0
    EQUAL = 1
    DIFFERENT = 2


@dataclass(frozen=True)
class BeliefFinding:
    """A finding on a recorded belief, view or decision."""

    # Topic of the message.
    topic: str
    # Index of the message in its topic.
    index: int
    # Its belief in words, as by `belief_name`; empty if the belief is not known.
    belief: str = ''
    # Differences from the computed message.
    differences: tuple[Difference, ...] = ()
    # The finding in words if there are no differences; else empty.
    reason: str = ''

    def __str__(self) -> str:
        held = f' ({self.belief})' if self.belief else ''
        why = self.reason or '; '.join(map(str, self.differences))
        return f'{self.topic} message {self.index}{held}: {why}'


def belief_name(newest: DeploymentKey | None) -> str:
    """Return a name for a belief, by the deployment that it assimilated last."""
    return 'the prior' if newest is None else f'after {newest}'


@dataclass
class ReplayReport:
    """The result of a replay."""

    # The recorded deployments.
    evidence: RecordedMission
    # The last recorded state of the mission.
    standing: MissionStatus = NOT_KNOWN
    # The state by the evidence; None without the parameters of the planner.
    computed: MissionState | None = None
    # Changes of parameters, in words.
    changes: list[str] = field(default_factory=list)
    # Final probability of each kind of hazard, and the check of the model.
    kinds: Mapping[str, float] = field(default_factory=dict)
    check: ModelCheck | None = None
    # Number of messages compared, by topic: beliefs, views and decisions.
    compared: Counter[str] = field(default_factory=Counter)
    # Evidence of the beliefs on record.
    beliefs: RecordedBeliefs = field(default_factory=lambda: RecordedBeliefs())
    # The decision on the last belief; None without a goal on record.
    decision: Decision | None = None
    # Messages that differ, and messages equal within `TOLERANCE` but not to the bit.
    mismatches: list[BeliefFinding] = field(default_factory=list)
    roundings: list[BeliefFinding] = field(default_factory=list)
    # Beliefs and decisions that the log cannot reproduce, and beliefs recorded twice.
    not_compared: list[BeliefFinding] = field(default_factory=list)
    repeated: list[BeliefFinding] = field(default_factory=list)
    # Deployments with a report that was not judged, although a later report was.
    passed_over: list[DeploymentKey] = field(default_factory=list)
    # Deployments that count, and that are in no belief on record.
    not_yet_held: list[DeploymentKey] = field(default_factory=list)
    # Whether the log was finished by its writer.
    finished: bool = False
    # The first corrupt place of each file, where reading ends.
    corrupt: list[LogError] = field(default_factory=list)

    def add(self, finding: BeliefFinding) -> None:
        """Add a message that is not identical."""
        is_equal = all(each.is_rounding for each in finding.differences)
        (self.roundings if is_equal else self.mismatches).append(finding)

    @property
    def method(self) -> str:
        """Return the inference method; empty without a recorded prior."""
        return '' if self.evidence.prior is None else self.evidence.prior.method

    @property
    def grade(self) -> Grade:
        """Return the grade of the compared beliefs."""
        if self.mismatches or self.passed_over:
            return Grade.DIFFERENT
        return Grade.EQUAL if self.roundings else Grade.IDENTICAL

    @property
    def reproduced(self) -> bool:
        """Return whether all compared messages are reproduced to the bit."""
        return self.grade == Grade.IDENTICAL


class RecordedBeliefs:
    """The evidence of the beliefs on record, and that of the missing ones."""

    def __init__(self) -> None:
        # Stamps of the beliefs on record by the evidence that they name: epoch and changes.
        self.stamps: dict[tuple[int, int], int] = {}
        # The first and the last changes of each epoch that standings on record name.
        self._changes: dict[int, tuple[int, int]] = {}

    def note(self, said: Snapshot) -> None:
        """Note a belief on record."""
        self.stamps[said.evidence] = said.stamp

    def note_standings(self, epoch: int, changes: int) -> None:
        """Note the evidence of standings on record."""
        first, last = self._changes.get(epoch, (changes, changes))
        self._changes[epoch] = first, max(changes, last)

    @property
    def missing(self) -> list[tuple[int, int]]:
        """Return the evidence whose beliefs may have been published, and are not on record."""
        return [
            (epoch, changes)
            for epoch, (first, last) in self._changes.items()
            # A resumed estimator publishes its prior, and then all that it resumes at once.
            for changes in range(first if (epoch, 0) in self.stamps else 0, last + 1)
            if (epoch, changes) not in self.stamps
        ]


class ReplayedViews:
    """The recorded views, and the views of the computed beliefs."""

    def __init__(self, report: ReplayReport) -> None:
        self._report = report
        # Stamp, index and content of recorded views, by role and topic.
        self._recorded = defaultdict[tuple[str, str], list[tuple[int, int, Any]]](list)
        # Computed views by role and stamp, which beliefs may share: the deployment assimilated
        # last, and the fields of a model or the digest of a grid.
        self._expected = defaultdict[tuple[str, int], list[tuple[DeploymentKey | None, Any]]](list)
        # Stamps of recorded beliefs that were not computed, so that their models are not known.
        self.unknown: set[int] = set()
        # Beliefs whose check was recorded, by deployments and stamp, and the computed checks: a
        # late report may give a belief with the same number and stamp.
        self.checked: dict[tuple[int, int], list[ModelCheck]] = {}

    def note(self, role: Role, logged: LoggedMessage) -> None:
        """Keep a view until all beliefs are computed; of a grid, only its digest."""
        message = logged.message
        if role.name == 'model':
            self.checked.setdefault(checked_belief(message), [])
        kept = message if role.name == 'model' else grid_digest(message)
        stamp = from_stamp(message.header.stamp)
        self._recorded[role.name, logged.topic].append((stamp, logged.index, kept))

    def expect(self, grid: Grid, maps: Any, said: Snapshot) -> None:
        """Keep the grids that are expected of a belief with these maps."""
        for name in VIEWS:
            view = occupancy_fields(grid, getattr(maps, name), said.stamp)
            self._expected[f'belief/{name}', said.stamp].append((said.newest, grid_digest(view)))

    def expect_model(self, ledger: Ledger, said: Snapshot) -> None:
        """Keep the model and the check that are expected of a ledger's belief."""
        key = len(ledger.deployments), said.stamp
        if key in self.checked:
            self.checked[key].append(ledger.estimator.model_check)
        if self.checked:
            expected = said.newest, model_fields(ledger, said.stamp)
            self._expected['model', said.stamp].append(expected)

    def compare(self) -> None:
        """Compare each recorded view with the computed views of its stamp."""
        report, missing = self._report, len(self._report.beliefs.missing)
        if (before := checked_belief(check_fields(NOT_CHECKED))) in self.checked:
            self.checked[before] = [NOT_CHECKED.check]
        for (role, topic), views in self._recorded.items():
            lacking = [self._lacking(role, stamp, view) for stamp, _, view in views]
            # Any missing belief may have an unknown stamp.
            is_missing = len({*lacking} - {None} - self.unknown) <= missing
            for (stamp, index, view), lacks in zip(views, lacking):
                if lacks is not None and (is_missing or lacks in self.unknown):
                    finding = BeliefFinding(topic, index, reason=NOT_COMPUTED)
                    report.not_compared.append(finding)
                    continue
                report.compared[topic] += 1
                if lacks is not None:
                    finding = BeliefFinding(topic, index, reason=NO_BELIEF)
                    report.mismatches.append(finding)
                    continue
                found, belief = min(
                    (
                        (self._differs(view, computed), belief_name(newest))
                        for newest, computed in self._expected[role, stamp]
                    ),
                    key=lambda each: len(each[0]),
                )
                if found:
                    report.add(BeliefFinding(topic, index, belief, found))

    def _lacking(self, role: str, stamp: int, view: Any) -> int | None:
        """Return the stamp of a view's belief, or of the checked one, if it was not computed."""
        if (role, stamp) not in self._expected:
            return stamp
        if role == 'model' and not self.checked[key := checked_belief(view)]:
            return key[1]
        return None

    def _differs(self, view: Any, computed: Any) -> tuple[Difference, ...]:
        """Return the differences of a recorded view from the computed one; of grids, digests."""
        if isinstance(view, bytes):
            return () if view == computed else (Difference('data', 'does not match the belief'),)
        found = tuple(differences(view, computed, TOLERANCE))
        key = checked_belief(view)
        return found + min(
            (check_differences(view, Checked(check, *key)) for check in self.checked[key]), key=len
        )


def check_differences(view: Any, checked: Checked) -> tuple[Difference, ...]:
    """Return the differences of a recorded check of the model from a computed one."""
    fields = check_fields(checked)
    reason = Fields(reason=fields.reason)
    del fields.reason
    # The reason has numbers of the check, which processors may round differently.
    return tuple(differences(view, fields, TOLERANCE)) or tuple(
        differences(view, reason, TOLERANCE)
    )


class ReplayedAcknowledgements:
    """The acknowledgements of a recorder, and the messages on record that they name."""

    def __init__(self, report: ReplayReport) -> None:
        self._report = report
        # Kind, agent, stamp, mission and hash of each message on record.
        self._on_record: set[tuple[int, str, int, int, int]] = set()
        self._said: list[LoggedMessage] = []

    def take(self, role: Role, logged: LoggedMessage) -> None:
        """Keep an acknowledgement, or note a message that may be acknowledged."""
        if role.name not in ACKNOWLEDGED:
            self._said.append(logged)
            return
        kind, mission, stamp = ACKNOWLEDGED[role.name], NO_MISSION, logged.said
        if role.name in REMARKS:
            stamp = stamp.stamp
        elif role.name != 'operator':
            (_, stamp), said = logged.said
            if role.name == 'path':
                mission = said
            elif role.name == 'status':
                kind = STATUS_KINDS[said.state]
        content = content_hash(logged.message)
        self._on_record.add((kind, role.agent, stamp, mission, content))

    def compare(self) -> None:
        """Report each acknowledgement of a message that is not on record."""
        for logged in self._said:
            said = logged.message
            stamp, mission = from_stamp(said.stamp), from_stamp(said.mission)
            self._report.compared[logged.topic] += 1
            if (said.kind, said.agent, stamp, mission, said.content) not in self._on_record:
                finding = BeliefFinding(logged.topic, logged.index, reason=NOT_ON_RECORD)
                self._report.mismatches.append(finding)


def field_names(fields: Fields) -> Iterator[str]:
    """Yield the names of all fields that are no messages, such as 'info.width'."""
    for name, value in vars(fields).items():
        if isinstance(value, Fields):
            yield from (f'{name}.{each}' for each in field_names(value))
        else:
            yield name


# All fields of a nav_msgs/OccupancyGrid but its data.
PLACE = {*field_names(occupancy_fields(Grid(1, 1), [0.0], 0))} - {'data'}
read_place = attrgetter(*sorted(PLACE))


def grid_digest(view: Any) -> bytes:
    """Return a digest of a nav_msgs/OccupancyGrid or its fields."""
    content = repr(read_place(view)).encode() + np.asarray(view.data, np.int8).tobytes()
    return blake2b(content, digest_size=16).digest()
