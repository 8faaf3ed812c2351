# SPDX-License-Identifier: Apache-2.0
"""Base and robot on two networks that are disconnected while the robot is in flight."""

import time

from apart import apart
from extent import LONG
from kbnitp_ros.log.replay import replay
import numpy as np
import pytest

pytestmark = pytest.mark.processes


def flap(mission, number, times, rng):
    for ups in range(times):
        if len(mission.reports()) == number:
            return ups
        mission.switch('up')
        time.sleep(0.01 * 300 ** rng.uniform())
        mission.switch('down')
        time.sleep(0.01 * 100 ** rng.uniform())
    return times


@pytest.mark.full
# Number of robots, minimum seconds of a link down, and short links at the robot's return.
@pytest.mark.parametrize('robots, longest, flaps', [
    (2, 1.5, 3),
    pytest.param(20, 90.0, 0, marks=LONG),
    pytest.param(20, 1.5, 12, marks=LONG),
])  # fmt: skip
def test_each_robot_that_was_out_of_reach_is_reported_once(tmp_path, robots, longest, flaps):
    rng = np.random.default_rng(9)
    cuts, ups = [], []
    with apart(tmp_path, robots) as mission:
        for number in range(1, robots + 1):
            mission.until(lambda n=number: mission.count('leaving on') == n, 'departure')
            mission.switch('down')
            gone = time.monotonic()
            cut = rng.uniform(1.0, longest)
            mission.until(lambda n=number: mission.count('home from') == n, 'return')
            time.sleep(max(0.0, gone + cut - time.monotonic()))
            assert len(mission.reports()) == number - 1
            cuts.append(time.monotonic() - gone)
            ups.append(flap(mission, number, flaps, rng))
            mission.switch('up')
            mission.until(lambda n=number: len(mission.reports()) == n, 'report')
    print('cuts', [round(cut, 1) for cut in cuts], 'ups', ups)
    reports = mission.reports()
    assert len(set(reports)) == len(reports) == robots
    told = replay(mission.log)
    assert told.reproduced
    assert not told.evidence.refused
    assert len(told.evidence.standings) == robots


@pytest.mark.full
@pytest.mark.campaign
def test_a_robot_cut_off_for_30_seconds_is_given_up_and_its_return_counts(tmp_path):
    """DDS forgets participants after 20 s of silence; by then the robot counts as lost."""
    with apart(tmp_path, 2, silent_loss=True, step_period=1.0, return_deadline=5.0) as mission:
        mission.until(lambda: mission.count('leaving on') == 1, 'departure')
        mission.switch('down')
        cut = time.monotonic()
        mission.until(lambda: mission.count('home from') == 1, 'return')
        mission.until(lambda: len(mission.reports()) == 1, 'loss')
        time.sleep(max(0.0, cut + 30.0 - time.monotonic()))
        mission.switch('up')
        mission.until(lambda: len(mission.reports()) == 3, 'return and report of the next robot')
    assert mission.count('to be started again') == 0
    told = replay(mission.log)
    assert told.reproduced
    assert not told.evidence.refused
    assert [each.survived for each in told.evidence.standings.values()] == [True, True]


@pytest.mark.full
@pytest.mark.campaign
@pytest.mark.parametrize('what', ['reboot', 'readdress'])
def test_a_robot_reconnects_after_a_reboot_without_link_or_a_new_address(tmp_path, what):
    with apart(tmp_path, 2) as mission:
        mission.until(lambda: mission.count('leaving on') == 1, 'departure')
        mission.switch('down')
        # While the robot is in flight.
        getattr(mission, what)()
        mission.until(lambda: mission.count('home from') == 1, 'return')
        if what == 'reboot':
            mission.until(lambda: mission.count('no network link but lo') == 1, 'word of it')
        mission.switch('up')
        mission.until(lambda: len(mission.reports()) == 1, 'report')
        assert mission.count('to be started again') == 1
        mission.until(lambda: len(mission.reports()) == 2, 'report of the next robot')
    told = replay(mission.log)
    assert told.reproduced
    assert not told.evidence.refused


@pytest.mark.full
@pytest.mark.campaign
@pytest.mark.parametrize('discovery', [
    {'ROS_DISCOVERY_SERVER': '10.77.0.1:11811', 'ROS_SUPER_CLIENT': 'TRUE'},
    {'ROS_STATIC_PEERS': '10.77.0.1;10.77.0.2'},
])  # fmt: skip
def test_base_and_robot_find_each_other_without_multicast(tmp_path, discovery):
    with apart(tmp_path, 1, discovery=discovery) as mission:
        mission.until(lambda: mission.count('leaving on') == 1, 'departure')
        mission.switch('down')
        mission.until(lambda: mission.count('home from') == 1, 'return')
        mission.switch('up')
        mission.until(lambda: len(mission.reports()) == 1, 'report')
    assert replay(mission.log).reproduced
