# SPDX-License-Identifier: Apache-2.0
"""A log's deployments are each told once, in their order, by what is known of them in the end."""

from dataclasses import replace

from kbnitp_ros.core import Observation
from kbnitp_ros.log.deployments import read_deployments
from kbnitp_ros.log.history import read_history
from kbnitp_ros.messages.deployments import report_message
from mission_log import Mission, on, record

NEAR, FAR = [2, 7, 2], [2, 7, 12, 7, 2]


def told(path):
    """Return path, outcome and readings of every deployment in a log."""
    return [
        (
            each.path.tolist(),
            each.survived,
            None if each.readings is None else each.readings.tolist(),
        )
        for each in read_history(path).observations
    ]


def test_deployments_are_in_their_order_and_a_return_outdoes_a_loss(tmp_path):
    whole = Mission()
    first, second, third = (
        whole.send_out(path, agent)
        for path, agent in ((FAR, 'scout_1'), (NEAR, 'scout_2'), (NEAR, 'scout_1'))
    )
    whole.assimilate(NEAR, *whole.come_back(third, Observation(NEAR, False)))
    whole.assimilate(FAR, *whole.come_back(first, Observation(FAR, False)))
    back = Observation(FAR, True, [True, False, False, True])
    whole.assimilate(FAR, *whole.come_back(first, back))
    whole.come_back(first, Observation(FAR, False))
    whole.assimilate(NEAR, *whole.come_back(second, Observation(NEAR, True, [True, True])))
    path = record(tmp_path / 'mission.mcap', [*whole.sent, *whole.sent])
    assert told(path) == [
        (FAR, True, [True, False, False, True]),
        (NEAR, True, [True, True]),
        (NEAR, False, None),
    ]
    assert len(read_history(path).beliefs) == 2 * 5


def test_who_answers_for_another_agent_tells_nothing_of_it(tmp_path):
    whole = Mission(namespace='/north')
    lost, out = (whole.send_out(NEAR, 'scout_2') for _ in range(2))
    whole.come_back(lost, Observation(NEAR, False))
    for key in (lost, out):
        back = report_message(key, Observation(NEAR, True, [True, True]), whole.now)
        whole.publish('scout_1/report', back)
    deployments = read_deployments(record(tmp_path / 'mission.mcap', whole.sent))
    assert deployments.keys() == {lost, out}
    assert deployments[lost].report.topic == '/north/scout_2/report'
    assert deployments[out].report is None


def test_maps_of_others_are_no_truth(whole_mission, tmp_path):
    other = on(whole_mission.sent, '/belief/hazard')[0]
    others = [replace(other, topic=f'/camera/truth/{name}') for name in ('floor', 'ceiling')]
    path = record(tmp_path / 'mission.mcap', [*whole_mission.sent, *others])
    assert read_history(path).world is None
