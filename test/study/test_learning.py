# SPDX-License-Identifier: Apache-2.0
"""Studies of unknown parameters."""

from dataclasses import replace

from kbnitp_ros.core import (
    Belief,
    Beta,
    Learning,
    run_mission,
    SearchOptions,
    SensorModel,
    Unknowns,
    World,
)
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import drawn_from, LEARNING, SAMPLED
from kbnitp_ros.study.scenario_file import read_study
from kbnitp_ros.study.trial import run_trial, Trial
from laws import for_each
import numpy as np
import pytest
import small_study

pytestmark = pytest.mark.slow

PRIORS = {'lethality': {'low': 0.1, 'high': 1.0}, 'malfunction': {'a': 2.0, 'b': 30.0}}
LEARNT_STUDY = {
    **small_study.CONTENT,
    'methods': ['kappa_bnitp', LEARNING, SAMPLED],
    'learn': PRIORS,
}
# Draws every parameter that can be learnt.
DRAWN_STUDY = {
    **LEARNT_STUDY,
    'methods': [LEARNING, SAMPLED],
    'lethalities': [None],
    'world': dict.fromkeys(('hazard_density', 'kappa', 'target_background')),
    'sensor': {
        'malfunction': None,
        'false_negative': 0.05,
        'true_positive': None,
        'false_positive': None,
    },
    'prior': None,
    'learn': {
        **PRIORS,
        'hazard_density': {'a': 1.5, 'b': 5.0},
        'kappa': {'a': 4.0, 'b': 1.5},
        'target_background': {'high': 0.3},
        'true_positive': {'a': 9.0},
        'false_positive': {'b': 9.0},
    },
}


def study(tmp_path, content):
    return read_study(small_study.write(tmp_path / 'scenario.yaml', content))


@pytest.fixture(scope='module')
def learnt(tmp_path_factory):
    """Return a study that learns numbers, and its outcomes."""
    found = study(tmp_path_factory.mktemp('learnt'), LEARNT_STUDY)
    return found, small_study.run(found)


@pytest.fixture(scope='module')
def drawn(tmp_path_factory):
    """Return a study with drawn numbers, and its outcomes."""
    found = study(tmp_path_factory.mktemp('drawn'), DRAWN_STUDY)
    return found, small_study.run(found)


@for_each('believed', [None, 1.0])
def test_the_learning_method_knows_the_other_numbers(learnt, believed):
    scenario = replace(learnt[0].first, believed_lethality=believed)
    outcome = run_trial(small_study.single(scenario), Trial(0.9, LEARNING, 2))
    rng = np.random.default_rng([7, 2])
    world = World.random(scenario.field(), rng, 0.3, 0.8, 0.1)
    mission = run_mission(
        scenario.field(),
        Belief.prior(scenario.field(), 0.3, 0.31, 0.8),
        SensorModel(0.9),
        world,
        4,
        rng,
        SAMPLED,
        SearchOptions('relaxed', max_steps=6, max_visits=2),
        learning=Learning(Unknowns(lethality=(0.1, 1.0), malfunction=Beta(2.0, 30.0)), seed=2),
    )
    assert outcome['entropy'].iloc[-1] == mission[-1].belief.entropy()
    known = mission[-1].parameters['lethality']
    expected = [known.mean, known.sd, known.quantile(0.05), known.quantile(0.95), 0.9]
    assert outcome.iloc[-1].filter(like='lethality_').tolist() == expected


def test_only_the_learning_method_has_learnt_numbers(learnt):
    found, outcomes = learnt
    for trial, outcome in outcomes.items():
        for name in PRIORS:
            assert (f'{name}_mean' in outcome) == (trial.method == LEARNING)
    measures = Results.of(found, outcomes).measures
    assert 'lethality_mean' in measures
    assert 'kappa_mean' not in measures


def test_numbers_are_drawn_by_world_and_known_to_informed_methods(drawn):
    found, outcomes = drawn
    scenario = found.first
    worlds = [scenario.truth(None, number) for number in range(3)]
    assert len({world['kappa'] for world in worlds}) == 3
    for number, truth in enumerate(worlds):
        assert truth['false_negative'] == 0.05
        assert 0.1 <= truth['lethality'] <= 1.0
        assert truth['target_background'] <= 0.3
        outcome = outcomes[Trial(None, LEARNING, number)]
        for name in scenario.learn.priors:
            values = outcome[f'{name}_true']
            assert set(values.tolist()) == {truth[name]}
    prior = scenario.belief(worlds[1])
    assert prior.hazard[0] == worlds[1]['hazard_density']
    assert prior.kappa[0] == pytest.approx(worlds[1]['kappa'])
    safe = prior.joint[0, 0]
    assert safe[1] / safe.sum() == pytest.approx(worlds[1]['target_background'])


def test_the_table_says_how_often_the_truth_is_within_the_quantiles(drawn):
    """By the cell of docs/files.md."""
    found, outcomes = drawn
    table = Results.of(found, outcomes).to_dataframe()
    assert set(table['lethality']) == {'null'}
    keys = ['strategy', 'world', 'robot']
    wide = table.pivot(index=keys, columns='measure', values='value').reset_index()
    last = wide[(wide['strategy'] == LEARNING) & (wide['robot'] == 4)]
    low, high, true = (last[f'kappa_{what}'] for what in ('5', '95', 'true'))
    assert (low < high).all()
    assert true.between(low, high).mean() in (0.0, 1 / 3, 2 / 3, 1.0)
    assert true.tolist() == [found.first.truth(None, number)['kappa'] for number in range(3)]


def test_numbers_are_drawn_from_their_priors():
    rng = np.random.default_rng(0)
    for prior, mean, sd in (
        (Beta(low=0.2, high=0.8), 0.5, 0.6 / 12**0.5),
        (Beta(2.0, 30.0), 2 / 32, (2 * 30 / (32**2 * 33)) ** 0.5),
    ):
        sample = [drawn_from(prior, rng) for _ in range(4000)]
        assert np.mean(sample) == pytest.approx(mean, abs=4 * sd / 4000**0.5)
        assert np.std(sample) == pytest.approx(sd, rel=0.05)
        assert prior.low <= min(sample) < max(sample) <= prior.high


@for_each('changes, complaint', [
    ({'learn': None}, 'learn is None'),
    ({'learn': {}}, f'learn: {LEARNING} has nothing to learn'),
    ({'learn': {'lethalty': {}}}, 'learn.lethalty is unknown: learn has lethality, malf'),
    ({'learn': {'lethality': {'low': 0.9, 'high': 0.1}}}, 'learn.lethality: interval is from'),
    ({'learn': {'lethality': {'a': 0}}}, r'learn.lethality.a is 0.*from 0\.01 to'),
    ({'learn': {'lethality': 0.5}}, 'learn.lethality is 0.5: it must have the keys a, b'),
    ({'lethalities': [None], 'learn': {'kappa': {}}},
     'learn: lethality has neither a value nor a prior'),
    ({'world': {**small_study.CONTENT['world'], 'kappa': None}},
     'learn: kappa has neither a value nor a prior'),
])  # fmt: skip
def test_bad_numbers_to_learn_are_refused(tmp_path, changes, complaint):
    with pytest.raises(ValueError, match=f'scenario.yaml: {complaint}'):
        study(tmp_path, {**LEARNT_STUDY, **changes})
