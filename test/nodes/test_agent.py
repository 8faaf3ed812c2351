# SPDX-License-Identifier: Apache-2.0
"""The simulated agent traverses valid paths, each once, and hides its world."""

from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_msgs.msg import DeploymentReport, Recorded
from kbnitp_ros.core import Observation, Report, SensorModel, World
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.deployments import read_report, report_message, Source
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from samples import BAD_PATHS, FIELD, GRID, HOME, key, on_disk, path
from visualization_msgs.msg import Marker

PARAMETERS = {**FIELD, 'await_nodes': ['test'], 'seed': 11}


@pytest.fixture(autouse=True)
def departing(field):
    field.let_depart()


def expected_reports(world, model, seed, paths):
    """Return the fates of robots on these paths, by the core."""
    rng = np.random.default_rng(seed)
    if world is None:
        world = World.random(GRID, rng, 0.15, 0.8, 0.1)
    for cells in paths:
        observation = world.traverse(cells, model, rng.spawn(1)[0])
        readings = () if observation.readings is None else observation.readings.tolist()
        seen = tuple(zip(cells[1:], readings))
        yield Report(observation.survived, seen, field_id=GRID.id)


def test_each_path_is_traversed_once_and_bad_ones_never(field):
    reports = field.listen(DeploymentReport, '/scout_1/report')
    field.start('agent', PARAMETERS)
    paths = field.talk(Path, '/scout_1/path')
    refused = 0
    for message, told in [case for case in BAD_PATHS if 'differs' not in case[1]]:
        paths.publish(message)
        refused += 1
        assert told in field.until_refused('/agent', refused)
    tours = [HOME, [0, 4, 8, 4, 0], [0, 0, 1, 0], HOME, [0, 1, 0]]
    for number, cells in enumerate(tours):
        paths.publish(path(number, cells))
        paths.publish(path(number, cells))
    paths.publish(path(0, [0, 0]))
    refusal = field.until_refused('/agent', refused + 1)
    assert 'already has another path: the first path counts' in refusal
    field.until(lambda: len(reports) == len(tours), 'last report')
    assert field.count('/agent', 'accepted') == len(tours)
    expected = expected_reports(None, SensorModel(0.5), PARAMETERS['seed'], tours)
    for number, (report, outcome) in enumerate(zip(reports, expected)):
        assert read_report(report) == (key(number), outcome)


@pytest.mark.interpreter
def test_a_robot_returns_though_the_system_clock_is_set_back(system_clock, field):
    reports = field.listen(DeploymentReport, '/scout_1/report')
    field.start('agent', {**PARAMETERS, 'step_period': 1.0})
    paths = field.talk(Path, '/scout_1/path')
    paths.publish(path(0, HOME))
    field.until(lambda: field.count('/agent', 'accepted') == 1, 'departure')
    system_clock.touch()
    field.until(lambda: reports, 'report')


def test_a_world_from_a_file_is_shown_only_on_request(field):
    file = field.folder / 'world.yaml'
    file.write_text('hazard: [..x., ...., ....]\ntarget: [x..., ...x, .x..]')
    maps = {name: field.listen(OccupancyGrid, f'/truth/{name}') for name in ('hazard', 'target')}
    hidden = {name: field.listen(OccupancyGrid, f'/b/truth/{name}') for name in maps}
    readings = field.listen(Marker, '/scout_1/readings')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    sure = {
        'sensor.malfunction': 0.0, 'sensor.false_positive': 0, 'sensor.true_positive': 1,
        'sensor.lethality': 1, 'sensor.false_negative': 0,
    }  # fmt: skip
    parameters = {**PARAMETERS, **sure, 'world.file': str(file)}
    field.start('agent', {**parameters, 'publish_truth': True})
    field.start('agent', {**parameters, 'await_nodes': []}, '/b')
    field.until(lambda: all(maps.values()), 'truth')
    assert list(maps['hazard'][0].data) == [0] * 5 + [-1] + [0] * 4 + [100, 0]
    assert list(maps['target'][0].data) == [0, 100, 0, 0, 0, -1, 0, 100, 100, 0, 0, 0]

    paths = field.talk(Path, '/scout_1/path')
    paths.publish(path(1, [0, 1, 2, 1, 0]))
    paths.publish(path(2, [0, 4, 9, 10, 6, 1, 0]))
    field.until(lambda: len(reports) == 2 and readings, 'reports and readings')
    seen = ((1, True), (2, False), (1, True), (0, False))
    assert read_report(reports[0]) == (key(1), Report(True, seen, field_id=GRID.id))
    assert read_report(reports[1]) == (key(2), Report(False, field_id=GRID.id))
    (marker,) = readings
    assert marker.header == reports[0].header
    assert [(point.x, point.y) for point in marker.points] == [
        (1.5, 0.5),
        (2.5, 0.5),
        (1.5, 0.5),
        (0.5, 0.5),
    ]
    assert marker.colors[0] == marker.colors[2] != marker.colors[1] == marker.colors[3]

    field.until(lambda: field.diagnosed('/b/agent').values, 'diagnostics of the other agent')
    assert not field.node.count_publishers('/b/truth/hazard')
    assert not any(hidden.values())


def test_a_robot_leaves_when_its_path_is_on_disk(field):
    reports = field.listen(DeploymentReport, '/scout_1/report')
    recorded = field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE)
    field.record_departures('scout_1')
    field.start('agent', {**PARAMETERS, 'recorded': True})
    paths = field.talk(Path, '/scout_1/path')
    for number in (1, 2, 3):
        paths.publish(path(number))
    field.until(lambda: field.count('/agent', 'waiting') == 3, 'three paths')
    assert not reports
    # A later path on disk does not confirm an earlier one.
    recorded.publish(on_disk(path(2)))
    field.until(lambda: field.count('/agent', 'waiting') == 2, 'a robot to leave')
    field.until(lambda: len(reports) == 1, 'report')
    for number in (3, 1):
        recorded.publish(on_disk(path(number)))
    field.until(lambda: len(reports) == 3, 'last report')
    assert [read_report(report)[0] for report in reports] == [key(2), key(3), key(1)]


def test_a_robot_that_was_given_up_returns_to_a_resumed_agent(field):
    log = field.folder / 'mission.mcap'
    tours = [HOME, [0, 4, 8, 4, 0], HOME, [0, 1, 2, 3, 2, 1, 0]]
    # No robot is lost, and readings are effectively random.
    model = {'lethality': 0.0, 'malfunction': 0.0, 'true_positive': 0.5, 'false_positive': 0.5}
    expected = list(expected_reports(None, SensorModel(**model), PARAMETERS['seed'], tours))
    assert all(report.survived for report in expected)
    back, *given_up = (
        report_message(key(number), Observation(tours[number], *ended), 0, source, field_id)
        for number, source, field_id, *ended in (
            (0, Source.AGENT, GRID.id, True, [read for _, read in expected[0].readings]),
            (1, Source.SILENCE, '', False),
            (2, Source.SILENCE, '', False),
        )
    )
    with LogWriter(log) as writer:
        writer.add_topic('/scout_1/path', 'nav_msgs/msg/Path', '[]')
        writer.add_topic('/scout_1/report', 'kbnitp_msgs/msg/DeploymentReport', '[]')
        for number, report in enumerate((back, *given_up)):
            sent = path(number, tours[number])
            writer.write('/scout_1/path', serialize_message(sent), 1, 1)
            writer.write('/scout_1/report', serialize_message(report), 1, 1)
    reports = field.listen(DeploymentReport, '/scout_1/report')
    parameters = {f'sensor.{name}': value for name, value in model.items()}
    field.start('agent', {**PARAMETERS, **parameters, 'silent_loss': True, 'resume': str(log)})
    paths = field.talk(Path, '/scout_1/path')
    # The second and the third order arrive in reverse.
    for number in (2, 0, 1, 3):
        paths.publish(path(number, tours[number]))
    field.until(lambda: len(reports) == 4, 'reports')
    assert [read_report(report) for report in reports] == [
        (key(number), expected[number]) for number in (0, 2, 1, 3)
    ]


def test_no_robot_waits_for_ever_for_an_earlier_path(field):
    reports = {name: field.listen(DeploymentReport, f'/{name}/report') for name in ('a', 'b')}
    field.start('agent', {**PARAMETERS, 'agents': ['a', 'b'], 'hazards.dynamics': 'used_up'})
    paths = {name: field.talk(Path, f'/{name}/path') for name in reports}
    # The first agent has no order in the last round.
    paths['b'].publish(path(2))
    field.until(lambda: 'the path of a in the same round' in field.state('/agent'), 'wait')
    assert not reports['b']
    paths['a'].publish(path(1))
    field.until(lambda: reports['a'] and reports['b'], 'reports of a round')
    paths['b'].publish(path(3))
    field.until(lambda: len(reports['b']) == 2, 'report of a robot that leaves alone')


def test_no_robot_waits_for_an_agent_with_a_robot_in_flight(field):
    agents = {'agents': ['a', 'b'], 'hazards.dynamics': 'used_up'}
    slow = {'step_period': 1000.0, 'team.b.step_period': 0.001}
    field.start('agent', {**PARAMETERS, **agents, **slow})
    reports = {name: field.listen(DeploymentReport, f'/{name}/report') for name in ('a', 'b')}
    paths = {name: field.talk(Path, f'/{name}/path') for name in reports}
    told = field.listen(DiagnosticArray, '/diagnostics', volatile=True)
    paths['a'].publish(path(1))
    field.until(lambda: field.count('/agent', 'accepted') == 1, 'departure of the first')
    for number in (2, 3, 4):
        paths['b'].publish(path(number))
    field.until(lambda: len(reports['b']) == 3, 'reports')
    # A wait of some seconds would be on diagnostics, which are published each second.
    assert 'in the same round' not in str(told)
