# SPDX-License-Identifier: Apache-2.0
"""A trial is a mission of the core, measured after every robot, perhaps with a prior map."""

from dataclasses import replace

from kbnitp_ros.core import (
    Belief,
    brier_score,
    Grid,
    log_loss,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Truth,
    World,
)
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import list_trials, MEASURES, run_trial, surveyed, Trial
from laws import for_each
import numpy as np
import pytest


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


def column(outcome, name):
    return outcome.measures[:, MEASURES.index(name)]


@for_each('method', ['relaxed_bnitp', 'kappa_bnitp'])
def test_the_measures_are_those_of_the_mission(scenario, method):
    trial = Trial(0.9, method, 2)
    outcome = run_trial(scenario, trial)
    world, prior, mission = fly(scenario, trial)
    first = prior.independent() if method == 'relaxed_bnitp' else prior
    beliefs = [first, *(deployment.belief for deployment in mission)]
    assert column(outcome, 'entropy').tolist() == [b.entropy() for b in beliefs]
    assert column(outcome, 'joint_entropy').tolist() == [b.joint_entropy() for b in beliefs]
    np.testing.assert_allclose(
        column(outcome, 'entropy_hazard') + column(outcome, 'entropy_target'),
        column(outcome, 'entropy'),
    )
    for name in ('hazard', 'target'):
        maps, truth = [getattr(b, name) for b in beliefs], getattr(world, name)
        losses = [log_loss(p, truth) for p in maps]
        assert column(outcome, f'{name}_log_loss').tolist() == losses
        assert column(outcome, f'{name}_brier').tolist() == [brier_score(p, truth) for p in maps]
    fates = [deployment.observation.survived for deployment in mission]
    assert column(outcome, 'robots_lost').tolist() == [
        fates[:robots].count(False) for robots in range(len(fates) + 1)
    ]
    planned = column(outcome, 'planned_information')
    assert np.isnan(planned[0])
    assert planned[1:].tolist() == [deployment.plan.information for deployment in mission]
    realised = column(outcome, 'realised_information')
    assert np.isnan(realised[0])
    assert realised[1] == first.joint_entropy() - mission[0].belief.joint_entropy()
    assert outcome.believed.tolist() == [
        mission[-1].belief.hazard.tolist(),
        mission[-1].belief.target.tolist(),
    ]
    assert outcome.truth.tolist() == [world.hazard.tolist(), world.target.tolist()]


def test_trials_of_one_number_share_their_world(results):
    worlds = {}
    for trial, outcome in results.outcomes.items():
        worlds.setdefault(trial.number, set()).add(outcome.truth.tobytes())
    assert [len(same) for same in worlds.values()] == [1, 1, 1]
    assert len(set.union(*worlds.values())) == 3


def test_methods_share_the_fate_of_the_first_robot(results):
    """They plan on the same belief until evidence separates them."""
    for number in range(3):
        for measure in ('planned_information', 'robots_lost'):
            exact, published = (
                results.series(0.2, method, measure)[number, 1]
                for method in ('kappa_bnitp', 'kappa_bnitp_published')
            )
            assert exact == published


@for_each('team, believed', [(Strategy(3, 'voronoi', 0.1), None), (Strategy(), 1.0)])
def test_a_team_leaves_together_and_the_believed_lethality_may_be_wrong(scenario, team, believed):
    trial = Trial(0.2, 'kappa_bnitp', 1, team)
    outcome = run_trial(replace(scenario, believed_lethality=believed), trial)
    _, _, mission = fly(scenario, trial, believed)
    assert outcome.believed[0].tolist() == mission[-1].belief.hazard.tolist()
    alone = run_trial(scenario, Trial(0.2, 'kappa_bnitp', 1))
    assert outcome.believed.tolist() != alone.believed.tolist()
    assert outcome.truth.tolist() == alone.truth.tolist()


def test_the_trials_are_all_combinations(scenario):
    trials = list_trials(scenario)
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
