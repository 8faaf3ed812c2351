# SPDX-License-Identifier: Apache-2.0
"""The demo: a whole mission in four processes, and the files it leaves."""

from contextlib import contextmanager, ExitStack, suppress
from functools import partial
import os
from pathlib import Path
import re
import shlex
import signal
import subprocess
import sys
from threading import Thread, Timer
import time
from types import SimpleNamespace

from demo_mission import demo_mission
from kbnitp_msgs.msg import MissionStatus, Progress
from kbnitp_ros.cli import demo_mission as demo_mission_module
from kbnitp_ros.cli.demo import main, parse
from kbnitp_ros.cli.demo_mission import (
    chosen_parameters,
    NODES,
    observed,
    recorded_parameters,
    watch,
)
from kbnitp_ros.cli.processes import environment, free_domain, given_domain, Processes
from kbnitp_ros.cli.replay import main as replay_command
from kbnitp_ros.configuration.agents import learnt_numbers
from kbnitp_ros.configuration.checks import ignored_note
from kbnitp_ros.configuration.table import FIELD_LEARNT, IN_FIELD
from kbnitp_ros.core import (
    log_loss,
    RobotType,
)
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.read import is_finished, read_log, read_recorded, RecordedMetadata
from kbnitp_ros.log.record import last_belief
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.progress import (
    Helper,
    mission_status_message,
    MissionState,
    Obstacle,
)
from kbnitp_ros.messages.progress import MissionStatus as Status
from kbnitp_ros.messages.topics import PROGRESS
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.report.mission import true_numbers
from launches import nodes_of_demo, reports_in, run_on_terminal
from laws import for_each
import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor

ROOT = Path(__file__).parents[2]
DEMO = [sys.executable, '-m', 'kbnitp_ros', 'demo']
PATIENCE = 180.0


def run_demo(*options):
    return subprocess.run(
        [*DEMO, *map(str, options)], capture_output=True, text=True, timeout=PATIENCE
    )


@pytest.fixture
def running(tmp_path):
    """Return a demo that has deployed some robots and has many left."""
    process = subprocess.Popen(
        [*DEMO, '--robots', '20000', '--size', '4', '--max-steps', '4', '--out', str(tmp_path)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    log = tmp_path / 'mission.mcap'
    deadline = time.monotonic() + PATIENCE
    while not log.exists() or reports_in(log) < 3:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.1)
    yield process, log
    # Its nodes may outlive the demo.
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


WHOLE = [
    '--robots', '6', '--lethality', '0.9', '--size', '6x4', '--max-steps', '6',
    '--planner', 'relaxed', '--seed', '3',
]  # fmt: skip


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Return the folder of a finished mission and the output of its demo."""
    out = tmp_path_factory.mktemp('made') / 'by demo'
    done = run_demo(*WHOLE, '--out', out)
    assert done.returncode == 0, done.stdout + done.stderr
    assert '/belief: 7 of 7 messages reproduced' in done.stdout
    return out, done.stdout


@pytest.mark.processes
def test_demo_leaves_a_mission_that_replays(whole, capsys):
    out, _ = whole
    _, expected, world, _ = demo_mission(*WHOLE)
    history = read_history(out / 'mission.mcap')
    assert [o.path.tolist() for o in history.observations] == [
        d.observation.path.tolist() for d in expected
    ]
    for recorded, deployment in zip(history.beliefs[1:], expected, strict=True):
        assert np.array_equal(recorded.joint, deployment.belief.joint)
    assert np.array_equal(history.world.hazard, world.hazard)
    assert np.array_equal(history.world.target, world.target)
    *_, last = read_log(out / 'mission.mcap', [PROGRESS])
    assert last.message.state == MissionState.DONE

    assert main(['--robots', '1', '--out', str(out)]) == 2
    assert str(out) in capsys.readouterr().err


@pytest.mark.processes
@pytest.mark.full
def test_the_bar_names_what_is_awaited(tmp_path):
    options = ['--robots', '2', '--size', '3', '--max-steps', '4', '--out', str(tmp_path)]
    code, shown = run_on_terminal([*DEMO, *options])
    assert code == 0
    assert re.search('starting: .*waiting for .*planner', shown)
    assert re.search(r'starting: .*waiting for the first belief.*deploying: .* 2/2 ', shown, re.S)
    assert re.search('reading: 100%', shown)


@pytest.mark.processes
@pytest.mark.full
def test_a_dead_demo_is_resumed_to_the_beliefs_of_an_unbroken_one(tmp_path, capsys):
    options = ['--robots', '40', '--size', '4', '--max-steps', '6', '--lethality', '0.3']
    killed = subprocess.Popen(
        [*DEMO, *options, '--seed', '7', '--out', str(tmp_path)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    log = tmp_path / 'mission.mcap'
    deadline = time.monotonic() + PATIENCE
    while reports_in(log) < 8 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    before = reports_in(log)
    assert 8 <= before < 40

    resumed = run_demo('--resume', log)
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    assert '40 deployments' in resumed.stdout
    history = read_history(log)
    _, expected, *_ = demo_mission(*options, '--seed', '7')
    assert [o.path.tolist() for o in history.observations] == [
        d.observation.path.tolist() for d in expected
    ]
    assert np.array_equal(history.beliefs[-1].joint, expected[-1].belief.joint)
    assert history.learnt[-1]['lethality'].mean == expected[-1].parameters['lethality'].mean

    assert main(['--resume', str(log), '--robots', '50']) == 2
    assert capsys.readouterr().err.startswith('demo: --resume takes no other options')
    assert main(['--resume', str(tmp_path / 'none.mcap')]) == 2


@pytest.mark.processes
def test_a_running_mission_is_not_resumed(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap'):
        for log in (tmp_path, tmp_path / 'mission.mcap'):
            done = run_demo('--resume', log)
            assert done.returncode == 2
            assert 'mission.mcap is being written by another recorder' in done.stderr


def test_a_log_that_ends_before_the_first_robot_left_is_not_resumed(tmp_path, capsys):
    LogWriter(tmp_path / 'mission.mcap').close()
    assert main(['--resume', str(tmp_path)]) == 2
    assert 'mission.mcap ends before the first robot left' in capsys.readouterr().err


@pytest.mark.processes
@pytest.mark.full
@for_each('has_left', [False, True])
def test_a_mission_with_a_hidden_truth_is_resumed_and_shows_it(whole, tmp_path, has_left):
    """Also if it died before its first robot left."""

    def hidden():
        for record in read_recorded(whole[0]):
            if not isinstance(record, RecordedMetadata):
                if has_left and '/truth/' not in record.channel.topic:
                    yield record
            elif record.name == 'parameters/agent':
                yield record._replace(values={**record.values, 'publish_truth': 'false'})
            else:
                yield record

    log = tmp_path / 'mission.mcap'
    with LogWriter(log) as writer:
        for record in hidden():
            if isinstance(record, RecordedMetadata):
                writer.add_metadata(record.name, record.values)
            else:
                channel = record.channel
                qos = channel.metadata['offered_qos_profiles']
                writer.add_topic(channel.topic, record.schema.name, qos)
                writer.write(channel.topic, record.data, record.log_time, record.publish_time)
    resumed = run_demo('--resume', log)
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    assert '6 deployments' in resumed.stdout
    assert read_history(log).world is not None


MINE = """
/**:
  ros__parameters:
    grid: {width: 4, height: 3, base: 5, blocked: [0, 7]}
    max_steps: 6
    sensor: {lethality: 0.3, malfunction: 0.02, false_negative: 0.1, true_positive: 0.9}
    seed: 11
    recorded: false
/**/agent:
  ros__parameters:
    sensor: {lethality: 0.8}
    world: {file: WORLD}
/**/planner:
  ros__parameters: {robots: 30, beam_width: 2, max_visits: 1, loss_cost: 0.5}
/**/estimator:
  ros__parameters:
    prior: {hazard: 0.3, target: 0.4, kappa: 0.7}
    method: relaxed_itp
"""

HIDDEN = "hazard: ['.x..', '....', '....']\ntarget: ['.x.x', '....', '..x.']\n"


def test_options_override_the_file_and_the_file_overrides_defaults(tmp_path, capsys):
    world_file = tmp_path / 'hidden.yaml'
    world_file.write_text(HIDDEN)
    mine = tmp_path / 'mine.yaml'
    mine.write_text(MINE.replace('WORLD', str(world_file)))
    options = [
        '--params', str(mine), '--robots', '5', '--set', 'max_visits=2',
        '--set', 'sensor.false_positive=0.1', '--set', 'agent:sensor.lethality=0.7',
        '--method', 'kappa_bnitp', '--out', str(tmp_path / 'out'),
    ]  # fmt: skip
    plain, given = (chosen_parameters(parse(each)) for each in ([], options))
    field = {'grid.width': 4, 'grid.height': 3, 'grid.base': 5, 'grid.blocked': [0, 7]}
    sensor = {'malfunction': 0.02, 'false_negative': 0.1, 'true_positive': 0.9}
    everywhere = {f'sensor.{name}': value for name, value in sensor.items()}
    everywhere |= {**field, 'max_steps': 6, 'sensor.lethality': 0.3, 'sensor.false_positive': 0.1}
    everywhere |= {'seed': 11, 'max_visits': 2, 'robots': 5, 'method': 'kappa_bnitp'}
    for node in NODES:
        own = {
            'agent': {'sensor.lethality': 0.7, 'world.file': str(world_file)},
            'planner': {'beam_width': 2, 'loss_cost': 0.5},
            'estimator': {'prior.hazard': 0.3, 'prior.target': 0.4, 'prior.kappa': 0.7},
        }.get(node, {})
        expected = {name: each for name, each in everywhere.items() if name in plain[node]} | own
        told = {name: given[node][name] for name in expected}
        assert {k: [*v] if isinstance(v, tuple) else v for k, v in told.items()} == expected
        others = plain[node].keys() - expected.keys() - {'learn.numbers', 'recorded', 'file'}
        assert {name: given[node][name] for name in others} == {
            name: plain[node][name] for name in others
        }
        # The demo records even if the file says otherwise.
        assert given[node].get('recorded', True)


@for_each('node', NODES)
def test_the_shipped_configuration_is_that_of_the_demo(node):
    config = ROOT / 'config' / 'mission.yaml'
    plain, given = (chosen_parameters(parse(each)) for each in ([], ['--params', str(config)]))
    assert plain[node].keys() == given[node].keys()
    differing = {name for name, value in plain[node].items() if given[node][name] != value}
    expected = {'planner': {'return_deadline'}}
    assert differing == expected.get(node, set())


@for_each('options, method, learn', [
    ([], 'kappa_bnitp', ('lethality', 'hazard_density')),
    (['--method', 'kappa_bnitp_sampled'], 'kappa_bnitp_sampled', ('lethality', 'hazard_density')),
    (['--method', 'relaxed_itp'], 'relaxed_itp', ('lethality', 'hazard_density')),
    (['--set', 'estimator:method=relaxed_bnitp'], 'relaxed_bnitp', ()),
    (['--set', 'learn.numbers=[]'], 'kappa_bnitp', ()),
    (['--set', 'learn.numbers=[kappa, malfunction]'], 'kappa_bnitp', ('kappa', 'malfunction')),
])  # fmt: skip
def test_lethality_and_hazard_density_are_learnt_by_default(options, method, learn):
    estimator = chosen_parameters(parse(options))['estimator']
    assert (estimator['method'], estimator['learn.numbers']) == (method, learn)


@for_each('options, told', [
    ([], ''),
    (['--set', 'learn.numbers=[]'], ''),
    (['--set', 'estimator:sensor.lethality=0.8'], 'sensor.lethality is 0.8, and not used'),
])  # fmt: skip
def test_the_true_lethality_is_told_only_where_it_is_not_learnt(options, told):
    parameters = chosen_parameters(parse(['--lethality', '0.3', *options]))
    agent, estimator = parameters['agent'], parameters['estimator']
    assert agent['sensor.lethality'] == 0.3
    learnt = learnt_numbers(estimator)
    assert ignored_note(estimator, learnt).startswith(told)
    assert bool(ignored_note(estimator, learnt)) == bool(told)
    assert learnt or estimator['sensor.lethality'] == 0.3


def test_a_mission_on_a_map_has_the_defaults_of_the_field(on_a_map):
    on_a_map += ['--set', 'grid.base=8']
    paper, field, given, without = (
        chosen_parameters(parse(options))
        for options in (
            [],
            on_a_map,
            [*on_a_map, '--set', 'sensor.malfunction=0.02', '--set', 'silent_loss=false'],
            [*on_a_map, '--set', 'defaults=paper'],
        )
    )
    assert {name: field['agent'][name] for name in IN_FIELD if name in field['agent']} == {
        name: value for name, value in IN_FIELD.items() if name in field['agent']
    }
    assert field['estimator']['learn.numbers'] == FIELD_LEARNT
    assert field['estimator']['targets.dynamics'] == 'learn'
    assert field['agent']['targets.dynamics'] == 'static'
    assert {field[node]['defaults'] for node in ('agent', 'estimator', 'planner')} == {'field'}
    assert given['estimator']['sensor.malfunction'] == 0.02
    assert (given['planner']['silent_loss'], given['planner']['step_period']) == (False, 0.2)
    for name in IN_FIELD.keys() & paper['agent'].keys():
        assert without['agent'][name] == paper['agent'][name] != field['agent'][name]


def test_few_cells_within_reach_are_a_question_on_a_terminal(monkeypatch):
    questions = []

    def answered(answer):
        monkeypatch.setattr('builtins.input', lambda asked: questions.append(asked) or answer)
        return chosen_parameters(parse(['--size', '30', '--set', 'minimum_reach=0.5']))

    monkeypatch.setattr('sys.stdin', SimpleNamespace(isatty=lambda: True))
    assert answered('y')['planner']['minimum_reach'] == 0.0
    with pytest.raises(ValueError, match='set max_steps to 58'):
        answered('')
    assert questions[0].endswith('max_steps to 58. Send robots all the same? [y/N] ')


@pytest.mark.processes
def test_a_demo_states_its_reach_and_shows_two_learnt_numbers(whole):
    out, printed = whole
    assert printed.splitlines()[0] == (
        'paths of 6 steps reach 16 of the 24 cells connected to the base (a box of 4x4 of 6x4 '
        'cells): to reach all, set max_steps to 10.'
    )
    # One for each belief, and one for each check.
    assert re.search(r'/model: (\d+) of \1 messages reproduced', printed)
    history = read_history(out)
    assert len(history.learnt) == len(history.beliefs) == 7
    low, _, middle, _, high = history.learnt[-1]['lethality'].quantiles
    told = f'lethality learnt: {middle:.2g}, 90 % interval {low:.2g} to {high:.2g}; true: 0.9'
    assert told in printed.splitlines()
    assert re.search(r'^hazard_density learnt: .* true: 0\.15$', printed, re.M)
    assert (out / 'report/report.html').stat().st_size > 1000
    # Only the robots knew the truth.
    assert history.learnt[0]['lethality'].mean == pytest.approx(0.5, abs=1e-3)


@pytest.mark.slow
@pytest.mark.full
def test_the_demo_learns_the_truth_in_ten_worlds():
    within = {'lethality': 0, 'hazard_density': 0}
    loss = 0.0
    for seed in range(10):
        _, deployments, world, numbers = demo_mission('--seed', str(seed))
        loss += log_loss(deployments[-1].belief.hazard, world.hazard) / 10
        for name, known in deployments[-1].parameters.items():
            within[name] += known.quantile(0.05) <= numbers[name] <= known.quantile(0.95)
    # With the hazard density fixed at 0.5: one world in the interval, 29 nats.
    assert min(within.values()) >= 8, within
    assert loss < 20.0


def test_the_recorded_truth_is_that_of_the_robots():
    options = ['--set', 'agent:sensor.malfunction=0.01', '--set', 'agent:world.kappa=0.7']
    parameters = chosen_parameters(parse(options))
    numbers = true_numbers(parameters['agent'], parameters['estimator'])
    assert numbers == {
        'lethality': 0.5, 'malfunction': 0.01, 'true_positive': 0.95, 'false_positive': 0.05,
        'hazard_density': 0.15, 'kappa': 0.7, 'target_background': 0.1, 'reach': 0.0, 'duds': 0.0,
    }  # fmt: skip
    # A malfunctioning hazard is equivalent to a less lethal one.
    parameters['agent']['sensor.false_negative'] = 0.24
    parameters['agent']['world.file'] = 'hidden.yaml'
    known = true_numbers(parameters['agent'], parameters['estimator'])
    assert known['lethality'] == pytest.approx(0.5 * 0.76 / 0.95)
    assert 'kappa' not in known


def test_the_domain_that_is_named_is_taken(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '79')
    with given_domain() as domain:
        assert domain == 79
    monkeypatch.setenv('ROS_DOMAIN_ID', '300')
    with pytest.raises(OSError, match="ROS_DOMAIN_ID is '300': it must be from 0 to 232"):
        given_domain().__enter__()
    monkeypatch.delenv('ROS_DOMAIN_ID')
    with given_domain() as domain:
        assert 1 <= domain <= 101


def test_a_simulated_clock_is_refused(tmp_path, capsys):
    (tmp_path / 'mine.yaml').write_text('/**: {ros__parameters: {use_sim_time: true}}')
    assert main(['--params', str(tmp_path / 'mine.yaml'), '--out', str(tmp_path / 'out')]) == 2
    assert 'use_sim_time is true' in capsys.readouterr().err


@pytest.mark.processes
@pytest.mark.full
def test_missions_with_two_robot_types_and_two_bases_run_as_documented(tmp_path):
    page = (ROOT / 'docs/maps.md').read_text()
    for option in ('max_steps', 'base'):
        (line,) = re.findall(rf'python3 -m kbnitp_ros demo (.*\.{option}=.*) --out ', page)
        log = tmp_path / option / 'mission.mcap'
        done = run_demo(*shlex.split(line), '--out', log.parent)
        assert done.returncode == 0, done.stdout + done.stderr
        report = replay(log)
        assert report.reproduced
        if option == 'base':
            paths = report.evidence.paths
            bases = {key.agent: int(report.evidence.paths[key][0]) for key in paths}
            assert bases == {'scout_1': 0, 'scout_2': 24}
        else:
            assert recorded_parameters(log)['planner']['team.scout_2.max_steps'] == 6
            belief = last_belief(MissionLog(log))
            assert belief.robot_types == {'scout_2': RobotType(max_steps=6)}
            assert belief.deployments == 6


@pytest.fixture
def on_a_map(tmp_path):
    """Return the options of a small mission on a map, without the base."""
    (tmp_path / 'field.pgm').write_text('P2 4 3 255 254 254 254 254 254 0 0 254 254 254 254 254')
    (tmp_path / 'field.yaml').write_text(
        'image: field.pgm\nresolution: 0.2\norigin: [3.0, -1.0, 0.0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.25\n'
    )
    map_file = ['--set', f'map={tmp_path / "field.yaml"}', '--set', 'grid.resolution=0.2']
    return [*map_file, '--set', 'max_steps=8', '--robots', '3']


def test_a_base_that_a_map_blocks_and_a_map_from_a_topic_are_refused(on_a_map, tmp_path, capsys):
    off = ['--set', 'grid.base_position=[3.3, -0.7]']
    assert main([*on_a_map, *off, '--out', str(tmp_path / 'off')]) == 2
    assert 'the base, cell 5 around (3.3, -0.7), is blocked' in capsys.readouterr().err
    assert main(['--set', 'map_topic=/map', '--out', str(tmp_path / 'heard')]) == 2
    assert 'the demo subscribes to no map' in capsys.readouterr().err


@for_each('options, complaint', [
    (['--robots', '-1'], 'robots.*-1.*from 0'),
    (
        ['--size', '30', '--set', 'minimum_reach=0.5'],
        'paths of 18 steps reach 100 of the 900 .* max_steps to 58, or minimum_r',
    ),
    (['--planner', 'nowhere:plan'], "planner is 'nowhere:plan': .*No module named 'nowhere'; it"),
    (['--size', '9x'], "--size.*'9x'"),
    (['--agents', '0'], 'agents is 0.*at least 1'),
    (['--agents', '17', '--size', '4'], 'agents has 17 names.*16 free cells'),
    (['--size', '600'], 'learning numbers on 360000 cells takes about .* GB.*: take a smaller'),
    (['--size', '600', '--max-steps', '1200'], 'max_steps = 1200.*takes about .* GB.*: lower one'),
    (['--set', 'robots'], '--set robots: it must be NAME=VALUE or NODE:NAME=VALUE'),
    (['--set', '=3'], '--set =3: it must be NAME=VALUE or NODE:NAME=VALUE'),
    (['--lethality', 'nan'], 'parameter sensor.lethality is nan: it must be from 0.0 to 1.0'),
    (['--set', 'sensor.lethality=nan'], 'sensor.lethality is nan: it must be from 0.0 to 1.0'),
    (['--set', 'sensor.lethality=x'], "is 'x': it must be a number, from 0.0 to 1.0"),
    (['--set', 'robbots=3'], 'robbots=3: parameter robbots is unknown to every.*mean robots?'),
    (['--set', 'agent:robots=3'], 'robots is unknown to the agent: it is a parameter'),
    (['--set', 'agnt:seed=3'], "'agnt' is no node of the demo: did you mean agent?"),
    (['--set', 'team.scout_2.max_steps=3'], 'of agent scout_2, .* did you mean scout_1'),
    (['--set', 'agent:team.scout_1.max_steps=3'], 'max_steps is 18 in .* and 3 in agent'),
    (['--set', 'publish_truth=false'], 'the demo sets publish_truth itself'),
    (['--set', 'hazards.dynamics=learn'], "hazards.dynamics is 'learn', but a world is of"),
    (['--set', 'planner:grid.width=5'], 'grid.width is 9 in .* and 5 in planner: .* must agree'),
    (['--set', 'grid.blocked=[1, 9, 10]'], 'scout_1 cannot leave .*cell 0: no other cell can be'),
    (['--max-steps', '1'], 'scout_1 cannot leave their base, cell 0: max_steps is 1: a way'),
    (['--method', 'relaxed_itp', '--set', 'learn.numbers=[kappa]'], 'kappa cannot be learnt'),
    (['--silent-loss', '--set', 'contact_probability=0.3'], 'contact_probability is 0.3, and sil'),
])  # fmt: skip
def test_bad_options_are_refused_before_anything_starts(tmp_path, capsys, options, complaint):
    assert main(['--out', str(tmp_path / 'out'), *options]) == 2
    told = capsys.readouterr().err
    assert re.fullmatch(f'demo: .*{complaint}.*\n', told), told
    assert not (tmp_path / 'out').exists()


# A busy machine tells later: the wait is several periods.
PERIOD, WAIT = 0.3, 1.5
status = partial(Status, author='/planner')
DONE = status(state=MissionState.DONE, obstacle=Obstacle.ALL_DEPLOYED)


def waits_for(obstacle, ends_by=Helper.OPERATOR, state=MissionState.RUNNING, **said):
    return status(state=state, obstacle=obstacle, ends_by=ends_by, **said)


@contextmanager
def shown(monkeypatch):
    """Yield a domain, its observer, a node in place of the planner, and its publisher."""
    monkeypatch.setattr(demo_mission_module, 'OPERATOR_WAIT', WAIT)
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        # The demo sets these for its process.
        for name, value in environment(domain).items():
            monkeypatch.setenv(name, value)
        observer = stack.enter_context(observed(domain))
        node = rclpy.create_node('planner')
        mission = node.create_publisher(MissionStatus, 'mission', qos.LATCHED)
        node.create_publisher(Progress, 'progress', qos.LATCHED).publish(Progress(deployments=1))
        yield domain, observer, node, mission
        node.destroy_node()


@pytest.mark.slow
@for_each('sent, until', [
    ([waits_for(Obstacle.SEARCHING, Helper.NOBODY), DONE], PERIOD),
    ([waits_for(Obstacle.SEARCHING, Helper.NOBODY),
      status(state=MissionState.DONE, out=1), DONE], 2 * PERIOD),
    ([waits_for(Obstacle.SEARCHING, Helper.NOBODY),
      status(state=MissionState.ENDED, obstacle=Obstacle.OVER)], PERIOD),
    ([waits_for(Obstacle.UNREPORTED, out=1)] * 4 + [DONE], 4 * PERIOD),
    ([waits_for(Obstacle.PAUSED, state=MissionState.PAUSED)], WAIT),
    ([waits_for(Obstacle.UNAPPROVED)], WAIT),
    ([waits_for(Obstacle.UNJUDGED, held=1)], WAIT),
    # The planner searches again, and does find a path later.
    ([waits_for(Obstacle.WORTHLESS), waits_for(Obstacle.SEARCHING, Helper.NOBODY)] * 3
     + [DONE], 6 * PERIOD),
], every=2)  # fmt: skip
def test_a_demo_runs_until_the_mission_is_over_or_waits_for_an_operator(monkeypatch, sent, until):
    with shown(monkeypatch) as (domain, observer, node, mission):
        left = iter(sent)

        def tell():
            if said := next(left, None):
                mission.publish(mission_status_message(said))

        begun = time.monotonic()
        tell()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        node.create_timer(PERIOD, tell)
        spinning = Thread(target=executor.spin)
        spinning.start()
        watch(*observer, 1, Processes(domain))
        assert until - 0.25 < time.monotonic() - begun < until + 5.0
        executor.shutdown()
        spinning.join()


@pytest.mark.slow
def test_a_demo_waits_for_an_operator_who_has_a_board(monkeypatch):
    with shown(monkeypatch) as (domain, observer, _, mission):
        board = rclpy.create_node('operator')
        mission.publish(mission_status_message(waits_for(Obstacle.UNAPPROVED)))
        deadline = time.monotonic() + 60.0
        while 'operator' not in observer[0].get_node_names():
            assert time.monotonic() < deadline, 'no board'
            time.sleep(0.05)
        begun = time.monotonic()
        resumed = Timer(3 * WAIT, lambda: mission.publish(mission_status_message(DONE)))
        resumed.start()
        watch(*observer, 1, Processes(domain))
        assert time.monotonic() - begun >= 3 * WAIT
        resumed.join()
        board.destroy_node()


@for_each('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_becomes_another_error_is_still_one(monkeypatch, capsys, tmp_path, number):
    """As where it arrives in a callback of rclpy."""
    handlers = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}

    def swallow(*_):
        try:
            signal.raise_signal(number)
        except (KeyboardInterrupt, SystemExit):
            raise RuntimeError('Unable to convert call argument') from None

    monkeypatch.setattr(demo_mission_module, 'deploy', swallow)
    try:
        parameters = chosen_parameters(parse([]))
        code = demo_mission_module.run(tmp_path / 'mission.mcap', parameters, has_page=False)
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
    assert code == 128 + number
    assert 'demo: interrupted; no robot had left' in capsys.readouterr().err


@pytest.mark.processes
@pytest.mark.full
def test_an_unattended_demo_ends_with_a_line_and_a_report(tmp_path):
    out = tmp_path / 'out'
    done = run_demo('--size', 4, '--set', 'loss_cost=1000', '--out', out)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'waiting for the operator, since nothing is worth a robot: the best' in done.stdout
    assert '0 robots of 0 agents went' in (out / 'report' / 'report.html').read_text()


@pytest.mark.processes
def test_an_interrupted_demo_ends_its_nodes_and_leaves_a_finished_log(running, capsys):
    process, log = running
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, stderr
    assert 'Traceback' not in stderr
    assert f'interrupted; resume it with: python3 -m kbnitp_ros demo --resume {log}' in stderr
    assert replay_command([str(log)]) == 0
    assert 'unfinished' not in capsys.readouterr().out


@pytest.mark.processes
@pytest.mark.full
@pytest.mark.parametrize('node', NODES)
def test_demo_fails_when_a_node_dies(running, node):
    process, _ = running
    nodes = nodes_of_demo(process)
    os.kill(nodes[node], signal.SIGKILL)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert re.search(
        f'nodes ended during the mission.*{node}.*-9.*; resume it with: .* demo --resume ', stderr
    )
    assert not any(Path(f'/proc/{pid}').exists() for pid in nodes.values())


def is_running(pid):
    """Return whether a process runs; a zombie has an empty command line."""
    try:
        return Path(f'/proc/{pid}/cmdline').read_text() != ''
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.processes
def test_nodes_end_well_when_the_demo_is_killed(running):
    process, log = running
    nodes = nodes_of_demo(process)
    assert len(nodes) == 4
    process.kill()
    deadline = time.monotonic() + PATIENCE
    while any(map(is_running, nodes.values())) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, nodes.values()))
    assert is_finished(log)
