# SPDX-License-Identifier: Apache-2.0
"""A mission of four processes equals the mission in the core, bit for bit."""

import signal

from extent import FULL
from kbnitp_msgs.msg import BeliefMaps, Decision, DeploymentReport, Progress
from kbnitp_ros.cli.parameters import asked_on_record
from kbnitp_ros.configuration import make_grid
from kbnitp_ros.core import Belief, Estimator, Ledger, Report, SensorModel
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_path, read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.views import Views
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetPlan
import numpy as np
from PIL import Image
import pytest
import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
import rosgraph_msgs.msg
from samples import FIELD, GRID, HOME, key, lost
from tf2_msgs.msg import TFMessage
from unbroken import core_mission, with_defaults

MAPS = ('hazard', 'target', 'kappa')

SMALL = {'grid.width': 5, 'grid.height': 4, 'max_steps': 8}
LARGE = {
    'grid.width': 100, 'grid.height': 100, 'max_steps': 200, 'sensor.malfunction': 0.001,
    'planner': 'relaxed',
}  # fmt: skip
HUGE = {
    'grid.width': 300, 'grid.height': 300, 'grid.base': 150 * 300 + 150, 'max_steps': 60,
    'sensor.malfunction': 0.001, 'planner': 'relaxed',
}  # fmt: skip


def listen(field, namespace):
    return (
        field.listen(Path, f'{namespace}/scout_1/path'),
        field.listen(DeploymentReport, f'{namespace}/scout_1/report'),
        field.listen(BeliefMaps, f'{namespace}/belief'),
    )


def stamps(messages):
    return [from_stamp(message.header.stamp) for message in messages]


def is_huge(parameters):
    return parameters.get('grid.width', 0) >= HUGE['grid.width']


def wait_for_end(field, parameters, heard):
    paths, reports, beliefs = heard
    robots = parameters['robots']
    field.until(
        lambda: beliefs and min(len(paths), len(reports), beliefs[-1].deployments) >= robots,
        'end',
        patience=180,
    )


def assert_is_core_mission(parameters, paths, reports, beliefs):
    """Check that a mission's messages equal the core's with the same parameters."""
    expected = core_mission(parameters)
    assert len(paths) == len(reports) == len(expected)
    told = {message.deployments: message for message in beliefs}
    assert [*told] == [message.deployments for message in beliefs] == sorted(told)
    # The next belief may replace one of megabytes before it has arrived.
    assert is_huge(parameters) or [*told] == list(range(len(expected) + 1))
    grid = read_belief_maps(beliefs[-1]).grid
    for number, (path, report, deployment) in enumerate(zip(paths, reports, expected), 1):
        key, cells = read_path(grid, 'scout_1', path)
        assert cells.tolist() == deployment.plan.path.tolist()
        reported, outcome = read_report(report)
        assert reported == key
        observation = deployment.observation
        readings = () if observation.readings is None else observation.readings.tolist()
        read = tuple(zip(observation.path[1:].tolist(), readings))
        known, lost_at = observation.steps_survived, observation.lost_at
        where = () if lost_at is None else tuple(lost_at.tolist())
        assert outcome == Report(
            observation.survived,
            read,
            steps_survived=known,
            lost_at=where,
            field_id=report.field_id,
        )
        if number not in told:
            continue
        assert read_belief_maps(told[number]).newest == key
        for name in (*MAPS, 'joint'):
            ours, core = getattr(told[number], name), getattr(deployment.belief, name)
            assert np.asarray(ours).tobytes() == core.tobytes(), (number, name)


@pytest.mark.parametrize(
    'parameters',
    [
        # Like users start nodes.
        pytest.param({'seed': 3, 'robots': 40 if FULL else 6}, marks=pytest.mark.interpreter),
        pytest.param({**LARGE, 'seed': 7, 'robots': 20}, marks=pytest.mark.full),
        pytest.param({**HUGE, 'seed': 8, 'robots': 3}, marks=pytest.mark.full),
    ],
    ids=['default', 'large', 'huge'],
)
def test_every_belief_is_that_of_core_also_in_the_log(field, parameters):
    log = field.folder / 'mission.mcap'
    paths, reports, beliefs = heard = listen(field, '/m')
    views = [field.listen(OccupancyGrid, f'/m/belief/{name}') for name in MAPS]
    field.start_mission(parameters, '/m', log)
    wait_for_end(field, parameters, heard)
    assert_is_core_mission(parameters, *heard)
    # Views follow their belief.
    last = beliefs[-1].header.stamp
    field.until(lambda: all(view and view[-1].header.stamp == last for view in views), 'last maps')
    newest = {'/m/scout_1/report': reports, '/m/progress': beliefs}
    newest |= {f'/m/belief/{name}': beliefs for name in MAPS}
    field.until_recorded(log, newest)
    assert set(field.processes.stop().values()) == {0}
    recorded = {}
    for logged in read_log(log):
        recorded.setdefault(logged.topic, []).append(logged.message)
    assert len(recorded['/m/scout_1/path']) == len(paths)
    assert len(recorded['/m/scout_1/report']) == len(reports)
    told = stamps(beliefs)
    on_record = stamps(recorded['/m/belief'])
    if not is_huge(parameters):
        assert on_record == told
    # Views show the last belief within a tenth of a second.
    for topic in ('/m/belief', '/m/progress', *(f'/m/belief/{name}' for name in MAPS)):
        on_record = stamps(recorded[topic])
        assert is_huge(parameters) or set(on_record) <= set(told)
        assert on_record[-1] == told[-1]
    assert '/m/scout_1/readings' in recorded
    assert '/diagnostics' in recorded
    assert not any('truth' in topic or '/test' in topic for topic in recorded)
    report = replay(log)
    assert report.finished
    assert report.reproduced
    assert report.compared['/m/belief'] == len(beliefs)


def test_viewers_see_all_maps(field):
    beliefs = field.listen(BeliefMaps, '/m/belief')
    field.start_mission({**SMALL, 'robots': 3}, '/m')
    progress = field.listen(Progress, '/m/progress')
    field.until(lambda: progress and progress[-1].deployments == 3, 'views of the third belief')

    late = {name: field.listen(OccupancyGrid, f'/m/belief/{name}') for name in MAPS}
    field.until(lambda: all(late.values()), 'map for the late viewer')
    assert all(len(maps) == 1 for maps in late.values())

    volatile = {
        name: field.listen(OccupancyGrid, f'/m/belief/{name}', volatile=True) for name in MAPS
    }
    topics = [f'/m/belief/{name}' for name in MAPS]
    field.until(
        lambda: all(field.node.count_subscribers(topic) == 2 for topic in topics), 'both viewers'
    )
    assert field.set_parameter('/m/planner', 'robots', 4).successful
    field.until(lambda: all(volatile.values()), 'map for the volatile viewer')
    field.until(lambda: beliefs and beliefs[-1].deployments == 4, 'fourth belief')
    for name in MAPS:
        field.until(
            lambda name=name: volatile[name][-1].header == beliefs[-1].header, f'last {name}'
        )
        shown = volatile[name][-1]
        assert shown.header == beliefs[-1].header
        percent = np.rint(100 * np.asarray(getattr(beliefs[-1], name)))
        assert list(shown.data) == percent.tolist()
    assert not field.set_parameter('/m/planner', 'grid.width', 4).successful
    assert not field.set_parameter('/m/planner', 'robots', -4).successful


def test_simulated_time_that_jumps_back_names_no_deployment_twice(field):
    paths, _, beliefs = heard = listen(field, '')
    parameters = {**SMALL, 'robots': 6}
    field.start_mission({**parameters, 'use_sim_time': True})

    field.until(
        lambda: 'waiting for the clock to start on /clock' in field.state('/estimator'),
        'wait for the clock',
    )
    assert not paths
    now = [100]
    clock = field.node.create_publisher(rosgraph_msgs.msg.Clock, '/clock', 1)

    def tick():
        message = rosgraph_msgs.msg.Clock()
        message.clock.sec = now[0]
        clock.publish(message)

    field.node.create_timer(0.02, tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
    wait_for_end(field, parameters, heard)
    now[0] = 40
    for name in ('/planner', '/estimator'):
        field.until(lambda name=name: field.diagnosed_at(name) == 40 * 10**9, 'jump back in time')
    parameters['robots'] = 12
    assert field.set_parameter('/planner', 'robots', 12).successful
    wait_for_end(field, parameters, heard)
    stamps = [from_stamp(path.header.stamp) for path in paths]
    # The mission began at 100 s, and its deployments have later stamps.
    assert stamps == [100 * 10**9 + 1 + k for k in range(12)]
    assert from_stamp(beliefs[-1].header.stamp) == 40 * 10**9
    assert_is_core_mission(parameters, *heard)


TEAM = {'grid.width': 5, 'grid.height': 4, 'max_steps': 8, 'planner': 'relaxed', 'seed': 2}


def start_team(field, agents, parameters, *, is_apart=False, namespace='/m'):
    names = [f'scout_{number}' for number in range(1, agents + 1)]
    reports = {
        name: field.listen(DeploymentReport, f'{namespace}/{name}/report') for name in names
    }
    given = {**TEAM, **parameters, 'agents': names}
    field.start('estimator', {**given, 'await_nodes': ['planner']}, namespace)
    field.start('planner', {**given, 'await_nodes': ['agent', 'estimator']}, namespace)
    for name in names if is_apart else ['']:
        own = {'agent': name, 'await_nodes': ['planner', 'estimator', 'test']}
        field.start('agent', given | own, f'{namespace}/{name}'.rstrip('/'))
    return reports


def until_done(field, reports, robots, namespace='/m'):
    field.until(lambda: 'done' in field.state(f'{namespace}/planner'), 'end', 180)
    field.until(lambda: sum(map(len, reports.values())) == robots, 'all reports')


def test_a_team_carries_on_when_an_agent_leaves(field):
    reports = start_team(field, 3, {'robots': 20_000, 'step_period': 0.01}, is_apart=True)
    field.until(lambda: all(len(each) > 2 for each in reports.values()), 'reports')
    gone = field.processes.started.pop('/m/scout_2/agent')
    gone.send_signal(signal.SIGINT)
    assert gone.wait(timeout=60) == 0
    field.until(lambda: field.count('/m/planner', 'refused') == 1, 'word of the agent gone')
    assert 'agent scout_2 has left' in field.diagnosed('/m/planner').message

    def others_report():
        before = {name: len(reports[name]) for name in ('scout_1', 'scout_3')}
        field.until(
            lambda: all(len(reports[name]) > made + 3 for name, made in before.items()),
            'reports of the others',
        )

    # The agent's last report may still be under way.
    others_report()
    of_gone = len(reports['scout_2'])
    others_report()
    assert len(reports['scout_2']) == of_gone


def test_an_agent_that_answers_for_another_is_refused(field):
    beliefs = field.listen(BeliefMaps, '/m/belief')
    until_done(field, start_team(field, 2, {'robots': 4}), 4)
    field.until(lambda: beliefs and beliefs[-1].deployments == 4, 'last belief')
    last, heard = beliefs[-1], len(beliefs)
    imposter = field.node.create_publisher(DeploymentReport, '/m/scout_2/report', qos.EVIDENCE)
    field.until(lambda: imposter.get_subscription_count() > 1, 'listeners')
    field.until(lambda: field.count('/m/planner', 'refused') == 1, 'word of two nodes')
    assert '2 nodes publish reports of agent scout_2' in field.diagnosed('/m/planner').message
    for name in ('scout_1', 'scout_9'):
        report = DeploymentReport(agent=name)
        report.header.frame_id = 'map'
        imposter.publish(report)
    field.until(lambda: field.count('/m/estimator', 'refused') == 2, 'refusals')
    assert "agent is 'scout_9': on this topic it must be 'scout_2'" in (
        field.diagnosed('/m/estimator').message
    )
    assert (beliefs[-1], len(beliefs)) == (last, heard)


def test_robots_in_flight_are_shown_only_on_request(field):
    shown = field.listen(TFMessage, '/tf', volatile=True)
    paths = [field.listen(Path, f'/seen/scout_{number}/path') for number in (1, 2)]
    parameters = {'robots': 4, 'step_period': 0.02, 'sensor.malfunction': 0.0}
    until_done(field, start_team(field, 2, parameters), 4)
    assert not shown
    # Poses that are due at the same time keep their order.
    parameters |= {'robots': 20_000, 'step_period': 1e-4, 'publish_pose': True}
    start_team(field, 2, parameters, namespace='/seen')

    def places(number):
        return [
            (pose.transform.translation.x, pose.transform.translation.y)
            for message in shown
            for pose in message.transforms
            if (pose.header.frame_id, pose.child_frame_id) == ('map', f'scout_{number}/base_link')
        ]

    # DDS may repeat poses seconds later, and a subscriber may miss the first ones.
    field.until(lambda: min(len(set(places(number))) for number in (1, 2)) > 1, 'poses of both')
    seen = [places(number) for number in (1, 2)]
    assert sum(map(len, seen)) == sum(len(message.transforms) for message in shown)

    def are_of_the_paths():
        for places, sent in zip(seen, paths):
            points = (pose.pose.position for path in sent for pose in path.poses)
            walked = iter([(point.x, point.y) for point in points])
            if not all(place in walked for place in places):
                return False
        return True

    # A path may arrive after the poses on it.
    field.until(are_of_the_paths, 'poses in the order of the paths')


MAPS = ('hazard', 'target', 'kappa')


@pytest.fixture
def estimator(field):
    """Yield an estimator that the test spins together with its own node."""
    arguments = [
        argument
        for name, value in FIELD.items()
        for argument in ('-p', f'{name}:={value}'.replace(' ', ''))
    ]
    rclpy.init(args=['--ros-args', *arguments])
    node = FieldNode('estimator')
    yield node
    node.destroy_node()
    rclpy.shutdown()


def test_of_simultaneous_beliefs_the_first_and_the_last_are_shown(field, estimator):
    views = Views(estimator, ['scout_1'])
    shown = {name: field.listen(OccupancyGrid, f'/belief/{name}') for name in MAPS}
    shown['progress'] = field.listen(Progress, '/progress')
    topics = ['/progress', *(f'/belief/{name}' for name in MAPS)]
    field.until(lambda: all(map(field.node.count_publishers, topics)), 'publishers')
    shows = [each for each in estimator.publishers if each.topic_name in topics]
    field.until(lambda: all(each.get_subscription_count() for each in shows), 'viewers')
    assert len(shows) == len(topics)
    ledger = Ledger(GRID, 6, Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), SensorModel(0.5)))
    views.show(ledger, 1)
    for number in range(1, 6):
        ledger.record_path(key(number), HOME)
        ledger.record_report(*read_report(lost(number)))
        views.show(ledger, 1 + number)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(estimator)

    def are_last_shown():
        executor.spin_once(timeout_sec=0.0)
        return all(each and each[-1].header.stamp.nanosec == 6 for each in shown.values())

    field.until(are_last_shown, 'views of the last belief')
    executor.shutdown()
    for name, messages in shown.items():
        assert [from_stamp(message.header.stamp) for message in messages] == [1, 6], name
    last = shown['progress'][-1]
    assert (last.deployments, last.lost) == (5, 5)
    # The view of the last report only, although the belief before it was not shown.
    assert 0.0 < last.information_expected < 1.0


LANE = {
    'grid.width': 5, 'grid.height': 4, 'max_steps': 10, 'method': 'kappa_bnitp',
    'planner': 'relaxed', 'sensor.lethality': 0.6, 'prior.hazard': 0.3, 'prior.target': 0.4,
    'world.hazard_density': 0.05, 'robots': 60, 'goal.kind': 'lane', 'goal.cells': [19],
    'stop.confidence': 0.9, 'seed': 7,
}  # fmt: skip


def ask(field, kind, service, request):
    client = field.node.create_client(kind, service)
    field.until(client.service_is_ready, service)
    future = client.call_async(request)
    field.until(future.done, f'answer of {service}')
    return future.result()


@pytest.mark.interpreter
def test_a_mission_with_a_goal_stops_and_continues_when_overruled(field):
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
    # The state may arrive before the last paths.
    field.until(lambda: len(paths) == len(expected), 'all paths')
    assert 0 < len(expected) < LANE['robots']
    field.until(lambda: decisions and decisions[-1].reached, 'decision')
    grid = make_grid(with_defaults(LANE))
    for path, deployment in zip(paths, expected):
        _, flown = read_path(grid, 'scout_1', path)
        assert flown.tolist() == deployment.plan.path.tolist()
    shown = decisions[-1].path.poses
    field.until(lambda: lanes and lanes[-1].poses == shown, 'lane')

    request = GetPlan.Request()
    # An empty request names no frame, and so no places.
    assert not ask(field, GetPlan, '/m/safest_path', request).plan.poses
    refusal = "safest_path refused: start.header.frame_id is '': it must be 'map'"
    field.until(lambda: refusal in field.said('/m/estimator'), 'refusal')
    request.start.header.frame_id = request.goal.header.frame_id = 'map'
    request.start.pose.position.x = request.start.pose.position.y = 0.5
    request.goal.pose.position.x, request.goal.pose.position.y = 4.5, 3.5
    found = ask(field, GetPlan, '/m/safest_path', request).plan
    assert found.poses == shown
    request.goal.pose.position.x = 99.0
    assert not ask(field, GetPlan, '/m/safest_path', request).plan.poses

    # The recorder has both, however soon one follows the other. The estimator follows what the
    # planner says next.
    before = len(decisions)
    for confidence in (0.0, 0.05):
        assert field.set_parameter('/m/estimator', 'stop.confidence', confidence).successful
    field.until(
        lambda: not all(each.reached for each in decisions[before:]),
        'decision by another confidence',
    )
    sent = len(paths)
    assert field.set_parameter('/m/planner', 'stop.confidence', 0.0).successful
    field.until(lambda: len(paths) > sent + 1, 'robots that leave again')
    assert set(field.processes.stop().values()) == {0}
    recorded = {}
    for logged in read_log(log):
        if logged.topic == '/m/decision':
            # Later decisions on the same deployments have another confidence.
            recorded.setdefault(logged.message.deployments, logged.message)
    for number, deployment in enumerate(expected, 1):
        decision, message = deployment.decision, recorded[number]
        assert message.probability == decision.p_free
        assert message.survival == decision.survival
        assert message.hazards_mean == decision.hazards_mean
        assert message.reached == decision.reached == (number == len(expected))
        assert len(message.path.poses) == len(decision.path)
    told = replay(log, asked=asked_on_record(MissionLog(log)))
    assert told.reproduced, told.mismatches
    assert told.compared['/m/decision'] > len(expected), told.not_compared
    [estimator] = [each for each in told.changes if ' of /m/estimator changed' in each][:1]
    assert 'stop.confidence' in estimator
    assert estimator.endswith(' to 0.0')


def test_a_mission_with_a_mask_replays_without_its_file(field):
    """The planner reads it once; the log has its cells."""
    Image.fromarray(np.array([[254, 254, 0], [254, 0, 254]], np.uint8)).save(
        field.folder / 'mask.png'
    )
    mask = field.folder / 'mask.yaml'
    mask.write_text(
        'image: mask.png\nresolution: 1.0\norigin: [0, 0, 0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.2\n'
    )
    parameters = {
        'grid.width': 3, 'grid.height': 2, 'max_steps': 4, 'robots': 4,
        'goal.kind': 'area', 'goal.mask': str(mask),
    }  # fmt: skip
    log = field.folder / 'mission.mcap'
    decisions = field.listen(Decision, '/m/decision')
    field.start_mission(parameters, '/m', log)
    field.until(lambda: decisions, 'decision')
    mask.unlink()
    field.until(lambda: field.state('/m/planner').startswith('done: 4 of 4'), 'end')
    field.until(lambda: len(decisions) == 5, 'the decision after the last robot')
    field.until_recorded(log, {'/m/decision': decisions})
    assert set(field.processes.stop().values()) == {0}
    assert [*decisions[-1].goal_cells] == [1, 5]
    recorded = MissionLog(log)
    report = replay(recorded, asked=asked_on_record(recorded))
    assert report.reproduced
    assert report.compared['/m/decision'] == 5
    assert read_history(log).decision.cells.tolist() == [1, 5]
