# SPDX-License-Identifier: Apache-2.0
"""A robot walks its orders by the actions of Nav2, and reports what truly happened."""

from __future__ import annotations

from fleet import Fleet, GRID, moves, TARGETS
import pytest

ROUND = [0, 1, 14, 14, 13, 25, 13, 12, 0, 1, 0]


def see_that_it_is_true(fleet, report, since=0, name='scout_1'):
    """Compare a report with where the simulator drove the robot, and with what is there."""
    cells = [GRID.base, *(cell for cell, _ in report.readings)]
    assert moves(cells) == fleet.walked(name, since)
    for cell, reading in report.readings[:-1]:
        assert reading == (cell in TARGETS), (cell, report)


@pytest.mark.parametrize('driver', ['follow_waypoints', 'navigate_through_poses', 'follow_path'])
def test_a_robot_reports_the_walk_that_it_was_driven(field, driver):
    fleet = Fleet(field)
    reports = fleet.reports()
    fleet.simulate()
    fleet.start(driver=driver)
    key = fleet.send(1, ROUND)
    report = fleet.report_of(reports, key)
    assert [cell for cell, _ in report.readings] == ROUND[1:]
    see_that_it_is_true(fleet, report)
