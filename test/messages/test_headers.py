# SPDX-License-Identifier: Apache-2.0
"""Times are whole nanoseconds and positions are in one frame."""

from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.messages.headers import (
    check_frame,
    from_stamp,
    header,
    LAST_COUNTED_ON,
    next_name,
    read_name,
    read_stamp,
    shown,
    to_stamp,
)
from laws import for_each
import pytest

LAST = 2**31 * 10**9 - 1


def test_a_stamp_is_seconds_and_the_rest():
    assert to_stamp(12_000_000_345) == Time(sec=12, nanosec=345)
    assert from_stamp(Time(sec=12, nanosec=345)) == 12_000_000_345


@given(st.integers(-(2**31) * 10**9, LAST))
def test_every_nanosecond_comes_back(nanoseconds):
    assert from_stamp(to_stamp(nanoseconds)) == nanoseconds


@for_each('nanoseconds', [LAST + 1, -(2**31) * 10**9 - 1])
def test_a_time_beyond_int32_seconds_is_refused(nanoseconds):
    with pytest.raises(ValueError, match=rf'stamp is {nanoseconds} ns.*int32'):
        to_stamp(nanoseconds)


def test_a_header_names_the_map_without_a_slash():
    assert header(7).frame_id == 'map'
    assert header(7).stamp == Time(nanosec=7)
    check_frame('header.frame_id', header(7).frame_id)


@for_each('frame_id', ['', '/map', 'odom', 'Map'])
def test_another_frame_is_refused(frame_id):
    with pytest.raises(ValueError, match=f"poses.* is '{frame_id}': it must be 'map'"):
        check_frame('poses[2].header.frame_id', frame_id)


@for_each('stamp, told', [
    (Time(sec=2**31 - 1, nanosec=999_999_999), '2147483647.999999999 s: it must be from 0'),
    (Time(sec=-5), 'stamp is -5.000000000 s'),
    (Time(nanosec=10**9), 'nanosec is 1000000000: it must be below'),
])  # fmt: skip
def test_what_is_no_time_that_others_can_follow_is_refused(stamp, told):
    for read in (read_stamp, read_name):
        with pytest.raises(ValueError, match=told):
            read('stamp', stamp)


# What any one message may say leaves room for all names that a mission will ever need.
@given(st.integers(0, LAST), st.lists(st.integers(0, LAST), max_size=3))
def test_names_can_always_be_counted_on(time, names):
    def read(function, nanoseconds):
        try:
            return function('stamp', to_stamp(nanoseconds))
        except ValueError:
            return 0

    time, names = read(read_stamp, time), [read(read_name, name) for name in names]
    first = next_name(time, *names)
    assert first >= time
    assert all(first > name for name in names if name <= LAST_COUNTED_ON)
    for number in range(first, first + 10**12, 10**11):
        assert next_name(time, *names, number) == number + 1
        assert read_name('stamp', to_stamp(number + 1)) == number + 1


def test_a_long_text_is_cut():
    assert shown('odom') == "'odom'"
    assert len(shown('x' * 50_000_000)) < 150
