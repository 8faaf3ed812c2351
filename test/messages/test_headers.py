# SPDX-License-Identifier: Apache-2.0
"""Times are whole nanoseconds and positions are in one frame."""

from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.messages.headers import check_frame, from_stamp, header, to_stamp
import pytest

LAST = 2**31 * 10**9 - 1


def test_a_stamp_is_seconds_and_the_rest():
    assert to_stamp(12_000_000_345) == Time(sec=12, nanosec=345)
    assert from_stamp(Time(sec=12, nanosec=345)) == 12_000_000_345


@given(st.integers(-(2**31) * 10**9, LAST))
def test_every_nanosecond_comes_back(nanoseconds):
    assert from_stamp(to_stamp(nanoseconds)) == nanoseconds


@pytest.mark.parametrize('nanoseconds', [LAST + 1, -(2**31) * 10**9 - 1])
def test_a_time_beyond_int32_seconds_is_refused(nanoseconds):
    with pytest.raises(ValueError, match=rf'stamp is {nanoseconds} ns.*int32'):
        to_stamp(nanoseconds)


def test_a_header_names_the_map_without_a_slash():
    assert header(7).frame_id == 'map'
    assert header(7).stamp == Time(nanosec=7)
    check_frame('header.frame_id', header(7).frame_id)


@pytest.mark.parametrize('frame_id', ['', '/map', 'odom', 'Map'])
def test_another_frame_is_refused(frame_id):
    with pytest.raises(ValueError, match=f"poses.* is '{frame_id}': it must be 'map'"):
        check_frame('poses[2].header.frame_id', frame_id)
