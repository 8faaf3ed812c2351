# SPDX-License-Identifier: Apache-2.0
"""The position of a robot by TF or satellites, and the step of its walk at any time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import isfinite, sqrt
from typing import Any, NamedTuple

from kbnitp_ros.messages.headers import from_stamp, SECOND, shown

# Maximum number of frames; a robot has tens.
MAX_FRAMES = 1000


# Seconds by which a stamp may be ahead: Nav2's AMCL dates its transforms up to a second ahead.
MAX_AHEAD = 5.0

Point = tuple[float, float, float]

# Scores of a transform whose stamps or parents go back and forth: of each step back, above which
# two nodes publish it, and the largest. Each message without a step back takes one off.
STEP_BACK, MAX_SCORE, SCORE_LIMIT = 4, 8, 40


class Link(NamedTuple):
    """The transform of a frame to its parent."""

    parent: str
    # Rotation and translation (metres): for x, y and z the three factors and the summand.
    rows: tuple[tuple[float, float, float, float], ...]
    # Nanoseconds; None if it is static.
    stamp: int | None

    def apply(self, point: Point) -> Point:
        """Return a point of the frame in its parent."""
        x, y, z = (a * point[0] + b * point[1] + c * point[2] + d for a, b, c, d in self.rows)
        return x, y, z


class Place(NamedTuple):
    """The place of a robot at a time."""

    # Metres.
    x: float
    y: float
    # The time of the oldest transform used, nanoseconds.
    stamp: int
    # The time of the first non-static transform on the way from the robot's frame to the map,
    # usually odometry. Later transforms correct odometry, may be rare, and may be dated ahead.
    odometry: int
    # Place by odometry, in its own frame, and that frame in the map: shift in metres, and turn as
    # a complex number; None without odometry.
    moved: complex = 0j
    correction: tuple[complex, complex] | None = None
    # Stated standard deviation in metres, of a place without odometry.
    sigma: float = 0.0


class Offset:
    """The offset of the clock that dates a source: one number while a fault lasts."""

    def __init__(self) -> None:
        self._last = 0.0

    def steady(self, seconds: float) -> str:
        """Describe the offset; a fault whose number trembles is one fault."""
        if abs(seconds - self._last) > 1.0:
            self._last = seconds
        return f'{self._last:.0f} s'

    def check_ahead(self, what: str, seconds: float) -> None:
        """Raise ValueError if a stamp was too many seconds ahead when it was received."""
        if seconds > MAX_AHEAD:
            raise ValueError(
                f'{what} is dated in the future, clock ahead by {self.steady(seconds)}: set the '
                'clocks of this computer and of its publisher alike (use_sim_time on both or on '
                'neither)'
            )


class Transforms:
    """The newest transform of each frame to its parent."""

    def __init__(self, frame: str, robot_frame: str, sigma: float = 0.0) -> None:
        self._frame = frame
        self._robot_frame = robot_frame
        self._links: dict[str, Link] = {}
        # Times at which transforms were received, nanoseconds; those received since the last look
        # count as received at the next.
        self._heard: dict[str, int] = {}
        self._unheard: set[str] = set()
        self._steps_back: dict[str, int] = {}
        self._offset = Offset()
        self._sigma = sigma

    def take(self, message: Any, *, static: bool) -> None:
        """Add a tf2_msgs/TFMessage."""
        for transform in message.transforms:
            child, pose = transform.child_frame_id.lstrip('/'), transform.transform
            move, turn = pose.translation, pose.rotation
            x, y, z, w = turn.x, turn.y, turn.z, turn.w
            length = sqrt(x * x + y * y + z * z + w * w)
            if not (all(map(isfinite, (move.x, move.y, move.z))) and 0.9 < length < 1.1):
                raise ValueError(
                    f'the transform to {child!r} has translation {[move.x, move.y, move.z]} and '
                    f'rotation {[x, y, z, w]}: they must be finite and a unit quaternion'
                )
            if child not in self._links and len(self._links) == MAX_FRAMES:
                raise ValueError(f'frame {child!r} exceeds the maximum of {MAX_FRAMES} frames')
            x, y, z, w = x / length, y / length, z / length, w / length
            rows = (
                (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), move.x),
                (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), move.y),
                (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), move.z),
            )
            parent = transform.header.frame_id.lstrip('/')
            stamp = None if static else from_stamp(transform.header.stamp)
            self._take(child, Link(parent, rows, stamp))

    def _take(self, child: str, link: Link) -> None:
        """Replace a link, and score it if its parent changes or its stamp goes back."""
        last = self._links.get(child, link)
        is_back = last.parent != link.parent or (last.stamp or 0) > (link.stamp or 0)
        score = self._steps_back.get(child, 0) + (STEP_BACK if is_back else -1)
        self._steps_back[child] = min(max(score, 0), SCORE_LIMIT)
        self._links[child] = link
        self._unheard.add(child)

    def take_deviation(self, message: Any) -> None:
        """Take the deviation of a geometry_msgs/PoseWithCovarianceStamped."""
        covariance = message.pose.covariance
        if not (isfinite(covariance[0]) and isfinite(covariance[7])):
            raise ValueError(
                f'pose.covariance has {covariance[0]} and {covariance[7]} for x and y'
            )
        self._sigma = sqrt(max(covariance[0], covariance[7], 0.0))

    def place(self, now: int, oldest: float) -> Place:
        """Return the place by transforms dated and received in the last `oldest` seconds."""
        self._heard |= dict.fromkeys(self._unheard, now)
        self._unheard.clear()
        links: list[Link] = []
        frame = self._robot_frame
        while frame != self._frame:
            if frame not in self._links or len(links) == len(self._links):
                raise ValueError(
                    f'no transform leads from {self._frame!r} to {self._robot_frame!r}: the place '
                    f'of {frame!r} is unknown'
                )
            link = self._links[frame]
            self._check(frame, link, now, oldest)
            links.append(link)
            frame = link.parent
        stamps = [link.stamp for link in links if link.stamp is not None]
        # The last transform that is not static corrects odometry, if there are others below it.
        numbers = [number for number, link in enumerate(links) if link.stamp is not None]
        split = numbers[-1] if len(numbers) > 1 else len(links)
        at: Point = (0.0, 0.0, 0.0)
        for link in links[:split]:
            at = link.apply(at)
        points, moved = [at, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], complex(*at[:2])
        for link in links[split:]:
            points = [link.apply(point) for point in points]
        (x, y, _), begin, end = points
        shift, turn = complex(*begin[:2]), complex(*end[:2]) - complex(*begin[:2])
        is_corrected = split < len(links) and turn != 0
        correction = (shift, turn / abs(turn)) if is_corrected else None
        first = stamps[0] if stamps else now
        return Place(x, y, min([now, *stamps]), first, moved, correction, self._sigma)

    def _check(self, frame: str, link: Link, now: int, oldest: float) -> None:
        """Raise ValueError unless a link is fresh and of one publisher."""
        name = f'from {link.parent!r} to {frame!r}'
        if self._steps_back[frame] > MAX_SCORE:
            raise ValueError(
                f'two nodes publish the transform {name}: its stamps or parents go back and '
                'forth; end one of them'
            )
        if link.stamp is None:
            return
        received = self._heard[frame]
        self._offset.check_ahead(f'the last transform {name}', (link.stamp - received) / SECOND)
        heard, age = (now - received) / SECOND, (now - link.stamp) / SECOND
        if max(age, heard) > oldest:
            raise ValueError(
                f'the last transform {name} is older than {oldest} s (parameter tf_timeout)'
                + (f': clock behind by {self._offset.steady(age)}' if heard <= oldest else '')
            )


# Values of sensor_msgs/NavSatFix: lowest status with a fix, and type of an unknown covariance.
FIX, UNKNOWN = 0, 0


class Fixes:
    """The newest place by satellite fixes."""

    def __init__(
        self, in_map: Callable[[float, float], tuple[float, float]], frame: str, largest: float
    ) -> None:
        self._in_map = in_map
        self._frame = frame
        self._largest = largest
        self._newest: Place | None = None
        self._offset = Offset()
        # Time at which the newest fix was received, nanoseconds; None before the next look.
        self._heard: int | None = None

    def take(self, message: Any) -> None:
        """Add a sensor_msgs/NavSatFix."""
        frame = message.header.frame_id.lstrip('/')
        if frame != self._frame:
            raise ValueError(
                f'header.frame_id is {shown(frame)}: it must be {self._frame!r}, the frame of '
                'the antenna (parameter base_frame)'
            )
        if message.status.status < FIX:
            raise ValueError(f'status.status is {message.status.status}: there is no fix')
        for name, most in (('latitude', 90.0), ('longitude', 180.0)):
            if not abs(value := getattr(message, name)) <= most:
                raise ValueError(f'{name} is {value}: it must be from {-most:g} to {most:g}')
        if message.position_covariance_type == UNKNOWN:
            raise ValueError('position_covariance_type is 0: a fix must have a covariance')
        variances = float(message.position_covariance[0]), float(message.position_covariance[4])
        if not all(isfinite(each) and each > 0.0 for each in variances):
            raise ValueError(
                f'position_covariance has {variances} east and north: they must be positive'
            )
        if (deviation := sqrt(max(variances))) > self._largest:
            raise ValueError(
                f'the standard deviation of the fix is {deviation:.2f} m: at most '
                f'{self._largest:g} m, half a cell, is accepted'
            )
        x, y = self._in_map(message.latitude, message.longitude)
        stamp = from_stamp(message.header.stamp)
        self._newest, self._heard = Place(x, y, stamp, stamp, sigma=deviation), None

    def place(self, now: int, oldest: float) -> Place:
        """Return the place by a fix dated and received in the last `oldest` seconds."""
        if self._newest is None:
            raise ValueError('no fix was accepted yet')
        self._heard = now if self._heard is None else self._heard
        self._offset.check_ahead('the last fix', (self._newest.stamp - self._heard) / SECOND)
        if now - min(self._newest.stamp, self._heard) > oldest * SECOND:
            raise ValueError(f'the last fix is older than {oldest} s (parameter tf_timeout)')
        return self._newest


# Step number of a robot near the edge of a cell or without a position: no detection counts.
NO_STEP = 0


# An interval in which the robot was in one step: first and last time, nanoseconds, and the number
# of the step from 1, or `NO_STEP`.
Span = tuple[int, int, int]


class Whereabouts:
    """The step of the robot at any recent time; times are in nanoseconds."""

    def __init__(self, kept: int, gap: int) -> None:
        # Between two positions more than `gap` apart in time, the robot may have been anywhere.
        self._kept = kept
        self._gap = gap
        self._spans: deque[Span] = deque()

    def note(self, time: int, step: int) -> None:
        """Record the robot's step at a time: its number from 1, or `NO_STEP`."""
        spans = self._spans
        if spans and time < spans[-1][1]:
            spans.clear()
        first = time
        if spans:
            since, last, before = spans[-1]
            if before == step and time <= last + self._gap:
                spans.pop()
                first = since
        spans.append((first, time, step))
        while spans[0][1] < time - self._kept:
            spans.popleft()

    def step_within(self, since: int, until: int) -> int | None:
        """Return the step that spans `since` to `until`, or `NO_STEP`; None if not known yet."""
        if not self._spans or until > self._spans[-1][1]:
            return None
        for first, last, step in reversed(self._spans):
            if first <= since:
                return step if until <= last else NO_STEP
        return NO_STEP
