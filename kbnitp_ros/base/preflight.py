# SPDX-License-Identifier: Apache-2.0
"""The checks before the first departure, over what the robots and the base say."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from math import isnan, nan
from typing import NamedTuple

from kbnitp_ros.base.readiness import percent
from kbnitp_ros.messages.health import Health
from kbnitp_ros.messages.states import AgentState, Readiness

# Largest difference of two clocks and age of a pose, seconds; standard deviation of a pose, cells.
MAX_OFFSET, MAX_POSE_AGE, MAX_DEVIATION = 1.0, 2.0, 0.25

# Checks that an operator may skip; the others are mandatory.
OPTIONAL = ('clock', 'pose', 'action server', 'battery', 'disk', 'parameters')

# Least free space on the disk of the log, bytes.
MIN_FREE = 10**9


class Light(IntEnum):
    """The result of a check."""

    GREEN = 0
    RED = 1
    # Not judged, or not known where it need not be.
    INFO = 2
    # Red, and skipped by the operator.
    SKIP = 3


class Check(NamedTuple):
    """A check, its result, and the finding with the remedy."""

    name: str
    light: Light
    text: str


class Heard(NamedTuple):
    """The last messages of an agent; None for missing ones."""

    state: AgentState | None = None
    health: Health | None = None
    # Time by the robot's clock after the base's, when its health arrived, seconds.
    offset: float = 0.0
    # Time of a service call to its node and back, seconds.
    round_trip: float = nan


def judged(name: str, is_green: bool, found: str, remedy: str) -> Check:
    """Return a check that is green or red; the remedy is stated where it is red."""
    text = found if is_green else f'{found}: {remedy}'
    return Check(name, Light.GREEN if is_green else Light.RED, text)


def robot_checks(
    agent: str, heard: Heard, base: AgentState, version: str, min_battery: float
) -> Iterator[Check]:
    """Yield the checks of the robot of an agent, against the state and version of the base."""
    state, health, offset, round_trip = heard
    if state is None:
        remedy = 'start its node; compare ROS_DOMAIN_ID and namespaces, and try the radio'
        yield judged('heard', False, f'nothing on {agent}/state', remedy)
        return
    yield judged('heard', True, f'{agent}/state', '')
    found = 'not known' if health is None else health.version
    remedy = f'install {version}, as at the base, and publish {agent}/health'
    yield judged('version', found == version, found, remedy)
    is_alike = state.field_id == base.field_id
    remedy = f'that of the base is {base.field_id}; {state.reason}'
    yield judged('field', is_alike, state.field_id, remedy)
    remedy = state.reason or 'bring it to its base'
    where = 'at its base' if state.is_at_base else 'not at its base'
    yield judged('at its base', state.is_at_base, where, remedy)
    trip = 'not known' if isnan(round_trip) else f'{1000.0 * round_trip:.0f} ms'
    yield Check('round trip', Light.INFO, f'{trip} for a service call')
    if health is None:
        return
    has_journal = health.journal and state.readiness is not Readiness.NO_JOURNAL
    remedy = state.reason or 'make room on its disk'
    words = 'written' if has_journal else 'not written'
    yield judged('journal', has_journal, words, remedy)
    remedy = 'set the clocks of both computers alike, such as by chrony'
    is_alike = abs(offset) <= MAX_OFFSET
    yield judged('clock', is_alike, f'{offset:+.1f} s against the base', remedy)
    yield pose_check(state, health, base.field.resolution)
    words = 'takes goals' if health.server else 'takes no goals'
    yield judged('action server', health.server, words, state.reason or 'start Nav2')
    if isnan(health.battery) and not min_battery:
        yield Check('battery', Light.INFO, 'not known')
        return
    charge = 'not known' if isnan(health.battery) else percent(health.battery)
    remedy = f'{percent(min_battery)} needed (parameters min_battery and battery_topic)'
    yield judged('battery', health.battery >= min_battery, charge, remedy)


def pose_check(state: AgentState, health: Health, cell: float) -> Check:
    """Return the check that a robot's pose is fresh, and precise against the side of a cell."""
    # A simulated robot has neither a journal nor a pose.
    if isnan(health.pose_age) and not state.journal:
        return Check('pose', Light.INFO, 'not known')
    if isnan(health.pose_age):
        return judged('pose', False, 'not known', state.reason or 'start its localization')
    if health.pose_age > MAX_POSE_AGE:
        remedy = f'at most {MAX_POSE_AGE} s; is its localization slow?'
        return judged('pose', False, f'{health.pose_age:.1f} s old', remedy)
    most = MAX_DEVIATION * cell
    words = f'{health.pose_age:.1f} s old'
    if not isnan(health.deviation):
        words += f', deviation {health.deviation:.2f} m'
    remedy = f'at most {most:.2f} m, a quarter of a cell; localize it better'
    return judged('pose', not health.deviation > most, words, remedy)


def disk_check(log: str, free: int | None) -> Check:
    """Return the check of the disk of a log, given its free bytes; None if it is elsewhere."""
    if free is None:
        return Check('disk', Light.INFO, f'{log} is on another computer')
    found = f'{free / 1e9:.1f} GB are free for {log}'
    return judged('disk', free >= MIN_FREE, found, f'at least {MIN_FREE / 1e9:.0f} GB')
