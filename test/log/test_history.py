# SPDX-License-Identifier: Apache-2.0
"""Deployments and departures of a log are each counted once, by their final reports."""

from collections import Counter
from itertools import pairwise

from kbnitp_msgs.msg import AgentStatus as AgentStatusMessage
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    SensorModel,
)
from kbnitp_ros.core.inference.record import OrderState
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.record import mission_start, read_resumed
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import (
    path_message,
    read_status,
    status_message,
)
from kbnitp_ros.messages.headers import to_stamp
from laws import for_each
from mission_log import GRID, MAX_STEPS, Mission, record, record_to
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

NEAR, FAR = [2, 7, 2], [2, 7, 12, 7, 2]


def told(path):
    return [
        (
            observation.path.tolist(),
            observation.survived,
            None if observation.readings is None else observation.readings.tolist(),
        )
        for observation in read_history(path).observations
    ]


def test_a_refused_path_displaces_no_other(tmp_path):
    whole = Mission()
    key = DeploymentKey('scout_1', whole.now + 2000)
    for path in ([2, 13, 2], [7, 2]):
        whole.publish('scout_1/path', path_message(GRID, path, key.stamp))
    assert whole.send_out(NEAR) == key
    whole.publish('scout_1/path', path_message(GRID, FAR, key.stamp))
    whole.assimilate(NEAR, *whole.come_back(key, Observation(NEAR, True, [True, False])))
    log = record(tmp_path / 'mission.mcap', whole.sent)
    assert told(log) == [(NEAR, True, [True, False])]
    resumed = read_resumed(MissionLog(log), GRID, MAX_STEPS)
    assert resumed.orders == [key]
    assert resumed.paths[key].tolist() == NEAR
    assert deserialize_message(resumed.messages[key], Path) == path_message(GRID, NEAR, key.stamp)
    report = replay(log)
    assert report.reproduced
    assert len(report.evidence.refused) == 3


@for_each('seed', range(4))
def test_a_history_is_continued_when_its_log_has_grown(seed, whole_mission, tmp_path):
    """Wherever the log was cut, and whether or not it was finished later."""
    whole = tmp_path / 'whole.mcap'
    with LogWriter(whole) as written:
        record_to(written, whole_mission.sent, synced=True)
    content = whole.read_bytes()
    rng = np.random.default_rng(seed)
    cuts = sorted(rng.integers(len(content) // 2, len(content), 5).tolist())
    path = tmp_path / 'mission.mcap'
    path.write_bytes(content[: cuts[0]])
    log = MissionLog(path)
    history = read_history(log)
    for start, end in pairwise([*cuts, len(content)]):
        with path.open('ab') as file:
            file.write(content[start:end])
        assert read_history(log, history=history) is history
    once = read_history(whole)
    assert [(each.time, each.position) for each in history.moments] == [
        (each.time, each.position) for each in once.moments
    ]
    assert history.beliefs[-1].joint.tobytes() == once.beliefs[-1].joint.tobytes()
    assert history.evidence.outcomes.keys() == once.evidence.outcomes.keys()
    assert history.models.keys() == once.models.keys()
    assert history.bookmark.metadata == once.bookmark.metadata
    assert history.evidence.refused == history.corrupt == []
    seen = len(history.moments)
    assert len(read_history(log, history=history).moments) == seen


def test_a_mission_on_another_grid_is_not_resumed(whole_mission, tmp_path):
    log = record(tmp_path / 'mission.mcap', whole_mission.sent)
    with pytest.raises(ValueError, match=r'a mission on Grid\(width=5, .* set Grid\(width=9'):
        read_resumed(MissionLog(log), Grid(9, 9), MAX_STEPS)


NARROW = Grid(3, 1)
OWN, FOREIGN, LATER = 5 * 10**9, 10**9, 9 * 10**9


def belief_entry(mission):
    estimator = Estimator(Belief.prior(NARROW, 0.5, 0.45, 0.8), SensorModel(0.5))
    return (
        '/belief',
        'kbnitp_msgs/msg/BeliefMaps',
        belief_maps(Ledger(NARROW, 4, estimator), 1, mission),
    )


def path_entry(mission, stamp=1):
    message = path_message(NARROW, [0, 1, 0], mission + stamp, mission)
    return '/scout/path', 'nav_msgs/msg/Path', message


@for_each('messages, mission, paths', [
    ([], None, []),
    ([belief_entry(OWN)], OWN, []),
    ([path_entry(FOREIGN), belief_entry(OWN)], OWN, []),
    ([path_entry(FOREIGN), belief_entry(OWN), path_entry(OWN)], OWN, [OWN + 1]),
    ([belief_entry(OWN), path_entry(FOREIGN), path_entry(OWN)], OWN, [OWN + 1]),
    # A path may arrive before its belief.
    ([path_entry(FOREIGN), path_entry(OWN), belief_entry(OWN)], OWN, [OWN + 1]),
    # An estimator restarts before the first departure, and after it.
    ([belief_entry(OWN), belief_entry(LATER), path_entry(LATER)], LATER, [LATER + 1]),
    ([belief_entry(OWN), path_entry(OWN), belief_entry(LATER)], OWN, [OWN + 1]),
    ([*(path_entry(each * 10**12) for each in range(1, 101)), belief_entry(OWN), path_entry(OWN)],
     OWN, [OWN + 1]),
])  # fmt: skip
def test_paths_of_other_missions_are_skipped(tmp_path, messages, mission, paths):
    log = tmp_path / 'mission.mcap'
    with LogWriter(log) as writer:
        for time, (topic, kind, message) in enumerate(messages):
            writer.add_topic(topic, kind, '[]')
            writer.write(topic, serialize_message(message), time, time)
    assert mission_start(MissionLog(log)) == mission
    assert read_resumed(MissionLog(log), NARROW, 4).orders == [
        DeploymentKey('scout', path) for path in paths
    ]


KEY = DeploymentKey('scout_1', 70)


def test_a_status_comes_back_and_bad_ones_are_refused_by_name():
    said = {
        OrderState.ACCEPTED: status_message(KEY, OrderState.ACCEPTED, 80),
        OrderState.DEPARTED: status_message(KEY, OrderState.DEPARTED, 80),
        OrderState.REFUSED: status_message(KEY, OrderState.REFUSED, 80, 'the battery is low'),
    }
    for state, message in said.items():
        key, status = read_status(message, 'scout_1')
        assert (key, status.state, status.stamp, status.reason) == (KEY, state, 80, message.reason)
    assert len({read_status(each, 'scout_1')[1].content for each in said.values()}) == 3
    for change, told in (
        ({'agent': 'scout_2'}, "agent is 'scout_2': on this topic it must be 'scout_1'"),
        ({'state': 0}, 'state is 0: it must be from 1 to 3'),
        ({'state': 4}, 'state is 4'),
        ({'reason': 'a rest'}, "reason is 'a rest' and state is DEPARTED"),
        ({'state': 3}, "reason is '' and state is REFUSED"),
        ({'state': 3, 'reason': 'x' * 501}, 'reason has 501 characters'),
        ({'deployment': to_stamp(-1)}, 'deployment is -1'),
    ):
        bad = status_message(KEY, OrderState.DEPARTED, 80)
        for name, value in change.items():
            setattr(bad, name, value)
        with pytest.raises(ValueError, match=told):
            read_status(bad, 'scout_1')
    bad = AgentStatusMessage(agent='scout_1', state=2)
    with pytest.raises(ValueError, match='header.frame_id'):
        read_status(bad, 'scout_1')


def test_all_states_have_a_name_in_the_message():
    names = Counter(getattr(AgentStatusMessage, state.name) == state for state in OrderState)
    assert names == {True: 3}
