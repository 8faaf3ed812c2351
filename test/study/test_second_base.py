# SPDX-License-Identifier: Apache-2.0
"""What a second base is worth is what the missions say, counted from the table by hand."""

from dataclasses import replace

from kbnitp_ros.study.comparison import BY_BASE
from kbnitp_ros.study.scenario import Strategy, team_labels
from kbnitp_ros.study.scenario_file import scenario_of
import numpy as np
import pytest
from small_study import compared_by, CONTENT

TEAMS = (Strategy(agents=2), Strategy(agents=2, second_base=11))


@pytest.fixture(scope='module')
def compared(scenario):
    """Return the results of missions from one base, and from two."""
    return compared_by(scenario, TEAMS)


def first_at(level, log_loss):
    """Return after how many robots a log loss was first reached, between two by the slope."""
    lowest = np.minimum.accumulate(log_loss)
    after = int(np.flatnonzero(lowest <= level)[0])
    if after == 0:
        return 0.0
    return after - 1 + (lowest[after - 1] - level) / (lowest[after - 1] - lowest[after])


def test_the_robots_to_the_same_log_loss(compared):
    (row,) = BY_BASE.summarise(compared)['rows']
    one, two = (
        compared.series(0.9, 'kappa_bnitp', 'hazard_log_loss', 'target_log_loss', team=team)
        for team in TEAMS
    )
    assert row['value']['mean'] == pytest.approx((one - two)[:, -1].mean(), abs=1e-6)
    means = [each.mean(axis=0) for each in (one, two)]
    level = max(mean.min() for mean in means)
    assert row['log_loss']['mean'] == pytest.approx(level, abs=1e-6)
    sent = [first_at(level, mean) for mean in means]
    for name, expected in zip(('sent_from_one', 'sent'), sent, strict=True):
        assert row[name]['mean'] == pytest.approx(expected, abs=1e-6)
    assert row['fewer']['mean'] == pytest.approx(sent[0] - sent[1], abs=1e-6)
    assert row['second_base'] == 11


def test_bases_differ_and_nothing_else_does(compared):
    scenario = compared.scenario
    assert BY_BASE.applies(scenario)
    assert not BY_BASE.applies(replace(scenario, teams=(TEAMS[0],)))
    assert [*team_labels(scenario).values()] == ['one base', 'second base 11']
    # Both meet the same worlds, in which both cells are free.
    assert scenario.field().bases == {5, 11}
    for number in range(scenario.trials):
        worlds = [
            outcome.truth for trial, outcome in compared.outcomes.items() if trial.number == number
        ]
        assert (worlds[0] == worlds[1]).all()
        assert not worlds[0][0, [5, 11]].any()


def test_a_second_base_of_one_robot_is_refused():
    for second, told in ((11, 'second_base is 11 of 1 robot'), (99, 'base is 99.*from 0 to')):
        agents = 1 if second == 11 else 2
        with pytest.raises(ValueError, match=told):
            scenario_of({**CONTENT, 'teams': [{'agents': agents, 'second_base': second}]})
