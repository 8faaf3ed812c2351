# SPDX-License-Identifier: Apache-2.0
"""The estimator assimilates valid evidence once, and refuses the rest."""

from signal import SIGINT

from diagnostic_msgs.msg import DiagnosticStatus
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, ModelBelief, TargetReading
from kbnitp_ros.configuration.table import LEARN
from kbnitp_ros.core import Belief, Estimator, Observation, SensorModel, update
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import report_message
from nav_msgs.msg import Path
import numpy as np
import pytest
from samples import BAD_PATHS, changed, FIELD, GRID, HOME, in_frame, key, lost, path, returned

PARAMETERS = {**FIELD, 'await_nodes': ['test'], 'agents': ['scout_1', 'scout_2']}
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
MODEL = SensorModel(0.5)
SAMPLED = {'method': 'kappa_bnitp_sampled', 'seed': 7}


@pytest.fixture
def estimator(field):
    field.beliefs = field.listen(BeliefMaps, '/belief')
    field.start('estimator', PARAMETERS)
    field.paths, field.reports = evidence(field)
    field.until(lambda: field.beliefs, 'prior')
    return field


def evidence(field):
    return field.talk(Path, '/scout_1/path'), field.talk(DeploymentReport, '/scout_1/report')


def until_held(field, deployments):
    """Wait for the belief with `count` deployments, and return its joint."""
    field.until(
        lambda: field.beliefs and field.beliefs[-1].deployments == deployments,
        f'belief {deployments}',
    )
    return read_belief_maps(field.beliefs[-1]).belief.joint


def test_a_report_without_its_path_is_pending(estimator):
    estimator.reports.publish(lost(1))
    estimator.until(lambda: estimator.count('/estimator', 'waiting') == 1, 'waiting report')
    assert estimator.count('/estimator', 'refused') == 0
    assert len(estimator.beliefs) == 1
    estimator.paths.publish(path(1))
    joint = until_held(estimator, 1)
    assert joint.tobytes() == update(PRIOR, MODEL, Observation(HOME, False)).joint.tobytes()
    estimator.until(lambda: estimator.count('/estimator', 'waiting') == 0, 'end of waiting')


BLIND_TARGETS = [
    TargetReading(cell=cell, detected=cell == 2, not_looked=True) for cell in HOME[1:]
]
BAD_REPORTS = [
    (in_frame(returned(3), ''), "header.frame_id is '': it must be 'map'"),
    (changed(returned(3), agent='scout_2'), "agent is 'scout_2': on this topic it must be"),
    (returned(3, [0, 4, 5, 1, 0]), 'path enters a blocked cell: at index 2 it is 5'),
    (returned(3, [0] * 62), 'at most 10 * max_steps = 60 are allowed'),
    (changed(returned(3), readings=BLIND_TARGETS), 'readings[1] has detected and not_looked'),
    (changed(lost(3), steps_survived=2**32 - 1), 'of 4 steps survived at most 3'),
    (
        report_message(key(1), Observation(HOME, True, [False] * 4), 0),
        'differ: the one with more readings counts',
    ),
]


@pytest.mark.parametrize('reported_first', [False, True])
def test_the_evidence_is_the_reported_walk(estimator, reported_first):
    """Sent to HOME: a robot that turned back, a detour, a camera that failed, a last contact."""
    happened = [
        Observation([0, 1, 0], True, [True, False]),
        Observation([0, 4, 8, 9, 6, 3, 2, 1, 0], True, [False, True, False, True] * 2),
        Observation([0, 1, 2, 6, 1, 0], True, [True, False, -1, -1, -1]),
        Observation(HOME, False, steps_survived=2),
    ]
    for number, observation in enumerate(happened, 1):
        report = report_message(key(number), observation, 0)
        for publisher, message in sorted(
            [(estimator.reports, report), (estimator.paths, path(number))],
            key=lambda each: (each[0] is estimator.paths) == reported_first,
        ):
            publisher.publish(message)
    joint = until_held(estimator, len(happened))
    expected = PRIOR
    for observation in happened:
        expected = update(expected, MODEL, observation)
    assert joint.tobytes() == expected.joint.tobytes()
    estimator.until(lambda: estimator.count('/estimator', 'accepted') == 8, 'eight messages')
    assert estimator.count('/estimator', 'refused') == 0


def test_missing_readings_at_the_end_are_stated(estimator):
    steps = len(HOME) - 1
    for number, unread in enumerate(range(steps + 1), 1):
        readings = np.where(np.arange(steps) < steps - unread, 0, -1)
        estimator.paths.publish(path(number))
        estimator.reports.publish(
            report_message(key(number), Observation(HOME, True, readings), 0)
        )
        until_held(estimator, number)
        told = f'{key(number)} has no readings after step {steps - unread} of {steps}'
        assert (told in estimator.said('/estimator')) == (unread > 1)


def test_bad_input_is_refused_counted_and_changes_nothing(estimator):
    estimator.paths.publish(path(1))
    estimator.reports.publish(returned(1))
    estimator.paths.publish(path(3))
    before = until_held(estimator, 1)
    refused = 0
    for publisher, cases in ((estimator.paths, BAD_PATHS), (estimator.reports, BAD_REPORTS)):
        for message, told in cases:
            publisher.publish(message)
            refused += 1
            assert told in estimator.until_refused('/estimator', refused)
    assert len(estimator.beliefs) == 2
    # Refused reports show that the robot is back, so that a loss would not count.
    estimator.reports.publish(lost(3))
    estimator.reports.publish(returned(3))
    after = until_held(estimator, 2)
    refused += 1
    seen = Observation(HOME, True, [True, False, True, False])
    expected = update(Belief(before), MODEL, seen)
    assert after.tobytes() == expected.joint.tobytes()
    assert refused == estimator.count('/estimator', 'refused')


def test_an_impossible_outcome_is_refused(field):
    field.beliefs = field.listen(BeliefMaps, '/belief')
    field.start('estimator', {**PARAMETERS, 'sensor.malfunction': 0.0, 'prior.hazard': 0.0})
    paths, reports = evidence(field)
    paths.publish(path(1))
    reports.publish(lost(1))
    assert 'impossible' in field.until_refused('/estimator', 1)
    reports.publish(returned(1))
    assert np.isfinite(until_held(field, 1)).all()


def test_a_model_is_published_only_if_a_number_is_learnt_or_the_model_checked(field):
    beliefs = field.listen(BeliefMaps, '/belief')
    # Clustered hazards have no model check either.
    field.start('estimator', {**PARAMETERS, **SAMPLED, 'prior.clustering': 0.5})
    field.until(lambda: beliefs, 'prior')
    assert '/model' not in dict(field.node.get_topic_names_and_types())
    assert not beliefs[0].unknowns
    assert beliefs[0].seed == 7


def test_every_nth_and_the_last_belief_are_checked(field):
    models = field.listen(ModelBelief, '/model')
    field.beliefs = field.listen(BeliefMaps, '/belief')
    node = field.start('estimator', {**PARAMETERS, 'check_every': 2})
    paths, reports = evidence(field)
    ours = Estimator(PRIOR, MODEL)
    checks = [ours.model_check]
    for number in range(1, 4):
        paths.publish(path(number))
        reports.publish(lost(number))
        until_held(field, number)
        ours.assimilate(Observation(HOME, False))
        checks.append(ours.model_check)
        due = number, number - number % 2
        field.until(
            lambda due=due: (models[-1].deployments, models[-1].checked) == due, 'the due check'
        )
    field.until(
        lambda: 'after 2 deployments' in field.told('/estimator', 'model_check'), 'diagnostics'
    )
    node.send_signal(SIGINT)
    field.until(lambda: models and models[-1].checked == 3, 'last check', may_end=True)
    stamps = {each.deployments: each.header.stamp for each in field.beliefs}
    for model in models:
        if model.checked_stamp.sec:
            assert model.checked_stamp == stamps[model.checked]
            told = dict(zip(model.alternative, model.alternative_ratio))
            assert told == checks[model.checked].alternatives


def test_a_weakly_known_density_of_clustered_hazards_is_stated(field):
    learnt = {'learn.numbers': ['hazard_density'], 'prior.clustering': 'learn'}
    parameters = {**PARAMETERS, **SAMPLED, **learnt}
    beliefs = field.listen(BeliefMaps, '/belief')
    field.start('estimator', parameters)
    paths, reports = evidence(field)
    field.until(lambda: beliefs, 'prior')
    told = 'hazards cluster and their learnt density is '
    field.until(lambda: field.diagnosed('/estimator').message.startswith(told), 'warning')
    assert field.diagnosed('/estimator').level == DiagnosticStatus.WARN
    assert field.said('/estimator').count(told) == 1
    # Until most cells were entered.
    tours = ([0, 4, 8, 9, 4, 0], [0, 1, 2, 3, 2, 1, 0])
    for number, cells in enumerate(tours, 1):
        paths.publish(path(number, cells=cells))
        reports.publish(returned(number, cells=cells))
    field.until(lambda: beliefs and beliefs[-1].deployments == len(tours), 'belief in all')
    field.until(lambda: told not in field.diagnosed('/estimator').message, 'no warning')


def test_sampling_that_does_not_converge_is_stated(field):
    """With all numbers open, uninformative readings leave most of them so."""
    numbers = [name for name in LEARN if name not in ('vanish', 'move', 'reach', 'duds')]
    intervals = {f'learn.{name}': [0.0, 1.0] for name in numbers}
    parameters = {**PARAMETERS, **SAMPLED, 'learn.numbers': numbers, **intervals}
    beliefs = field.listen(BeliefMaps, '/belief')
    field.start('estimator', parameters)
    paths, reports = evidence(field)
    for number in range(1, 9):
        paths.publish(path(number))
        reports.publish(returned(number) if number % 3 else lost(number))
    field.until(lambda: beliefs and beliefs[-1].deployments == 8, 'belief in all')
    told = 'the sampling of the belief has not converged: '
    field.until(lambda: field.diagnosed('/estimator').message.startswith(told), 'warning')
    status = field.diagnosed('/estimator')
    assert status.level == DiagnosticStatus.WARN
    (error,) = (each.value for each in status.values if each.key == 'sampling_error')
    assert float(error) > 0.0
    assert error in status.message
    assert field.count('/estimator', 'refused') == 0
