# SPDX-License-Identifier: Apache-2.0
"""Missions of robots that Nav2's actions drive, in a simulator that is not ours."""

from extent import LONG
from fleet import FIELD, Fleet
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp
import pytest

MISSION = '/mission'


@pytest.mark.parametrize(
    'driver, names, robots, max_steps',
    [
        ('navigate_through_poses', ['scout_1'], 3, 8),
        *(
            pytest.param(driver, ['scout_1', 'scout_2'], 10, 18, marks=LONG)
            for driver in ('follow_waypoints', 'navigate_through_poses', 'follow_path')
        ),
    ],
)
def test_a_mission_ends_and_its_log_tells_what_the_simulator_did(
    field, driver, names, robots, max_steps
):
    fleet = Fleet(field, names, mission=MISSION)
    log = field.folder / 'log' / 'mission.mcap'
    log.parent.mkdir()
    base = {**FIELD, 'max_steps': max_steps, 'agents': names, 'recorded': True}
    heard = {name: fleet.reports(name) for name in names}
    fleet.simulate()
    for name in names:
        fleet.start(name, driver=driver, await_nodes=['planner', 'estimator', 'recorder'])
    field.start('recorder', {'file': str(log)}, MISSION)
    # A log can be replayed from the belief before the first deployment.
    field.start('estimator', {**base, 'await_nodes': ['planner', 'recorder']}, MISSION)
    field.start('planner', {**base, 'robots': robots}, MISSION)
    field.until(
        lambda: field.state(f'{MISSION}/planner').startswith(f'done: {robots} of {robots}'),
        'end of the mission',
        300,
    )
    field.until(lambda: sum(map(len, heard.values())) == robots, 'all reports')
    field.processes.stop()
    told = replay(log)
    assert told.reproduced
    assert len(told.evidence.reports) == robots
    for name in names:
        in_order = sorted(heard[name], key=lambda each: from_stamp(each.deployment))
        reports = [read_report(each, name)[1] for each in in_order]
        fleet.see_that_all_is_true(reports, name=name)
        looks = [reading for report in reports for _, reading in report.readings[:-1]]
        assert all(report.survived for report in reports)
        # Detections arrive: of no cell but the last is nothing known.
        assert -1 not in looks
