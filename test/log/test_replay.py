# SPDX-License-Identifier: Apache-2.0
"""A log's beliefs are computed again, and whatever is not reproduced is said."""

from array import array
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from functools import cache, partial
from itertools import product
import re

from extent import FULL
from hypothesis import assume, given, Phase, settings
from hypothesis import strategies as st
from kbnitp_msgs.msg import UnknownNumber
from kbnitp_ros.bag import writer
from kbnitp_ros.bag.reader import LogError
from kbnitp_ros.bag.schema import describe
from kbnitp_ros.bag.writer import LogWriter
from kbnitp_ros.cli.replay import main
from kbnitp_ros.core import (
    AS_ORDERED,
    Beta,
    DeploymentKey,
    Execution,
    Grid,
    METHODS,
    Observation,
    Report,
    Unknowns,
)
from kbnitp_ros.log.deployments import read_deployments, read_newest_round
from kbnitp_ros.log.evidence import BELIEF, PATH, REPORT
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replay_report import Grade
from kbnitp_ros.messages.deployments import path_message, read_report, report_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.nodes.assimilated import COMPLETE_EVERY
from laws import for_each
from mcap_ros2 import writer as ros2
from mission_log import (
    GRID,
    instead,
    MAX_STEPS,
    Mission,
    mission,
    observations,
    on,
    QOS,
    record,
    record_to,
    Sent,
    START,
    without,
)
from nav_msgs.msg import Path
import numpy as np
import pytest

ROBOTS = 8
WILFUL = Execution(detour=0.3, early_return=0.1, contact=0.5, camera_failure=0.2)
VIEWS = ('/belief/hazard', '/belief/target', '/belief/kappa')
REPRODUCED = dict.fromkeys(('/belief', *VIEWS), ROBOTS + 1)


@pytest.fixture
def replayed(tmp_path_factory):
    """Return a function that records messages and replays the log."""

    def replayed(sent, folder=None):
        folder = folder or tmp_path_factory.mktemp('log')
        return replay(record(folder / 'mission.mcap', sent))

    return replayed


def keys(sent):
    """Return the deployments of the paths, in order."""
    stamps = [each.message.header.stamp for each in on(sent, '/scout_1/path')]
    return [DeploymentKey('scout_1', s.sec * 10**9 + s.nanosec) for s in stamps]


def beliefs(sent):
    """Return the messages on the topic of the beliefs."""
    return on(sent, '/belief')


def flipped(message, field, index, bit):
    """Return a copy of a message with one bit of an array changed."""
    changed = deepcopy(message)
    values = getattr(changed, field)
    content = bytearray(values.tobytes())
    content[index * values.itemsize + bit // 8] ^= 1 << bit % 8
    setattr(changed, field, array(values.typecode, bytes(content)))
    return changed


@for_each('method', METHODS)
def test_a_mission_is_reproduced(replayed, method):
    report = replayed(mission(ROBOTS, method=method).sent)
    assert report.reproduced
    assert report.mismatches == []
    assert report.compared == REPRODUCED
    assert report.method == method
    assert report.finished
    observed = [deployment.observation for deployment in observations(ROBOTS, method=method)]
    assert len(report.evidence.reports) == ROBOTS
    assert report.evidence.survived == sum(each.survived for each in observed)
    assert 0 < report.evidence.survived < ROBOTS
    assert report.passed_over == report.not_yet_held == report.evidence.without_report == []
    assert report.evidence.without_path == report.evidence.refused == []


@pytest.mark.slow
@for_each('method', METHODS)
def test_what_robots_make_of_their_orders_is_reproduced(replayed, method):
    """Walks, last contacts and failed cameras."""
    whole = mission(2 * ROBOTS, method=method, conduct=WILFUL)
    told = [each.message for each in on(whole.sent, '/scout_1/report')]
    assert any(each.steps_survived for each in told)
    assert any(reading.not_looked for each in told for reading in each.readings)
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.compared['/belief'] == 2 * ROBOTS + 1
    assert report.evidence.refused == []


@for_each('recorded', [(), (1,), (2,), (1, 2)])
def test_a_later_contact_is_reproduced(replayed, recorded):
    """Beliefs before it have the earlier one; some may be missing."""
    whole = Mission()
    tour = [2, 7, 12, 7, 2]
    key = whole.deploy(Observation(tour, False))
    for steps in (1, 3):
        heard = Observation(tour, False, steps_survived=steps)
        whole.assimilate(tour, *whole.come_back(key, heard))
    whole.come_back(key, Observation(tour, False, steps_survived=2))
    whole.deploy(Observation([2, 7, 2], True, [True, False]))
    assert [each.message.deployments for each in beliefs(whole.sent)] == [0, 1, 1, 1, 2]
    missing = [beliefs(whole.sent)[index] for index in recorded]
    report = replayed(without(whole.sent, *missing))
    assert report.mismatches == report.passed_over == report.not_yet_held == []
    assert report.evidence.refused == []
    assert report.evidence.observation(key).steps_survived == 3


LEARNT = Unknowns(lethality=(0.1, 1.0), hazard_density=(0.02, 0.8), kappa=Beta(3, 2))


@pytest.fixture(scope='module')
def learnt_mission():
    """Return a mission that learns numbers; not to be changed."""
    return mission(ROBOTS, method='kappa_bnitp_sampled', unknowns=LEARNT, method_seed=5)


def test_what_was_learnt_is_reproduced(learnt_mission, replayed):
    report = replayed(learnt_mission.sent)
    assert report.reproduced
    assert report.compared == {**REPRODUCED, '/model': ROBOTS + 1}


def test_the_order_of_learning_is_that_of_the_deployments(replayed):
    whole = Mission('kappa_bnitp_sampled', unknowns=LEARNT)
    told = []
    for deployment in observations(5):
        path = deployment.observation.path
        key = whole.send_out(path)
        told.append((path, *whole.come_back(key, deployment.observation)))
    for index in (1, 4, 0, 3, 2):
        whole.assimilate(*told[index])
    in_order = Mission('kappa_bnitp_sampled', unknowns=LEARNT)
    for deployment in observations(5):
        in_order.deploy(deployment.observation)
    assert whole.ledger.belief.joint.tobytes() == in_order.ledger.belief.joint.tobytes()
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.compared['/model'] == 6


def test_an_estimator_that_was_restarted_has_learnt_the_same(replayed):
    whole = Mission('kappa_bnitp_sampled', unknowns=LEARNT)
    heard = []
    for number, deployment in enumerate(observations(6)):
        if number == 4:
            told = whole.ledger
            whole.start_estimator()
            for each in heard:
                whole.assimilate(*each)
            assert whole.ledger.belief.joint.tobytes() == told.belief.joint.tobytes()
        path = deployment.observation.path
        heard.append((path, *whole.come_back(whole.send_out(path), deployment.observation)))
        whole.assimilate(*heard[-1])
    assert replayed(whole.sent).reproduced


@pytest.mark.slow
@for_each(
    'field, bit, grade',
    [
        (field, *flip)
        for field in ('mean', 'sd', 'quantile_5', 'effective_sample_size')
        for flip in ((0, Grade.EQUAL), (50, Grade.DIFFERENT))
    ],
)
def test_one_flipped_bit_of_what_was_learnt_is_found(learnt_mission, replayed, field, bit, grade):
    original = on(learnt_mission.sent, '/model')[5]
    spoiled = flipped(original.message, field, 1, bit)
    report = replayed(instead(learnt_mission.sent, original, spoiled))
    assert report.grade == grade
    (mismatch,) = report.mismatches + report.roundings
    assert (mismatch.topic, mismatch.index) == ('/model', 5)
    assert mismatch.deployment == keys(learnt_mission.sent)[4]
    (difference,) = mismatch.differences
    assert difference.field == field
    assert 'in value 1' in difference.text


@for_each(
    'field, value, told',
    [
        ('low', 0.2, 'unknowns[0].low is 0.2, computed is 0.1'),
        ('name', 'malfunction', "unknowns[0].name is 'malfunction', computed is 'lethality'"),
    ],
)
def test_another_interval_is_found(learnt_mission, replayed, field, value, told):
    original = beliefs(learnt_mission.sent)[5]
    spoiled = deepcopy(original.message)
    setattr(spoiled.unknowns[0], field, value)
    report = replayed(instead(learnt_mission.sent, original, spoiled))
    (mismatch,) = report.mismatches
    assert told in str(mismatch)


def test_a_model_of_others_is_none_of_the_mission(learnt_mission, replayed):
    others = [
        Sent('/model', Path(), START),
        Sent('/other/model', on(learnt_mission.sent, '/model')[0].message, START),
    ]
    assert replayed([*others[1:], *learnt_mission.sent]).reproduced
    assert replayed([others[0], *mission(ROBOTS).sent]).reproduced


@for_each('grid', [
    Grid(9, 3, base=13, resolution=1 / 3, origin=(1e3, -1e3)),
    Grid(5, 4, base=2, blocked=(8, 11), through_corners=False),
    Grid(5, 4, base=2, blocked=(8, 11), connectivity=4),
])  # fmt: skip
def test_another_grid_is_reproduced(replayed, grid):
    report = replayed(mission(5, grid=grid).sent)
    assert report.reproduced
    assert (report.evidence.grid.neighbor_table == grid.neighbor_table).all()


def test_a_mission_in_a_namespace_is_reproduced(replayed):
    report = replayed(mission(ROBOTS, namespace='/field/north').sent)
    assert report.reproduced
    assert report.compared['/field/north/belief'] == ROBOTS + 1
    assert len(report.evidence.reports) == ROBOTS


@pytest.mark.slow
@given(st.data())
@settings(max_examples=40 if FULL else 10, deadline=None)
def test_the_order_between_topics_does_not_matter(whole_mission, tmp_path_factory, data):
    """A recorder hears each topic in order, but one may be far behind another."""
    queues = [on(whole_mission.sent, topic) for topic in {s.topic for s in whole_mission.sent}]
    shuffled = []
    while any(queues):
        queue = data.draw(st.sampled_from([queue for queue in queues if queue]))
        count = data.draw(st.integers(1, len(queue)))
        shuffled += queue[:count]
        del queue[:count]
    path = tmp_path_factory.mktemp('shuffled') / 'mission.mcap'
    report = replay(record(path, shuffled))
    assert report.reproduced
    assert report.compared == REPRODUCED


def two_out():
    """Return a mission whose two robots are out and report, and how to take their reports in."""
    whole = Mission()
    first, second = Observation([2, 7, 12, 7, 2], False), Observation([2, 7, 6, 2], False)
    keys = [whole.send_out(first.path, 'scout_1'), whole.send_out(second.path, 'scout_2')]
    reports = [whole.come_back(key, each) for key, each in zip(keys, (first, second))]
    take = [
        partial(whole.assimilate, each.path, *report)
        for each, report in zip((first, second), reports)
    ]
    return whole, take


@for_each('order', [(0, 1), (1, 0)])
def test_the_estimators_order_counts_not_the_recorders(replayed, order):
    whole, take = two_out()
    for index in order:
        take[index]()
    assert replayed(whole.sent).reproduced
    _, after_one, after_both = beliefs(whole.sent)
    assert after_one.message.agent == f'scout_{order[0] + 1}'

    # The other one's belief is another one, and of both there is only one.
    wrong = deepcopy(after_one.message)
    wrong.agent, wrong.deployment = after_both.message.agent, after_both.message.deployment
    wrong.header, wrong.taken_in = after_both.message.header, after_both.message.taken_in
    (mismatch,) = replayed(instead(whole.sent, after_one, wrong)).mismatches[:1]
    assert 'joint' in [difference.field for difference in mismatch.differences]
    assert replayed(without(whole.sent, after_one)).reproduced


@for_each('recorded', [(), (2,), (3,), (2, 3)])
def test_a_late_return_is_reproduced(replayed, recorded):
    """Beliefs before it have the loss and those after it the return; some may be missing."""
    whole = Mission()
    lost, other, back = (
        Observation([2, 7, 12, 7, 2], False),
        Observation([2, 7, 6, 2], False),
        Observation([2, 7, 12, 7, 2], True, [True, False, True, False]),
    )
    key = whole.deploy(lost)
    whole.deploy(other)
    whole.assimilate(back.path, *whole.come_back(key, back))
    whole.deploy(other, 'scout_2')
    assert [each.message.deployments for each in beliefs(whole.sent)] == [0, 1, 2, 2, 3]
    missing = [beliefs(whole.sent)[index] for index in recorded]
    report = replayed(without(whole.sent, *missing))
    assert report.mismatches == report.not_yet_held == report.evidence.refused == []
    assert report.reproduced
    assert report.evidence.survived == 1
    assert len(report.evidence.reports) == 3


def test_a_late_return_that_no_belief_has_is_said(replayed):
    whole = Mission()
    key = whole.deploy(Observation([2, 7, 2], False))
    whole.come_back(key, Observation([2, 7, 2], True, [True, False]))
    assert replayed(whole.sent).not_yet_held == [key]
    whole.deploy(Observation([2, 7, 2], False))
    report = replayed(whole.sent)
    assert (report.passed_over, report.mismatches) == ([key], [])
    assert not report.reproduced


@pytest.mark.slow
@for_each('gone, is_sent_anew', [
    ((0,), False), ((0, 1), False), ((0, 2), False), ((0, 1, 2), False),
    # With (0, 1, 2) nothing on record would tell that the estimator was restarted.
    ((0,), True), ((0, 1), True), ((0, 2), True),
])  # fmt: skip
def test_counts_of_a_restarted_estimator_are_its_own(replayed, gone, is_sent_anew):
    """It holds two deployments again, as the one before did, and not yet their late returns."""
    whole = Mission()
    told = []
    for tour in ([2, 7, 12, 7, 2], [2, 7, 6, 2]):
        key = whole.send_out(tour)
        back = Observation(tour, True, [True] * (len(tour) - 1))
        for observation in (Observation(tour, False), back):
            told.append((tour, *whole.come_back(key, observation)))
            whole.assimilate(*told[-1])
    before = whole.sent.copy()
    whole.start_estimator()
    for loss in told[::2]:
        whole.assimilate(*loss)
    if is_sent_anew:
        whole.deploy(Observation([2, 1, 2], False))
    for late in told[1::2]:
        whole.assimilate(*late)
    again = beliefs(without(whole.sent, *before))
    assert [each.message.since for each in again] == [0, 0, 1, 2, *[3] * is_sent_anew, 0]
    sent = without(whole.sent, *(again[index] for index in gone))
    # Now and then the bytes are the same: what pads the fields differs.
    same = beliefs(before)[1]
    sent = [same if each is again[1] else each for each in sent]
    report = replayed(sent)
    assert report.mismatches == report.passed_over == []
    assert report.compared['/belief'] == len(beliefs(before)) + 1
    assert len(report.repeated) == (1 not in gone)
    # Of the views of one time those of a belief that is not compared may be the only ones.
    stamps = [beliefs(sent)[each.index].message.header.stamp for each in report.not_compared]
    shown = [each for each in on(before, *VIEWS) if each.message.header.stamp in stamps]
    assert is_sent_anew or shown
    assert replayed(without(sent, *shown)).mismatches == []


flown = cache(observations)


@pytest.mark.slow
@given(st.booleans(), st.data())
# Making a case smaller takes minutes, and a case is small.
@settings(max_examples=100 if FULL else 15, deadline=None, phases=[Phase.generate])
def test_what_a_restarted_estimator_catches_up_with_is_reproduced(tmp_path_factory, silent, data):
    """
    It hears what each publisher said in its order, and not all its beliefs are recorded.

    The losses of silent robots are reported by the planner, and some of these come home late, or
    were heard of.
    """
    whole = Mission()
    told = {}
    conduct = data.draw(st.sampled_from([AS_ORDERED, WILFUL]))
    for deployment in flown(6, seed=data.draw(st.integers(0, 5)), conduct=conduct):
        observation, agent = deployment.observation, f'scout_{data.draw(st.integers(1, 3))}'
        orders = deployment.plan.path
        key = whole.send_out(orders, agent)
        says_more = observation.survived or observation.steps_survived
        is_late = silent and says_more and data.draw(st.booleans())
        lost = [Observation(orders, False)] if is_late else []
        for each in (*lost, observation):
            said = orders, *whole.come_back(key, each)
            whole.assimilate(*said)
            told.setdefault((agent, silent and each.survived), []).append(said)
    first_run = len(whole.sent)
    whole.start_estimator()
    while publishers := [publisher for publisher in told if told[publisher]]:
        path, key, report = told[data.draw(st.sampled_from(publishers))].pop(0)
        whole.hear_path(key, path)
        # A loss says nothing new after the return.
        whole.hear_report(key, report)
    again = [each for each in whole.sent[first_run:] if each.topic == '/belief']
    # The last one is latched, so that a recorder hears it.
    gone = [again[index] for index in data.draw(st.sets(st.integers(0, len(again) - 2)))]
    evidence = [each for each in whole.sent if re.search('path|report', each.topic)]
    sent = [*without(whole.sent, *gone), *evidence]
    path = tmp_path_factory.mktemp('caught_up') / 'mission.mcap'
    report = replay(record(path, sent))
    assert report.mismatches == report.passed_over == report.evidence.refused == []
    recorded = len(beliefs(whole.sent)) - len(gone)
    counted = report.compared['/belief'] + len(report.not_compared) + len(report.repeated)
    assert counted == recorded
    assert gone or not report.not_compared + report.repeated


@pytest.mark.slow
@for_each('method', METHODS)
def test_reports_out_of_order_are_reproduced(replayed, method):
    """All robots are out at once, and their reports come the other way round."""
    whole = Mission(method=method)
    observed = [each.observation for each in observations(6, seed=3)]
    keys = [whole.send_out(each.path) for each in observed]
    for key, observation in reversed([*zip(keys, observed)]):
        whole.assimilate(observation.path, *whole.come_back(key, observation))
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.compared['/belief'] == 7


@for_each('field, method', product(['joint', 'hazard', 'target', 'kappa'], METHODS), every=3)
def test_one_flipped_bit_is_found(whole_mission, tmp_path, capsys, method, field):
    sent = mission(ROBOTS, method=method).sent
    original = beliefs(sent)[5]
    cell = 7
    index = 4 * cell + 3 if field == 'joint' else cell
    spoiled = flipped(original.message, field, index, bit=0)
    path = record(tmp_path / 'mission.mcap', instead(sent, original, spoiled))

    report = replay(path)
    (mismatch,) = report.mismatches or report.roundings
    assert not report.reproduced
    assert report.grade == Grade.DIFFERENT or field == 'joint'
    assert (mismatch.topic, mismatch.index) == ('/belief', 5)
    assert mismatch.deployment == keys(sent)[4]
    difference, *_ = mismatch.differences
    assert (difference.field, difference.cell) == (field, cell)
    assert difference.largest == abs(
        getattr(spoiled, field)[index] - getattr(original.message, field)[index]
    )
    assert 0.0 < difference.largest < 1e-15

    assert main([str(path)]) == (report.grade == Grade.DIFFERENT)
    told = capsys.readouterr().out.splitlines()
    if report.grade == Grade.EQUAL:
        assert (
            f'/belief: {ROBOTS + 1} of {ROBOTS + 1} messages reproduced, 1 of them equal to 1e-09'
            in told
        )
        return
    assert f'/belief: {ROBOTS} of {ROBOTS + 1} messages reproduced' in told
    (line,) = [line for line in told if line.startswith('not reproduced')]
    assert '/belief message 5' in line
    assert str(mismatch.deployment) in line
    assert f'{field} differs in 1 values, by up to {difference.largest:.3g} in cell 7' in line


@for_each('field', ['hazard', 'target', 'kappa'])
def test_the_sign_of_a_zero_in_a_map_is_found(whole_mission, replayed, field):
    original = beliefs(whole_mission.sent)[4]
    blocked = 8
    assert getattr(original.message, field)[blocked] == 0.0
    spoiled = flipped(original.message, field, blocked, bit=63)
    report = replayed(instead(whole_mission.sent, original, spoiled))
    assert report.grade == Grade.DIFFERENT
    assert [(each.topic, each.index) for each in report.mismatches] == [('/belief', 4)]


@pytest.mark.slow
@given(st.data())
@settings(max_examples=60 if FULL else 20, deadline=None)
def test_any_flipped_bit_of_a_map_is_found(whole_mission, tmp_path_factory, data):
    """One of the last bits of a joint may look like rounding; it is said all the same."""
    which = on(whole_mission.sent, '/belief', *VIEWS)
    original = data.draw(st.sampled_from(which))
    names = ['data'] if original.topic in VIEWS else ['joint', 'hazard', 'target', 'kappa']
    field = data.draw(st.sampled_from(names))
    # A prior's joint is where the replay starts: the last bit may get lost in the first update.
    assume((original, field) != (which[0], 'joint'))
    values = getattr(original.message, field)
    index = data.draw(st.integers(0, len(values) - 1))
    bit = data.draw(st.integers(0, 8 * values.itemsize - 1))
    spoiled = flipped(original.message, field, index, bit)
    path = tmp_path_factory.mktemp('flipped') / 'mission.mcap'
    report = replay(record(path, instead(whole_mission.sent, original, spoiled)))
    found = report.mismatches + report.roundings
    assert not report.reproduced
    assert report.grade == Grade.DIFFERENT or field == 'joint'
    place = next(
        n for n, one in enumerate(on(whole_mission.sent, original.topic)) if one is original
    )
    assert (found[0].topic, found[0].index) == (original.topic, place)


@pytest.mark.slow
@for_each(
    'field, value',
    [
        ('base', 3),
        ('blocked', [8]),
        ('max_steps', 9),
        ('method', 'relaxed_itp'),
        ('lethality', 0.6000000000000001),
        ('seed', 5),
        ('unknowns', [UnknownNumber(name='kappa', a=1.0, b=1.0, low=0.0, high=1.0)]),
        ('prior', array('d', [0.25] * 80)),
        ('false_positive', 0.0),
        ('deployments', 4),
        ('deployments', 6),
        ('deployments', 4_000_000_000),
        ('deployments', 0),
        ('agent', 'scout_2'),
        ('agent', ''),
    ],
)
def test_a_changed_field_is_found(whole_mission, replayed, field, value):
    original = beliefs(whole_mission.sent)[5]
    spoiled = deepcopy(original.message)
    setattr(spoiled, field, value)
    report = replayed(instead(whole_mission.sent, original, spoiled))
    assert 5 in [mismatch.index for mismatch in report.mismatches]
    assert not report.reproduced


@for_each('field', ['width', 'height', 'resolution'])
def test_another_geometry_is_found(whole_mission, replayed, field):
    original = beliefs(whole_mission.sent)[5]
    spoiled = deepcopy(original.message)
    setattr(spoiled.info, field, getattr(spoiled.info, field) * 2)
    (mismatch,) = replayed(instead(whole_mission.sent, original, spoiled)).mismatches
    assert [difference.field for difference in mismatch.differences] == [f'info.{field}']


def test_a_belief_of_another_size_is_found(whole_mission, replayed):
    original = beliefs(whole_mission.sent)[5]
    spoiled = deepcopy(original.message)
    spoiled.hazard = spoiled.hazard[:-1]
    (mismatch,) = replayed(instead(whole_mission.sent, original, spoiled)).mismatches
    assert str(mismatch).endswith('hazard has 19 values, computed are 20')


def test_changed_evidence_changes_what_follows(whole_mission, replayed):
    """A belief names evidence by its content: what has another is not what it assimilated."""
    index, original = next(
        (index, each)
        for index, each in enumerate(on(whole_mission.sent, '/scout_1/report'))
        if each.message.survived and index > 1
    )
    spoiled = deepcopy(original.message)
    spoiled.readings[0].detected = not spoiled.readings[0].detected
    report = replayed(instead(whole_mission.sent, original, spoiled))
    (mismatch,) = report.mismatches
    assert mismatch.index == index + 1
    assert mismatch.reason == f'report of deployment {mismatch.deployment} is not on record'
    assert [each.index for each in report.not_compared] == [*range(index + 2, ROBOTS + 1)]


def test_a_log_without_the_prior_cannot_be_reproduced(whole_mission, replayed):
    report = replayed(without(whole_mission.sent, beliefs(whole_mission.sent)[0]))
    assert not report.reproduced
    assert len(report.mismatches) == ROBOTS
    assert all('prior it started from is not on record' in str(m) for m in report.mismatches)
    assert report.method == ''


@for_each(
    'method, why', [('guessing', 'known are'), ('kappa_bnitp_smoothed', '0.3.0 reads .*use')]
)
def test_a_log_of_a_method_that_is_none_is_refused(whole_mission, replayed, method, why):
    original = beliefs(whole_mission.sent)[0]
    spoiled = deepcopy(original.message)
    spoiled.method = method
    with pytest.raises(LogError, match=f'cannot be computed: method is {method!r}: .*{why}'):
        replayed(instead(whole_mission.sent, original, spoiled))


@for_each('gone', [(2, 3, 6), (8,), (1, 2, 3, 4, 5, 6, 7)])
def test_beliefs_after_one_that_is_missing_are_not_compared(whole_mission, tmp_path, capsys, gone):
    """Beliefs are kept one deep: under load one may be gone before the recorder gets it."""
    sent = without(whole_mission.sent, *(beliefs(whole_mission.sent)[index] for index in gone))
    path = record(tmp_path / 'mission.mcap', sent)
    report = replay(path)
    assert report.reproduced
    assert report.compared['/belief'] == gone[0]
    assert len(report.not_compared) == ROBOTS + 1 - gone[0] - len(gone)
    assert report.passed_over == []
    first = gone[0] - 1
    assert report.not_yet_held == keys(whole_mission.sent)[first:]
    assert main([str(path)]) == 0
    told = capsys.readouterr().out
    for each in report.not_compared[:3]:
        assert f'not compared: {each}' in told
        assert 'deployments that it adds to is missing' in str(each)
    assert (f'not compared: {len(report.not_compared) - 3} more' in told) == (
        len(report.not_compared) > 3
    )


def test_a_belief_that_names_all_ends_a_gap(replayed):
    """As to a recorder that was away for some beliefs, and to one that starts late."""
    whole = Mission()
    for number, deployment in enumerate(observations(ROBOTS)):
        if number in (3, 6):
            whole.new.name_all()
        whole.deploy(deployment.observation)
    _first, *others = beliefs(whole.sent)
    assert [each.message.since for each in others] == [0, 1, 2, 0, 4, 5, 0, 7]
    report = replayed(without(whole.sent, others[1]))
    assert report.reproduced
    assert report.compared['/belief'] == ROBOTS - 1
    assert [each.index for each in report.not_compared] == [2]
    report = replayed(without(whole.sent, *others[1:6]))
    assert (report.compared['/belief'], report.not_compared) == (4, [])
    assert report.passed_over == report.not_yet_held == []


def test_one_belief_of_a_few_dozen_names_all():
    whole = Mission()
    for _number in range(2 * COMPLETE_EVERY + 2):
        whole.deploy(Observation([2, 7, 2], False))
    since = [each.message.since for each in beliefs(whole.sent)]
    assert [held for held, each in enumerate(since) if each == 0] == [
        0, 1, COMPLETE_EVERY + 1, 2 * COMPLETE_EVERY + 1
    ]  # fmt: skip


def test_beliefs_out_of_order_are_said_and_those_after_them(whole_mission, replayed):
    _, _first, second, third, *_ = beliefs(whole_mission.sent)
    sent = without(whole_mission.sent, second)
    sent.insert(sent.index(third) + 1, second)
    report = replayed(sent)
    assert report.reproduced
    assert [each.index for each in report.not_compared] == [2, 3, 4, 5, 6, 7, 8]
    assert report.compared['/belief'] == 2


@for_each('index', [0, 4, ROBOTS])
def test_a_belief_on_record_twice_is_said_and_the_rest_is_compared(
    whole_mission, tmp_path, capsys, index
):
    """A restarted recorder hears the last one again, with the latched paths and reports."""
    again = on(whole_mission.sent, '/scout_1/path', '/scout_1/report')
    path = tmp_path / 'mission.mcap'
    record(path, [*whole_mission.sent, *again, beliefs(whole_mission.sent)[index]])
    report = replay(path)
    assert report.reproduced
    assert len(report.evidence.reports) == ROBOTS
    assert report.evidence.refused == []
    assert report.compared == REPRODUCED
    (repeated,) = report.repeated
    assert main([str(path)]) == 0
    assert f'repeated: {repeated}' in capsys.readouterr().out


@pytest.fixture
def reported_twice():
    """
    Return a mission, its first deployment, and the first report of it.

    The agent and the recorder are killed once the report is published, and the agent reports the
    deployment again after the belief in the next one.
    """
    whole = Mission()
    key = whole.deploy(Observation([2, 7, 2], True, [True, False]))
    (first,) = on(whole.sent, '/scout_1/report')
    whole.deploy(Observation([2, 3, 2], False))
    whole.hear_report(*whole.come_back(key, Observation([2, 7, 2], True, [True, False])))
    whole.new.name_all()
    whole.deploy(Observation([2, 1, 2], False))
    return whole, key, first


@for_each('is_heard_late, is_complete', product([False, True], repeat=2))
def test_beliefs_of_a_report_that_was_made_again_are_not_compared(
    reported_twice, tmp_path, capsys, is_heard_late, is_complete
):
    """A recorder that starts again may hear the belief after the report that was made again."""
    whole, key, first = reported_twice
    sent = without(whole.sent, first)
    _, one, two, _ = beliefs(sent)
    if is_complete:
        # Then it names the report itself, as the one before does.
        complete = deepcopy(two.message)
        complete.since, complete.taken_in = 0, one.message.taken_in + two.message.taken_in
        sent = instead(sent, two, complete)
    if is_heard_late:
        (again,) = (
            each for each in on(sent, '/scout_1/report') if read_report(each.message)[0] == key
        )
        sent = without(sent, again)
        sent.insert(0, again)
    path = record(tmp_path / 'mission.mcap', sent)
    report = replay(path)
    assert report.reproduced
    assert report.passed_over == report.not_yet_held == []
    assert [each.index for each in report.not_compared] == [1, 2]
    missing = f'report of deployment {key} is not on record, but a later one'
    builds_on = 'the belief of 1 deployments that it adds to is missing'
    reasons = [each.reason for each in report.not_compared]
    assert reasons == [missing, missing if is_complete else builds_on]
    assert main([str(path)]) == 0
    told = capsys.readouterr().out
    assert '/belief: 2 of 2 messages reproduced, 2 not compared\n' in told
    assert f'not compared: /belief message 1 (after {key}): {missing}\n' in told


def test_what_follows_a_report_that_was_made_again_is_compared(reported_twice, replayed):
    whole, _key, first = reported_twice
    last = beliefs(whole.sent)[-1]
    spoiled = instead(whole.sent, last, flipped(last.message, 'hazard', 7, bit=0))
    report = replayed(without(spoiled, first))
    assert [each.index for each in report.mismatches] == [3]


def test_a_log_with_later_reports_only_says_how_much_is_not_compared(
    whole_mission, tmp_path, capsys
):
    sent = whole_mission.sent
    for each in on(sent, '/scout_1/report'):
        later = deepcopy(each.message)
        later.header.stamp.sec += 3600
        sent = instead(sent, each, later)
    path = record(tmp_path / 'mission.mcap', sent)
    assert replay(path).not_yet_held == keys(sent)
    assert main([str(path)]) == 0
    told = capsys.readouterr().out
    assert f'/belief: 1 of 1 messages reproduced, {ROBOTS} not compared\n' in told


def test_a_report_with_other_contents_is_found_though_it_was_made_again(reported_twice, replayed):
    whole, key, first = reported_twice
    spoiled = deepcopy(first.message)
    spoiled.readings[0].detected = False
    report = replayed(instead(whole.sent, first, spoiled))
    (mismatch, *_) = report.mismatches
    assert (mismatch.index, mismatch.reason) == (1, f'report of deployment {key} is not on record')


@for_each('finished', [True, False])
def test_a_mission_may_end_before_the_last_belief(whole_mission, tmp_path, capsys, finished):
    last = [on(whole_mission.sent, topic)[-1] for topic in ('/belief', *VIEWS)]
    log = LogWriter(tmp_path / 'mission.mcap')
    record_to(log, without(whole_mission.sent, *last))
    log.sync()
    if finished:
        log.close()
    report = replay(log.path)
    assert report.finished == finished
    assert report.not_yet_held == keys(whole_mission.sent)[-1:]
    assert report.passed_over == []
    assert report.reproduced
    assert main([str(log.path)]) == 0
    told = capsys.readouterr().out
    assert f'deployment {keys(whole_mission.sent)[-1]} is in no belief yet' in told
    assert ('the log is unfinished' in told) != finished
    if not finished:
        log.close()


def test_a_deployment_that_later_beliefs_pass_over_is_lost(replayed, tmp_path, capsys):
    """The estimator never took it in, and all else is right."""
    whole = Mission()
    first, second, third = (deployment.observation for deployment in observations(3))
    whole.deploy(first)
    key = whole.send_out(second.path)
    whole.come_back(key, second)
    whole.deploy(third)
    report = replayed(whole.sent, tmp_path)
    assert report.mismatches == []
    assert report.passed_over == [key]
    assert not report.reproduced
    assert main([str(tmp_path / 'mission.mcap')]) == 1
    assert f'not reproduced: deployment {key} is in no belief' in capsys.readouterr().out


def test_a_robot_that_is_still_out_is_said(whole_mission, replayed, tmp_path, capsys):
    whole = deepcopy(whole_mission)
    key = whole.send_out([2, 2])
    report = replayed(whole.sent, tmp_path)
    assert report.evidence.without_report == [key]
    assert report.reproduced
    assert main([str(tmp_path / 'mission.mcap')]) == 0
    assert f'{key} has no report on record: the robot was still out' in capsys.readouterr().out


@for_each('kind', ['path', 'report'])
def test_lost_evidence_is_said_for_every_belief_that_needs_it(whole_mission, replayed, kind):
    sent = without(whole_mission.sent, on(whole_mission.sent, f'/scout_1/{kind}')[3])
    report = replayed(sent)
    (mismatch,) = report.mismatches
    assert mismatch.index == 4
    assert [each.index for each in report.not_compared] == [5, 6, 7, 8]
    lost = keys(whole_mission.sent)[3]
    assert mismatch.reason == f'{kind} of deployment {lost} is not on record'
    listed = {'path': report.evidence.without_path, 'report': report.evidence.without_report}
    assert listed[kind] == [lost]


def test_a_restarted_estimator_is_reproduced(whole_mission, replayed):
    """It publishes its prior, takes in all that is latched and goes on."""
    whole = deepcopy(whole_mission)
    evidence = [deployment.observation for deployment in observations(ROBOTS)]
    reports = on(whole.sent, '/scout_1/report')
    whole.start_estimator()
    for key, observation in zip(keys(whole.sent), evidence):
        whole.assimilate(observation.path, *whole.come_back(key, observation))
    whole.deploy(evidence[0])
    assert len(reports) == ROBOTS
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.compared['/belief'] == 2 * (ROBOTS + 1) + 1

    prior_again = beliefs(whole.sent)[ROBOTS + 1]
    assert prior_again.message.deployments == 0
    assert replayed(without(whole.sent, prior_again)).reproduced


@pytest.mark.slow
@pytest.mark.parametrize('first', ['path', 'reports'])
def test_any_number_of_reports_of_one_deployment_is_read_once_each(
    whole_mission, replayed, tmp_path, capsys, monkeypatch, first
):
    """However many there are, each is compared with few others."""
    whole = deepcopy(whole_mission)
    key = DeploymentKey('scout_1', whole.now + 10**9)
    tour = [2, 7, 2]
    path = Sent('/scout_1/path', path_message(GRID, tour, key.stamp), whole.now)
    junk = [
        Sent('/scout_1/report', report_message(key, outcome, stamp), whole.now)
        for stamp in range(START, START + 500)
        for outcome in (
            Observation(tour, False),
            Observation(tour, True, [False, True]),
            Observation([2, 10, 2], True, [stamp % 2 == 0, stamp % 3 == 0]),
        )
    ]
    compared = 0

    def equal(one, other):
        nonlocal compared
        compared += 1
        return (one.survived, one.readings) == (other.survived, other.readings)

    monkeypatch.setattr(Report, '__eq__', equal)
    sent = [*whole.sent, path, *junk] if first == 'path' else [*whole.sent, *junk, path]
    report = replayed(sent, tmp_path)
    assert report.reproduced
    assert report.not_yet_held == [key]
    assert report.evidence.survived == 1 + replayed(whole.sent).evidence.survived
    assert compared < 2 * len(junk)
    assert main([str(tmp_path / 'mission.mcap')]) == 0
    refused = [line for line in capsys.readouterr().out.splitlines() if 'refused: ' in line]
    if first == 'path':
        # Of each instant the return that does not fit, and none of the losses.
        assert len(report.evidence.refused) == len(junk) / 3
        assert len(refused) == 21
        assert refused[-1] == f'refused: {len(junk) // 3 - 20} more'


def test_what_contradicts_is_refused_as_the_estimator_does(whole_mission, replayed):
    whole = deepcopy(whole_mission)
    returned = next(
        each for each in on(whole.sent, '/scout_1/report') if each.message.survived
    ).message
    key = read_report(returned)[0]
    cells = [2, *(reading.cell for reading in returned.readings)]
    readings = [not reading.detected for reading in returned.readings]
    whole.come_back(key, Observation(cells, True, readings))
    whole.come_back(key, Observation(cells, False))
    whole.publish('scout_1/path', path_message(whole.grid, [2, 2], key.stamp))
    unnamed = report_message(DeploymentKey('', 5), Observation([2, 2], False), 5)
    whole.publish('scout_1/report', unnamed)
    report = replayed(whole.sent)
    assert report.reproduced
    second_return, second_path, no_agent = report.evidence.refused
    assert f'reports of deployment {key} differ: that with more readings counts' in second_return
    assert f'path of deployment {key} is known and differs: the first holds' in second_path
    assert "/scout_1/report: agent is ''" in no_agent


@for_each('heard, at_once', product([(0, 1), (1, 0)], [False, True]))
def test_of_two_returns_the_same_counts_however_they_were_heard(replayed, heard, at_once):
    """Two robots of one name; then the estimator goes on with the log."""
    whole = Mission()
    path = [2, 7, 2]
    key = whole.send_out(path)
    walks = Observation([2, 7, 12, 7, 2], True, [True] * 4), Observation(path, True, [False] * 2)
    on_record = []
    for walk in walks:
        whole.now -= 1000 * at_once * len(on_record)
        on_record.append(whole.come_back(key, walk))
    whole.hear_path(key, path)
    for number in heard:
        with suppress(ValueError):
            whole.hear_report(*on_record[number])
    whole.deploy(Observation([2, 1, 2], False))
    held = whole.ledger
    whole.start_estimator()
    whole.ledger = held
    whole.publish_belief()
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.compared['/belief'] == (5 if heard == (0, 1) else 6)


def test_who_answers_for_another_agent_is_refused_as_the_estimator_does(replayed):
    whole = Mission(namespace='/north')
    path = [2, 7, 2]
    key = whole.deploy(Observation(path, False), 'scout_2')
    forged = report_message(key, Observation(path, True, [True, False]), whole.now)
    whole.publish('scout_1/report', forged)
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.not_yet_held == []
    assert report.evidence.survived == 0
    (refused,) = report.evidence.refused
    assert "/north/scout_1/report: agent is 'scout_2'" in refused


def test_what_the_estimator_refused_is_refused_again(replayed, tmp_path, capsys):
    """Reports without their last reading: of one deployment the first, of another the only one."""
    whole = Mission()
    first, second = Observation([2, 3, 2], True, [True] * 2), Observation([2, 7, 2], False)
    for correct in (True, False):
        key = whole.send_out(first.path)
        whole.come_back(key, first)
        whole.sent[-1].message.readings.pop()
        if correct:
            whole.assimilate(first.path, *whole.come_back(key, first))
    whole.deploy(second)
    report = replayed(whole.sent, tmp_path)
    assert report.mismatches == report.passed_over == report.not_yet_held == []
    assert report.reproduced
    assert report.compared['/belief'] == 3
    assert len(report.evidence.refused) == 2
    misfit = report.evidence.refused[-1]
    assert f'readings of deployment {key} has 1 values' in misfit
    assert main([str(tmp_path / 'mission.mcap')]) == 0
    assert f'refused: {misfit}' in capsys.readouterr().out


def test_a_belief_of_what_cannot_be_taken_in_is_said(whole_mission, replayed):
    original = next(
        each for each in on(whole_mission.sent, '/scout_1/report') if each.message.survived
    )
    spoiled = deepcopy(original.message)
    spoiled.readings = spoiled.readings[:-1]
    report = replayed(instead(whole_mission.sent, original, spoiled))
    assert 'is not on record' in report.mismatches[0].reason
    assert not report.reproduced


def test_paths_of_others_are_none_of_the_mission(whole_mission, replayed):
    others = [Sent('/plan', Path(), START), Sent('path', Path(), START), Sent('/path', Path(), 7)]
    report = replayed([*others, *whole_mission.sent])
    assert report.reproduced
    assert len(report.evidence.reports) == ROBOTS
    assert len(report.evidence.without_report) <= 1


def test_maps_of_others_are_none_of_the_mission(whole_mission, replayed):
    truth = occupancy_grid(whole_mission.grid, np.zeros(20), START)
    report = replayed([Sent('/truth/hazard', truth, START), *whole_mission.sent])
    assert report.reproduced
    assert report.compared == REPRODUCED


def refused(path, capsys):
    """Return the one line on standard error with which a file is refused."""
    assert main([str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ''
    (line,) = captured.err.splitlines()
    return line


def test_two_missions_in_a_log_are_refused(whole_mission, tmp_path, capsys):
    other = mission(2, namespace='/other')
    path = record(tmp_path / 'mission.mcap', [*whole_mission.sent, *other.sent])
    assert re.search('beliefs are on record from /belief and /other/belief', refused(path, capsys))


def test_a_log_without_beliefs_is_refused(whole_mission, tmp_path, capsys):
    path = record(tmp_path / 'mission.mcap', on(whole_mission.sent, '/scout_1/path'))
    assert 'mission.mcap has no beliefs on record: ' in refused(path, capsys)


def test_what_is_no_log_is_refused(whole_mission, tmp_path, capsys):
    assert 'cannot be read: No such file' in refused(tmp_path / 'gone.mcap', capsys)
    assert 'holds no log: there is no file' in refused(tmp_path, capsys)
    path = tmp_path / 'notes.txt'
    path.write_text('scout_1 did not come back')
    assert 'notes.txt is no MCAP file' in refused(path, capsys)
    path = record(tmp_path / 'mission.mcap', whole_mission.sent)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert 'mission.mcap is corrupt after byte' in refused(path, capsys)


def rewritten(path, sent, type_name, edit):
    """Write messages as a program does that has another definition of one of their types."""
    with path.open('wb') as file:
        log = ros2.Writer(file)
        schemas = {}
        for name in {BELIEF, *(each.type_name for each in sent if each.topic != '/belief')}:
            definition = describe(name).definition
            schemas[name] = log.register_msgdef(
                name, edit(definition) if name == type_name else definition
            )
        for each in sent:
            schema = schemas[BELIEF if each.topic == '/belief' else each.type_name]
            log.write_message(each.topic, schema, each.message, each.time, each.time)
        log.finish()
    return path


READERS = (
    replay,
    read_history,
    lambda log: read_deployments(log, GRID, MAX_STEPS),
)


@for_each('read', READERS)
def test_a_log_of_before_this_version_is_refused_and_told_what_reads_it(
    whole_mission, tmp_path, capsys, read
):
    def before(definition):
        return re.sub(r'^uint32 method_version .*\n', '', definition, flags=re.MULTILINE)

    path = rewritten(tmp_path / 'mission.mcap', whole_mission.sent, BELIEF, before)
    told = 'recorded before version 0.3.0, its beliefs have no method_version: kbnitp_ros 0.2.0 '
    with pytest.raises(LogError, match=re.escape(f'{told}(commit 2e485c7) reads it')):
        read(path)
    assert told in refused(path, capsys)


@for_each('read', READERS)
def test_a_log_of_a_version_to_come_is_refused(whole_mission, tmp_path, capsys, read):
    def later(definition):
        return definition.replace('\nfloat64[] prior ', '\nuint8 relays\nfloat64[] prior ', 1)

    sent = [
        replace(each, message=Later(each.message)) if each.topic == '/belief' else each
        for each in whole_mission.sent
    ]
    path = rewritten(tmp_path / 'mission.mcap', sent, BELIEF, later)
    told = 'was recorded by a later version, its beliefs have relays: read it with that version'
    with pytest.raises(LogError, match=told):
        read(path)
    assert told in refused(path, capsys)


class Later:
    """A belief with a field that nobody has yet."""

    def __init__(self, belief):
        self._belief = belief
        self.relays = 0

    def __getattr__(self, name):
        return getattr(self._belief, name)


def test_beliefs_by_another_version_of_a_method_are_refused(whole_mission, tmp_path, capsys):
    sent = [replace(each, message=deepcopy(each.message)) for each in whole_mission.sent]
    for each in beliefs(sent):
        each.message.method_version += 1
    path = record(tmp_path / 'mission.mcap', sent)
    assert 'beliefs are on record by version 2 of kappa_bnitp: ' in refused(path, capsys)


def deployments(path):
    return read_deployments(path, GRID, MAX_STEPS)


def newest_round(path):
    return read_newest_round(path, deployments(path))


ANOTHER_VERSION = 'mission.mcap (has messages of another version of their|was recorded before)'


@for_each('read, type_name, field, other', [
    (replay, PATH, 'geometry_msgs/PoseStamped[] poses', 'uint32 poses'),
    (read_history, PATH, 'geometry_msgs/PoseStamped[] poses', 'uint32 poses'),
    (read_history, BELIEF, 'std_msgs/Header header', 'std_msgs/Header head'),
    (deployments, PATH, 'std_msgs/Header header', 'std_msgs/Header head'),
    (deployments, REPORT, 'string agent', 'string name'),
    (newest_round, BELIEF, 'std_msgs/Header header', 'std_msgs/Header head'),
    (newest_round, BELIEF, 'uint32 deployments', 'float32 deployments'),
])  # fmt: skip
def test_a_type_with_another_field_is_refused(
    whole_mission, tmp_path, monkeypatch, read, type_name, field, other
):
    def described(name):
        known = describe(name)
        if name != type_name:
            return known
        assert field in known.definition
        return replace(known, definition=known.definition.replace(field, other, 1))

    monkeypatch.setattr(writer, 'describe', described)
    path = record(tmp_path / 'mission.mcap', whole_mission.sent)
    with pytest.raises(LogError, match=ANOTHER_VERSION):
        read(path)


def test_the_command_says_what_it_found(whole_mission, tmp_path, capsys):
    path = record(tmp_path / 'mission.mcap', whole_mission.sent, QOS)
    assert main([str(path)]) == 0
    captured = capsys.readouterr()
    survived = sum(each.message.survived for each in on(whole_mission.sent, '/scout_1/report'))
    assert captured.out.splitlines() == [
        f'8 deployments, {survived} survived, {8 - survived} lost; method kappa_bnitp',
        '/belief: 9 of 9 messages reproduced',
        '/belief/hazard: 9 of 9 messages reproduced',
        '/belief/kappa: 9 of 9 messages reproduced',
        '/belief/target: 9 of 9 messages reproduced',
    ]
    assert captured.err == ''
