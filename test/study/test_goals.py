# SPDX-License-Identifier: Apache-2.0
"""Missions that are asked for a decision are compared by how they come to it."""

from dataclasses import replace
from itertools import product
import json

from kbnitp_ros.core import Area, Estimator, HazardDraws, Lane
from kbnitp_ros.core.decision.decision import FEWEST_LEFT_OUT
from kbnitp_ros.study.comparison import AREAS, CERTIFICATES, COMPARISONS, LANES, write_report
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Asked, SafestLane, Strategy
from kbnitp_ros.study.scenario_file import read_scenario, scenario_file, scenario_of
from kbnitp_ros.study.trial import DECLARED, measures_of, OF_GOALS, run_trial, Trial, trials_of
import numpy as np
import pytest
from small_study import CONTENT, run

pytestmark = pytest.mark.slow

GOAL = 11
LANE = (Strategy(), Strategy(goal='safest_lane'), Strategy(goal='lane'))
METHOD = 'kappa_bnitp'


@pytest.fixture(scope='module')
def asked(scenario):
    """Return a scenario that asks for a lane."""
    return replace(
        scenario,
        methods=(METHOD,),
        lethalities=(0.5,),
        robots=12,
        teams=LANE,
        asked=Asked('lane', (GOAL,)),
    )


@pytest.fixture(scope='module')
def lanes(asked):
    return run(asked)


@pytest.fixture(scope='module')
def certificates(asked):
    sure = replace(asked, trials=12, teams=LANE[2:], asked=Asked('lane', (GOAL,), 0.95))
    return run(sure)


def series(results, name, team):
    return results.series(0.5, METHOD, name, team=team)


def test_every_strategy_is_asked_for_the_same_decision(asked, lanes):
    for number, team in product(range(asked.trials), asked.teams):
        outcome = lanes.outcomes[Trial(0.5, METHOD, number, team)]
        measured = dict(zip(measures_of(asked), outcome.measures.T))
        hazard = outcome.truth[0]
        truth = asked.truth(0.5, number)
        prior = Estimator(asked.belief(truth), asked.model(truth), METHOD, seed=number)
        draws = HazardDraws.of(prior, 0)
        first = Lane(GOAL).decide(asked.field(), draws, prior.model, asked.planning.max_steps)
        assert measured['p_free'][0] == first.p_free
        assert measured['free'][0] == (not hazard[first.path].any())
        assert set(measured['free']) <= {0.0, 1.0}
        if hazard[GOAL]:
            assert not measured['free'].any()
        # Nothing is declared of a cell but that it is free at the probability for that.
        declared = outcome.believed[0, GOAL] <= 1.0 - DECLARED
        assert measured['declared'][-1] == declared
        assert measured['declared_free'][-1] == (declared and not hazard[GOAL])
        assert measured['sent'].tolist() == list(range(13))


def test_lanes_are_compared_with_those_of_the_first_strategy(lanes):
    rows = LANES.summarise(lanes)['rows']
    assert [(row['label'], row['robots']) for row in rows] == [
        (f'goal {goal}', robots) for goal in ('map', 'safest_lane', 'lane') for robots in (10, 12)
    ]
    for row, (team, robots) in zip(rows, product(LANE, (10, 12)), strict=True):
        free, first = (series(lanes, 'free', of)[:, robots] for of in (team, LANE[0]))
        assert row['free']['mean'] == pytest.approx(free.mean(), abs=1e-6)
        assert row['difference']['mean'] == pytest.approx((free - first).mean(), abs=1e-6)
        believed = series(lanes, 'p_free', team)[:, robots]
        assert row['believed']['mean'] == pytest.approx(believed.mean(), abs=1e-6)


def test_missions_that_stop_are_told_by_what_they_state(certificates):
    [team] = certificates.scenario.teams
    rows = CERTIFICATES.summarise(certificates)['rows']
    assert [row['confidence'] for row in rows] == [0.9, 0.95]
    names = ('sent', 'p_free', 'free', 'independent_draws')
    sent, p_free, free, draws = (series(certificates, name, team) for name in names)
    assert (draws == 2048).all()
    for row in rows:
        stated, true, robots = [], [], []
        for mission in range(12):
            for after in range(13):
                if p_free[mission, after] >= row['confidence']:
                    stated.append(p_free[mission, after])
                    true.append(free[mission, after])
                    robots.append(after)
                    break
        assert row['stopped'] == len(stated) > 0
        assert row['stated']['mean'] == pytest.approx(np.mean(stated), abs=1e-6)
        assert row['free']['mean'] == pytest.approx(np.mean(true), abs=1e-6)
        assert row['sent']['mean'] == pytest.approx(np.mean(robots), abs=1e-6)
    # A mission that stopped is carried on as it was, and one that did not sent all robots.
    assert (sent[:, -1] < 12).any()
    for mission in range(12):
        end = int(sent[mission, -1])
        assert (p_free[mission, end:] == p_free[mission, end]).all()
        assert (p_free[mission, :end] < 0.95).all()
        assert end == 12 or p_free[mission, end] >= 0.95


def test_a_mission_that_stops_is_the_beginning_of_one_that_goes_on(asked, lanes, certificates):
    [team] = certificates.scenario.teams
    for number in range(asked.trials):
        stopped, whole = (
            of.outcomes[Trial(0.5, METHOD, number, team)].measures for of in (certificates, lanes)
        )
        place = measures_of(asked).index('sent')
        end = int(stopped[-1, place])
        np.testing.assert_array_equal(stopped[: end + 1], whole[: end + 1])


def test_too_few_draws_certify_nothing(certificates):
    changed = {}
    place = measures_of(certificates.scenario).index('independent_draws')
    for trial, outcome in certificates.outcomes.items():
        measures = outcome.measures.copy()
        measures[:, place] = FEWEST_LEFT_OUT / 0.07
        changed[trial] = outcome._replace(measures=measures)
    rows = CERTIFICATES.summarise(Results(certificates.scenario, changed))['rows']
    assert [row['confidence'] for row in rows] == [0.9]


def test_areas_are_told_by_how_many_robots_declare_most_of_them(asked):
    """The rows agree with measures written by hand."""
    area = replace(
        asked, trials=2, teams=(Strategy(), Strategy(goal='area')), asked=Asked('area', (3, GOAL))
    )
    names = measures_of(area)
    declared = {
        (LANE[0], 0): [0.0] * 4 + [0.8] * 4 + [0.5] * 5,
        (LANE[0], 1): [0.0] * 13,
        (Strategy(goal='area'), 0): [0.0] * 2 + [1.0] * 11,
        (Strategy(goal='area'), 1): [0.0] * 12 + [0.9],
    }
    outcomes = {}
    for trial in trials_of(area):
        outcome = run_trial(area, trial)
        measures = outcome.measures.copy()
        measures[:, names.index('declared')] = declared[trial.team, trial.number]
        measures[:, names.index('declared_free')] = 0.5 * measures[:, names.index('declared')]
        measures[:, names.index('robots_lost')] = np.arange(13)
        outcomes[trial] = outcome._replace(measures=measures)
    first, second = AREAS.summarise(Results(area, outcomes))['rows']

    def means(row):
        names = ('reached', 'needed', 'difference', 'lost', 'declared', 'wrong')
        return [row[name]['mean'] for name in names]

    assert means(first) == pytest.approx([0.5, 8.0, 0.0, 8.0, 0.25, 0.125])
    assert means(second) == pytest.approx([1.0, 7.0, -1.0, 7.0, 0.95, 0.475])


def test_the_report_has_one_table_and_a_figure_of_it(lanes, certificates, tmp_path):
    for results, comparison in ((lanes, LANES), (certificates, CERTIFICATES)):
        folder = tmp_path / comparison.name
        folder.mkdir()
        write_report(results, folder)
        summary = json.loads((folder / 'summary.json').read_text())
        names = {each.name for each in COMPARISONS} & summary.keys()
        assert names == {comparison.name}
        told = comparison.table(summary[comparison.name]).markdown()
        assert (folder / 'summary.md').read_text().endswith(told)
        assert (folder / 'decision.png').stat().st_size > 0


def test_without_a_decision_nothing_of_it_is_measured(scenario, results):
    assert not set(OF_GOALS) & set(results.table().column_names)
    assert results.table().column('goal').unique().to_pylist() == ['map']


@pytest.mark.parametrize('changes, named', [
    ({'teams': [{'goal': 'lane'}]}, 'asked: robots are sent for lane, and nothing is asked'),
    (
        {'asked': {'goal': 'area', 'cells': [3]}, 'teams': [{'goal': 'lane'}]},
        'sent for lane, and area is asked',
    ),
    ({'asked': {'goal': 'map', 'cells': [3]}}, 'goal map has no such thing as cells'),
    ({'asked': {'goal': 'lane', 'cells': [3, 4]}}, 'goal lane has 2 cells'),
    ({'asked': {'goal': 'lane', 'cells': [12]}}, 'asked: goal is cell 12, off the map'),
    ({'asked': {'goal': 'lane', 'cells': [5]}}, 'asked: goal is cell 5, the base'),
    ({'asked': {'goal': 'lane', 'cells': [3], 'confidence': 0.999}}, 'independent draws'),
    ({'asked': {'goal': 'lane', 'cells': [3], 'confidence': 1.0}}, 'confidence is 1.0'),
])  # fmt: skip
def test_what_does_not_fit_is_refused(changes, named):
    with pytest.raises(ValueError, match=named):
        scenario_of({**CONTENT, **changes})


@pytest.mark.parametrize('name, goals', [
    ('lanes', [type(None), SafestLane, Lane]),
    ('lanes_learning', [type(None), SafestLane, Lane]),
    ('certificates', [Lane]),
    ('certificates_learning', [Lane]),
    ('certificates_clustered', [Lane]),
    ('areas', [type(None), Area, type(None), type(None)]),
])  # fmt: skip
def test_shipped_scenarios_send_robots_for_goals(name, goals):
    scenario = read_scenario(scenario_file(name))
    assert [type(scenario.goal(team)) for team in scenario.teams] == goals
