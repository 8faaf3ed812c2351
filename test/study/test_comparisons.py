# SPDX-License-Identifier: Apache-2.0
"""Strategies are compared in the same worlds, and tables agree with their missions."""

from dataclasses import astuple, replace
from functools import partial

from kbnitp_ros.core import Mission
from kbnitp_ros.study.comparison import (
    BY_BASE,
    BY_MAP,
    BY_OBJECTIVE,
    BY_PLANNER,
    BY_SIZE,
    COMPARISONS,
    CONTACT,
    differ_in_objective,
)
from kbnitp_ros.study.questions import at_equal_log_loss, compare, differ_in_size, EQUAL
from kbnitp_ros.study.results import after_rounds, trade
from kbnitp_ros.study.scenario import differ_only_in, Strategy, team_labels
from kbnitp_ros.study.scenario_file import parse_scenario
from kbnitp_ros.study.trial import list_trials, MEASURES, run_trial, Trial
from laws import for_each
import numpy as np
import pytest
from small_study import compared_by, CONTENT, written

NONE = Strategy()
CONTACTS = (Strategy(last_contact=1.0), NONE, Strategy(last_contact=0.3))
OBJECTIVES = (NONE, Strategy(objective='behavioral', alpha=2.0), Strategy(loss_cost=0.5))
PLANNERS = (NONE, Strategy(planner='coverage'), Strategy(planner='random'))
MAPS = (NONE, Strategy(survey=0.9), Strategy(survey=0.5, trusted=0.8))


@pytest.mark.slow
@for_each('comparison, teams, others, name, sign, cells', [
    (BY_PLANNER, PLANNERS, (1, 2), 'difference', 1, [['`coverage`'], ['`random`']]),
    (CONTACT, CONTACTS, (2, 0), 'value', -1, [['0.3'], ['1']]),
    (BY_OBJECTIVE, OBJECTIVES, (1, 2), 'difference', 1, None),
    (BY_MAP, MAPS, (1, 2), 'value', -1, [['0.9', '0.9'], ['0.5', '0.8']]),
])  # fmt: skip
def test_each_is_compared_with_the_first(
    scenario, tmp_path, comparison, teams, others, name, sign, cells
):
    results = compared_by(scenario, teams)
    summary, rows = written(results, comparison, tmp_path)
    assert {each.name for each in COMPARISONS} & summary.keys() == {comparison.name}
    table = results.to_dataframe()
    table['log_loss'] = table['hazard_log_loss'] + table['target_log_loss']
    by = [*vars(NONE), 'deployment']
    means = table.groupby(by)[['log_loss', 'robots_lost']].mean()
    after = summary[comparison.name]['robots']
    for place, (row, shown) in enumerate(rows):
        team = teams[others[place]]
        apart = means.loc[astuple(team)] - means.loc[astuple(NONE)]
        differences = [each['mean'] for each in row[name]]
        assert differences == pytest.approx(list(sign * apart['log_loss'][after]), abs=1e-6)
        if 'lost_more' in row:
            lost = means['robots_lost'][astuple(team)].iloc[-1]
            assert row['lost']['mean'] == pytest.approx(lost, abs=1e-6)
            more = apart['robots_lost'].iloc[-1]
            assert row['lost_more']['mean'] == pytest.approx(more, abs=1e-6)
        told = ['`kappa_bnitp`', *cells[place]] if cells else [row['objective']]
        assert shown[: len(told) + 1] == ['0.9', *told]
        mean, low, high = row[name][0].values()
        assert shown[len(told) + 1] == f'{mean:.1f} [{low:.1f}, {high:.1f}]'


@pytest.mark.slow
def test_objectives_are_compared_at_equal_log_loss_and_at_equal_losses(scenario):
    results = compared_by(scenario, OBJECTIVES)
    summary = BY_OBJECTIVE.summarise(results)
    assert summary['first'] == 'information'
    assert [row['objective'] for row in summary['rows']] == [
        'alpha 2',
        'information, loss cost 0.5',
    ]
    for row, team in zip(summary['rows'], OBJECTIVES[1:]):
        series = partial(results.series, 0.9, 'kappa_bnitp')
        both = trade(series, NONE), trade(series, team)
        more = compare(*both)['difference'].mean
        assert row['lost_at_equal']['mean'] == pytest.approx(more, abs=1e-6)
        (lost, log_loss), (other_lost, other_log_loss) = (each.mean(axis=0) for each in both)
        at = min(lost[-1], other_lost[-1])
        higher = np.interp(at, other_lost, other_log_loss) - np.interp(at, lost, log_loss)
        found = row['log_loss_at_equal']
        assert found['mean'] == pytest.approx(higher, abs=1e-6)
        assert found['low'] < found['mean'] < found['high']


@pytest.mark.slow
def test_each_mission_has_the_planner_and_the_contact_of_its_strategy(scenario, monkeypatch):
    used = []

    def noting(*arguments, truth, **named):
        mission = resume(*arguments, truth=truth, **named)
        used.append((arguments[4].planner, truth.execution.contact, mission))
        return mission

    resume = Mission.resume
    monkeypatch.setattr(Mission, 'resume', noting)
    # Robots whose first step is their last make no contact.
    teams = (*PLANNERS[1:], *CONTACTS[:2])
    few = replace(scenario, teams=teams, robots=30, trials=1, lethalities=(0.5,))
    for trial in list_trials(replace(few, methods=('kappa_bnitp',))):
        run_trial(few, trial)
    known = [
        (*of_strategy, any(d.observation.steps_survived for d in mission))
        for *of_strategy, mission in used
    ]
    assert known == [
        ('coverage', 0.0, False),
        ('random', 0.0, False),
        ('relaxed', 1.0, True),
        ('relaxed', 0.0, False),
    ]


COSTS = (Strategy(loss_cost=0.5), Strategy(), Strategy(loss_cost=5))


def equal(*missions):
    return dict(zip(EQUAL, at_equal_log_loss(*(np.array(m, dtype=float) for m in missions))))


@pytest.mark.slow
def test_missions_are_compared_at_the_lowest_log_loss_that_both_reach():
    least = [[0, 1, 2, 2, 3], [10, 6, 4, 3, 2]]
    this = [[0, 0, 1, 1, 1], [10, 9, 7, 5, 8]]
    # 5 is half the way from 6 to 4, between the first robot and the second.
    assert equal(least, this) == {
        'log_loss': 5,
        'sent_at_least': 1.5,
        'sent': 3,
        'lost_at_least': 1.5,
        'lost': 1,
        'difference': -0.5,
        'fewer': -1.5,
    }
    there_and_back = equal(this, least)
    assert there_and_back['difference'] == 0.5
    assert there_and_back['sent'] == 1.5


@pytest.mark.slow
def test_a_mission_counts_up_to_where_it_first_got_there():
    least = [[0, 1, 2, 3, 4], [10, 4, 4, 6, 4]]
    this = [[0, 0, 0, 1, 1], [10, 8, 6, 4, 2]]
    assert equal(least, this) == {
        'log_loss': 4,
        'sent_at_least': 1,
        'sent': 3,
        'lost_at_least': 1,
        'lost': 1,
        'difference': 0,
        'fewer': -2,
    }


@pytest.mark.slow
def test_a_mission_without_information_is_not_compared():
    nothing = [[0, 1, 2], [10, 11, 12]]
    compared = equal([[0, 1, 2], [10, 6, 4]], nothing)
    assert compared == dict.fromkeys(EQUAL, 0) | {'log_loss': 10}


@pytest.mark.slow
def test_the_difference_is_that_of_the_same_worlds():
    """A loss cost that saves each world's mission the same has no interval."""
    lost = np.array([[0, 1, 2], [0, 3, 6], [0, 5, 10]], dtype=float)
    log_loss = np.array([[9, 4, 1]] * 3, dtype=float)
    least, this = (np.stack([of, log_loss], axis=1) for of in (lost, np.maximum(0, lost - 1)))
    compared = compare(least, this)
    assert compared['difference'] == pytest.approx((-1, -1, -1))
    mean, low, high = compared['lost_at_least']
    assert mean == 6
    assert low < 4 < 8 < high


SIZES = (Strategy(), Strategy(3, 'independent'), Strategy(2, 'voronoi'))


@pytest.fixture(scope='module')
def teams(scenario):
    """Return the results of missions of four robots: in four rounds, and twice in two."""
    return compared_by(scenario, SIZES)


@pytest.mark.slow
@for_each('robots, agents, expected', [
    (4, 1, [0, 1, 2, 3, 4]),
    (4, 2, [0, 2, 4]),
    (4, 3, [0, 3, 4]),
    (4, 4, [0, 4]),
    (4, 8, [0, 4]),
])  # fmt: skip
def test_a_round_is_over_when_its_last_robot_is(robots, agents, expected):
    series = np.arange(3.0)[:, None] + np.arange(robots + 1.0)
    assert after_rounds(series, agents)[0].tolist() == expected
    assert after_rounds(series, agents)[2].tolist() == [2 + value for value in expected]


@pytest.mark.slow
def test_information_by_robot_and_by_round(teams):
    """With three at a time there is one full round: its information is compared with others."""
    summary = BY_SIZE.summarise(teams)
    assert (summary['robots'], summary['rounds']) == (4, 1)
    assert [row['rounds'] for row in summary['rows']] == [4, 2, 2]

    def mean(team, robots, *names):
        """Return the sum of some measures after some robots, averaged over trials."""
        outcomes = [teams.outcomes[Trial(0.9, 'kappa_bnitp', t, team)] for t in range(3)]
        values = [[o.measures[robots, MEASURES.index(name)] for name in names] for o in outcomes]
        return np.sum(values) / 3

    loss = ('hazard_log_loss', 'target_log_loss')
    for row, team in zip(summary['rows'], SIZES, strict=True):
        assert {name: row[name] for name in vars(team)} == vars(team)
        prior = mean(team, 0, 'joint_entropy')
        gained = prior - mean(team, 4, 'joint_entropy')
        first = {1: 1, 2: 2, 3: 3}[team.agents]
        for name, expected in {
            'information_a_robot': gained / 4,
            'information_a_round': gained / row['rounds'],
            'log_loss': mean(team, 4, *loss),
            'difference': mean(team, 4, *loss) - mean(Strategy(), 4, *loss),
            'early_information': prior - mean(team, first, 'joint_entropy'),
            'early_log_loss': mean(team, first, *loss),
            'early_robots_lost': mean(team, first, 'robots_lost'),
        }.items():
            assert row[name]['mean'] == pytest.approx(expected, abs=1e-6), name
            assert row[name]['low'] <= row[name]['mean'] <= row[name]['high']
    assert summary['rows'][0]['difference'] == {'mean': 0.0, 'low': 0.0, 'high': 0.0}
    # A robot's information is that of its own update, robot after robot.
    realised = teams.series(0.9, 'kappa_bnitp', 'realised_information', team=SIZES[1])
    gained = summary['rows'][1]['information_a_robot']['mean']
    assert gained == pytest.approx(realised[:, 1:].mean(), abs=1e-6)


BASES = (Strategy(agents=2), Strategy(agents=2, second_base=11))


@pytest.fixture(scope='module')
def compared(scenario):
    """Return the results of missions from one base, and from two."""
    return compared_by(scenario, BASES)


def first_at(level, log_loss):
    """Return the number of robots to a log loss first reached, interpolated between two."""
    lowest = np.minimum.accumulate(log_loss)
    after = int(np.flatnonzero(lowest <= level)[0])
    if after == 0:
        return 0.0
    return after - 1 + (lowest[after - 1] - level) / (lowest[after - 1] - lowest[after])


def test_the_robots_to_the_same_log_loss(compared):
    (row,) = BY_BASE.summarise(compared)['rows']
    one, two = (
        compared.series(0.9, 'kappa_bnitp', 'hazard_log_loss', 'target_log_loss', team=team)
        for team in BASES
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


@for_each('teams, names', [
    (OBJECTIVES, {'objective'}), (OBJECTIVES[::2], {'loss_cost'}), (MAPS, {'survey'}),
    (COSTS, {'loss_cost'}), (SIZES, {'size'}), (BASES, {'base'}),
    ((NONE, Strategy(2, loss_cost=0.1)), set()),
    ((NONE, Strategy(survey=0.9, loss_cost=1)), set()),
    ((*OBJECTIVES, Strategy(agents=2)), set()), ((NONE, Strategy(last_contact=0.1)), set()),
    ((Strategy(2, 'voronoi'), Strategy(2, 'greedy')), set()),
    *((each[:1], set()) for each in (OBJECTIVES, MAPS, COSTS, SIZES, BASES)),
])  # fmt: skip
def test_compared_strategies_differ_in_one_option(scenario, teams, names):
    among = replace(scenario, teams=teams)
    found = {
        'objective': differ_in_objective(among),
        'loss_cost': differ_only_in(among, 'loss_cost'),
        'survey': differ_only_in(among, 'survey', 'trusted'),
        'size': differ_in_size(among),
        'base': BY_BASE.applies(among),
    }
    assert {name for name, differ in found.items() if differ} == names


def test_bases_differ_and_nothing_else_does(compared):
    scenario = compared.scenario
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
    for second, told in ((11, 'second_base is 11 and agents is 1'), (99, 'base is 99.*from 0 to')):
        agents = 1 if second == 11 else 2
        with pytest.raises(ValueError, match=told):
            parse_scenario({**CONTENT, 'teams': [{'agents': agents, 'second_base': second}]})
