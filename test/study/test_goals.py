# SPDX-License-Identifier: Apache-2.0
"""Value of goals, and of the belief in a kind of hazards."""

from dataclasses import replace
from itertools import product

from kbnitp_ros.core import Estimator, Grid, Lane, log_loss, Mission
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import DecisionRequest, Hazards, Strategy
from kbnitp_ros.study.scenario_file import parse_scenario
from kbnitp_ros.study.trial import blobs, DECLARED, draw_world, rows, run_trial, Trial
from laws import for_each
import numpy as np
import pytest
from small_study import changed, CONTENT, run, single

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
    return run(single(asked))


@pytest.fixture(scope='module')
def certified(asked):
    """Return a study of missions that end at a confidence, and its outcomes."""
    study = single(
        replace(asked, trials=12, teams=LANE[2:], asked=DecisionRequest('lane', (GOAL,), 0.95))
    )
    return study, run(study)


@pytest.mark.slow
def test_every_strategy_is_asked_for_the_same_decision(asked, lanes):
    for number, team in product(range(asked.trials), asked.teams):
        outcome = lanes[Trial(0.5, METHOD, number, team)]
        names = ('p_free', 'free', 'declared', 'declared_free', 'sent')
        p_free, free, declared, declared_free, sent = (outcome[name] for name in names)
        truth = asked.truth(0.5, number)
        rng = np.random.default_rng([asked.seed, number])
        hazard = draw_world(asked, asked.field(), truth, rng, number).hazard
        prior = Estimator(asked.belief(truth), asked.model(truth), METHOD, seed=number)
        hazards = joint_hazards(prior, 0)
        first = Lane(GOAL).decide(asked.field(), hazards, prior.model, asked.planning.max_steps)
        assert p_free[0] == first.p_free
        assert free[0] == (not hazard[first.path].any())
        assert set(free) <= {0.0, 1.0}
        if hazard[GOAL]:
            assert not free.any()
        # Before the first robot no cell is declared free, and later rightly or wrongly.
        assert declared[0] == (prior.belief.hazard[GOAL] <= 1.0 - DECLARED) == 0.0
        assert (declared_free == declared * (not hazard[GOAL])).all()
        assert sent.tolist() == list(range(13))


@pytest.mark.slow
def test_the_table_says_how_often_certified_lanes_are_free(certified):
    """By the cell of docs/files.md."""
    study, outcomes = certified
    table = Results.of(study, outcomes).to_dataframe()
    wide = table.pivot(index=['world', 'robot'], columns='measure', values='value').reset_index()
    confidence = 0.9
    is_exact = wide['p_free_error'] <= (1 - confidence) / 2
    sure = wide[is_exact & (wide['p_free'] >= confidence)].groupby('world').first()
    stated, free, robots = [], [], []
    for outcome in outcomes.values():
        p_free = outcome['p_free']
        end = next((robot for robot in range(13) if p_free[robot] >= confidence), None)
        if end is not None:
            stated.append(p_free[end])
            free.append(outcome['free'][end])
            robots.append(end)
    assert sure['p_free'].tolist() == stated
    assert sure['free'].tolist() == free
    assert sure['robot'].tolist() == robots
    assert len(stated) > 0


@pytest.mark.slow
def test_a_stopped_mission_is_the_start_of_a_longer_one_and_keeps_its_last_values(
    asked, lanes, certified
):
    study, outcomes = certified
    [team] = study.first.teams
    for number in range(12):
        stopped = outcomes[Trial(0.5, METHOD, number, team)]
        sent, p_free = (stopped[name] for name in ('sent', 'p_free'))
        end = int(sent.iloc[-1])
        assert end == 12 or p_free[end] >= 0.95
        assert (p_free[:end] < 0.95).all()
        assert (p_free[end:] == p_free[end]).all()
        if number < asked.trials:
            whole = lanes[Trial(0.5, METHOD, number, team)]
            both = [each.loc[:end, :'declared_free'] for each in (stopped, whole)]
            assert both[0].equals(both[1])
    assert any(each['sent'].iloc[-1] < 12 for each in outcomes.values())


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
    outcome = run_trial(single(scenario), Trial(0.9, 'kappa_bnitp', 1, RIGHT))
    (mission,) = missions
    fields = [deployment.world.hazard.tolist() for deployment in mission]
    assert len(set(map(tuple, fields))) > 1
    losses = outcome['hazard_log_loss'][1:].tolist()
    assert losses == pytest.approx([log_loss(e.belief.hazard, e.world.hazard) for e in mission])


@for_each('kind', KINDS)
def test_the_same_paths_give_the_same_evidence(scenario, kind):
    scenario = of_kind(scenario, kind)
    trials = [Trial(0.9, 'kappa_bnitp', 1, team) for team in scenario.teams]
    _, static, same = (run_trial(single(scenario), trial) for trial in trials)
    lost, entropy = (
        [each[name].tolist() for each in (static, same)] for name in ('robots_lost', 'entropy')
    )
    assert lost[0] == lost[1]
    assert entropy[0] != entropy[1]
    # In worlds of static hazards all beliefs are equal.
    still = single(replace(scenario, hazards=Hazards()))
    first, *others = (run_trial(still, trial) for trial in trials)
    assert all(first.equals(each) for each in others)


@for_each('key, value, told', [
    ('hazards', {'dynamics': 'odd'}, "'odd': it must be one of static, changing, used_up"),
    ('hazards', {'appear': 0.1}, 'hazards: appear is 0.1: neither worlds nor teams have changing'),
    ('hazards', {'dynamics': 'changing'}, 'hazards: changing hazards need a rate'),
    ('hazards', {'layout': 'odd'}, "'odd': it must be one of independent, blobs, rows"),
    ('hazards', {'dynamics': 'used_up'}, 'hazards: .* does not take hazards that are used_up'),
    ('teams', [{'clustering': 'learn'}], 'hazards: .* does not take clustered hazards'),
    ('teams', [{'objective': 'odd'}], "'odd': it must be one of information, information_per"),
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
