# SPDX-License-Identifier: Apache-2.0
"""In which step a robot was, against a record of every moment."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.robot.whereabouts import Whereabouts

times = st.integers(0, 60)


@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(0, 2)), min_size=1),
    st.integers(1, 9),
    times,
    times,
)
def test_a_time_is_in_a_step_if_the_robot_was_seen_there_before_after_and_often(
    sights, gap, one, other
):
    since, until = sorted((one, other))
    whereabouts = Whereabouts(10**9, gap)
    time, seen = 0, []
    for later, step in sights:
        time += later
        seen.append((time, step))
        whereabouts.note(time, step)
    first = max((number for number, (at, _) in enumerate(seen) if at <= since), default=None)
    after = min((number for number, (at, _) in enumerate(seen, 1) if at >= until), default=None)
    expected = None if after is None else 0
    if first is not None and after is not None:
        between = seen[first:after]
        is_one = len({step for _, step in between}) == 1
        if is_one and all(b - a <= gap for (a, _), (b, _) in pairwise(between)):
            expected = between[0][1]
    assert whereabouts.step_within(since, until) == expected


def test_what_was_long_ago_is_forgotten():
    whereabouts = Whereabouts(10, 10)
    for time in range(100):
        whereabouts.note(time, 1 + time // 4)
    assert whereabouts.step_within(95, 95) == 24
    assert whereabouts.step_within(50, 50) == 0


def test_a_clock_that_is_set_back_does_not_mix_two_times():
    whereabouts = Whereabouts(1000, 1000)
    whereabouts.note(500, 1)
    whereabouts.note(520, 1)
    whereabouts.note(100, 2)
    whereabouts.note(120, 2)
    assert whereabouts.step_within(110, 110) == 2
    assert whereabouts.step_within(50, 50) == 0
