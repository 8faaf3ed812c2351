# SPDX-License-Identifier: Apache-2.0
"""Decisions of a log are recomputed, and every difference is reported."""

from copy import deepcopy
from functools import reduce

from kbnitp_ros.cli.replay import main
from kbnitp_ros.configuration.known import node_parameters
from kbnitp_ros.core import Area, Lane, Observation, Unknowns
from kbnitp_ros.log.configuration import parameters_record
from kbnitp_ros.log.read import PARAMETERS
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.log.replayed_decisions import RecordedGoal
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.deployments import read_report, report_message
from kbnitp_ros.messages.operator_actions import Action, operator_action_message, OperatorAction
from kbnitp_ros.messages.progress import mission_status_message, MissionState, MissionStatus
from laws import for_each
from mission_log import (
    cells,
    Deciding,
    GRID,
    instead,
    MAX_STEPS,
    observations,
    on,
    record,
    record_to,
    Sent,
    START,
    without,
)
import pytest

ROBOTS = 4
LANE = Lane(to=19, confidence=0.6)


@pytest.fixture(scope='module')
def sent():
    return decided(LANE)


def decided(goal, method='kappa_bnitp'):
    mission = Deciding(goal, method=method)
    for deployment in observations(ROBOTS, method=method):
        mission.deploy(deployment.observation, orders=deployment.plan.path)
    return mission.sent


def changed(message, field, value):
    message = deepcopy(message)
    *above, name = field.split('.')
    setattr(reduce(getattr, above, message), name, value)
    return message


def replayed(folder, sent, goal=LANE, confidences=None):
    path = folder / 'mission.mcap'
    with LogWriter(path) as log:
        asked = (0.9, goal.confidence or 0.0) if confidences is None else confidences
        for confidence in asked:
            values = parameters_record({'stop.confidence': confidence})
            log.add_metadata(f'{PARAMETERS}/estimator', values)
        record_to(log, sent)
    return replay(path, asked=RecordedGoal(goal, MAX_STEPS, cells(goal)))


@for_each('goal, method', [(LANE, 'kappa_bnitp_sampled'), (Area([5, 6]), 'kappa_bnitp')])
def test_decisions_are_reproduced(tmp_path_factory, goal, method):
    report = replayed(tmp_path_factory.mktemp('log'), decided(goal, method), goal)
    assert report.reproduced, report.mismatches
    assert report.compared['/decision'] == report.compared['/decision/lane'] == ROBOTS + 1
    assert report.not_compared == []


@for_each('field, value, grade', [
    ('probability', 0.25, Grade.DIFFERENT),
    ('probability', None, Grade.EQUAL),
    ('hazards_95', 9.0, Grade.DIFFERENT),
    ('goal', 'area', Grade.DIFFERENT),
    ('path', None, Grade.DIFFERENT),
    ('reached', True, Grade.DIFFERENT),
    ('reason', 'no confidence is asked for', Grade.DIFFERENT),
    ('goal_cells', [18], Grade.DIFFERENT),
    ('header.frame_id', 'odom', Grade.DIFFERENT),
    ('header.stamp.nanosec', 1, Grade.DIFFERENT),
    ('deployments', 99, Grade.DIFFERENT),
    ('changes', 99, Grade.DIFFERENT),
    ('author', '/other', Grade.DIFFERENT),
])  # fmt: skip
def test_changed_decisions_are_reported(tmp_path_factory, sent, field, value, grade):
    original = on(sent, '/decision')[2]
    if field == 'path':
        message = deepcopy(original.message)
        message.path.poses[-1].pose.position.x += 0.1
    else:
        value = getattr(original.message, field) + 1e-12 if value is None else value
        message = changed(original.message, field, value)
    report = replayed(tmp_path_factory.mktemp('log'), instead(sent, original, message))
    assert report.grade == grade
    found = report.mismatches + report.roundings
    assert [(each.topic, each.index) for each in found] == [('/decision', 2)] * (grade > 0)


@for_each('field, value', [
    ('header.frame_id', 'odom'),
    ('header.stamp.nanosec', 1),
    ('poses', []),
])  # fmt: skip
def test_changed_lanes_are_reported(tmp_path_factory, sent, field, value):
    original = on(sent, '/decision/lane')[2]
    message = changed(original.message, field, value)
    report = replayed(tmp_path_factory.mktemp('log'), instead(sent, original, message))
    [found] = report.mismatches
    assert (found.topic, found.index) == ('/decision/lane', 2)


def test_a_decision_without_a_belief_is_reported(tmp_path, sent):
    original = on(sent, '/decision')[2]
    forged = instead(sent, original, changed(original.message, 'changes', ROBOTS + 1))
    report = replayed(tmp_path, forged)
    assert [str(each) for each in report.mismatches] == [
        '/decision message 2: no standings on record have its evidence'
    ]


def test_the_confidence_is_not_guessed(tmp_path, sent):
    original = on(sent, '/decision')[2]
    forged = instead(sent, original, changed(original.message, 'reached', True))
    assert replayed(tmp_path, forged, confidences=()).reproduced


def test_decisions_without_standings_on_record_are_not_compared(tmp_path, sent):
    left = without(without(sent, on(sent, '/belief')[2]), on(sent, '/standings')[2])
    report = replayed(tmp_path, left)
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


def say(sent, state):
    """Return messages with the last state of their planner."""
    status = MissionStatus(START, '/planner', state)
    return [*sent, Sent('/mission', mission_status_message(status), START)]


@for_each('named, is_on_record', [((), True), ((6,), True), ((6, 7), True), ((7,), False)])
def test_decisions_avoid_the_no_go_cells_that_they_name(tmp_path, named, is_on_record):
    """Each decision is computed with its own cells, of those that were ever closed."""
    mission = Deciding(LANE, no_go=named)
    for cell in (6, 7):
        action = OperatorAction(START + cell, Action.NO_GO, 0, cells=(cell,))
        mission.publish('operator', operator_action_message(GRID, action))
    mission.deploy(observations(1)[0].observation)
    report = replayed(tmp_path, mission.sent)
    assert report.compared['/decision'] == 2
    found = [str(each) for each in report.mismatches if each.topic == '/decision']
    assert len(found) == (0 if is_on_record else 2)
    assert all('no_go has cells that were never on record' in each for each in found)
    assert report.reproduced is is_on_record
    assert report.decision.path.size
    assert not {6, 7} & {*report.decision.path.tolist()}


@for_each('place', [-2, -1])
def test_what_goes_with_a_missing_belief_may_have_the_stamp_of_the_next(tmp_path, place):
    """A killed estimator or recorder may leave views and decisions without their belief."""
    whole = Deciding(LANE, unknowns=Unknowns(lethality=(0.0, 1.0)))
    path = [2, 7, 12, 7, 2]
    whole.deploy(Observation(path, False))
    first, second = (whole.send_out(path, agent) for agent in ('scout_1', 'scout_2'))
    later = report_message(first, Observation(path, False), whole.now + 10**9)
    whole.publish('scout_1/report', later)
    whole.assimilate(path, *read_report(later))
    back = Observation(path, True, [False, True, False, False])
    whole.assimilate(path, *whole.come_back(second, back))
    beliefs = on(whole.sent, '/belief')
    assert beliefs[-1].message.header.stamp == beliefs[-2].message.header.stamp
    left = [each for each in whole.sent if each is not beliefs[place]]
    report = replayed(tmp_path, left)
    assert not report.mismatches
    for topic in ('/model', '/belief/hazard', '/decision', '/decision/lane'):
        assert report.compared[topic] == len(beliefs)
    assert not report.not_compared


def end(sent, action):
    message = operator_action_message(GRID, OperatorAction(START, action, 0))
    return [*sent, Sent('/operator', message, START)]


@for_each('planner, said, action, computed', [
    ({}, 'RUNNING', None, 'RUNNING'),
    ({'stop.confidence': 0.3}, 'RUNNING', None, 'DONE'),
    ({'stop.confidence': 0.3}, 'DONE', None, 'DONE'),
    ({'robots': ROBOTS}, 'RUNNING', None, 'DONE'),
    ({'robots': ROBOTS}, 'PAUSED', None, 'DONE'),
    ({'stop.losses': 1}, 'RUNNING', None, 'DONE'),
    ({}, 'DONE', None, 'RUNNING'),
    # Whether a plan is worth a robot is not computed.
    ({'stop.gain': 0.1}, 'DONE', None, 'DONE'),
    ({}, 'RUNNING', Action.END, 'ENDED'),
    ({}, 'RUNNING', Action.PAUSE, 'PAUSED'),
])  # fmt: skip
def test_the_state_of_the_mission_follows_from_its_evidence(
    tmp_path, capsys, sent, planner, said, action, computed
):
    """Its planner may have been killed before it said so."""
    assert on(sent, '/decision')[-1].message.probability > 0.3
    values = {name: each.default for name, each in node_parameters('planner').items()}
    values |= {'goal.kind': 'lane', 'goal.cells': [19], 'max_steps': MAX_STEPS, 'robots': 20}
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        log.add_metadata(f'{PARAMETERS}/planner', parameters_record(values | planner))
        record_to(log, say(sent if action is None else end(sent, action), MissionState[said]))
    assert main([str(path)]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if 'the mission was' in line]
    assert told == [
        f'the mission was {said} when the log ended',
        *[f'by its evidence the mission was {computed}'] * (said != computed),
    ]
