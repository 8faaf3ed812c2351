# SPDX-License-Identifier: Apache-2.0
"""Decisions of a log are recomputed, and every difference is reported."""

from copy import deepcopy

from kbnitp_ros.core import Area, HazardDraws, Lane
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.progress import decision_message
from laws import for_each
from mission_log import GRID, instead, MAX_STEPS, Mission, observations, on, record, without
import pytest

ROBOTS = 4
LANE = Lane(to=19, confidence=0.6)


class Deciding(Mission):
    """A mission whose planner decides after each belief."""

    def __init__(self, goal, **options):
        self.goal = goal
        super().__init__(**options)

    def publish_belief(self):
        super().publish_belief()
        held = len(self.ledger.deployments)
        stamp = from_stamp(on(self.sent, '/belief')[-1].message.header.stamp)
        estimator = self.ledger.estimator
        draws = HazardDraws.of(estimator, held)
        decision = self.goal.decide(GRID, draws, estimator.model, MAX_STEPS)
        self.publish('decision', decision_message(GRID, decision, held, stamp, 0))


@pytest.fixture(scope='module')
def sent():
    return decided(LANE)


def decided(goal, method='kappa_bnitp'):
    mission = Deciding(goal, method=method)
    for deployment in observations(ROBOTS, method=method):
        mission.deploy(deployment.observation, orders=deployment.plan.path)
    return mission.sent


def replayed(folder, sent, goal=LANE):
    return replay(record(folder / 'mission.mcap', sent), asked=(goal, MAX_STEPS))


@for_each('goal, method', [(LANE, 'kappa_bnitp_sampled'), (Area([5, 6]), 'kappa_bnitp')])
def test_decisions_are_reproduced(tmp_path_factory, goal, method):
    report = replayed(tmp_path_factory.mktemp('log'), decided(goal, method), goal)
    assert report.reproduced, report.mismatches
    assert report.compared['/decision'] == ROBOTS + 1
    assert report.not_compared == []


@for_each('field, value, grade', [
    ('probability', 0.25, Grade.DIFFERENT),
    ('probability', None, Grade.EQUAL),
    ('hazards_95', 9.0, Grade.DIFFERENT),
    ('goal', 'area', Grade.DIFFERENT),
    ('path', None, Grade.DIFFERENT),
    # The operator may have required another confidence.
    ('reached', True, Grade.IDENTICAL),
])  # fmt: skip
def test_changed_decisions_are_reported(tmp_path_factory, sent, field, value, grade):
    original = on(sent, '/decision')[2]
    message = deepcopy(original.message)
    if field == 'path':
        message.path.poses[-1].pose.position.x += 0.1
    else:
        rounded = getattr(message, field) + 1e-12 if value is None else value
        setattr(message, field, rounded)
    report = replayed(tmp_path_factory.mktemp('log'), instead(sent, original, message))
    assert report.grade == grade
    found = report.mismatches + report.roundings
    assert [(each.topic, each.index) for each in found] == [('/decision', 2)] * (grade > 0)


def test_decisions_on_missing_beliefs_are_not_compared(tmp_path, sent):
    report = replayed(tmp_path, without(sent, on(sent, '/belief')[2]))
    assert report.compared['/decision'] < ROBOTS
    left = [finding for finding in report.not_compared if finding.topic == '/decision']
    assert left
    assert 'is not on record, or differs from' in str(left[0])


def test_without_a_goal_on_record_no_decision_is_compared(tmp_path, sent):
    report = replay(record(tmp_path / 'mission.mcap', sent))
    assert report.reproduced
    assert '/decision' not in report.compared
    left = [finding for finding in report.not_compared if finding.topic == '/decision']
    assert len(left) == ROBOTS + 1
    assert 'the goal is not on record' in str(left[0])
