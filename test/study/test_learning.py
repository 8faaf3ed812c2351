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
from kbnitp_ros.study.comparison import OF_LEARNING, OF_NUMBERS, study_figures
from kbnitp_ros.study.results import LOG_LOSS
from kbnitp_ros.study.scenario import drawn_from, LEARNING, NUMBERS, SAMPLED
from kbnitp_ros.study.scenario_file import read_scenario
from kbnitp_ros.study.trial import LEARNT, run_trial, Trial
from laws import for_each
from legible import check_lines, check_texts
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
    return read_scenario(small_study.write(tmp_path / 'scenario.yaml', content))


@pytest.fixture(scope='module')
def learnt(tmp_path_factory):
    return small_study.run(study(tmp_path_factory.mktemp('learnt'), LEARNT_STUDY))


@pytest.fixture(scope='module')
def drawn(tmp_path_factory):
    """Return the results of a study with drawn parameters; do not change them."""
    return small_study.run(study(tmp_path_factory.mktemp('drawn'), DRAWN_STUDY))


@for_each('believed', [None, 1.0])
def test_the_learning_method_knows_the_other_numbers(learnt, believed):
    scenario = replace(learnt.scenario, believed_lethality=believed)
    outcome = run_trial(scenario, Trial(0.9, LEARNING, 2))
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
    assert outcome.believed[0].tolist() == mission[-1].belief.hazard.tolist()
    place = NUMBERS.index('lethality')
    known = mission[-1].parameters['lethality']
    quantiles = [known.quantile(q) for q in LEARNT[2:]]
    assert outcome.learnt[-1, place].tolist() == [known.mean, known.sd, *quantiles]
    assert outcome.numbers[place] == 0.9
    assert np.isnan(outcome.learnt[:, NUMBERS.index('kappa')]).all()


def test_methods_that_know_the_numbers_learn_nothing(learnt):
    for trial, outcome in learnt.outcomes.items():
        assert np.isnan(outcome.learnt).all() == (trial.method != LEARNING)


def test_numbers_are_drawn_by_world_and_known_to_informed_methods(drawn):
    scenario = drawn.scenario
    worlds = [scenario.truth(None, number) for number in range(3)]
    assert len({world['kappa'] for world in worlds}) == 3
    for number, truth in enumerate(worlds):
        assert truth['false_negative'] == 0.05
        assert 0.1 <= truth['lethality'] <= 1.0
        assert truth['target_background'] <= 0.3
        for method in (LEARNING, SAMPLED):
            outcome = drawn.outcomes[Trial(None, method, number)]
            assert outcome.numbers.tolist() == [truth[name] for name in NUMBERS]
    prior = scenario.belief(worlds[1])
    assert prior.hazard[0] == worlds[1]['hazard_density']
    assert prior.kappa[0] == pytest.approx(worlds[1]['kappa'])
    safe = prior.joint[0, 0]
    assert safe[1] / safe.sum() == pytest.approx(worlds[1]['target_background'])
    known = drawn.outcomes[Trial(None, LEARNING, 1)].learnt
    assert np.isfinite(known).all()


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


def test_learnt_numbers_are_summarised(drawn):
    (row,) = (
        row for row in OF_NUMBERS.summarise(drawn)['rows'] if row['number'] == 'target_background'
    )
    known, truth = drawn.learnt(None)
    place = NUMBERS.index('target_background')
    last = known[:, -1, place]
    errors = np.abs(last[:, 0] - truth[:, place])
    assert row['error']['mean'] == pytest.approx(errors.mean(), abs=1e-6)
    assert row['sd']['mean'] == pytest.approx(last[:, 1].mean(), abs=1e-6)
    assert row['sd_before']['mean'] == pytest.approx(0.3 / 12**0.5, rel=1e-3)
    within = (last[:, 2] <= truth[:, place]) & (truth[:, place] <= last[:, -1])
    assert row['within']['mean'] == pytest.approx(within.mean(), abs=1e-6)


def test_the_cost_of_learning_is_paired(learnt):
    value = OF_LEARNING.summarise(learnt)
    assert value['robots'] == [4]
    rows = {(row['lethality'], row['method']): row['costs'] for row in value['rows']}
    assert rows.keys() == {(p, m) for p in (0.2, 0.9) for m in ('kappa_bnitp', SAMPLED)}
    learner, told = (
        learnt.series(0.9, method, *LOG_LOSS)[:, -1] for method in (LEARNING, SAMPLED)
    )
    (cost,) = rows[0.9, SAMPLED]
    assert cost['mean'] == pytest.approx((learner - told).mean(), abs=1e-6)


@for_each('kind', ['drawn', 'learnt'], every=2)
def test_learnt_numbers_can_be_read(request, kind):
    figures = study_figures(request.getfixturevalue(kind))
    assert 'numbers' in figures
    for figure in figures.values():
        check_texts(figure)
        check_lines(figure)


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
