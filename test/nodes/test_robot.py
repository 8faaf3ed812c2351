# SPDX-License-Identifier: Apache-2.0
"""A robot walks its orders by the actions of Nav2, and reports what truly happened."""

from functools import reduce
from itertools import count
import time

from extent import FULL, LONG, some
from fleet import Fleet, moves, TARGETS
from kbnitp_msgs.msg import AgentStatus
import numpy as np
import pytest
from sensor_msgs.msg import NavSatFix, NavSatStatus

ROUND = [0, 1, 14, 14, 13, 25, 13, 12, 0, 1, 0]


@pytest.mark.parametrize(
    'driver', some(['follow_path', 'follow_waypoints', 'navigate_through_poses'], 3)
)
def test_a_robot_reports_the_walk_that_it_was_driven(field, driver):
    fleet, reports = Fleet.simulated(field)
    fleet.start(driver=driver)
    key = fleet.send(1, ROUND)
    report = fleet.report_of(reports, key)
    assert [cell for cell, _ in report.readings] == ROUND[1:]
    fleet.see_that_it_is_true(report)
    assert all(reading == (cell in TARGETS) for cell, reading in report.readings[:-1])


DATUM = (55.944904, -3.186693, -0.8)


# In the second case nobody tells where this frame is but fixes.
@pytest.mark.parametrize('own', [{}, {'position': 'fix', 'remapped': {'/tf': '/nobody'}}])
def test_a_robot_walks_a_turned_field(field, own):
    fleet, reports = Fleet.simulated(field, placed=(40.0, -7.0, 2.1), datum=DATUM)
    fleet.start(driver='navigate_through_poses', **own)
    report = fleet.report_of(reports, fleet.send(1, ROUND))
    assert [cell for cell, _ in report.readings] == ROUND[1:]
    fleet.see_that_it_is_true(report)


BAD_FIXES = {
    "header.frame_id is 'gps': it must be 'base_link'": {'header.frame_id': 'gps'},
    'status.status is -1: there is no fix': {'status.status': -1},
    'position_covariance_type is 0': {'position_covariance_type': 0},
    'latitude is nan': {'latitude': float('nan')},
    'longitude is 181.0': {'longitude': 181.0},
    'the standard deviation of the fix is 3.00 m: it may be half the side of a cell, 0.5 m': {
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
    # The robot may know the receiver a moment later, and nothing is sent to it again.
    known = time.monotonic() + 1.0
    field.until(lambda: time.monotonic() > known, 'second')
    for number, (told, changes) in enumerate(BAD_FIXES.items(), 1):
        fix = NavSatFix(latitude=DATUM[0], longitude=DATUM[1], position_covariance_type=2)
        fix.status.status = NavSatStatus.STATUS_FIX
        fix.header.frame_id = 'base_link'
        fix.position_covariance = np.diag([0.01, 0.01, 0.01]).ravel()
        for name, value in changes.items():
            *parents, last = name.split('.')
            setattr(reduce(getattr, parents, fix), last, value)
        receiver.publish(fix)
        field.until_refused('/scout_1/robot', number)
        assert f'fix refused: {told}' in field.said('/scout_1/robot')


def test_fixes_without_a_datum_are_refused_at_the_start(field):
    assert Fleet(field).start(position='fix').wait(60) == 2
    assert "parameter position is 'fix', and datum is empty" in field.said('/scout_1/robot')


def test_a_datum_off_the_earth_is_refused_at_the_start(field):
    assert Fleet(field, datum=(91.0, 0.0, 0.0)).start().wait(60) == 2
    assert 'datum has latitude 91.0' in field.said('/scout_1/robot')


def test_what_is_seen_in_a_picture_is_read_where_it_was_taken(field):
    fleet, reports = Fleet.simulated(field, detection_type='detection2d_array')
    fleet.start(driver='navigate_through_poses', detection_class='target')
    report = fleet.report_of(reports, fleet.send(1, ROUND))
    fleet.see_that_it_is_true(report)
    assert all(reading == (cell in TARGETS) for cell, reading in report.readings[:-1])


def test_a_robot_leaves_from_and_comes_home_to_its_own_base(field):
    """It takes no path from the base of others, in a file of parameters that names both."""
    fleet = Fleet(field)
    reports = fleet.reports()
    fleet.simulate(scout_1=(11.5, 11.5))
    fleet.start(**{'team.scout_1.base_position': [11.2, 11.9], 'team.scout_2.base': 11})
    fleet.send(1, [0, 1, 0])
    field.until(lambda: field.count('/scout_1/robot', 'refused') == 1, 'refusal')
    # What it waits for may be told in the meantime.
    assert 'path must start at the base 143, not at cell 0' in field.said('/scout_1/robot')
    orders = [143, 142, 130, 131, 143]
    report = fleet.report_of(reports, fleet.send(2, orders))
    assert [cell for cell, _ in report.readings] == orders[1:]
    assert fleet.walked() == orders


# How often each failure is injected.
ROUNDS = 20 if FULL else 1


def fail(fleet, how, when):
    """Have a failure strike a robot that is to leave, or has left some time ago, in seconds."""
    if how in ('reject', 'abort', 'silent', 'lie'):
        fleet.inject(how)
        return
    fleet.field.until(lambda: 'driving' in fleet.state(), 'robot under way')
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
            pytest.param(
                driver,
                ['reject', 'abort', 'silent', 'lie', 'die'],
                marks=LONG,
            )
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
            report = fleet.report_of(reports, key)
            fleet.see_that_it_is_true(report, since)
            assert moves([0, *(cell for cell, _ in report.readings)]) == orders, how


WAY_ROUND = [0, 1, 2, 3, 16, 15, 14, 13, 0]


def is_out_and_back(report):
    """Say whether a robot came home by the way it came, before the end of its orders."""
    cells = moves([0, *(cell for cell, _ in report.readings)])
    turn = len(cells) // 2
    return cells == cells[::-1] and cells[: turn + 1] == WAY_ROUND[: turn + 1]


def test_a_robot_that_cannot_go_on_goes_home_and_tells_how_far_it_came(field):
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
    report = fleet.report_of(reports, key)
    fleet.see_that_it_is_true(report)
    assert is_out_and_back(report)
    assert 'rejected the goal; going home' in field.said('/scout_1/robot')


def test_a_robot_whose_goal_is_cancelled_goes_home(field):
    fleet, reports = Fleet.simulated(field)
    fleet.start()
    key = fleet.send(1, WAY_ROUND)
    field.until(lambda: {2, 3} & set(fleet.walked()), 'robot under way')
    fleet.cancel_all('follow_waypoints')
    report = fleet.report_of(reports, key)
    fleet.see_that_it_is_true(report)
    assert is_out_and_back(report)
    said = field.said('/scout_1/robot')
    assert 'was cancelled: error code 0, no message; going home' in said


def test_a_robot_goes_home_while_its_time_budget_lasts_for_the_way_back(field):
    fleet, reports = Fleet.simulated(field, speed=1.0)
    fleet.start(time_budget=5.0)
    report = fleet.report_of(reports, fleet.send(1, WAY_ROUND))
    fleet.see_that_it_is_true(report)
    assert is_out_and_back(report)
    assert '(parameter time_budget) what the way back takes is left' in field.said(
        '/scout_1/robot'
    )


def test_nothing_is_read_after_a_jump_that_no_robot_can_make(field):
    fleet, reports = Fleet.simulated(field, speed=1.0)
    fleet.start(max_speed=1.5, tf_timeout=0.5)
    key = fleet.send(1, [0, 1, 2, 3, 2, 1, 0])
    field.until(lambda: 2 in fleet.walked(), 'robot under way')
    fleet.inject('jump')
    field.until(lambda: 'its walk is doubted' in field.said('/scout_1/robot'), 'doubt')
    fleet.inject('live')
    report = fleet.report_of(reports, key)
    first = next(number for number, (cell, _) in enumerate(report.readings) if cell > 3)
    before, after = report.readings[:first], report.readings[first:]
    assert all(reading == -1 for _, reading in after)
    # The shortest way to where it seemed to be begins with cells that it was not seen in.
    assert all(reading in (cell in TARGETS, -1) for cell, reading in before)
    assert before[0] == (1, False)


@pytest.mark.parametrize('lifecycle, told', [
    (True, 'waiting for /scout_1/waypoint_follower to be active: its lifecycle state is '),
    (False, 'waiting for Nav2 to be ready: the action server /scout_1/follow_waypoints '),
])  # fmt: skip
def test_a_robot_does_not_depart_before_nav2_takes_goals(field, lifecycle, told):
    fleet = Fleet(field, lifecycle=lifecycle)
    reports = fleet.reports()
    fleet.simulate(wrong='inactive')
    fleet.start(attempts=1)
    key = fleet.send(1, [0, 1, 0])
    field.until(lambda: told in field.said('/scout_1/robot'), 'wait for Nav2 on the console')
    # What the operator decides meanwhile holds when Nav2 is ready.
    fleet.hold(True)
    fleet.inject('live')
    field.until(lambda: 'the operator to end the pause' in fleet.state(), 'wait for the operator')
    said = [status.state for status in fleet.statuses['scout_1']]
    assert said == [AgentStatus.ACCEPTED]
    fleet.hold(False)
    report = fleet.report_of(reports, key)
    assert moves([0, *(cell for cell, _ in report.readings)]) == [0, 1, 0]


def test_a_robot_waits_for_what_drives_it_and_says_so(field):
    fleet = Fleet(field)
    reports = fleet.reports()
    fleet.start()
    key = fleet.send(1, [0, 1, 0])
    field.until(lambda: 'waiting for TF' in fleet.state(), 'wait for TF')
    assert "nobody tells where 'base_link' is" in fleet.state()
    fleet.simulate(scout_1=(5.5, 5.5))
    field.until(lambda: 'to be at its base, cell 0: it is 7.1 m' in fleet.state(), 'wait for it')
    fleet.end_simulator()
    fleet.simulate(scout_1=(0.5, 0.5))
    fleet.report_of(reports, key)
