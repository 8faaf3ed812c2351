# SPDX-License-Identifier: Apache-2.0
"""Poses that cannot be true are refused in one line that names them."""

from geometry_msgs.msg import TransformStamped
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.headers import SECOND, to_stamp
from kbnitp_ros.robot.journal import Step
from kbnitp_ros.robot.track import Track
from kbnitp_ros.robot.whereabouts import Fixes, Place, Transforms
from laws import for_each
import pytest
from sensor_msgs.msg import NavSatFix
from tf2_msgs.msg import TFMessage

NOW = 1_800_000_000 * SECOND
YEAR = 365 * 24 * 3600 * SECOND
# The last time of a message, in 2038.
LATEST = (2**31 - 1) * SECOND


def moved(parent, child, x, stamp):
    told = TransformStamped(child_frame_id=child)
    told.header.frame_id, told.header.stamp = parent, to_stamp(stamp)
    told.transform.translation.x, told.transform.rotation.w = x, 1.0
    return TFMessage(transforms=[told])


def place_by(source, *messages, now=NOW):
    """Return the place at a time by messages received at that time."""
    for message in messages:
        source.take(message, static=False)
    return source.place(now, 2.0)


@for_each('stamp, told', [
    (0, "transform from 'map' to 'base' is older than 2.0 s .*clock behind by 1800000000 s"),
    (NOW - 57 * YEAR, 'clock behind by'),
    (LATEST, "to 'base' is dated in the future, clock ahead by"),
    (NOW + 30 * SECOND, 'clock ahead by 30 s'),
    (NOW - 3 * SECOND, 'older than 2.0 s .*clock behind by 3 s'),
])  # fmt: skip
def test_a_pose_of_another_time_is_no_place(stamp, told):
    with pytest.raises(ValueError, match=told) as refusal:
        place_by(Transforms('map', 'base'), moved('map', 'base', 1.5, stamp))
    assert '\n' not in str(refusal.value)


@for_each('lead', [0.0, 1.0, 4.9])
def test_a_pose_dated_a_little_ahead_goes_stale_once_nothing_is_heard(lead):
    # Nav2's AMCL dates its transforms ahead.
    source = Transforms('map', 'base')
    stamp = NOW + int(lead * SECOND)
    assert place_by(source, moved('map', 'base', 1.5, stamp)).x == 1.5
    assert source.place(NOW + SECOND, 2.0).x == 1.5
    with pytest.raises(ValueError, match='older than 2.0 s'):
        source.place(NOW + 3 * SECOND, 2.0)


@for_each('ahead, told', [
    (-56 * YEAR, 'the last fix is older'), (70 * YEAR, 'dated in the future'), (0, ''),
])  # fmt: skip
def test_a_fix_of_another_time_is_no_place(ahead, told):
    source = Fixes(lambda latitude, longitude: (longitude, latitude), 'gps', 1.0)
    fix = NavSatFix(latitude=0.5, longitude=1.5, position_covariance_type=2)
    fix.status.status = 0
    fix.header.frame_id, fix.header.stamp = 'gps', to_stamp(min(NOW + ahead, LATEST))
    fix.position_covariance[0] = fix.position_covariance[4] = 0.01
    source.take(fix)
    if not told:
        assert (source.place(NOW, 2.0).x, source.place(NOW, 2.0).sigma) == (1.5, 0.1)
        told, now = 'the last fix is older', NOW + 3 * SECOND
    else:
        now = NOW
    with pytest.raises(ValueError, match=told):
        source.place(now, 2.0)


def test_a_clock_ahead_is_one_fault_while_it_lasts():
    source, told = Transforms('map', 'base'), set()
    for number in range(100):
        # The lead of 30.5 s trembles, and nothing is heard in the end.
        now = NOW + number * SECOND
        ahead = int((30.5 + 0.2 * (-1) ** number) * SECOND)
        poses = [moved('map', 'base', 1.5, now + ahead)] if number < 50 else []
        with pytest.raises(ValueError) as refusal:
            place_by(source, *poses, now=now)
        told.add(str(refusal.value))
    assert len(told) == 1


@for_each('apart', [SECOND // 100, SECOND // 2])
def test_two_publishers_of_a_transform_are_named(apart):
    # Both at 5 Hz, and one behind the other in time.
    source = Transforms('map', 'base')
    told = ''
    for number in range(100):
        now = NOW + number * SECOND // 5
        poses = moved('map', 'base', 1.5, now), moved('map', 'base', 4.5, now - apart)
        try:
            place_by(source, *poses, now=now)
        except ValueError as error:
            told = str(error)
            break
    assert told.startswith("two nodes publish the transform from 'map' to 'base'")
    assert number < 20


def test_transforms_out_of_order_now_and_then_are_no_second_publisher():
    source = Transforms('map', 'base')
    for number in range(200):
        now = NOW + number * SECOND // 5
        late = [moved('map', 'base', 1.5, now - SECOND // 2)] if number % 10 == 0 else []
        assert place_by(source, moved('map', 'base', 1.5, now), *late, now=now).x == 1.5


@for_each('has_odometry', [True, False])
@for_each('jump', [1.0, 3.0, 5.0])
def test_a_jump_after_the_first_pose_vouches_for_no_step_before_it(has_odometry, jump):
    """The first pose is wrong: the robot begins in another cell than it believes."""
    grid = Grid(12, 1)
    track, steps, last = Track(grid, 1.0, 0), [], 0
    for number in range(60):
        # At the first pose the localization is put right; then it drives a cell a second.
        at = 0.5 + number / 10
        shift = complex(jump if number else 0.0)
        x = at + shift.real
        if int(x) != last:
            last = int(x)
            steps.append(Step(last, NOW))
            track.enter(is_own=True)
        correction = (shift, 1 + 0j) if has_odometry else None
        time = NOW + number * SECOND // 5
        track.add(Place(x, 0.5, time, time, complex(at, 0.5), correction))
    track.end_goal(is_home=True)
    track.judge(steps)
    assert not steps[0].is_entered
    if not has_odometry:
        assert 'jumped farther than the maximum speed' in track.doubt
        assert not any(step.is_entered for step in steps)


@for_each('rule, seen, reading', [
    ((1, 1), '', -1),
    ((1, 1), '0', 0),
    ((1, 1), '00100', 1),
    ((2, 3), '11', -1),
    ((2, 3), '110', 1),
    ((2, 3), '101', 1),
    ((2, 3), '100', 0),
    ((2, 3), '1001001', 0),
    ((2, 3), '100001100', 1),
    ((3, 3), '11011011', 0),
    ((3, 3), '0111', 1),
])  # fmt: skip
def test_a_reading_is_positive_if_enough_detections_in_a_row_are(rule, seen, reading):
    """The robot drives into a cell, and is in it while its detector speaks each second."""
    track, steps = Track(Grid(3, 1), 1.0, 0, *rule), [Step(1, NOW)]
    for number in range(40):
        x = min(0.5 + number / 5, 1.5)
        if number == 3:
            track.enter(is_own=True)
        time = NOW + number * SECOND // 2
        track.add(Place(x, 0.5, time, time, complex(x, 0.5), (0j, 1 + 0j)))
    for number, each in enumerate(seen):
        at = NOW + (6 + number) * SECOND
        track.detect(1, at, at, each == '1')
    track.end_goal(is_home=True)
    track.judge(steps)
    assert steps[0].is_entered
    assert steps[0].reading == reading
