# SPDX-License-Identifier: Apache-2.0
"""The mission of a log is the one that its beliefs state, whatever paths came before."""

from kbnitp_ros.core import Belief, DeploymentKey, Estimator, Grid, Ledger, SensorModel
from kbnitp_ros.log.record import read_mission, read_resumed
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import path_message
from laws import for_each
from rclpy.serialization import serialize_message

GRID = Grid(3, 1)
OWN, FOREIGN, LATER = 5 * 10**9, 10**9, 9 * 10**9


def prior(mission):
    """Return the first belief that an estimator publishes."""
    estimator = Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), SensorModel(0.5))
    return (
        '/belief',
        'kbnitp_msgs/msg/BeliefMaps',
        belief_maps(Ledger(GRID, 4, estimator), 1, mission),
    )


def path(mission, stamp=1):
    """Return a path of a mission."""
    message = path_message(GRID, [0, 1, 0], mission + stamp, mission)
    return '/scout/path', 'nav_msgs/msg/Path', message


@for_each('messages, mission, paths', [
    ([], None, []),
    ([prior(OWN)], OWN, []),
    ([path(FOREIGN), prior(OWN)], OWN, []),
    ([path(FOREIGN), prior(OWN), path(OWN)], OWN, [OWN + 1]),
    ([prior(OWN), path(FOREIGN), path(OWN)], OWN, [OWN + 1]),
    # A path may come before its belief.
    ([path(FOREIGN), path(OWN), prior(OWN)], OWN, [OWN + 1]),
    # An estimator starts anew before the first robot leaves, and after it.
    ([prior(OWN), prior(LATER), path(LATER)], LATER, [LATER + 1]),
    ([prior(OWN), path(OWN), prior(LATER)], OWN, [OWN + 1]),
    ([path(each * 10**12) for each in range(1, 101)] + [prior(OWN), path(OWN)], OWN, [OWN + 1]),
])  # fmt: skip
def test_paths_of_other_missions_are_skipped(tmp_path, messages, mission, paths):
    log = tmp_path / 'mission.mcap'
    with LogWriter(log) as writer:
        for time, (topic, kind, message) in enumerate(messages):
            writer.add_topic(topic, kind, '[]')
            writer.write(topic, serialize_message(message), time, time)
    assert read_mission(MissionLog(log)) == mission
    assert read_resumed(MissionLog(log), GRID, 4).orders == [
        DeploymentKey('scout', each) for each in paths
    ]
