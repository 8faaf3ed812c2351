# SPDX-License-Identifier: Apache-2.0
"""A mission of four processes is the mission that core runs, bit for bit."""

from extent import FULL
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, ModelBelief, Progress
from kbnitp_ros.core import Report
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_path, read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.progress import read_model_belief
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
import pytest
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
import rosgraph_msgs.msg
from unbroken import core_mission

MAPS = ('hazard', 'target', 'kappa')

SMALL = {'grid.width': 5, 'grid.height': 4, 'max_steps': 8}
ODD = {
    'grid.width': 6,
    'grid.height': 5,
    'grid.base': 14,
    'grid.resolution': 0.1,
    'grid.origin': [-1.3, 2.7],
    'grid.blocked': [7, 8, 22],
    'max_steps': 11,
    'sensor.lethality': 0.8,
    'prior.hazard': 0.3,
    'method': 'kappa_bnitp_published',
    'beam_width': 4,
    'max_visits': 2,
    'hazards.dynamics': 'changing',
    'hazards.appear': 0.02,
    'hazards.vanish': 0.1,
    # A topic that keeps one message drops it for the next one.
    'step_period': 0.01,
}
LARGE = {
    'grid.width': 100, 'grid.height': 100, 'max_steps': 200, 'sensor.malfunction': 0.001,
    'planner': 'relaxed',
}  # fmt: skip
HUGE = {
    'grid.width': 300, 'grid.height': 300, 'grid.base': 150 * 300 + 150, 'max_steps': 60,
    'sensor.malfunction': 0.001, 'planner': 'relaxed',
}  # fmt: skip

LEARNING = {
    **SMALL,
    'method': 'kappa_bnitp_sampled',
    'learn.numbers': ['lethality', 'hazard_density', 'false_positive'],
    'learn.hazard_density': [0.05, 0.6],
    'beam_width': 4,
}


def listen(field, namespace):
    """Return what a mission's paths, reports and beliefs will be."""
    return (
        field.listen(Path, f'{namespace}/scout_1/path'),
        field.listen(DeploymentReport, f'{namespace}/scout_1/report'),
        field.listen(BeliefMaps, f'{namespace}/belief'),
    )


def stamps(messages):
    """Return the times that messages are stamped with, in nanoseconds."""
    return [from_stamp(message.header.stamp) for message in messages]


def wait_for_end(field, parameters, heard):
    """Wait until a mission has made all its deployments."""
    paths, reports, beliefs = heard
    robots = parameters['robots']
    field.until(
        lambda: min(len(paths), len(reports), len(beliefs) - 1) >= robots, 'end', patience=180
    )


def assert_is_core_mission(parameters, paths, reports, beliefs):
    """See that a mission's messages are what core makes of the same parameters."""
    expected = core_mission(parameters)
    assert len(paths) == len(reports) == len(expected)
    assert [message.deployments for message in beliefs] == list(range(len(expected) + 1))
    grid = read_belief_maps(beliefs[0]).grid
    for path, report, belief, deployment in zip(paths, reports, beliefs[1:], expected):
        key, cells = read_path(grid, 'scout_1', path)
        assert cells.tolist() == deployment.plan.path.tolist()
        reported, outcome = read_report(report)
        assert reported == key
        observation = deployment.observation
        readings = () if observation.readings is None else observation.readings.tolist()
        read = tuple(zip(observation.path[1:].tolist(), readings))
        known, lost_at = observation.steps_survived, observation.lost_at
        where = () if lost_at is None else tuple(lost_at.tolist())
        assert outcome == Report(observation.survived, read, steps_survived=known, lost_at=where)
        assert read_belief_maps(belief).newest == key
        for name in (*MAPS, 'joint'):
            ours, core = getattr(belief, name), getattr(deployment.belief, name)
            assert np.asarray(ours).tobytes() == core.tobytes(), (belief.deployments, name)


@pytest.mark.parametrize(
    'parameters',
    [
        # As users start nodes.
        pytest.param({'seed': 3, 'robots': 40 if FULL else 6}, marks=pytest.mark.interpreter),
        {**ODD, 'seed': 4, 'robots': 25 if FULL else 12},
        pytest.param({**LARGE, 'seed': 7, 'robots': 20}, marks=pytest.mark.full),
        pytest.param({**HUGE, 'seed': 8, 'robots': 3}, marks=pytest.mark.full),
        {
            **SMALL,
            'hazards.dynamics': 'used_up',
            'objective': 'behavioral',
            'alpha': 2.0,
            'step_period': 0.01,
            'seed': 10,
            'robots': 10,
        },
    ],
    ids=['default', 'odd', 'large', 'huge', 'behavioral'],
)
def test_every_belief_is_that_of_core_also_on_record(field, parameters):
    log = field.folder / 'mission.mcap'
    paths, reports, beliefs = heard = listen(field, '/m')
    views = [field.listen(OccupancyGrid, f'/m/belief/{name}') for name in MAPS]
    field.start_mission(parameters, '/m', log)
    wait_for_end(field, parameters, heard)
    assert_is_core_mission(parameters, *heard)
    # They follow their belief.
    last = beliefs[-1].header.stamp
    field.until(lambda: all(view and view[-1].header.stamp == last for view in views), 'last maps')
    assert set(field.processes.stop().values()) == {0}
    recorded = {}
    for logged in read_log(log):
        recorded.setdefault(logged.topic, []).append(logged.message)
    assert len(recorded['/m/scout_1/path']) == len(paths)
    assert len(recorded['/m/scout_1/report']) == len(reports)
    told = stamps(beliefs)
    on_record = stamps(recorded['/m/belief'])
    if parameters.get('grid.width', 0) < HUGE['grid.width']:
        assert on_record == told
    # Views are of the last belief within a tenth of a second.
    for topic in ('/m/belief', '/m/progress', *(f'/m/belief/{name}' for name in MAPS)):
        on_record = stamps(recorded[topic])
        assert set(on_record) <= set(told)
        assert on_record[-1] == told[-1]
    assert '/m/scout_1/readings' in recorded
    assert '/diagnostics' in recorded
    assert not any('truth' in topic or '/test' in topic for topic in recorded)
    report = replay(log)
    assert report.finished
    assert report.reproduced
    assert report.compared['/m/belief'] == len(beliefs)


def test_what_is_learnt_is_that_of_core_also_on_record(field):
    """The planner has other numbers than the truth, and plans with what the belief says."""
    log = field.folder / 'mission.mcap'
    parameters = {**LEARNING, 'seed': 6, 'robots': 20, 'sensor.lethality': 0.9}
    heard = listen(field, '/m')
    models = field.listen(ModelBelief, '/m/model')
    field.start_mission(parameters, '/m', log)
    wait_for_end(field, parameters, heard)
    field.until(lambda: len(models) == 21, 'last model')
    assert set(field.processes.stop().values()) == {0}
    expected = core_mission(parameters)
    assert [message.deployments for message in models] == list(range(21))
    for message, belief, deployment in zip(models[1:], heard[2][1:], expected):
        assert message.header == belief.header
        known = read_model_belief(message).numbers
        assert known.keys() == deployment.parameters.keys() == set(parameters['learn.numbers'])
        for name, number in deployment.parameters.items():
            assert known[name].mean == number.mean
            assert known[name].sd == number.sd
            quantiles = [number.quantile(q) for q in (0.05, 0.25, 0.5, 0.75, 0.95)]
            assert known[name].quantiles == tuple(quantiles)
            assert known[name].effective_samples == number.effective_samples
        assert read_belief_maps(belief).model == deployment.model
    report = replay(log)
    assert report.reproduced
    assert report.compared['/m/model'] == report.compared['/m/belief'] == 21


@pytest.mark.full
def test_missions_in_two_namespaces_do_not_meet(field):
    missions = {'/a': {**SMALL, 'seed': 1, 'robots': 10}, '/b': {**SMALL, 'seed': 2, 'robots': 8}}
    heard = {namespace: listen(field, namespace) for namespace in missions}
    for namespace, parameters in missions.items():
        field.start_mission(parameters, namespace, field.folder / f'{namespace[1:]}.mcap')
    for namespace, parameters in missions.items():
        wait_for_end(field, parameters, heard[namespace])
        assert_is_core_mission(parameters, *heard[namespace])
    field.processes.stop()
    for namespace in missions:
        log = field.folder / f'{namespace[1:]}.mcap'
        for logged in read_log(log):
            told_by = [logged.topic]
            if logged.topic == '/diagnostics':
                told_by = [status.name for status in logged.message.status]
            assert all(name.startswith(f'{namespace}/') for name in told_by)
        assert replay(log).reproduced


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
    field.until(lambda: beliefs[-1].deployments == 4, 'fourth belief')
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
    # The mission began at 100 s, and its deployments have later names.
    assert stamps == [100 * 10**9 + 1 + k for k in range(12)]
    assert from_stamp(beliefs[-1].header.stamp) == 40 * 10**9
    assert_is_core_mission(parameters, *heard)
