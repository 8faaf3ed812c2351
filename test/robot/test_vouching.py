# SPDX-License-Identifier: Apache-2.0
"""A robot vouches for no cell that it did not enter, and every robot that came back is home."""

import pytest
from scenarios import (
    BEYOND,
    CLEAN,
    CORRECTIONS,
    count,
    JUMPS,
    NAV2,
    OUTLIERS,
    SCENARIOS,
    SILENCE,
    SLIPS,
    without_odometry,
)

MANY = 100
WALKS = [3, pytest.param(MANY, marks=pytest.mark.full)]

# False steps and readings in a thousand reported steps.
MAX_FALSE = 1.0

# Where the rule fails more often, as many walks tell: a jump seen between two poses like a move,
# and a turn of the localization, which moves all places behind it.
LIMITS = {
    ('jump of 1 with a turn', True): 4.0,
    ('jump of 0.4, lasting', False): 4.0,
    ('jump of 0.6, lasting', False): 4.0,
}


def counted(name, odometry, walks):
    scenario = SCENARIOS[name]
    return count(scenario if odometry else without_odometry(scenario), walks)


@pytest.mark.slow
@pytest.mark.parametrize('walks', WALKS)
@pytest.mark.parametrize('odometry', [True, False])
@pytest.mark.parametrize('names', [CLEAN, CORRECTIONS, JUMPS, SLIPS, OUTLIERS, SILENCE, NAV2])
def test_no_step_is_vouched_for_in_a_cell_that_was_not_entered(names, odometry, walks):
    for name in names:
        most = LIMITS.get((name, odometry), MAX_FALSE)
        if most > MAX_FALSE and walks < MANY:
            continue
        counts = counted(name, odometry, walks)
        assert 1000 * counts.false <= most * counts.reported, name
        assert 1000 * counts.misread <= most * counts.reported, name
        # A robot whose clock differs does not leave, and all others come home.
        if SCENARIOS[name].ahead > 5.0:
            assert (counts.home, counts.entered) == (0, 0), name
        else:
            assert counts.home == counts.walks, name


@pytest.mark.slow
def test_most_steps_are_vouched_for():
    for odometry, clean, corrected in ((True, 0.98, 0.9), (False, 0.95, 0.75)):
        for name, least in (('clean', clean), ('corrections of 0.2 a second', corrected)):
            counts = counted(name, odometry, 25)
            assert counts.vouched >= least * counts.reported


@pytest.mark.slow
def test_a_jump_of_odometry_voids_what_comes_after_it_until_it_is_taken_back():
    """A quarter of a walk is lost to a jump of four seconds, and single poses cost nothing."""
    for name, least in (
        ('odometry jumps by 2, lasting', 0.3),
        ('odometry jumps by 2, back after 4 s', 0.65),
        ('odometry jumps by 2, corrected after 4 s', 0.65),
        ('0.5% of poses are off', 0.97),
    ):
        counts = counted(name, True, 25)
        assert counts.vouched >= least * counts.reported, name
        assert counts.false == counts.misread == 0, name


@pytest.mark.slow
@pytest.mark.parametrize('name', BEYOND)
def test_what_no_rule_can_tell_is_false(name):
    # Where a rule tells these as well, docs/robots.md says too little of it.
    assert any(count(BEYOND[name], 1, seed).false for seed in range(100))
