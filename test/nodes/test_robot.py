# SPDX-License-Identifier: Apache-2.0
"""A robot walks its orders by actions of Nav2, and reports its true walk."""

from collections import Counter
from functools import reduce
from itertools import count, cycle, product
import json
from math import atan2, hypot
from operator import itemgetter
import os
import signal
import subprocess

from extent import FULL, LONG, some
from fleet import FIELD, Fleet, GRID, moves, TARGETS
from geometry_msgs.msg import PoseStamped
from kbnitp_msgs.msg import AgentState, AgentStatus, BeliefMaps
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.topics import REPORT
from kbnitp_ros.nodes.runtime import qos
from launches import interrupt, launched, node_pids
from nav_msgs.msg import Path
import numpy as np
import pytest
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Bool

ROUND = [0, 1, 14, 14, 13, 25, 13, 12, 0, 1, 0]


DATUM = (55.944904, -3.186693, -0.8)
TURNED = {'placed': (40.0, -7.0, 2.1), 'datum': DATUM}
POSES = {'driver': 'navigate_through_poses'}

# Simulated detections and positions, and the robot's parameters; one robot is located by fixes
# only.
WALKS = {
    'fixes': (TURNED, {**POSES, 'position': 'fix', 'remapped': {'/tf': '/nobody'}}),
    'pictures': ({'detection_type': 'detection2d_array'}, {**POSES, 'detection_class': 'target'}),
    'turned': (TURNED, POSES),
    'follow_path': ({}, {'driver': 'follow_path'}),
    'waypoints': ({}, {'driver': 'follow_waypoints'}),
    'poses': ({}, POSES),
}


@pytest.mark.parametrize('kind', some(WALKS, 6))
def test_a_robot_reports_its_true_walk(field, kind):
    simulated, told = WALKS[kind]
    fleet, reports = Fleet.simulated(field, **simulated)
    fleet.start(**told)
    report = fleet.wait_for_report(reports, fleet.send(1, ROUND))
    fleet.see_that_it_is_true(report)
    # A detector of images only gives the robot's cell at each time.
    if kind != 'pictures':
        assert [cell for cell, _ in report.readings] == ROUND[1:]
    if 'placed' not in simulated:
        assert all(reading == (cell in TARGETS) for cell, reading in report.readings[:-1])


BAD_FIXES = {
    "header.frame_id is 'gps': it must be 'base_link'": {'header.frame_id': 'gps'},
    'status.status is -1: there is no fix': {'status.status': -1},
    'position_covariance_type is 0': {'position_covariance_type': 0},
    'latitude is nan': {'latitude': float('nan')},
    'longitude is 181.0': {'longitude': 181.0},
    'the standard deviation of the fix is 3.00 m: at most 0.5 m, half a cell, is accepted': {
        'position_covariance': np.diag([9.0, 1.0, 1.0]).ravel()
    },
    'position_covariance has (0.0, 0.0) east and north: they must be positive': {
        'position_covariance': np.zeros(9)
    },
}


def test_bad_fixes_are_refused_by_name_and_counted(field):
    fleet = Fleet(field, datum=DATUM)
    fleet.start(position='fix')
    receiver = field.talk(NavSatFix, '/scout_1/fix', 10)
    for told, changes in BAD_FIXES.items():
        fix = NavSatFix(latitude=DATUM[0], longitude=DATUM[1], position_covariance_type=2)
        fix.status.status = NavSatStatus.STATUS_FIX
        fix.header.frame_id = 'base_link'
        fix.position_covariance = np.diag([0.01, 0.01, 0.01]).ravel()
        for name, value in changes.items():
            *parents, last = name.split('.')
            setattr(reduce(getattr, parents, fix), last, value)

        def is_refused(fix=fix, told=told):
            # The robot may not have discovered the receiver, and fixes are best effort.
            receiver.publish(fix)
            return f'fix refused: {told}' in field.said('/scout_1/robot')

        field.until(is_refused, told)
    counted = len(BAD_FIXES)
    field.until(lambda: field.count('/scout_1/robot', 'refused') >= counted, 'count')


def test_a_robot_leaves_from_and_comes_home_to_its_own_base(field):
    """It refuses paths from others' bases, with a file of parameters that names both."""
    fleet = Fleet(field)
    reports = fleet.reports()
    fleet.simulate(scout_1=(11.5, 11.5))
    fleet.start(**{'team.scout_1.base_position': [11.2, 11.9], 'team.scout_2.base': 11})
    fleet.send(1, [0, 1, 0])
    field.until(lambda: field.count('/scout_1/robot', 'refused') == 1, 'refusal')
    # It may state meanwhile what it waits for.
    assert 'path must start at the base 143, not at cell 0' in field.said('/scout_1/robot')
    orders = [143, 142, 130, 131, 143]
    report = fleet.wait_for_report(reports, fleet.send(2, orders))
    assert [cell for cell, _ in report.readings] == orders[1:]
    assert fleet.walked() == orders


def test_two_robots_park_apart_at_one_base(field):
    """Each leaves from its own place, comes back to it, and stands there as it was told."""
    homes = {'scout_1': (0.25, 0.3, 3.0), 'scout_2': (0.75, 0.7)}
    fleet = Fleet(field, tuple(homes))
    states = {name: field.listen(AgentState, f'/{name}/state') for name in homes}
    reports = {name: fleet.reports(name) for name in homes}
    parked = {f'team.{name}.parking': list(place) for name, place in homes.items()}
    # Each robot is where the other one parks.
    fleet.simulate(scout_1=homes['scout_2'], scout_2=homes['scout_1'][:2])
    goals = field.listen(PoseStamped, '/scout_1/goal')
    for name in homes:
        fleet.start(name, arrival_tolerance=0.2, **POSES, **parked)
    words = 'is 0.6 m from its home, at most 0.2 m are allowed'
    for said in states.values():
        field.until(lambda said=said: said and words in said[-1].reason, words)
        assert not said[-1].at_base
    assert not any(reports.values())
    fleet.end_simulator()
    fleet.simulate(**{name: place[:2] for name, place in homes.items()})
    for said in states.values():
        field.until(lambda said=said: said[-1].state == AgentState.READY, 'robot at home')
    orders = [0, 1, 14, 1, 0]
    for name, (x, y, *_) in homes.items():
        report = fleet.wait_for_report(reports[name], fleet.send(1, orders, name))
        assert [cell for cell, _ in report.readings] == orders[1:]
        last_x, last_y = fleet.truth()[name][-1]
        assert hypot(last_x - x, last_y - y) < 0.2
        field.until(lambda name=name: states[name][-1].at_base, f'{name} at its base')
    yaw = goals[-1].pose.orientation
    assert 2.0 * atan2(yaw.z, yaw.w) == pytest.approx(3.0)


def test_a_robot_that_would_park_outside_its_base_is_refused(field):
    Fleet(field).start(**{'team.scout_1.parking': [1.5, 0.5]})
    code, told = field.until_failed('/scout_1/robot')
    assert code == 2
    assert 'parameter team.scout_1.parking is [1.5, 0.5], in cell 1, and the base is cell' in told


def test_a_reading_needs_several_detections_of_a_poor_detector(field):
    fleet, reports = Fleet.simulated(field, speed=1.0)
    rule = {'detections.needed': 2, 'detections.of': 3}
    fleet.start(remapped={'detections': '/scout_1/poor'}, **rule)
    detector = field.talk(Bool, '/scout_1/poor', qos.READINGS)
    # At most one of another kind while in a cell, however many get lost.
    pattern = cycle([True] + 32 * [False])
    field.node.create_timer(0.06, lambda: detector.publish(Bool(data=next(pattern))))
    for number, seen in enumerate((False, True), 1):
        report = fleet.wait_for_report(reports, fleet.send(number, [0, 1, 2, 1, 0]))
        readings = [reading for _, reading in report.readings]
        assert readings.count(seen) >= 3
        assert (not seen) not in readings
        pattern = cycle([False] + 32 * [True])


def test_a_rule_of_readings_that_no_detections_fulfil_is_refused(field):
    Fleet(field).start(**{'detections.needed': 3, 'detections.of': 2})
    code, told = field.until_failed('/scout_1/robot')
    assert code == 2
    assert 'parameter detections.needed is 3: it must be at most detections.of' in told


# Number of injections of each failure.
ROUNDS = 20 if FULL else 1


def fail(fleet, how, when):
    """Inject a failure into a robot before its departure, or some seconds after it."""
    if how in ('reject', 'abort', 'silent', 'lie'):
        fleet.inject(how)
        return
    # By diagnostics of each second, it may be back.
    fleet.field.until(fleet.is_away, 'robot under way')
    fleet.wait(when)
    fleet.inject('die')
    fleet.field.until(lambda: 'waiting for the action server' in fleet.state(), 'wait')
    fleet.inject('live')


@pytest.mark.parametrize(
    'driver, failures',
    [
        ('follow_waypoints', ['reject', 'abort']),
        pytest.param('follow_path', ['silent', 'lie', 'die'], marks=pytest.mark.full),
        *(
            pytest.param(driver, ['reject', 'abort', 'silent', 'lie', 'die'], marks=LONG)
            for driver in ('follow_waypoints', 'navigate_through_poses', 'follow_path')
        ),
    ],
)
def test_a_failure_is_tried_again_and_the_walk_is_reported_as_it_was(field, driver, failures):
    rng = np.random.default_rng(len(failures))
    fleet, reports = Fleet.simulated(field)
    fleet.start(driver=driver, server_timeout=0.5)
    numbers = count(1)
    for how in failures:
        for _ in range(ROUNDS if len(failures) > 3 else 1):
            field.until(lambda: fleet.state().startswith('taking paths'), 'robot at home')
            since = len(fleet.truth()['scout_1'])
            orders = [0, 1, 2, 1, 0]
            if how in ('reject', 'abort', 'silent', 'lie'):
                fail(fleet, how, 0)
                key = fleet.send(next(numbers), orders)
            else:
                key = fleet.send(next(numbers), orders)
                fail(fleet, how, rng.uniform(0, 0.3))
            report = fleet.wait_for_report(reports, key)
            fleet.see_that_it_is_true(report, since)
            assert moves([0, *(cell for cell, _ in report.readings)]) == orders, how
            if how == 'abort':
                said = 'was aborted: error 106 NO_VALID_CONTROL; trying again'
                assert said in field.said('/scout_1/robot')


WAY_ROUND = [0, 1, 2, 3, 16, 15, 14, 13, 0]


def is_out_and_back(report):
    """Return whether a robot returned the way it came, before the end of its orders."""
    cells = moves([0, *(cell for cell, _ in report.readings)])
    turn = len(cells) // 2
    return cells == cells[::-1] and cells[: turn + 1] == WAY_ROUND[: turn + 1]


def test_a_stuck_robot_goes_home_and_reports_its_walk(field):
    fleet, reports = Fleet.simulated(field)
    fleet.start(attempts=2)
    key = fleet.send(1, WAY_ROUND)
    field.until(lambda: {2, 3} & set(fleet.walked()), 'robot under way')
    fleet.inject('die')
    field.until(lambda: 'waiting for the action server' in fleet.state(), 'wait')
    fleet.inject('live')
    fleet.inject('reject!')
    field.until(lambda: 'going home' in field.said('/scout_1/robot'), 'end of its orders')
    fleet.inject('live')
    report = fleet.wait_for_report(reports, key)
    fleet.see_that_it_is_true(report)
    assert is_out_and_back(report)
    assert 'rejected the goal; going home' in field.said('/scout_1/robot')
    # So does one whose goal is cancelled.
    since = len(fleet.truth()['scout_1'])
    key = fleet.send(2, WAY_ROUND)
    field.until(lambda: {2, 3} & set(fleet.walked(since=since)), 'robot under way')
    fleet.cancel_all('follow_waypoints')
    report = fleet.wait_for_report(reports, key)
    fleet.see_that_it_is_true(report, since)
    assert is_out_and_back(report)
    said = field.said('/scout_1/robot')
    assert 'the goal of /scout_1/follow_waypoints was cancelled; going home' in said


def test_a_robot_goes_home_while_its_time_budget_lasts_for_the_way_back(field):
    fleet, reports = Fleet.simulated(field, speed=1.0)
    fleet.start(time_budget=5.0)
    report = fleet.wait_for_report(reports, fleet.send(1, WAY_ROUND))
    fleet.see_that_it_is_true(report)
    assert is_out_and_back(report)
    assert '(parameter time_budget) is needed for the way back' in field.said('/scout_1/robot')


def test_a_robot_asks_nav2_for_its_speed_and_warns_of_its_goal_tolerance(field):
    limits = {'FollowPath.desired_linear_vel': 0.8, 'general_goal_checker.xy_goal_tolerance': 0.45}

    def tell(request, response):
        # Nav2 answers nothing if it lacks one of the names.
        if limits.keys() >= {*request.names}:
            response.values = [
                ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=limits[name])
                for name in request.names
            ]
        return response

    field.node.create_service(GetParameters, '/scout_1/controller_server/get_parameters', tell)
    fleet, reports = Fleet.simulated(field)
    fleet.start(arrival_tolerance=0.4)
    fleet.wait_for_report(reports, fleet.send(1, [0, 1, 0]))
    said = field.said('/scout_1/robot')
    assert 'at 0.8 m/s the robot vouches for its steps' in said
    assert 'xy_goal_tolerance of Nav2 is 0.45 m: set it to at most 0.4 m' in said


def test_a_robot_that_nav2_leaves_beside_its_home_reports_and_does_not_leave_again(field):
    fleet, reports = Fleet.simulated(field)
    # Nav2 ends goals farther away.
    fleet.start(arrival_tolerance=0.1)
    report = fleet.wait_for_report(reports, fleet.send(1, [0, 1, 0]))
    assert moves([0, *(cell for cell, _ in report.readings)]) == [0, 1, 0]
    tries = field.said('/scout_1/robot').count('reports home as reached, but the robot is 0.1')
    assert tries == 3
    fleet.send(2, [0, 1, 0])
    field.until(lambda: 'waiting for the robot to be at its base' in fleet.state(), 'wait')


DRIVERS = ['follow_waypoints', 'navigate_through_poses', 'follow_path']


@pytest.mark.parametrize('driver, fault', some(product(DRIVERS, ('jump', 'blind')), 6))
def test_no_cell_is_vouched_for_that_was_not_entered_around_a_fault(field, driver, fault):
    fleet, reports = Fleet.simulated(field, speed=1.0)
    fleet.start(driver=driver, max_speed=1.5, tf_timeout=0.5)
    key = fleet.send(1, [0, 1, 2, 3, 2, 1, 0])
    field.until(lambda: 2 in fleet.walked(), 'robot under way')
    fleet.inject(fault)
    states = field.listen(AgentState, '/scout_1/state')

    def is_told():
        is_blind = states and states[-1].reason.startswith('TF')
        return is_blind if fault == 'blind' else 'jump' in field.said('/scout_1/robot')

    field.until(is_told, 'word of the fault')
    # Longer than a jump must last to be accepted.
    fleet.wait(1.5)
    fleet.inject('live')
    report = fleet.wait_for_report(reports, key)
    field.until(lambda: 'not vouched for' in field.said('/scout_1/robot'), 'word of the steps')
    sure = [each for each, is_sure in zip(report.readings, report.entered) if is_sure]
    assert sure
    assert {cell for cell, _ in sure} <= {*fleet.walked()}
    assert all(reading in (cell in TARGETS, -1) for cell, reading in sure)
    assert report.readings[0] == (1, False)


def test_a_robot_says_why_it_cannot_leave_and_where_it_stands(field):
    fleet = Fleet(field)
    states = field.listen(AgentState, '/scout_1/state')
    reports = fleet.reports()
    fleet.start(tf_timeout=1.0)

    def said(words, **values):
        field.until(
            lambda: (
                states
                and words in states[-1].reason
                and all(getattr(states[-1], name) == value for name, value in values.items())
            ),
            f'{words!r} {values}',
        )

    said('TF: ', state=AgentState.WAITING, at_base=False)
    assert states[-1].field_id == GRID.id
    fleet.simulate(wrong='reject!')
    said('', state=AgentState.READY, at_base=True)
    # Nav2 rejects the goals: it comes back without a step, and says why.
    fleet.send(1, [0, 1, 0])
    said('rejected the goal', state=AgentState.OUT, at_base=True)
    field.until(lambda: reports, 'report')
    said('rejected the goal', state=AgentState.READY, at_base=True)
    fleet.inject('live')
    key = fleet.send(2, [0, 1, 2, 3, 2, 1, 0])
    said('', state=AgentState.OUT, at_base=False)
    fleet.wait_for_report(reports, key)
    said('', state=AgentState.READY, at_base=True)
    fleet.end_simulator()
    said('', state=AgentState.WAITING)


@pytest.mark.parametrize('lifecycle, told', some([
    (True, 'waiting for /scout_1/waypoint_follower to be active: its lifecycle state is '),
    (False, 'waiting for Nav2 to be ready: the action server /scout_1/follow_waypoints '),
], 2))  # fmt: skip
def test_a_robot_does_not_depart_before_nav2_takes_goals(field, lifecycle, told):
    fleet = Fleet(field, lifecycle=lifecycle)
    reports = fleet.reports()
    fleet.simulate(wrong='inactive')
    fleet.start(attempts=1)
    key = fleet.send(1, [0, 1, 0])
    field.until(lambda: told in field.said('/scout_1/robot'), 'wait for Nav2 on the console')
    # Operator actions meanwhile still hold when Nav2 is ready.
    fleet.hold(True)
    fleet.inject('live')
    field.until(lambda: 'the operator to end the pause' in fleet.state(), 'wait for the operator')
    said = [status.state for status in fleet.statuses['scout_1']]
    assert said == [AgentStatus.ACCEPTED]
    fleet.hold(False)
    report = fleet.wait_for_report(reports, key)
    assert moves([0, *(cell for cell, _ in report.readings)]) == [0, 1, 0]


def test_a_robot_waits_for_its_action_servers_and_says_so(field):
    fleet = Fleet(field)
    reports = fleet.reports()
    fleet.start()
    key = fleet.send(1, [0, 1, 0])
    field.until(lambda: 'waiting for TF' in fleet.state(), 'wait for TF')
    assert "the place of 'base_link' is unknown" in fleet.state()
    fleet.simulate(scout_1=(5.5, 5.5))
    field.until(lambda: 'to be at its base, cell 0: it is 7.1 m' in fleet.state(), 'wait for it')
    fleet.end_simulator()
    fleet.simulate(scout_1=(0.5, 0.5))
    fleet.wait_for_report(reports, key)


MISSION = '/mission'
NODES = ('recorder', 'estimator', 'planner')
# Seconds after a path was sent at which the base dies, and seconds until its restart.
CRASHES = np.random.default_rng(4).uniform(0, [3.0, 5.0], (20, 2)).tolist()


@pytest.mark.parametrize('driver, names, robots, max_steps, crashes', [
    ('navigate_through_poses', ['scout_1'], 3, 8, [[0.7, 0.0]]),
    pytest.param('follow_path', ['scout_1'], 21, 8, CRASHES, marks=pytest.mark.full),
    *(
        pytest.param(driver, ['scout_1', 'scout_2'], 10, 18, [], marks=LONG)
        for driver in ('follow_waypoints', 'navigate_through_poses', 'follow_path')
    ),
])  # fmt: skip
def test_a_mission_ends_and_its_log_agrees_with_the_simulator(
    field, driver, names, robots, max_steps, crashes
):
    """Also if the base dies with a robot in flight, and resumes from the log."""
    fleet = Fleet(field, names, mission=MISSION)
    log = field.folder / 'log' / 'mission.mcap'
    log.parent.mkdir()
    base = {**FIELD, 'max_steps': max_steps, 'agents': names, 'recorded': True, 'robots': robots}
    heard = {name: fleet.reports(name) for name in names}
    paths = field.listen(Path, f'{MISSION}/scout_1/path')
    beliefs = field.listen(BeliefMaps, f'{MISSION}/belief')
    fleet.simulate()
    for name in names:
        fleet.start(name, driver=driver, await_nodes=['planner', 'estimator', 'recorder'])

    def start_base(**own):
        for name in NODES:
            # Replay needs the belief before the first deployment.
            awaited = {'await_nodes': ['planner', 'recorder']} if name == 'estimator' else {}
            field.start(name, {**base, **awaited, **own}, MISSION)

    start_base(file=str(log))
    where = Counter()
    for number, (after, gone) in enumerate(crashes, 1):
        field.until(lambda n=number: len({str(path.header) for path in paths}) == n, 'path')
        if len(crashes) == 1:
            field.until(lambda: 'driving' in fleet.state(), 'robot under way')
        fleet.wait(after)
        said = field.said(f'{MISSION}/scout_1/robot')
        left, back = said.count('leaving on'), said.count('home from')
        where['at home' if back == number else 'out' if left == number else 'not left'] += 1
        for name in NODES:
            field.processes.started[f'{MISSION}/{name}'].kill()
        for name in NODES:
            field.kill(f'{MISSION}/{name}')
        fleet.wait(gone)
        start_base(resume=str(log))
    print(dict(where))
    done = f'done: {robots} of {robots} robots deployed'
    field.until(lambda: field.state(f'{MISSION}/planner') == done, done, 300)
    # The planner's diagnostics may arrive before its last belief.
    field.until(lambda: beliefs and beliefs[-1].deployments == robots, 'belief in all')
    said = ''.join(field.said(f'{MISSION}/{name}/robot') for name in names)
    assert where['out'] >= len(crashes) // 3
    assert said.count('leaving on') == robots
    field.processes.stop()
    told = replay(log)
    assert told.reproduced
    assert not told.evidence.refused
    # Repeated reports equal the first, and equal the robots'.
    on_record = {read_report(logged.message) for logged in read_log(log, [REPORT])}
    assert on_record == {read_report(message) for each in heard.values() for message in each}
    assert len(on_record) == len({key for key, _ in on_record}) == robots
    for name in names:
        reports = [
            report for key, report in sorted(on_record, key=itemgetter(0)) if key.agent == name
        ]
        fleet.see_that_all_is_true(reports, name=name)
        assert all(report.survived for report in reports)
        # Detections arrive: only the last cell may lack them.
        readings = [reading for each in reports for _, reading in each.readings[:-1]]
        assert -1 not in readings


ORDERS = [0, 1, 2, 3, 16, 15, 14, 13, 0]

# Seconds after departure at which the power is cut: in the field, or at any time.
CUTS = np.random.default_rng(6).uniform(0, 4.5, 100) if FULL else (0.7,)


@pytest.fixture
def synced(tmp_path, monkeypatch):
    library = tmp_path / 'keep_synced.so'
    source = Fleet.SOURCES / 'keep_synced.c'
    subprocess.run(['cc', '-shared', '-fPIC', '-o', library, source, '-ldl'], check=True)
    monkeypatch.setenv('LD_PRELOAD', str(library))


def cut_power(fleet, rng):
    """Cut a robot's power: it stops, and unsynced data is lost."""
    fleet.field.kill('/scout_1/robot')
    fleet.inject('die')
    fleet.inject('live')
    journal = fleet.journal('scout_1')
    content = journal.read_bytes()
    synced = int(journal.with_name(f'{journal.name}.synced').read_text())
    assert synced <= len(content)
    # Any part of unsynced data may be on disk, also as blocks of zeros.
    end = int(rng.integers(synced, len(content) + 1))
    journal.write_bytes(content[:end] + bytes(int(rng.integers(0, 20))))


@pytest.mark.processes
@pytest.mark.interpreter
@pytest.mark.usefixtures('synced')
def test_a_robot_without_power_anywhere_reports_its_walk_once(request):
    field = request.getfixturevalue('field')
    rng = np.random.default_rng(5)
    fleet, reports = Fleet.simulated(field)

    fleet.start()
    where = {'in the field': 0, 'at home': 0}
    for number, after in enumerate(CUTS, 1):
        since = len(fleet.truth()['scout_1'])
        key = fleet.send(number, ORDERS)
        field.until(fleet.is_away, 'robot under way')
        fleet.wait(after)
        is_home = any(each.deployment.sec == number for each in reports)
        cut_power(fleet, rng)
        fleet.start()
        report = fleet.wait_for_report(reports, key)
        fleet.see_that_it_is_true(report, since)
        where['at home' if is_home else 'in the field'] += 1
        field.until(lambda: fleet.state().startswith('taking paths'), 'robot at home')
    print(where)
    # Each start repeats all earlier reports: see `wait_for_report`.
    for number in range(1, len(CUTS) + 1):
        told = {str(each.readings) for each in reports if each.deployment.sec == number}
        assert len(told) == 1
    assert where['in the field'] >= len(CUTS) // 3
    assert 'it goes home' in field.said('/scout_1/robot')


@pytest.mark.processes
@pytest.mark.interpreter
def test_a_launched_robot_that_is_killed_in_the_field_returns(field):
    pytest.importorskip('launch_ros', reason='launch comes with an installation of ROS 2 only')
    fleet, reports = Fleet.simulated(field)
    parameters = field.folder / 'robot.yaml'
    given = {**FIELD, 'await_nodes': ['test'], 'stay_time': 0.3}
    # JSON is YAML.
    parameters.write_text(json.dumps({'/**/robot': {'ros__parameters': given}}))
    arguments = {
        'nav_namespace': 'scout_1',
        'journal': fleet.journal('scout_1'),
        'params_file': parameters,
    }
    robot = launched(
        field.folder,
        int(os.environ['ROS_DOMAIN_ID']),
        *(f'{name}:={value}' for name, value in arguments.items()),
        launch_file='robot',
    )
    try:
        key = fleet.send(1, ORDERS)
        field.until(lambda: {2, 3} & set(fleet.walked()), 'robot under way')
        os.kill(node_pids(robot)['/scout_1/robot'], signal.SIGKILL)
        fleet.inject('die')
        fleet.inject('live')
        report = fleet.wait_for_report(reports, key)
    finally:
        interrupt(robot)
    assert robot.wait(60) == 0
    fleet.see_that_it_is_true(report)
