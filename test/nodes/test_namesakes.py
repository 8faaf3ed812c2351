# SPDX-License-Identifier: Apache-2.0
"""Two robots of one name that leave on one path, since neither knew of the other."""

from __future__ import annotations

from apart import apart
from base import Base, GRID
from extent import FULL
from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.core import Observation
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.nodes import qos
import pytest


def test_of_two_robots_on_one_path_the_first_that_is_home_counts(field):
    base = Base(field)
    base.until_sent(1)
    key, cells = read_path(GRID, 'scout_1', base.paths['scout_1'][-1])
    other = field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    # The three nodes of the base, and the test.
    field.until(lambda: other.get_subscription_count() == 4, 'whole base')
    base.come_back()
    base.until_held(1)
    base.until_sent(2)
    # The other one turned back half way.
    half = cells[: cells.size // 2]
    walk = [*half, *half[-2::-1]]
    home = Observation(walk, True, [True] * (len(walk) - 1))
    other.publish(report_message(key, home, key.stamp + 2))
    told = field.until_refused('/estimator', 1)
    assert told.startswith(f'scout_1/report refused: report of deployment {key} is known and')
    assert told.endswith('the first return holds (do two robots have the name scout_1?)')
    if FULL:
        base.crash()
        base.until_held(1)
    # Nor does it end the deployment that its name is on now.
    base.until_state('to be reported on /scout_1/report')
    base.come_back()
    base.until_held(2)
    field.processes.stop(60)
    report = replay(base.log)
    assert report.reproduced
    assert len(report.evidence.reports) == 2
    # A recorder that was started again has heard it again.
    (refused,) = set(report.evidence.refused)
    assert refused == told.replace('scout_1/report refused', '/scout_1/report')


@pytest.mark.full
@pytest.mark.campaign
def test_two_robots_that_do_not_hear_each_other_are_reported_as_one(tmp_path):
    robots = 4
    with apart(tmp_path, robots, namesakes=2) as mission:
        mission.until(lambda: len(mission.reports()) == 2 * robots, 'reports')
        assert mission.count('leaving on') == 2 * robots
    told = replay(mission.log)
    assert told.reproduced
    assert len(told.evidence.reports) == robots
    assert len(told.evidence.refused) == robots
