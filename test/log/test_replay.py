# SPDX-License-Identifier: Apache-2.0
"""Beliefs of a log are recomputed, and every difference is reported."""

from array import array
from copy import deepcopy
from dataclasses import replace
from functools import cache
from itertools import product
import re

from extent import FULL
from hypothesis import assume, given, Phase, settings
from hypothesis import strategies as st
from kbnitp_msgs.msg import UnknownNumber
from kbnitp_ros.cli.replay import lines, main
from kbnitp_ros.core import (
    Belief,
    Beta,
    DeploymentKey,
    Execution,
    Grid,
    METHODS,
    Observation,
    Unknowns,
)
from kbnitp_ros.core.field.world import AS_ORDERED
from kbnitp_ros.log import write as writer
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.read import LogError
from kbnitp_ros.log.record import read_newest_round, read_resumed
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.log.schema import describe
from kbnitp_ros.messages.deployments import (
    path_message,
    read_path,
    read_report,
    report_message,
)
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import from_stamp, to_stamp
from kbnitp_ros.messages.topics import BELIEF, PATH, REPORT
from laws import for_each
from mcap_ros2 import writer as ros2
from mission_log import (
    GRID,
    instead,
    KNOWN,
    MAX_STEPS,
    Mission,
    mission,
    observations,
    on,
    record,
    Sent,
    START,
    without,
)
from nav_msgs.msg import Path
import numpy as np
import pytest
from samples import changed

ROBOTS = 8
WILFUL = Execution(detour=0.3, early_return=0.1, contact=0.5, camera_failure=0.2)
LEARNT = Unknowns(lethality=(0.1, 1.0), hazard_density=(0.02, 0.8), kappa=Beta(3, 2))
VIEWS = ('/belief/hazard', '/belief/target', '/belief/kappa')
REPRODUCED = dict.fromkeys(('/belief', '/standings', *VIEWS), ROBOTS + 1)


@pytest.fixture
def replayed(tmp_path_factory):
    """Return a function that records messages and replays the log."""
    return lambda sent: replay(record(tmp_path_factory.mktemp('log') / 'mission.mcap', sent))


@pytest.fixture(scope='module')
def learnt_mission():
    """Return a mission that learns numbers; not to be changed."""
    return mission(ROBOTS, method='kappa_bnitp_sampled', unknowns=LEARNT, method_seed=5)


def keys(sent):
    stamps = [entry.message.header.stamp for entry in on(sent, '/scout_1/path')]
    return [DeploymentKey('scout_1', s.sec * 10**9 + s.nanosec) for s in stamps]


def beliefs(sent):
    return on(sent, '/belief')


def indices(findings):
    """Return the indices of the beliefs that some findings concern."""
    return [finding.index for finding in findings if finding.topic == '/belief']


def flipped(message, field, index, bit):
    """Return a copy of a message with one bit of an array changed."""
    values = getattr(message, field)
    content = bytearray(values.tobytes())
    content[index * values.itemsize + bit // 8] ^= 1 << bit % 8
    return changed(message, **{field: array(values.typecode, bytes(content))})


@pytest.mark.slow
@for_each('options', [
    *({'method': method, 'conduct': conduct}
      for method, conduct in product(METHODS, [AS_ORDERED, WILFUL])),
    {'namespace': '/field/north'},
    {'method': 'kappa_bnitp_sampled', 'unknowns': LEARNT},
    {'grid': Grid(9, 3, base=13, resolution=1 / 3, origin=(1e3, -1e3))},
    {'grid': Grid(5, 4, base=2, blocked=(8, 11), through_corners=False)},
    {'grid': Grid(5, 4, base=2, blocked=(8, 11), connectivity=4)},
], every=3)  # fmt: skip
def test_a_mission_is_reproduced(replayed, options):
    robots = 2 * ROBOTS if options.get('conduct') is WILFUL else ROBOTS
    whole = mission(robots, **options)
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.finished
    topics = [*REPRODUCED, *['/model'] * ('unknowns' in options)]
    assert report.compared == {whole.namespace + topic: robots + 1 for topic in topics}
    assert report.method == whole.method
    assert (report.check is not None) == ('unknowns' in options)
    told = [entry.message for entry in whole.sent if entry.topic.endswith('/report')]
    assert len(report.evidence.standings) == robots
    assert report.evidence.survived == sum(each.survived for each in told) < robots
    assert report.not_yet_held == report.evidence.without_report == []
    assert report.evidence.without_path == report.evidence.refused == []
    assert (report.evidence.grid.neighbor_table == whole.grid.neighbor_table).all()
    if options.get('conduct') is WILFUL:
        assert any(each.steps_survived for each in told)
        assert any(reading.not_looked for each in told for reading in each.readings)


def test_standings_without_a_belief_of_their_own_are_judged(replayed):
    """Two judgements before one belief, and a report that is missing from the log."""
    whole, tour, other = Mission(), [2, 7, 12, 7, 2], [2, 7, 6, 2]
    key = whole.deploy(Observation(tour, False))
    second = whole.send_out(other, 'scout_2')
    whole.hear_path(second, other)
    back = Observation(tour, True, [True, False] * 2)
    for sent in (whole.come_back(key, back), whole.come_back(second, Observation(other, False))):
        assert whole.ledger.record_report(*sent)
        whole.publish_standings()
    whole.publish_belief()
    assert replayed(whole.sent).reproduced
    lost = without(whole.sent, *on(whole.sent, '/scout_1/report')[1:])
    found = replayed(lost).mismatches
    assert 'judges reports or states of the order that are not on record' in str(found[0])


@pytest.mark.slow
@for_each('method', METHODS)
def test_the_order_of_assimilation_is_that_of_the_deployments(replayed, method):
    """Even if reports are late, and for a restarted estimator."""
    unknowns = LEARNT if method == 'kappa_bnitp_sampled' else KNOWN
    whole, told = Mission(method, unknowns=unknowns), []
    for deployment in observations(6, seed=3):
        path = deployment.observation.path
        key = whole.send_out(path)
        told.append((path, *whole.come_back(key, deployment.observation)))
    for index in (5, 1, 4, 0, 3, 2):
        whole.assimilate(*told[index])
    joint = whole.ledger.belief.joint.tobytes()
    whole.start_estimator()
    for evidence in told:
        whole.assimilate(*evidence)
    assert whole.ledger.belief.joint.tobytes() == joint
    report = replayed(whole.sent)
    assert report.reproduced
    assert report.compared['/belief'] == 14
    assert report.compared['/model'] == (14 if unknowns is LEARNT else 0)


@pytest.mark.slow
@given(st.data())
@settings(max_examples=40 if FULL else 10, deadline=None)
def test_the_order_between_topics_does_not_matter(whole_mission, tmp_path_factory, data):
    """A recorder receives each topic in order, but one may be far behind another."""
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


flown = cache(observations)


@pytest.mark.slow
@given(st.booleans(), st.data())
# Shrinking takes minutes, and cases are small.
@settings(max_examples=100 if FULL else 8, deadline=None, phases=[Phase.generate])
def test_the_catch_up_of_a_restarted_estimator_is_reproduced(tmp_path_factory, silent, data):
    """It receives each publisher in order, and some of its beliefs are not recorded."""
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
        for outcome in (*lost, observation):
            said = orders, *whole.come_back(key, outcome)
            whole.assimilate(*said)
            told.setdefault((agent, silent and outcome.survived), []).append(said)
    first_run = len(whole.sent)
    whole.start_estimator()
    while publishers := [publisher for publisher in told if told[publisher]]:
        path, key, report = told[data.draw(st.sampled_from(publishers))].pop(0)
        whole.hear_path(key, path)
        # A loss changes nothing after the return.
        whole.hear_report(key, report)
    if data.draw(st.booleans()):
        whole.deploy(Observation([2, 7, 2], False))
    again = [message for message in whole.sent[first_run:] if message.topic == '/belief']
    # The last belief is latched, so a recorder receives it.
    gone = [again[index] for index in data.draw(st.sets(st.integers(0, len(again) - 2)))]
    places = [next(n for n, each in enumerate(whole.sent) if each is one) for one in gone]
    views = [whole.sent[place + n] for place in places for n in range(1, 1 + len(VIEWS))]
    assert {view.topic for view in views} <= {*VIEWS}
    evidence = [each for each in whole.sent if re.search('path|report', each.topic)]
    sent = [*without(whole.sent, *gone, *views), *evidence]
    path = tmp_path_factory.mktemp('caught_up') / 'mission.mcap'
    report = replay(record(path, sent))
    assert report.mismatches == report.evidence.refused == report.not_compared == []
    recorded = len(beliefs(whole.sent)) - len(gone)
    assert report.compared['/belief'] + len(report.repeated) == recorded


@pytest.mark.slow
@given(st.data())
@settings(max_examples=60 if FULL else 12, deadline=None)
def test_any_flipped_bit_is_found(whole_mission, learnt_mission, tmp_path_factory, data):
    """A flip of a last bit could be taken for rounding, and is reported too."""
    sent = data.draw(st.sampled_from([whole_mission, learnt_mission])).sent
    original = data.draw(st.sampled_from(on(sent, '/belief', *VIEWS, '/model')))
    numbers = ['mean', 'sd', 'quantile_5', 'effective_sample_size']
    names = {'/belief': ['joint', 'hazard', 'target', 'kappa'], '/model': numbers}
    field = data.draw(st.sampled_from(names.get(original.topic, ['data'])))
    # Replay starts from a prior's joint, whose last bit may vanish in the first update.
    assume((original, field) != (beliefs(sent)[0], 'joint'))
    values = getattr(original.message, field)
    index = data.draw(st.integers(0, len(values) - 1))
    bit = data.draw(st.integers(0, 8 * values.itemsize - 1))
    spoiled = flipped(original.message, field, index, bit)
    path = tmp_path_factory.mktemp('flipped') / 'mission.mcap'
    report = replay(record(path, instead(sent, original, spoiled)))
    found = report.mismatches + report.roundings
    assert not report.reproduced
    assert report.grade == Grade.DIFFERENT or field in ('joint', *numbers)
    place = next(n for n, one in enumerate(on(sent, original.topic)) if one is original)
    assert (found[0].topic, found[0].index) == (original.topic, place)


def interval(**values):
    return lambda unknowns: [changed(unknowns[0], **values), *unknowns[1:]]


@pytest.mark.slow
@for_each('field, value, told', [
    ('base', 3, 'base is 3, computed is 2'),
    ('blocked', [8], ''),
    ('max_steps', 9, ''),
    ('method', 'relaxed_itp', ''),
    ('lethality', 0.6000000000000001, ''),
    ('seed', 6, ''),
    ('unknowns', [UnknownNumber(name='kappa', a=1.0, b=1.0, low=0.0, high=1.0)], ''),
    ('unknowns', interval(low=0.2), 'unknowns[0].low is 0.2, computed is 0.1'),
    ('unknowns', interval(name='malfunction'), "unknowns[0].name is 'malfunction', computed"),
    ('prior', array('d', [0.25] * 80), ''),
    ('false_positive', 0.0, ''),
    ('deployments', 4, ''),
    ('deployments', 6, ''),
    ('deployments', 4_000_000_000, ''),
    ('deployments', 0, ''),
    ('agent', 'scout_2', ''),
    ('agent', '', ''),
    ('info', lambda info: changed(info, width=10), 'joint has 80 values'),
    ('info', lambda info: changed(info, height=8), 'joint has 80 values'),
    ('info', lambda info: changed(info, resolution=0.2), 'info.resolution'),
    ('hazard', lambda hazard: hazard[:-1], 'hazard has 19 values, the computed field has 20'),
], every=3)  # fmt: skip
def test_a_changed_field_is_found(learnt_mission, replayed, field, value, told):
    original = beliefs(learnt_mission.sent)[5]
    value = value(getattr(original.message, field)) if callable(value) else value
    spoiled = changed(original.message, **{field: value})
    report = replayed(instead(learnt_mission.sent, original, spoiled))
    assert told in str(report.mismatches[indices(report.mismatches).index(5)])
    assert not report.reproduced


def is_refused(path):
    return main([str(path)]) == 1


@for_each('topic, shift', [(topic, shift) for topic in VIEWS for shift in (0, 1, 10**9)])
def test_grids_of_no_belief_are_reported(whole_mission, tmp_path, topic, shift):
    """All of them are zeros, and their stamps are none of a belief, or that of one."""
    sent = whole_mission.sent
    for original in on(sent, topic):
        stamp = from_stamp(original.message.header.stamp) + shift
        sent = instead(sent, original, occupancy_grid(GRID, np.zeros(20), stamp))
    assert is_refused(record(tmp_path / 'mission.mcap', sent))


@for_each('topic', [*VIEWS, '/model'])
def test_a_second_view_of_a_belief_is_compared_too(tmp_path, topic):
    whole = mission(2, unknowns=Unknowns(lethality=(0.1, 0.9)))
    forged = deepcopy(on(whole.sent, topic)[1].message)
    if topic == '/model':
        forged.mean[0] = 0.5
    else:
        forged.data[0] = 99
    path = record(tmp_path / 'mission.mcap', [*whole.sent, Sent(topic, forged, START)])
    assert is_refused(path)


@for_each('checked, stamp', [(0, 0), (1, None), (2, 0), (99, None), (99, 1)])
def test_a_check_of_no_belief_is_reported(tmp_path, checked, stamp):
    """The last model is said to be in doubt."""
    whole = mission(3, unknowns=Unknowns(lethality=(0.1, 0.9)))
    original = on(whole.sent, '/model')[-1]
    assert original.message.checked == 2
    stamp = original.message.checked_stamp if stamp is None else to_stamp(stamp)
    forged = {'in_doubt': True, 'checked': checked, 'checked_stamp': stamp}
    sent = instead(whole.sent, original, changed(original.message, **forged))
    assert is_refused(record(tmp_path / 'mission.mcap', sent))


@for_each('field, value', [
    ('in_doubt', True),
    ('alternative_ratio', lambda ratios: [ratios[0] + 1.0, *ratios[1:]]),
])  # fmt: skip
@for_each('repeated', [False, True])
def test_a_changed_check_is_found(replayed, field, value, repeated):
    whole = mission(5, unknowns=Unknowns(lethality=(0.1, 0.9)))
    assert replayed(whole.sent).reproduced
    models = on(whole.sent, '/model')
    assert [each.message.checked for each in models] == [0, 0, 2, 2, 4, 4]
    original = models[4 + repeated]
    value = value(list(getattr(original.message, field))) if callable(value) else value
    report = replayed(instead(whole.sent, original, changed(original.message, **{field: value})))
    assert [each.differences[0].field for each in report.mismatches] == [field]


@for_each('change', [3e-9, 1e-6])
def test_a_difference_above_a_billionth_is_no_rounding(whole_mission, replayed, change):
    original = beliefs(whole_mission.sent)[5]
    joint = np.array(original.message.joint).reshape(-1, 2, 2)
    cell = int(np.argmax((joint > 2 * change).all(axis=(1, 2))))
    joint[cell] += np.array([[change, 0.0], [0.0, -change]])
    belief = Belief(joint)
    maps = {name: getattr(belief, name) for name in ('hazard', 'target', 'kappa')}
    spoiled = changed(original.message, joint=joint.ravel(), **maps)
    report = replayed(instead(whole_mission.sent, original, spoiled))
    assert '/belief' in {each.topic for each in report.mismatches}
    assert report.grade is Grade.DIFFERENT


@for_each('field', ['joint', 'hazard', 'target', 'kappa'])
def test_the_last_bit_of_a_value_is_found_by_its_cell(whole_mission, replayed, field):
    original = beliefs(whole_mission.sent)[5]
    cell = 7
    spoiled = flipped(original.message, field, 4 * cell + 3 if field == 'joint' else cell, bit=0)
    report = replayed(instead(whole_mission.sent, original, spoiled))
    (mismatch,) = report.mismatches or report.roundings
    assert (mismatch.topic, mismatch.index) == ('/belief', 5)
    assert mismatch.belief == f'after {keys(whole_mission.sent)[4]}'
    difference, *_ = mismatch.differences
    assert (difference.field, difference.cell) == (field, cell)
    assert 0.0 < difference.largest < 1e-15
    assert f'{field} differs in 1 values, by up to {difference.largest:.3g} in cell 7' in str(
        mismatch
    )


@for_each('field', ['hazard', 'target', 'kappa'])
def test_the_sign_of_a_zero_in_a_map_is_found(whole_mission, replayed, field):
    original = beliefs(whole_mission.sent)[4]
    blocked = 8
    assert getattr(original.message, field)[blocked] == 0.0
    spoiled = flipped(original.message, field, blocked, bit=63)
    report = replayed(instead(whole_mission.sent, original, spoiled))
    assert report.grade == Grade.DIFFERENT
    assert indices(report.mismatches) == [4]


def drop(topic, *which):
    return lambda whole: without(whole.sent, *(on(whole.sent, topic)[each] for each in which))


def edit(topic, which, change):
    def edited(whole):
        original = on(whole.sent, topic)[which]
        spoiled = deepcopy(original.message)
        change(spoiled)
        return instead(whole.sent, original, spoiled)

    return edited


def swapped(whole):
    _, _, second, third, *_ = beliefs(whole.sent)
    sent = without(whole.sent, second)
    sent.insert(sent.index(third) + 1, second)
    return sent


def heard_again(which):
    """Return messages that a restarted recorder receives: last belief, latched paths, reports."""
    return lambda whole: [
        *whole.sent,
        *on(whole.sent, '/scout_1/path', '/scout_1/report'),
        beliefs(whole.sent)[which],
    ]


def reported_later(whole):
    sent = whole.sent
    for number in range(ROBOTS):
        later = deepcopy(on(sent, '/scout_1/report')[number].message)
        later.header.stamp.sec += 3600
        sent = instead(sent, on(sent, '/scout_1/report')[number], later)
    return sent


def sent_out(whole):
    whole.send_out([2, 2])
    return whole.sent


def not_held(late, then):
    """Return a change: the estimator misses a return, perhaps a late one, but not later ones."""

    def change(whole):
        key = whole.deploy(Observation([2, 7, 2], False)) if late else whole.send_out([2, 7, 2])
        whole.come_back(key, Observation([2, 7, 2], True, [True, False]))
        if then:
            whole.deploy(Observation([2, 7, 2], False))
        return whole.sent

    return change


def with_others(*others):
    return lambda whole: [*(Sent(topic, each, START) for topic, each in others), *whole.sent]


def contradicted(whole):
    """Publish another return and a loss of a returned robot, a second path, and an empty name."""
    returned = next(e.message for e in on(whole.sent, '/scout_1/report') if e.message.survived)
    key = read_report(returned)[0]
    cells = [2, *(reading.cell for reading in returned.readings)]
    readings = [not reading.detected for reading in returned.readings]
    whole.come_back(key, Observation(cells, True, readings))
    whole.come_back(key, Observation(cells, False))
    whole.publish('scout_1/path', path_message(whole.grid, [2, 2], key.stamp))
    unnamed = report_message(DeploymentKey('', 5), Observation([2, 2], False), 5)
    whole.publish('scout_1/report', unnamed)
    return whole.sent


def misfit(whole):
    """Publish reports without their last reading: a deployment's first, and an only one."""
    first = Observation([2, 3, 2], True, [True] * 2)
    for correct in (True, False):
        key = whole.send_out(first.path)
        whole.come_back(key, first)
        whole.sent[-1].message.readings.pop()
        whole.hear_path(key, first.path)
        whole.hear_report(*read_report(whole.sent[-1].message))
        if correct:
            whole.assimilate(first.path, *whole.come_back(key, first))
    whole.deploy(Observation([2, 7, 2], False))
    return whole.sent


def lose(report):
    report.survived, report.readings = False, []
    report.header.stamp.sec += 1


def flip_reading(report):
    report.readings[0].detected = not report.readings[0].detected


TRUTH = occupancy_grid(GRID, np.zeros(20), START)
UNRECORDED = 'standing of {3} judges reports or states of the order that are not on record'
CHANGES = {
    'nothing': (lambda whole: whole.sent, 0, 9, [], [], [
        '/belief: 9 of 9 messages reproduced\n/belief/hazard: 9 of 9 messages reproduced\n'
        '/belief/kappa: 9 of 9 messages reproduced\n/belief/target: 9 of 9 messages reproduced\n'
    ]),
    'some beliefs': (drop('/belief', 2, 3, 6), 0, 6, [], [], ['/belief: 6 of 6 messages']),
    'most beliefs': (drop('/belief', *range(1, 8)), 0, 2, [], [], ['/belief: 2 of 2 messages']),
    'the last belief': (drop('/belief', 8), 0, 8, [], [], ['/standings: 9 of 9 messages']),
    'the last standings': (drop('/standings', 8), 0, 8, [], [8], [
        'no standings on record are those of its evidence', '{7} is not judged']),
    'some standings': (drop('/standings', 3), 0, 3, [], [*range(3, 9)], [
        'standings between events 2 and 3 are missing', 'not compared: 8 more']),
    'the order': (swapped, 0, 9, [], [], []),
    'the first belief twice': (heard_again(0), 0, 9, [], [], ['repeated: ']),
    'a belief twice': (heard_again(4), 0, 9, [], [], ['repeated: ']),
    'the last belief twice': (heard_again(8), 0, 9, [], [], ['repeated: ']),
    'the prior': (drop('/belief', 0), 1, 8, [*range(8)], [], [
        'method not on record', 'prior of its estimator is not on record',
        'not compared: 8 more']),
    'a path': (drop('/scout_1/path', 3), 1, 9, [*range(4, 9)], [], [
        'not reproduced: /standings message 4: changes is more, unlike the computed evidence; '
        'standing of {3} is RETURN, computed is OPEN',
        'deployment {3} has no path on record']),
    'a report': (drop('/scout_1/report', 3), 1, 9, [*range(4, 9)], [], [
        UNRECORDED, 'deployment {3} has no report on record: the robot was in flight']),
    'a reading': (edit('/scout_1/report', 3, flip_reading), 1, 9, [*range(4, 9)], [], [
        UNRECORDED]),
    'the readings': (edit('/scout_1/report', 3, lambda told: told.readings.pop()), 1, 9,
                     [*range(4, 9)], [], [UNRECORDED, 'refused: ']),
    'a return': (edit('/scout_1/report', 3, lose), 1, 9, [*range(4, 9)], [], [UNRECORDED]),
    'a verdict': (edit('/standings', 4, lambda said: setattr(said.standings[0], 'verdict', 3)),
                  1, 9, [], [], ['standing of {3} is LOSS, computed is RETURN']),
    'all reports': (reported_later, 1, 9, [*range(1, 9)], [], ['{0} is in no belief yet']),
    'a robot out': (sent_out, 0, 9, [], [], [
        '{8} has no report on record: the robot was in flight']),
    'a return not held yet': (not_held(False, False), 0, 9, [], [], ['{8} is not judged']),
    'a return passed over': (not_held(False, True), 1, 10, [], [], [
        'not reproduced: a report of deployment {8} is not judged, but a later one is']),
    'a late return not held yet': (not_held(True, False), 0, 10, [], [], ['{8} is not judged']),
    'a late return passed over': (not_held(True, True), 1, 11, [], [], [
        'not reproduced: a report of deployment {8} is not judged']),
    'paths of others': (with_others(('/plan', Path()), ('path', Path()), ('/path', Path())),
                        0, 9, [], [], ['8 deployments']),
    'maps of others': (with_others(('/truth/hazard', TRUTH)), 0, 9, [], [], ['8 deployments']),
    'a model of others': (with_others(('/model', Path())), 0, 9, [], [], ['8 deployments']),
    'contradictions': (contradicted, 0, 9, [], [], [
        '{0} is not judged', 'differs from its first path',
        "/scout_1/report: agent is ''"]),
    'misfits': (misfit, 0, 11, [], [], ['refused: ', 'readings of deployment {9} has 1 values']),
}  # fmt: skip


@pytest.mark.slow
@for_each('changed', CHANGES, every=2)
def test_changes_to_a_log_are_reported(whole_mission, tmp_path, changed):
    change, code, compared, different, left, told = CHANGES[changed]
    whole = deepcopy(whole_mission)
    path = record(tmp_path / 'mission.mcap', change(whole))
    report = replay(path)
    assert report.reproduced == (code == 0)
    assert report.compared['/belief'] == compared
    assert (indices(report.mismatches), indices(report.not_compared)) == (different, left)
    assert len(report.repeated) == changed.endswith('twice')
    printed = ''.join(f'{line}\n' for line in lines(report))
    for sentence in told:
        assert sentence.format(*keys(whole.sent)) in printed


def test_a_model_of_another_namespace_is_ignored(learnt_mission, replayed):
    other = Sent('/other/model', on(learnt_mission.sent, '/model')[0].message, START)
    assert replayed([other, *learnt_mission.sent]).reproduced


def test_complete_standings_end_a_gap(replayed):
    """As for a recorder that missed standings, or started late."""
    whole = Mission()
    for number, deployment in enumerate(observations(ROBOTS)):
        if number == 5:
            whole.events = 0
            whole.ledger._changed = dict.fromkeys(whole.ledger.standings)
        whole.deploy(deployment.observation)
    said = on(whole.sent, '/standings')
    assert [each.message.since for each in said] == [0, 0, 1, 2, 3, 4, 0, 6, 7]
    report = replayed(without(whole.sent, said[3]))
    assert report.reproduced
    assert indices(report.not_compared) == [3, 4, 5]
    assert report.compared['/belief'] == ROBOTS - 2
    assert report.not_yet_held == []


@for_each('heard', [(0, 1), (1, 0)])
def test_the_same_of_two_returns_counts_in_any_order(replayed, heard):
    """Two robots of one name; then the estimator resumes from the log."""
    whole = Mission()
    path = [2, 7, 2]
    key = whole.send_out(path)
    walks = Observation([2, 7, 12, 7, 2], True, [True] * 4), Observation(path, True, [False] * 2)
    on_record = [whole.come_back(key, walk) for walk in walks]
    whole.hear_path(key, path)
    for number in heard:
        whole.hear_report(*on_record[number])
    whole.deploy(Observation([2, 1, 2], False))
    joint = whole.ledger.belief.joint.tobytes()
    whole.start_estimator()
    for entry in [each for each in whole.sent if each.topic == '/scout_1/path']:
        order, cells = read_path(GRID, 'scout_1', entry.message)
        whole.hear_path(order, cells)
    for entry in [each for each in whole.sent if each.topic == '/scout_1/report']:
        whole.hear_report(*read_report(entry.message))
    assert whole.ledger.belief.joint.tobytes() == joint
    report = replayed(whole.sent)
    assert report.reproduced, report.mismatches
    assert report.evidence.lost == 1


def refused(path, capsys):
    assert main([str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ''
    (line,) = captured.err.splitlines()
    return line


def every_belief(**fields):
    return lambda sent: [
        replace(each, message=changed(each.message, **fields)) if each.topic == '/belief' else each
        for each in sent
    ]


@for_each('change, told', [
    (lambda sent: sent + mission(2, namespace='/other').sent,
     'has missions in the namespaces /, /other: choose one by --namespace'),
    (lambda sent: on(sent, '/scout_1/path'), 'mission.mcap has no readable beliefs'),
    (every_belief(method_version=2), 'the beliefs were computed by version 2 of kappa_bnitp, and'),
    (every_belief(method='guessing'), "cannot be computed: method is 'guessing': .*known are"),
])  # fmt: skip
def test_a_log_that_cannot_be_replayed_is_refused(whole_mission, tmp_path, capsys, change, told):
    path = record(tmp_path / 'mission.mcap', change(whole_mission.sent))
    assert re.search(told, refused(path, capsys))


def rewritten(path, sent, edit):
    """Write messages as a program with another definition of beliefs does."""
    with path.open('wb') as file:
        log = ros2.Writer(file)
        schemas = {}
        for name in {BELIEF, *(each.type_name for each in sent if each.topic != '/belief')}:
            definition, _ = describe(name)
            schemas[name] = log.register_msgdef(
                name, edit(definition) if name == BELIEF else definition
            )
        for message in sent:
            schema = schemas[BELIEF if message.topic == '/belief' else message.type_name]
            log.write_message(message.topic, schema, message.message, message.time, message.time)
        log.finish()
    return path


def resumed(path):
    return read_resumed(MissionLog(path), GRID, MAX_STEPS)


def newest_round(path):
    return read_newest_round(MissionLog(path), resumed(path))


class Later:
    """A belief with a field of a later version."""

    def __init__(self, belief):
        self._belief = belief
        self.relays = 0

    def __getattr__(self, name):
        return getattr(self._belief, name)


@for_each('read', [replay, read_history, resumed])
@for_each('edit, told', [
    (lambda definition: re.sub(r'\nuint32 changes .*', '', definition),
     'was recorded by another version (not on record): the field changes of its beliefs is not '
     'that of this version; logs of 1.x are read by kbnitp_ros 1.9'),
    (lambda definition: definition.replace('\nfloat64[] pri', '\nuint8 relays\nfloat64[] pri', 1),
     'was recorded by another version (not on record): the field relays of its beliefs'),
])  # fmt: skip
def test_a_log_of_another_version_is_refused_with_the_version_that_reads_it(
    whole_mission, tmp_path, capsys, read, edit, told
):
    sent = [
        replace(entry, message=Later(entry.message)) if entry.topic == '/belief' else entry
        for entry in whole_mission.sent
    ]
    path = rewritten(tmp_path / 'mission.mcap', sent, edit)
    with pytest.raises(LogError, match=re.escape(told)):
        read(path)
    assert told in refused(path, capsys)


@for_each('read, type_name, field, other', [
    (replay, PATH, 'geometry_msgs/PoseStamped[] poses', 'uint32 poses'),
    (read_history, PATH, 'geometry_msgs/PoseStamped[] poses', 'uint32 poses'),
    (read_history, BELIEF, 'std_msgs/Header header', 'std_msgs/Header head'),
    (resumed, PATH, 'std_msgs/Header header', 'std_msgs/Header head'),
    (resumed, REPORT, 'string agent', 'string name'),
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
        assert field in known[0]
        return known[0].replace(field, other, 1), known[1]

    monkeypatch.setattr(writer, 'describe', described)
    path = record(tmp_path / 'mission.mcap', whole_mission.sent)
    another = 'mission.mcap (has messages of another version of their|was recorded by another)'
    with pytest.raises(LogError, match=another):
        read(path)


def test_messages_that_are_recorded_twice_do_not_stop_a_replay(tmp_path):
    sent = mission(4).sent
    rng = np.random.default_rng(1)
    for number in range(20):
        doubled = [*sent]
        for place in rng.integers(len(sent), size=20):
            doubled.insert(rng.integers(len(doubled)), sent[place])
        timed = [replace(each, time=START + place) for place, each in enumerate(doubled)]
        report = replay(record(tmp_path / f'{number}.mcap', timed))
        assert report.compared['/belief'] + len(report.not_compared) >= 5


def test_checks_of_two_beliefs_with_one_stamp_are_told_apart(tmp_path):
    """A late return may have the stamp of the loss that it replaces."""
    whole = Mission(unknowns=Unknowns(lethality=(0.0, 1.0)))
    path = [2, 7, 12, 7, 2]
    whole.deploy(Observation(path, False))
    late = whole.deploy(Observation(path, False))
    at = whole.ledger.newest_stamp
    back = report_message(late, Observation(path, True, [True, False, True, False]), at)
    whole.publish(f'{late.agent}/report', back)
    assert whole.hear_report(*read_report(back))
    models = [each.message for each in whole.sent if each.topic == '/model']
    names = [(each.checked, each.checked_stamp, each.alternative_ratio) for each in models]
    assert names[-1][:2] == names[-2][:2]
    assert names[-1][2] != names[-2][2]
    assert replay(record(tmp_path / 'mission.mcap', whole.sent)).grade is Grade.IDENTICAL
