# SPDX-License-Identifier: Apache-2.0
"""A trial is a mission of the core, measured after every robot, perhaps with a prior map."""

from dataclasses import replace
from itertools import pairwise

from kbnitp_ros.core import (
    Belief,
    brier_score,
    Dynamics,
    Grid,
    Learning,
    log_loss,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Truth,
    Unknowns,
    World,
)
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.scenario_file import parse_study
from kbnitp_ros.study.trial import (
    list_trials,
    NEVER,
    run_trial,
    surveyed,
    Trial,
    without_ties,
)
from laws import for_each
import numpy as np
import pytest
from small_study import CONTENT, single


def fly(scenario, trial, believed=None):
    """Return the world and the mission, from the core alone."""
    rng = np.random.default_rng([scenario.seed, trial.number])
    grid = scenario.field()
    world = World.random(grid, rng, 0.3, 0.8, 0.1)
    model = SensorModel(trial.lethality)
    prior = Belief.prior(grid, 0.3, 0.31, 0.8)
    mission = run_mission(
        grid,
        prior,
        model if believed is None else SensorModel(believed),
        world,
        scenario.robots,
        rng,
        trial.method,
        SearchOptions('relaxed', max_steps=6, max_visits=2, loss_cost=trial.team.loss_cost),
        team=Team(trial.team.agents, trial.team.allocation),
        truth=Truth(model),
    )
    return world, prior, mission


@for_each('method', ['relaxed_bnitp', 'kappa_bnitp'])
def test_the_measures_are_those_of_the_mission(scenario, method):
    trial = Trial(0.9, method, 2)
    outcome = run_trial(single(scenario), trial)
    world, prior, mission = fly(scenario, trial)
    first = prior.independent() if method == 'relaxed_bnitp' else prior
    beliefs = [first, *(deployment.belief for deployment in mission)]
    assert outcome['entropy'].tolist() == [b.entropy() for b in beliefs]
    assert outcome['joint_entropy'].tolist() == [b.joint_entropy() for b in beliefs]
    np.testing.assert_allclose(
        outcome['entropy_hazard'] + outcome['entropy_target'],
        outcome['entropy'],
    )
    total = np.zeros(len(beliefs))
    for name in ('hazard', 'target'):
        maps, truth = [getattr(b, name) for b in beliefs], getattr(world, name)
        losses = [log_loss(p, truth) for p in maps]
        assert outcome[f'{name}_log_loss'].tolist() == losses
        total += losses
        assert outcome[f'{name}_brier'].tolist() == [brier_score(p, truth) for p in maps]
    fates = [deployment.observation.survived for deployment in mission]
    assert outcome['robots_lost'].tolist() == [
        fates[:robots].count(False) for robots in range(len(fates) + 1)
    ]
    planned = outcome['planned_information']
    assert np.isnan(planned[0])
    assert planned[1:].tolist() == [deployment.plan.information for deployment in mission]
    realised = outcome['realised_information']
    assert np.isnan(realised[0])
    assert realised[1] == first.joint_entropy() - mission[0].belief.joint_entropy()
    assert outcome['log_loss'].tolist() == total.tolist()
    alone = world.hazard & ~world.target
    assert outcome['false_targets'].tolist() == pytest.approx(
        [b.target[alone].sum() for b in beliefs]
    )
    assert len(outcome) == len(beliefs)


def test_beliefs_are_compared_with_the_truth_by_classes_of_probability(scenario):
    trial = Trial(0.9, 'kappa_bnitp', 2)
    outcome = run_trial(single(scenario), trial)
    world, _, mission = fly(scenario, trial)
    assert outcome.iloc[:-1].filter(regex='_[0-9]$').isna().all(axis=None)
    for name in ('hazard', 'target'):
        believed, truth = getattr(mission[-1].belief, name), getattr(world, name)
        for place in range(10):
            inside = (believed >= place / 10) & ((believed < (place + 1) / 10) | (place == 9))
            for what, expected in (
                ('cells', inside.sum()),
                ('expected', believed[inside].sum()),
                ('true', truth[inside].sum()),
            ):
                found = outcome[f'{name}_{what}_{place}'].iloc[-1]
                assert found == pytest.approx(expected)


def test_trials_of_one_number_share_their_world_and_the_fate_of_the_first_robot(outcomes):
    """Methods plan on the same belief until evidence separates them."""
    for number in range(3):
        exact, published = (
            outcomes[Trial(0.2, method, number)]
            for method in ('kappa_bnitp', 'kappa_bnitp_published')
        )
        for measure in ('planned_information', 'robots_lost'):
            assert exact[measure][1] == published[measure][1]
        hazards = [each.iloc[-1].filter(like='hazard_true_').sum() for each in (exact, published)]
        assert hazards[0] == hazards[1]


@for_each('team, believed', [(Strategy(3, 'voronoi', 0.1), None), (Strategy(), 1.0)])
def test_a_team_leaves_together_and_the_believed_lethality_may_be_wrong(scenario, team, believed):
    trial = Trial(0.2, 'kappa_bnitp', 1, team)
    changed = replace(scenario, believed_lethality=believed)
    outcome = run_trial(single(changed), trial)
    _, _, mission = fly(scenario, trial, believed)
    entropy = outcome['entropy']
    assert entropy[1:].tolist() == [deployment.belief.entropy() for deployment in mission]
    alone = run_trial(single(scenario), Trial(0.2, 'kappa_bnitp', 1))
    assert entropy.tolist() != alone['entropy'].tolist()


def test_choices_are_run_in_the_same_worlds():
    study = parse_study(CONTENT, {'max_visits': [1, 2], 'ties': ['first', 'random']})
    assert study.axes == ('max_visits', 'ties')
    trials = list_trials(study)
    assert len(trials) == 4 * 2 * 3 * 3
    found = {}
    for choices, scenario in study.scenarios.items():
        trial = Trial(0.9, 'kappa_bnitp', 1, choices=choices)
        assert trial in trials
        outcome = run_trial(study, trial)
        assert outcome.equals(run_trial(single(scenario), trial._replace(choices=())))
        found[choices] = outcome
    targets = {each.iloc[-1].filter(like='target_true_').sum() for each in found.values()}
    assert len(targets) == 1
    assert not found[1, 'first'].equals(found[1, 'random'])


def test_ties_are_broken_by_less_than_evidence_changes():
    broken = without_ties(PRIOR, 1, 2)
    assert broken.hazard[1:] == pytest.approx(PRIOR.hazard[1:], rel=2e-6)
    assert len(set(broken.hazard.tolist())) == GRID.cells
    assert broken.hazard[0] == 0.0


def test_the_trials_are_all_combinations(study):
    trials = list_trials(study)
    assert len(set(trials)) == len(trials) == 2 * 3 * 3
    assert trials[:4] == [
        Trial(0.2, 'relaxed_bnitp', 0),
        Trial(0.2, 'relaxed_bnitp', 1),
        Trial(0.2, 'relaxed_bnitp', 2),
        Trial(0.2, 'kappa_bnitp_published', 0),
    ]


GRID = Grid(40, 40)
WORLD = World.random(GRID, np.random.default_rng(3), 0.15, 0.8, 0.1)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)


@pytest.mark.slow
def test_a_map_has_the_stated_accuracy_and_trust():
    cells = np.arange(1, GRID.cells)
    for survey, trusted in ((0.7, 0.0), (0.9, 0.0), (0.5, 0.8)):
        belief = surveyed(PRIOR, WORLD, Strategy(survey=survey, trusted=trusted), 1, 2)
        told = belief.hazard[cells] > 0.15
        assert (told == WORLD.hazard[cells]).mean() == pytest.approx(survey, abs=0.04)
        odds = (trusted or survey) / (1 - (trusted or survey))
        expected = np.where(told, odds, 1 / odds) * 0.15 / 0.85
        assert belief.hazard[cells] == pytest.approx(expected / (1 + expected))
        assert belief.kappa == pytest.approx(PRIOR.kappa)
        assert belief.hazard[0] == 0.0
    assert surveyed(PRIOR, WORLD, Strategy(), 1, 2) is PRIOR


@pytest.mark.slow
def test_a_better_map_is_wrong_only_where_a_poorer_one_is():
    wrong = [
        (surveyed(PRIOR, WORLD, Strategy(survey=survey), 1, 2).hazard > 0.15) != WORLD.hazard
        for survey in (0.7, 0.9)
    ]
    assert (wrong[0] | ~wrong[1])[1:].all()


@for_each('method, changes, truth, unknowns, targets', [
    ('kappa_bnitp', {'sensor.reach': 0.3, 'believed.reach': 0.0}, {'reach': 0.3}, {}, 'static'),
    ('kappa_bnitp_learning', {'sensor.duds': 0.5, 'learn': {'duds': {'low': 0.0, 'high': 0.9}}},
     {'duds': 0.5}, {'duds': (0.0, 0.9)}, 'static'),
    ('kappa_bnitp', {'sensor.false_positive': 0.3, 'believed.false_positive': 0.05},
     {'false_positive': 0.3}, {}, 'static'),
    ('kappa_bnitp', {'targets': {'dynamics': 'moving', 'move': 0.5}}, {}, {}, 'learn'),
])  # fmt: skip
def test_fields_may_be_other_than_believed(method, changes, truth, unknowns, targets):
    team = {'teams': [{'target_dynamics': targets}]}
    study = parse_study(CONTENT, {**changes, **team, 'methods': [method], 'lethalities': [0.9]})
    scenario = study.first
    (*_, trial) = list_trials(study)
    outcome = run_trial(study, trial)
    rng, grid = np.random.default_rng([scenario.seed, trial.number]), scenario.field()
    world = World.random(grid, rng, 0.3, 0.8, 0.1)
    if 'duds' in truth:
        world = world.with_duds(0.5, np.random.default_rng([NEVER, scenario.seed, trial.number]))
    mission = run_mission(
        grid,
        Belief.prior(grid, 0.3, 0.31, 0.8),
        SensorModel(0.9),
        world,
        scenario.robots,
        rng,
        options=SearchOptions('relaxed', max_steps=6, max_visits=2),
        truth=Truth(SensorModel(0.9, **truth), target_dynamics=scenario.targets.truth),
        learning=Learning(Unknowns(**unknowns), trial.number),
        target_dynamics=Dynamics(targets),
    )
    assert outcome['entropy'].iloc[-1] == mission[-1].belief.entropy()
    assert outcome['hazard_log_loss'].iloc[-1] == log_loss(mission[-1].belief.hazard, world.hazard)
    if targets == 'learn':
        targets = [each.world.target for each in mission]
        assert any((one != other).any() for one, other in pairwise(targets))
