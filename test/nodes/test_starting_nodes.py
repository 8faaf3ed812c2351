# SPDX-License-Identifier: Apache-2.0
"""How nodes start, appear in the graph, print and end."""

from contextlib import suppress
import re
import signal
import subprocess

from base import Base
from base import GRID as BASE_GRID
from diagnostic_msgs.msg import DiagnosticStatus
from extent import some
from forked import ForkedProcess, run_node
from kbnitp_msgs.msg import DeploymentReport, Progress
from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.configuration import NODES
from kbnitp_ros.core import (
    Belief,
    Estimator,
    Grid,
    Ledger,
    Observation,
    plan,
    SearchOptions,
    SensorModel,
)
from kbnitp_ros.files import counted
from kbnitp_ros.log.read import is_finished, read_parameters
from kbnitp_ros.messages.deployments import read_path, read_report, report_message
from kbnitp_ros.messages.progress import MissionState
from kbnitp_ros.nodes.runtime import signals
from kbnitp_ros.nodes.runtime.diagnostics import Diagnostics
from kbnitp_ros.nodes.runtime.node import DEPLOYMENTS, MissionNode
from laws import for_each
from nav_msgs.msg import Path
import pytest
import rclpy


@pytest.fixture
def run(server, tmp_path):
    """Return a function that runs commands in parallel, and returns exit codes and outputs."""

    def run(commands):
        started = []
        with free_domain() as domain:
            for number, arguments in enumerate(commands):
                said = tmp_path / f'said_{number}.txt'
                said.write_text('')
                forked = ForkedProcess(run_node, (arguments,), environment(domain), str(said))
                started.append((forked, said))
            return [(process.wait(timeout=60), said.read_text()) for process, said in started]

    return run


def complaints(said, told='[INFO]'):
    """Return a node's lines that are not about waits or deployments."""
    return [line for line in said.splitlines() if not line.startswith(told)]


ROBOT = 'agent:=scout_1 journal:=FOLDER'

CANNOT_START = [
    ('planner', 'max_steps:=0', 'parameter max_steps is 0: it must be from 1 to 10000'),
    ('planner', 'planner:=coverage objective:=information_per_loss', 'coverage does not seek it'),
    (
        'planner',
        'grid.width:=100 grid.height:=100 max_steps:=200 beam_width:=10000',
        'a beam width of 10000 and max_visits = 3 takes about',
    ),
    ('planner', 'agents:=[operator]', 'operator cannot name an agent'),
    ('planner', 'return_deadline:=0.0', 'return_deadline is 0.0'),
    ('planner', 'silent_loss:=true', 'silent_loss is true and step_period is 0 for scout_1'),
    ('planner', 'grid.origin:=[1e16,0.0]', 'origin is (1e+16, 0.0): cells of 1.0 m cannot'),
    *((name, 'resume:=no.mcap', 'no.mcap') for name in ('planner', 'agent', 'recorder')),
    ('agent', 'map:=no.yaml', 'no.yaml cannot be read: No such file or directory'),
    ('agent', 'grid.blocked:=[0]', 'base is 0: it must be a free cell, and this cell is'),
    ('agent', 'agent:=/scout', "agent is '/scout': it must be of the form"),
    ('agent', 'agent:=scout_2', 'agent is scout_2: it must be one of scout_1'),
    ('agent', 'world.file:=no.yaml', 'agent: no.yaml: No such file or directory'),
    ('estimator', 'prior.target:=0.0', 'maps have no joint distribution at cell 0'),
    ('estimator', 'prior.hazard_map:=no.npy', 'no.npy'),
    ('estimator', 'learn.numbers:=[lethalty]', "numbers is 'lethalty': did you mean lethality?"),
    ('estimator', 'hazards.move:=0.1', 'parameter hazards.move is 0.1 and hazards are static:'),
    ('estimator', 'filter.type:=0 filter.multiplier:=2.0', 'filter.base is 0.0 and'),
    ('robot', f'{ROBOT}/1 position:=fix', "parameter position is 'fix', and datum is empty"),
    ('robot', f'{ROBOT}/2 datum:=[91.0,0.0,0.0]', 'datum has latitude 91.0'),
    ('recorder', 'file:=7', 'parameter file is 7: it must be a text'),
    ('recorder', 'file:=/', "'/'"),
    ('recorder', 'file', "Couldn't parse parameter override rule"),
    ('recorder', 'flie:=a.mcap', 'flie is unknown to the recorder: did you mean file?'),
    ('recorder', 'recorder:step_period:=1.0', 'step_period is unknown to the recorder: it is a'),
]  # fmt: skip


@pytest.mark.processes
@pytest.mark.parametrize('refused', [
    CANNOT_START[::4], pytest.param(CANNOT_START, marks=pytest.mark.full)
], ids=['some', 'all'])  # fmt: skip
def test_a_failing_start_is_explained_in_one_line(run, tmp_path, refused):
    files = [(name, 'no.yaml', 'parameter file no.yaml: No such file or') for name in NODES]
    cannot = [given.replace('FOLDER', str(tmp_path)) for _, given, _ in refused]
    commands = [
        [name, '--ros-args', '--disable-rosout-logs', '-p', *given.replace(' ', ' -p ').split()]
        for (name, _, _), given in zip(refused, cannot)
    ] + [[name, '--ros-args', '--params-file', file] for name, file, _ in files]
    for (name, given, told), (code, said) in zip([*refused, *files], run(commands)):
        assert code == 2, given
        (complaint,) = complaints(said, ('[', '\x1b'))
        assert complaint.startswith(f'{name}: ')
        assert told in complaint
        assert 'Errno' not in complaint


@for_each('name', NODES)
def test_a_failing_start_is_explained_in_its_namespace(field, name):
    field.start(name, {'max_steps': 0, 'file': '/'}, '/m')
    code, told = field.until_failed(f'/m/{name}')
    assert code == 2
    assert field.said(f'/m/{name}') == f'{told}\n'
    assert told.startswith(f'{name}: ')


def test_a_failure_is_published_on_diagnostics(field):
    node = rclpy.create_node('failing', context=field.node.context, namespace='/m')
    diagnostics = Diagnostics(node)
    topic = [each for each in node.publishers if each.topic_name == '/diagnostics']
    field.until(lambda: topic[0].get_subscription_count() == 1, 'reader')
    diagnostics.fail(ValueError('max_steps is 0'))
    field.until(lambda: field.diagnosed('/m/failing').level == DiagnosticStatus.ERROR, 'failure')
    assert field.diagnosed('/m/failing').message == 'max_steps is 0'
    node.destroy_node()


@pytest.mark.processes
def test_arguments_that_are_not_for_ros_are_refused(run):
    ((code, said),) = run([['planner', '--robots', '3']])
    assert code == 2
    assert 'unrecognized arguments: --robots 3' in said


@pytest.mark.parametrize('number', some([signal.SIGINT, signal.SIGTERM], 2), ids=lambda s: s.name)
def test_a_signal_amid_a_mission_ends_every_node_well(field, number):
    log = field.folder / 'mission.mcap'
    # First compilations are announced on the console.
    grid = Grid(4, 4)
    plan(grid, Belief.prior(grid, 0.5, 0.45, 0.8), SensorModel(0.5), SearchOptions(max_steps=6))
    field.start_mission({'grid.width': 4, 'grid.height': 4, 'max_steps': 6}, '/', log)
    field.until(lambda: field.count('/estimator', 'accepted') > 5, 'third deployment')
    nodes = field.processes.started
    for process in nodes.values():
        process.send_signal(number)
    for name, process in nodes.items():
        assert process.wait(timeout=60) == 0, name
        assert complaints(field.said(name)) == []
    assert is_finished(log)


@pytest.fixture
def nothing_compiled(tmp_path, monkeypatch):
    """Use an empty kernel cache for nodes that start next."""
    pytest.importorskip('numba')
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'numba'))


@pytest.mark.interpreter
def test_a_signal_ends_a_planner_that_compiles(nothing_compiled, field):
    paths = field.listen(Path, '/scout_1/path')
    field.start_mission({'grid.width': 4, 'grid.height': 4, 'max_steps': 6})
    field.until(lambda: 'compiling kernels' in field.said('/planner'), 'compiling planner')
    planner = field.processes.started['/planner']
    planner.send_signal(signal.SIGINT)
    field.until(lambda: planner.poll() is not None, 'end of the planner', may_end=True)
    assert planner.returncode == 0
    assert len(complaints(field.said('/planner'))) == 1
    # It did not finish what it compiled for.
    field.until(lambda: field.node.count_publishers('/scout_1/path') == 0, 'silence')
    assert paths == []


@pytest.mark.interpreter
@pytest.mark.parametrize('gap', some([0.0, 0.3, 0.6, 0.9], 2))
def test_interrupts_do_not_kill_an_ending_node(field, gap):
    agent = field.start('agent')
    field.until(lambda: field.diagnosed('/agent').values, 'diagnostics')
    agent.send_signal(signal.SIGINT)
    with suppress(subprocess.TimeoutExpired):
        agent.wait(timeout=gap)
    while agent.poll() is None:
        agent.send_signal(signal.SIGINT)
    assert agent.returncode == 0


@pytest.mark.interpreter
def test_a_starting_node_ends_well_after_any_number_of_signals(field):
    planner = field.start('planner', {'map_topic': '/map'})
    field.until(lambda: 'waiting for a map' in field.state('/planner'), 'waiting planner')
    while planner.poll() is None:
        planner.send_signal(signal.SIGINT)
    assert planner.returncode == 0


def test_a_node_ends_while_it_reads_a_log(monkeypatch):
    monkeypatch.setattr(signals, 'SIGNALS', [])
    items = MissionNode.log_progress(None, range(9), 'taking in a log')
    assert next(items) == 0
    signals.SIGNALS.append(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        next(items)


GRID = Grid(3, 3)
MODEL = SensorModel(0.5)
ROLES = ('agent', 'estimator', 'recorder', 'planner')
PARAMETERS = {'grid.width': 3, 'grid.height': 3, 'max_steps': 4}


def ledger():
    """Return an estimator's ledger before the first deployment."""
    return Ledger(GRID, 4, Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), MODEL))


def until_said(field, name, *words):
    field.until(lambda: all(each in field.said(name) for each in words), f'{words} of {name}')


def test_nodes_in_a_role_may_have_any_name(field):
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    for node in ROLES:
        # Agents do not subscribe to beliefs.
        passed_over = (node, 'agent') if node == 'estimator' else (node,)
        parameters = {
            **PARAMETERS,
            'robots': 2,
            'recorded': True,
            'await_nodes': [each for each in ROLES if each not in passed_over],
            'file': str(field.folder / 'mission.mcap'),
        }
        field.start(node, parameters, remaps={'__node': f'some_{node}'})
    field.until(lambda: len(paths) == len(reports) == 2, 'mission')


def test_nodes_name_what_they_wait_for(field):
    field.start('recorder', {'file': str(field.folder / 'mission.mcap')})
    field.start('estimator', PARAMETERS)
    field.start('agent', PARAMETERS)
    until_said(
        field,
        '/agent',
        'waiting for planner to subscribe to /scout_1/report (parameter await_nodes)',
    )
    until_said(
        field, '/estimator', 'waiting for planner to subscribe to /belief (parameter await_nodes)'
    )
    until_said(
        field,
        '/recorder',
        'waiting for a planner to publish AGENT/path in namespace /; recording ',
    )


def deployments_said(field, name):
    """Return a node's lines on each deployment."""
    lines = field.said(name).splitlines()
    return [line.partition(f'{DEPLOYMENTS}]: ')[2] for line in lines if DEPLOYMENTS in line]


def test_each_deployment_is_a_line_of_the_planner_and_one_of_the_estimator(field):
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    field.start_mission({**PARAMETERS, 'robots': 5, 'sensor.lethality': 0.5, 'seed': 3})
    field.until(
        lambda: (
            len(deployments_said(field, '/estimator')) == 5 == len(reports) and len(paths) == 5
        ),
        'mission',
    )
    known, lost = ledger(), 0
    for number, (path, report) in enumerate(zip(paths, reports), start=1):
        key, cells = read_path(GRID, 'scout_1', path)
        planned = plan(GRID, known.belief, MODEL, SearchOptions(max_steps=4))
        left = deployments_said(field, '/planner')[number - 1]
        numbers = re.fullmatch(
            rf'{key} leaves for \((.*), (.*)\) m and back in {len(cells) - 1} steps: it returns '
            'with probability (.*), expected information (.*) nats',
            left,
        )
        assert numbers, left
        x, y, survival, information = map(float, numbers.groups())
        assert int(GRID.cells_at([(x, y)])[0]) in cells
        assert survival == pytest.approx(planned.survival, abs=0.006)
        assert information == pytest.approx(planned.information, rel=0.01)
        known.record_path(key, cells)
        known.record_report(*read_report(report))
        lost += not report.survived
        ended = 'came back' if report.survived else 'was lost'
        assert deployments_said(field, '/estimator')[number - 1] == (
            f'{key} {ended}: entropy {known.belief.entropy():.2f} nats after '
            f'{counted(number, "deployment")}, {counted(lost, "robot")} lost'
        )
    assert 0 < lost < 5


# The base stays for one more deadline, in which its loss must be judged and the robot return.
SILENT = {'silent_loss': True, 'step_period': 0.001, 'return_deadline': 8.0}


def test_a_base_stays_for_robots_that_were_given_up(field):
    base = Base(field, robots=1, keep_running=False, **SILENT)
    base.until_sent(1)
    base.until_held(1)
    stays = 'since robots that were given up may return: scout_1 at '
    field.until(lambda: stays in field.said('/planner'), 'that the base stays')
    base.come_back()
    field.until(lambda: len(base.beliefs) > 2, 'belief in the return')
    planner = field.processes.started['/planner']
    field.until(lambda: planner.poll() is not None, 'end', may_end=True)
    assert planner.returncode == 0
    report = base.replayed()
    assert [each.survived for each in report.evidence.outcomes.values()] == [True]


def test_console_and_replay_state_the_end_of_a_mission(field):
    progress = field.listen(Progress, '/progress')
    base = Base(field, robots=2)
    base.until_sent(1)
    key, _ = read_path(BASE_GRID, 'scout_1', base.paths['scout_1'][0])
    stay = Observation([BASE_GRID.base, BASE_GRID.base], True, [-1])
    base.reports['scout_1'].publish(report_message(key, stay, key.stamp + 1))
    base.until_sent(2)
    assert f'{key} returned without moving' in field.said('/planner')

    def is_recorded(loss_cost):
        planner = read_parameters(base.log).get('/planner', {})
        return planner.get('loss_cost') == loss_cost

    field.until(lambda: is_recorded(0.0), 'parameters on record')
    assert field.set_parameter('/planner', 'loss_cost', 0.5).successful
    field.until(lambda: is_recorded(0.5), 'the change on record')
    base.do('end_mission')
    base.come_back()
    # The robot that did not move does not count.
    ended = 'done: 1 of 2 robots deployed, ended by the operator'
    base.until_state(ended)
    said = field.said('/planner')
    assert 'parameter loss_cost is 0.5 now, and was 0.0' in said
    assert f'the mission is over: {ended}' in said
    # The estimator publishes it in `progress`, from the planner's diagnostics.
    field.until(lambda: progress and progress[-1].reason.startswith('done'), 'end in progress')
    report = base.replayed()
    assert f'the log of the mission is {base.log}' in field.said('/recorder')
    told = [*lines(report)]
    assert 'parameter loss_cost of /planner changed from 0.0 to 0.5' in told
    assert f'the mission was ENDED when the log ended: {ended}' in told


def test_states_of_missions_are_those_of_the_message():
    assert all(getattr(Progress, each.name) == each for each in MissionState)
