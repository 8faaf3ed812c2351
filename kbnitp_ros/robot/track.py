# SPDX-License-Identifier: Apache-2.0
"""The poses of a robot on a deployment, and the steps that it vouches for."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import NamedTuple

from kbnitp_ros.core import Grid
from kbnitp_ros.messages.headers import SECOND
from kbnitp_ros.robot.journal import NOT_LOOKED, Step
from kbnitp_ros.robot.whereabouts import Place
import numpy as np
from numpy.typing import NDArray

# docs/robots.md explains the rule. Lengths are in sides of a cell, times in seconds.


class Limits(NamedTuple):
    """The limits of a source of positions."""

    # Depth by which a track must enter a cell, and be in it for a reading.
    depth: float
    read_depth: float
    # Distance up to which a frame follows the localization.
    error: float
    # Time and distance up to which poses are joined by a line.
    gap: float
    stretch: float


BY_ODOMETRY = Limits(depth=0.15, read_depth=0.15, error=0.25, gap=1.5, stretch=1.5)
BY_POSES = Limits(depth=0.2, read_depth=0.3, error=0.1, gap=1.1, stretch=0.3)

# Largest move of a frame at a correction, per length driven, and the length that counts.
MAX_PULL, MAX_DRIVEN = 0.05, 1.0

# With odometry: nothing is vouched for if more corrections than a number and a share are large.
LARGE, MAX_LARGE, MAX_LARGE_SHARE = 0.3, 3, 1 / 3

# Without odometry: stated deviation; distance from the straight course of the two poses before,
# and beyond the reach of the robot at its maximum speed; deviation from both moves beside that is
# no turn of the robot.
MAX_SIGMA, MAX_OFF_COURSE, MAX_BEYOND, MAX_TURN = 0.25, 0.55, 0.4, 0.1

# Share of poses that may be off alone, and distance by which the jump that takes another back may
# differ from it.
MAX_OUTLIERS, MAX_MATCH = 0.1, 0.2

# Smallest time between two detections of a step with the same result, nanoseconds.
DETECTION_PERIOD = SECOND // 20

Positions = NDArray[np.complex128]

# The numbers of a pose: time, position, position by odometry, shift and turn of odometry in the
# map, and standard deviation.
NUMBERS = 10


class Track:
    """The poses, the entries of cells and the detections of a deployment."""

    def __init__(
        self, grid: Grid, max_speed: float, steps: int, needed: int = 1, of: int = 1
    ) -> None:
        self._grid = grid
        # A reading is positive if so many of successive detections are.
        self._needed, self._of = needed, of
        self._max_speed = max_speed / grid.resolution
        # Why no step is vouched for; empty if some may be.
        self.doubt = ''
        self._poses = array('d')
        self._first = self._last = 0
        self._has_odometry = True
        # For each step the number of poses at its entry, and whether it may be vouched for. The
        # poses of steps before a restart are gone.
        self._entries = [(0, False)] * steps
        # Number of a step, first and last possible time of a detection, and its result.
        self._detections: list[tuple[int, int, int, bool]] = []
        self._detected: dict[tuple[int, bool], int] = {}
        # Number of poses at the end of the last goal with a step; None if the last led home.
        self._goal_end: int | None = 0
        self._has_entered = False

    def add(self, place: Place) -> None:
        """Add a pose."""
        first, last = self._first or place.odometry, place.odometry
        self._first, self._last = first, last
        shift, turn = place.correction or (0j, 0j)
        self._has_odometry &= place.correction is not None
        self._poses.append((last - first) / SECOND)
        for point in (complex(place.x, place.y), place.moved, shift, turn):
            self._poses.extend((point.real, point.imag))
        self._poses.append(place.sigma)

    def enter(self, *, is_own: bool) -> None:
        """Add a step at the last pose; `is_own` if a pose shows it while a goal runs."""
        self._entries.append((len(self._poses) // NUMBERS, is_own))
        self._has_entered |= is_own

    def end_goal(self, *, is_home: bool) -> None:
        """Note the end of a goal, and whether it led the robot home."""
        if is_home or self._has_entered:
            self._goal_end = None if is_home else len(self._poses) // NUMBERS
        self._has_entered = False

    def detect(self, number: int, since: int, until: int, seen: bool) -> None:
        """Add a detection made during a step, unless a like one was made just before."""
        if since - self._detected.get((number, seen), 0) >= DETECTION_PERIOD:
            self._detected[number, seen] = since
            self._detections.append((number, since, until, seen))

    def judge(self, steps: Sequence[Step]) -> None:
        """Set which steps the robot vouches for, and the readings of these."""
        for step in steps:
            step.is_entered, step.reading = False, NOT_LOOKED
        poses = np.array(self._poses).reshape(-1, NUMBERS)[: self._goal_end]
        if not len(poses):
            return
        times, frames, limits = self._frames(poses)
        ends = np.array([number for number, _ in self._entries])
        width = self._grid.width
        for number, (end, is_own) in enumerate(self._entries):
            if self.doubt or not is_own or end > len(times):
                continue
            before, after = ends[ends < end], ends[ends > end]
            first = max(before[-1] - 1, 0) if before.size else 0
            window = slice(first, after[0] if after.size else None)
            row, col = divmod(steps[number].cell, width)
            steps[number].is_entered = all(
                _enters(frame[window] - complex(col, row), times[window], limits)
                for frame in frames
            )
        counted: dict[int, list[bool]] = {}
        for number, since, until, seen in self._detections:
            step = steps[number - 1]
            made = (since - self._first) / SECOND, (until - self._first) / SECOND
            if not step.is_entered or made[0] < times[0] or made[1] > times[-1]:
                continue
            row, col = divmod(step.cell, width)
            when = np.append(made, times[slice(*np.searchsorted(times, made))])
            at = np.array([np.interp(when, times, frame) for frame in frames])
            off = at - complex(col + 0.5, row + 0.5)
            if max(np.abs(off.real).max(), np.abs(off.imag).max()) <= 0.5 - limits.read_depth:
                counted.setdefault(number, []).append(seen)
        for number, results in counted.items():
            starts = range(len(results) - self._of + 1)
            if positive := [sum(results[slice(start, start + self._of)]) for start in starts]:
                steps[number - 1].reading = int(max(positive) >= self._needed)

    def _frames(
        self, poses: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], list[Positions], Limits]:
        """Return the times and positions in both frames, and the limits of their source."""
        grid, times, sigma = self._grid, poses[:, 0], poses[:, 9] / self._grid.resolution
        farthest = self._max_speed * np.diff(times) + MAX_BEYOND
        if not self._has_odometry:
            at, outliers = _without_outliers(
                times, _as_complex(grid.in_cells(poses[:, 1:3])), farthest
            )
            self.doubt = self._why_scattered(outliers, len(times))
            self.doubt = self.doubt or self._why_off_course(times, at, sigma)
            course = _by_course(times, at)
            frames = _both(course, at - course, np.ones_like(course), BY_POSES.error)
            depth = max(BY_POSES.depth, 2 * sigma.max())
            return times, frames, BY_POSES._replace(depth=depth)
        moved = _as_complex(poses[:, 3:5] / grid.resolution)
        shift = _as_complex(grid.in_cells(poses[:, 5:7]))
        turn = _as_complex(poses[:, 7:9]) * np.exp(-1j * grid.yaw)
        moved, outliers = _without_outliers(times, moved, farthest)
        self.doubt = self._why_scattered(outliers, len(times))
        self.doubt = self.doubt or self._why_wild(times, moved, shift, turn)
        moved, shift, end = _without_slips(moved, shift, turn, farthest)
        frames = _both(moved[:end], shift[:end], turn[:end], BY_ODOMETRY.error)
        return times[:end], frames, BY_ODOMETRY

    def _why_scattered(self, outliers: int, poses: int) -> str:
        """Explain why poses that are off alone are too many; empty if they are not."""
        if outliers <= max(MAX_LARGE, MAX_OUTLIERS * poses):
            return ''
        return (
            f'{outliers} of {poses} poses are off by more than the maximum speed allows '
            '(parameter max_speed; do two nodes publish them?)'
        )

    def _why_wild(
        self, times: NDArray[np.float64], moved: Positions, shift: Positions, turn: Positions
    ) -> str:
        """Explain why the corrections are too large to trust a pose; empty if they are not."""
        sizes = np.abs(np.diff(shift) + np.diff(turn) * moved[1:])
        changes, large = np.count_nonzero(sizes), np.count_nonzero(sizes > LARGE)
        if large > max(MAX_LARGE, MAX_LARGE_SHARE * changes):
            return (
                f'{large} of {changes} corrections of the localization exceed {LARGE} cells (do '
                'two nodes publish it?)'
            )
        jumps = np.abs(np.diff(moved)) > self._max_speed * np.diff(times) + MAX_BEYOND
        if np.count_nonzero(jumps) > MAX_LARGE:
            return (
                f'odometry jumped {np.count_nonzero(jumps)} times farther than the maximum speed '
                'allows (parameter max_speed; do two nodes publish it?)'
            )
        return ''

    def _why_off_course(
        self, times: NDArray[np.float64], at: Positions, sigma: NDArray[np.float64]
    ) -> str:
        """Explain why poses without odometry cannot be trusted; empty if they can."""
        if sigma.max() > MAX_SIGMA:
            return (
                f'the stated deviation of the position was {sigma.max():.2f} cells, more than '
                f'{MAX_SIGMA}'
            )
        seconds, moves = np.diff(times), np.diff(at)
        if (np.abs(moves) > self._max_speed * seconds + MAX_BEYOND).any():
            return (
                'the position jumped farther than the maximum speed allows (parameter max_speed)'
            )
        is_joined = (seconds[:-1] > 0) & (np.maximum(seconds[:-1], seconds[1:]) <= BY_POSES.gap)
        ratio = seconds[1:][is_joined] / seconds[:-1][is_joined]
        off = np.abs(moves[1:][is_joined] - moves[:-1][is_joined] * ratio)
        if off.size and off.max() > MAX_OFF_COURSE:
            return (
                f'the position jumped {off.max():.2f} cells off its course, more than '
                f'{MAX_OFF_COURSE}'
            )
        return ''


def _without_outliers(
    times: NDArray[np.float64], at: Positions, farthest: NDArray[np.float64]
) -> tuple[Positions, int]:
    """Return positions with those that the next one takes back on its way, and their number."""
    at, count = at.copy(), 0
    for number in range(1, len(at) - 1):
        before, here, after = (at[each] for each in (number - 1, number, number + 1))
        there, back = farthest[number - 1], farthest[number]
        is_away = abs(here - before) > there and abs(after - here) > back
        if is_away and abs(after - before) <= there + back - MAX_BEYOND:
            seconds = times[number + 1] - times[number - 1]
            share = (times[number] - times[number - 1]) / seconds if seconds else 0.5
            at[number] = before + (after - before) * share
            count += 1
    return at, count


def _without_slips(
    moved: Positions, shift: Positions, turn: Positions, farthest: NDArray[np.float64]
) -> tuple[Positions, Positions, int]:
    """
    Return odometry and its shift without jumps of odometry that were taken back.

    Also returns the number of poses before the first jump that was not.
    """
    moved, shift = moved.copy(), shift.copy()
    moves, number = np.diff(moved), np.arange(len(moved))
    # Moves of the localization's frame, at each pose after the first.
    corrections = np.diff(shift) + np.diff(turn) * moved[1:]
    slips = np.flatnonzero(np.abs(moves) > farthest)
    taken_back = set()
    for slip in slips.tolist():
        if slip in taken_back:
            continue
        # Both jumps hold a move of the robot itself.
        jump, most = moves[slip], 2.0 * (farthest[slip] - MAX_BEYOND) + MAX_MATCH
        back = [each for each in slips[slips > slip].tolist() if abs(moves[each] + jump) <= most]
        left = np.abs(corrections + turn[1:] * jump)
        fixed = np.flatnonzero((left <= most) & (np.arange(left.size) >= slip))
        if back and not (fixed.size and fixed[0] < back[0]):
            # Between the two only the move of the robot itself counts.
            moved[(number > slip) & (number <= back[0])] -= jump
            taken_back.add(back[0])
        elif fixed.size:
            moved[number > slip] -= jump
            shift[number > fixed[0]] += turn[number > fixed[0]] * jump
        else:
            return moved, shift, slip + 1
    return moved, shift, len(moved)


def _both(moved: Positions, shift: Positions, turn: Positions, error: float) -> list[Positions]:
    """Return the positions in the frame of the departure, and in that of the return."""
    backward = _follow(moved[::-1], shift[::-1], turn[::-1], error)[::-1]
    return [_follow(moved, shift, turn, error), backward]


def _as_complex(points: NDArray[np.float64]) -> Positions:
    """Return points x, y, shape (n, 2), as complex numbers."""
    numbers: Positions = points @ np.array([1, 1j])
    return numbers


def _by_course(times: NDArray[np.float64], at: Positions) -> Positions:
    """Return the positions without jumps: moves that do not lie between their neighbours."""
    moves, seconds = np.diff(at), np.maximum(np.diff(times), 1e-3)
    speeds = moves / seconds
    before, after = np.append(speeds[:1], speeds[:-1]), np.append(speeds[1:], speeds[-1:])
    turn = after - before
    with np.errstate(divide='ignore', invalid='ignore'):
        share = ((speeds - before) / turn).real
    usual = before + turn * np.clip(np.nan_to_num(share), 0.0, 1.0)
    is_jump = np.abs(speeds - usual) * seconds > MAX_TURN
    return np.concatenate([at[:1], at[0] + np.where(is_jump, usual * seconds, moves).cumsum()])


def _follow(moved: Positions, shift: Positions, turn: Positions, error: float) -> Positions:
    """Return the positions by odometry, in the first frame and slowly towards the later ones."""
    is_change = (np.diff(shift) != 0) | (np.diff(turn) != 0)
    driven = np.concatenate([[0.0], np.abs(np.diff(moved)).cumsum()])
    positions = np.empty_like(moved)
    own_shift, own_turn, since = shift[0], turn[0], 0
    for now in (np.flatnonzero(is_change) + 1).tolist():
        positions[since:now] = own_shift + own_turn * moved[since:now]
        at = own_shift + own_turn * moved[now]
        old, new = (shift[each] + turn[each] * moved[now] for each in (now - 1, now))
        move = new - old
        if abs(new - at) <= error:
            move, own_turn = new - at, turn[now]
        most = MAX_PULL * min(driven[now] - driven[since], MAX_DRIVEN)
        at += move * min(1.0, most / abs(move)) if move else 0.0
        own_shift, since = at - own_turn * moved[now], now
    positions[since:] = own_shift + own_turn * moved[since:]
    return positions


def _enters(at: Positions, times: NDArray[np.float64], limits: Limits) -> bool:
    """Return whether a track enters the unit square deep enough."""
    depth, seconds, moves = limits.depth, np.diff(times), np.diff(at)
    is_joined = (seconds >= 0) & (seconds <= limits.gap) & (np.abs(moves) <= limits.stretch)
    # Poses that are not joined count by themselves.
    start = np.concatenate([at, at[:-1][is_joined]])
    move = np.concatenate([np.zeros_like(at), moves[is_joined]])
    first, last = np.zeros(len(start)), np.ones(len(start))
    for begin, change in ((start.real, move.real), (start.imag, move.imag)):
        is_inside = (depth <= begin) & (begin <= 1 - depth)
        with np.errstate(divide='ignore', invalid='ignore'):
            sides = np.sort([(depth - begin) / change, (1 - depth - begin) / change], axis=0)
        stands = change == 0
        first = np.maximum(first, np.where(stands, np.where(is_inside, 0.0, 2.0), sides[0]))
        last = np.minimum(last, np.where(stands, 1.0, sides[1]))
    return bool((first <= last).any())
