# SPDX-License-Identifier: Apache-2.0
"""Value of goals, and of the belief in a kind of hazards."""

from dataclasses import replace
from itertools import product
import json

from kbnitp_ros.core import Estimator, Grid, HazardDraws, Lane, log_loss, Mission
from kbnitp_ros.core.decision.decision import FEWEST_LEFT_OUT
from kbnitp_ros.study import trial as running
from kbnitp_ros.study.comparison import (
    AREAS,
    BY_KIND,
    CERTIFICATES,
    LANES,
    OF_HAZARDS,
    write_report,
)
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import DecisionRequest, Hazards, Strategy, team_labels
from kbnitp_ros.study.scenario_file import parse_scenario
from kbnitp_ros.study.trial import (
    blobs,
    DECLARED,
    draw_world,
    list_trials,
    measure_names,
    rows,
    run_trial,
    Trial,
)
from laws import for_each
import numpy as np
import pytest
from small_study import changed, CONTENT, run

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
        asked=DecisionRequest('lane', (GOAL,)),
    )


@pytest.fixture(scope='module')
def lanes(asked):
    return run(asked)


@pytest.fixture(scope='module')
def certificates(asked):
    sure = replace(asked, trials=12, teams=LANE[2:], asked=DecisionRequest('lane', (GOAL,), 0.95))
    return run(sure)


def series(results, name, team):
    return results.series(0.5, METHOD, name, team=team)


@pytest.mark.slow
def test_every_strategy_is_asked_for_the_same_decision(asked, lanes):
    for number, team in product(range(asked.trials), asked.teams):
        outcome = lanes.outcomes[Trial(0.5, METHOD, number, team)]
        measured = dict(zip(measure_names(asked), outcome.measures.T))
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
        # A cell is declared free only, at the required probability.
        declared = outcome.believed[0, GOAL] <= 1.0 - DECLARED
        assert measured['declared'][-1] == declared
        assert measured['declared_free'][-1] == (declared and not hazard[GOAL])
        assert measured['sent'].tolist() == list(range(13))


@pytest.mark.slow
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


@pytest.mark.slow
def test_stopped_missions_have_the_stated_numbers(certificates):
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
    # A stopped mission keeps its last values; one that did not stop sent all robots.
    assert (sent[:, -1] < 12).any()
    for mission in range(12):
        end = int(sent[mission, -1])
        assert (p_free[mission, end:] == p_free[mission, end]).all()
        assert (p_free[mission, :end] < 0.95).all()
        assert end == 12 or p_free[mission, end] >= 0.95


@pytest.mark.slow
def test_a_stopped_mission_is_the_start_of_a_longer_one(asked, lanes, certificates):
    [team] = certificates.scenario.teams
    for number in range(asked.trials):
        stopped, whole = (
            of.outcomes[Trial(0.5, METHOD, number, team)].measures for of in (certificates, lanes)
        )
        place = measure_names(asked).index('sent')
        end = int(stopped[-1, place])
        np.testing.assert_array_equal(stopped[: end + 1], whole[: end + 1])


@pytest.mark.slow
def test_too_few_draws_certify_nothing(certificates):
    changed = {}
    place = measure_names(certificates.scenario).index('independent_draws')
    for trial, outcome in certificates.outcomes.items():
        measures = outcome.measures.copy()
        measures[:, place] = FEWEST_LEFT_OUT / 0.07
        changed[trial] = outcome._replace(measures=measures)
    rows = CERTIFICATES.summarise(Results(certificates.scenario, changed))['rows']
    assert [row['confidence'] for row in rows] == [0.9]


@pytest.mark.slow
def test_areas_are_measured_by_the_robots_to_declare_most_cells(asked):
    """The rows agree with independent measures."""
    area = replace(
        asked,
        trials=2,
        teams=(Strategy(), Strategy(goal='area')),
        asked=DecisionRequest('area', (3, GOAL)),
    )
    names = measure_names(area)
    declared = {
        (LANE[0], 0): [0.0] * 4 + [0.8] * 4 + [0.5] * 5,
        (LANE[0], 1): [0.0] * 13,
        (Strategy(goal='area'), 0): [0.0] * 2 + [1.0] * 11,
        (Strategy(goal='area'), 1): [0.0] * 12 + [0.9],
    }
    outcomes = {}
    for trial in list_trials(area):
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


@pytest.mark.slow
@pytest.mark.parametrize('changes, named', [
    ({'teams': [{'goal': 'lane'}]}, 'asked: robots are sent for the goal lane: give its cells'),
    (
        {'asked': {'goal': 'area', 'cells': [3]}, 'teams': [{'goal': 'lane'}]},
        'flies for lane, but the study asks for area',
    ),
    ({'asked': {'goal': 'map', 'cells': [3]}}, 'goal map takes no cells'),
    ({'asked': {'goal': 'lane', 'cells': [3, 4]}}, 'goal lane has 2 cells'),
    ({'asked': {'goal': 'lane', 'cells': [12]}}, 'asked: goal is cell 12, off the map'),
    ({'asked': {'goal': 'lane', 'cells': [3], 'confidence': 0.999}}, 'independent draws'),
])  # fmt: skip
def test_inconsistent_goals_are_refused(changes, named):
    with pytest.raises(ValueError, match=named):
        parse_scenario({**CONTENT, **changes})


RIGHT, STATIC, SAME = (Strategy(), Strategy(dynamics='static'), Strategy(paths='static'))
KINDS = {'changing': Hazards('changing', appear=0.1, vanish=0.3), 'used_up': Hazards('used_up')}


def of_kind(scenario, kind, teams=(RIGHT, STATIC, SAME)):
    """Return a study of one method in worlds of a kind."""
    return replace(
        scenario,
        hazards=KINDS[kind],
        teams=teams,
        methods=('kappa_bnitp',),
        lethalities=(0.9,),
        robots=12,
    )


@for_each('kind', KINDS)
def test_beliefs_are_scored_by_the_field_of_their_time(scenario, kind, monkeypatch):
    scenario, missions = of_kind(scenario, kind), []

    def keeping(*arguments, **options):
        missions.append(original(*arguments, **options))
        return missions[-1]

    original = Mission.run
    monkeypatch.setattr(Mission, 'run', keeping)
    outcome = run_trial(scenario, Trial(0.9, 'kappa_bnitp', 1, RIGHT))
    (mission,) = missions
    fields = [deployment.world.hazard.tolist() for deployment in mission]
    assert len(set(map(tuple, fields))) > 1
    losses = outcome.measures[1:, running.MEASURES.index('hazard_log_loss')]
    assert losses == pytest.approx([log_loss(e.belief.hazard, e.world.hazard) for e in mission])
    assert outcome.truth[0].tolist() == fields[-1]


@for_each('kind', KINDS)
def test_the_same_paths_give_the_same_evidence(scenario, kind):
    scenario = of_kind(scenario, kind)
    static, same = (run_trial(scenario, Trial(0.9, 'kappa_bnitp', 1, t)) for t in (STATIC, SAME))
    lost = running.MEASURES.index('robots_lost')
    assert (same.measures[:, lost] == static.measures[:, lost]).all()
    assert (same.truth == static.truth).all()
    assert not np.array_equal(same.believed, static.believed)
    # In worlds of static hazards all beliefs are equal.
    still = replace(scenario, hazards=Hazards())
    a, b, c = (run_trial(still, Trial(0.9, 'kappa_bnitp', 1, team)) for team in scenario.teams)
    assert a.believed.tobytes() == b.believed.tobytes() == c.believed.tobytes()
    assert a.measures.tobytes() == b.measures.tobytes() == c.measures.tobytes()


@pytest.mark.slow
def test_each_belief_is_compared_with_the_first(scenario, tmp_path):
    scenario = of_kind(scenario, 'used_up', (RIGHT, STATIC))
    results = run(scenario)
    write_report(results, tmp_path)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert (summary['kinds']['first'], summary['kinds']['robots']) == ('used up', [12])
    (row,) = summary['kinds']['rows']
    total = [
        results.series(0.9, 'kappa_bnitp', 'hazard_log_loss', 'target_log_loss', team=team)[:, -1]
        for team in (STATIC, RIGHT)
    ]
    assert row['believed'] == 'static'
    assert row['difference'][0]['mean'] == pytest.approx((total[0] - total[1]).mean(), abs=1e-6)
    for row, team in zip(summary['hazards']['rows'], (RIGHT, STATIC), strict=True):
        series = results.series(0.9, 'kappa_bnitp', 'hazard_log_loss', team=team)
        mean = row['hazard_log_loss'][0]['mean']
        assert mean == pytest.approx(series[:, -1].mean(), abs=1e-6)
    told = [each.table(summary[each.name]).markdown() for each in (OF_HAZARDS, BY_KIND)]
    assert (tmp_path / 'summary.md').read_text().endswith('\n'.join(told))


def test_rows_are_named_by_the_belief(scenario):
    scenario = of_kind(scenario, 'used_up')
    labels = 'used up, own paths', 'static, own paths', 'used up, static paths'
    assert tuple(team_labels(scenario).values()) == labels
    clustered = replace(scenario, teams=(RIGHT, Strategy(clustering='learn')))
    assert tuple(team_labels(clustered).values()) == ('independent', 'clustered')


@for_each('key, value, told', [
    ('hazards', {'dynamics': 'odd'}, "'odd': it must be one of static, changing, used_up"),
    ('hazards', {'appear': 0.1}, 'hazards: appear is 0.1: neither worlds nor teams have changing'),
    ('hazards', {'dynamics': 'changing'}, 'hazards: changing hazards need a rate'),
    ('hazards', {'layout': 'odd'}, "'odd': it must be one of independent, blobs, rows"),
    ('hazards', {'dynamics': 'used_up'}, 'hazards: .* does not take hazards that are used_up'),
    ('teams', [{'clustering': 'learn'}], 'hazards: .* does not take clustered hazards'),
    ('teams', [{'objective': 'odd'}], "'odd': it must be one of information, behavioral"),
])  # fmt: skip
def test_dynamics_that_no_method_supports_are_refused(key, value, told):
    with pytest.raises(ValueError, match=told):
        parse_scenario(changed(key, value))


@for_each('lay_out', [blobs, rows])
def test_hazards_lie_closer_than_by_chance(lay_out):
    together = 0
    for seed in range(100):
        hazard = lay_out(Grid(9, 9), 12, np.random.default_rng(seed)).reshape(9, 9)
        assert hazard.sum() == 12
        together += (hazard[1:] & hazard[:-1]).sum() + (hazard[:, 1:] & hazard[:, :-1]).sum()
        together += (hazard[1:, 1:] & hazard[:-1, :-1]).sum()
        together += (hazard[1:, :-1] & hazard[:-1, 1:]).sum()
    # Of 2 * 72 pairs of cells that share a side and 2 * 64 that share a corner.
    assert together / 100 > 1.5 * 272 * (12 / 81) * (11 / 80)


@for_each('layout', ['blobs', 'rows'])
def test_a_layout_changes_hazards_and_no_other_draw(scenario, layout):
    laid_out = replace(scenario, hazards=Hazards(layout=layout))
    truth = scenario.truth(0.9, 0)
    worlds, left = [], []
    for study in (scenario, laid_out):
        rng = np.random.default_rng(3)
        worlds.append(draw_world(study, study.field(), truth, rng, 0))
        left.append(rng.random())
    assert left[0] == left[1]
    worlds[1].check(laid_out.field())
    assert not np.array_equal(worlds[0].hazard, worlds[1].hazard)
