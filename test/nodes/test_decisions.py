# SPDX-License-Identifier: Apache-2.0
"""A mission with a goal decides as core does, stops by itself and goes on if it is told to."""

from kbnitp_msgs.msg import Decision
from kbnitp_ros.cli.parameters import asked_on_record
from kbnitp_ros.configuration import grid_of
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.deployments import read_path
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
import pytest
from unbroken import core_mission, with_defaults

LANE = {
    'grid.width': 5, 'grid.height': 4, 'max_steps': 10, 'method': 'kappa_bnitp',
    'planner': 'relaxed', 'sensor.lethality': 0.6, 'prior.hazard': 0.3, 'prior.target': 0.4,
    'world.hazard_density': 0.05, 'robots': 60, 'goal.kind': 'lane', 'goal.cells': [19],
    'stop.confidence': 0.9, 'seed': 7,
}  # fmt: skip


def ask(field, kind, service, request):
    """Return the answer of a service."""
    client = field.node.create_client(kind, service)
    field.until(client.service_is_ready, service)
    future = client.call_async(request)
    field.until(future.done, f'answer of {service}')
    return future.result()


@pytest.mark.interpreter
def test_a_mission_with_a_goal_stops_by_itself_and_goes_on_when_overruled(field):
    log = field.folder / 'mission.mcap'
    decisions = field.listen(Decision, '/m/decision')
    lanes = field.listen(Path, '/m/decision/lane')
    paths = field.listen(Path, '/m/scout_1/path')
    field.start_mission(LANE, '/m', log)
    field.until(lambda: paths, 'path')
    for name, value in (('goal.kind', 'map'), ('goal.cells', [18])):
        assert not field.set_parameter('/m/planner', name, value).successful
    field.until(lambda: 'stop.confidence' in field.state('/m/planner'), 'stop', patience=180)
    expected = core_mission(LANE)
    assert 0 < len(paths) == len(expected) < LANE['robots']
    field.until(lambda: decisions and decisions[-1].reached, 'decision')
    grid = grid_of(with_defaults(LANE))
    by_deployments = {message.deployments: message for message in decisions}
    assert by_deployments[len(expected)].reached
    for number, deployment in enumerate(expected, 1):
        _, flown = read_path(grid, 'scout_1', paths[number - 1])
        assert flown.tolist() == deployment.plan.path.tolist()
        decision = deployment.decision
        message = by_deployments[number]
        assert message.probability == decision.p_free
        assert message.survival == decision.survival
        assert message.hazards_mean == decision.hazards_mean
        assert message.reached == decision.reached
        assert len(message.path.poses) == len(decision.path)
    shown = decisions[-1].path.poses
    field.until(lambda: lanes and lanes[-1].poses == shown, 'lane')

    request = GetPlan.Request()
    request.start.pose.position.x = request.start.pose.position.y = 0.5
    request.goal.pose.position.x, request.goal.pose.position.y = 4.5, 3.5
    found = ask(field, GetPlan, '/m/safest_path', request).plan
    assert found.poses == shown
    request.goal.pose.position.x = 99.0
    assert not ask(field, GetPlan, '/m/safest_path', request).plan.poses

    assert not field.set_parameter('/m/planner', 'stop.confidence', 0.9999).successful
    sent = len(paths)
    assert field.set_parameter('/m/planner', 'stop.confidence', 0.0).successful
    field.until(lambda: len(paths) > sent + 1, 'robots that leave again')
    assert set(field.processes.stop().values()) == {0}
    recorded = [logged for logged in read_log(log) if logged.topic == '/m/decision']
    assert {each.message.deployments for each in recorded} >= {len(expected)}
    told = replay(log, asked=asked_on_record(MissionLog(log)))
    assert told.reproduced, told.mismatches
    assert told.compared['/m/decision'] > len(expected)
