# SPDX-License-Identifier: Apache-2.0
"""In which step a robot was, against a record of every moment."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.robot import Whereabouts


@given(st.lists(st.tuples(st.integers(1, 3), st.integers(0, 2)), min_size=1), st.integers(0, 60))
def test_a_time_between_two_sights_is_in_a_step_if_both_are(sights, asked):
    whereabouts = Whereabouts(10**9)
    time, seen = 0, []
    for since, step in sights:
        time += since
        seen.append((time, step))
        whereabouts.note(time, step)
    before = [step for at, step in seen if at <= asked][-1:]
    after = [step for at, step in seen if at >= asked][:1]
    # One that was not seen since is where it was; before the first sight it is nowhere.
    expected = before[0] if before and (not after or after == before) else 0
    assert whereabouts.step_at(asked) == expected


def test_what_was_long_ago_is_forgotten():
    whereabouts = Whereabouts(10)
    for time in range(100):
        whereabouts.note(time, 1 + time // 4)
    assert whereabouts.step_at(95) == 24
    assert whereabouts.step_at(50) == 0


def test_a_clock_that_is_set_back_does_not_mix_two_times():
    whereabouts = Whereabouts(1000)
    whereabouts.note(500, 1)
    whereabouts.note(520, 1)
    whereabouts.note(100, 2)
    assert whereabouts.step_at(110) == 2
    assert whereabouts.step_at(50) == 0
