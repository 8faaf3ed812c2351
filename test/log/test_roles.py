# SPDX-License-Identifier: Apache-2.0
"""Topics and parameters of a log that belong to the mission."""

from array import array
from dataclasses import replace
from datetime import datetime, timezone
import math
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_msgs.msg import (
    AgentStatus,
    Decision,
    DeploymentReport,
    MissionStatus,
    ModelBelief,
    OperatorAction,
    Progress,
)
from kbnitp_ros.cli.replay import main as replay_main
from kbnitp_ros.core import DeploymentKey, Grid, Observation
from kbnitp_ros.log.configuration import numerical_environment, parameters_record, run_record
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.read import PARAMETERS, read_metadata, read_parameters, RUN
from kbnitp_ros.log.record import read_ledger, read_resumed
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog, RECORD, resumed_log, Roles
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.deployments import (
    OrderState,
    path_message,
    report_message,
    status_message,
)
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import header
from kbnitp_ros.messages.operator_actions import Action, operator_action_message
from kbnitp_ros.messages.operator_actions import OperatorAction as Decided
from kbnitp_ros.report.mission import read_summary
from laws import for_each
from mcap.reader import make_reader
from mission_log import GRID, MAX_STEPS, Mission, mission, QOS, record_to
import numpy as np
import pytest
from std_msgs.msg import String

NEAR = [2, 7, 2]
ROLES = Roles.of('/m', ['scout_1'])


def write(path, sent, roles=ROLES):
    with LogWriter(path) as log:
        if roles is not None:
            log.add_metadata(RECORD, roles.record)
        record_to(log, sent, QOS)
    return path


def shown(value):
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {str(key): shown(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [shown(each) for each in value]
    return shown(vars(value)) if hasattr(value, '__dict__') else repr(value)


def read(path):
    """Return the values that each reader takes from a log, and the refused ones."""
    log = MissionLog(path)
    record = read_resumed(log, GRID, MAX_STEPS)
    report, history, page = replay(log), read_history(log), read_summary(path)
    taken = {
        'replay': [
            report.grade, report.compared, report.standing, report.not_yet_held,
            report.evidence.standings, report.evidence.operator, report.evidence.statuses,
        ],
        'history': [history.observations, history.beliefs, history.models, history.decision,
                    history.world],
        'resumed': [record.paths, record.outcomes, record.statuses, record.operator,
                    record.mission],
        'ledger': read_ledger(log).belief.joint,
        'page': [[moment.held for moment in page.moments], page.deployments, page.world],
    }  # fmt: skip
    # Times of reading differ.
    refused = report.evidence.refused + history.evidence.refused
    return {name: shown(each) for name, each in taken.items()}, refused


@pytest.fixture(scope='module')
def whole():
    """Return a mission in a namespace that ends with a robot in flight."""
    whole = mission(5, namespace='/m')
    key = whole.send_out(NEAR)
    whole.publish('scout_1/status', status_message(key, OrderState.DEPARTED, whole.now))
    return whole


@pytest.fixture(scope='module')
def expected(whole, tmp_path_factory):
    """Return the values that each reader takes from the whole mission."""
    return read(write(tmp_path_factory.mktemp('clean') / 'clean.mcap', whole.sent))[0]


def of_all(whole):
    """Return messages that would change a mission if their topics were its own."""
    out = DeploymentKey('scout_1', whole.now - 1000)
    end = Decided(whole.now, Action.END, 6, {}, 0)
    give_up = Decided(whole.now, Action.GIVE_UP, 6, {out: np.array(NEAR)}, 0)
    other = Mission(namespace='/m/evil', grid=Grid(3, 3))
    first = min(entry.message.header.stamp.sec for entry in whole.sent)
    back = report_message(out, Observation(NEAR, True, [True, True]), whole.now)
    return {
        'operator': operator_action_message(GRID, end),
        'm/operator': operator_action_message(GRID, give_up),
        'evil/operator': operator_action_message(GRID, give_up),
        'x/scout_1/report': back,
        'scout_1/scout_1/report': back,
        'evil/path': path_message(GRID, NEAR, whole.now + 5),
        'evil/scout_1/path': path_message(GRID, [2, 7, 12, 7, 2], out.stamp),
        'evil/belief': other.sent[1].message,
        'belief/belief': other.sent[1].message,
        'evil/decision': Decision(header=header(first), goal='cell 4', reached=True),
        'evil/truth/hazard': occupancy_grid(GRID, np.ones(GRID.cells), whole.now),
        'evil/truth/target': occupancy_grid(GRID, np.ones(GRID.cells), whole.now),
        'evil/progress': Progress(header=header(whole.now), state=3, reason='over'),
        'evil/scout_1/status': status_message(out, OrderState.REFUSED, whole.now, 'tired'),
        'battery/status': String(data='full'),
        'sensor/report': String(data='wet'),
        'nav/path': path_message(GRID, NEAR, whole.now + 6),
        'stranger/report': report_message(
            DeploymentKey('stranger', whole.now), Observation(NEAR, False), whole.now
        ),
        # Of another type on a topic of the mission.
        'belief': String(data='none'),
        'scout_1/report': String(data='lost'),
        'decision': String(data='safe'),
    }


@pytest.mark.slow
def test_messages_without_a_role_change_nothing(whole, expected, tmp_path):
    sent = [
        replace(whole.sent[0], topic=f'/m/{name}' if name != 'operator' else '/operator',
                message=message, time=whole.sent[0].time)
        for name, message in of_all(whole).items()
    ]  # fmt: skip
    for number, place in enumerate((0, len(whole.sent) // 2, len(whole.sent))):
        mixed = [*whole.sent[:place], *sent, *whole.sent[place:]]
        # Our recorder never records another type on a topic of the mission.
        log = tmp_path / f'{number}.mcap'
        with LogWriter(log) as writer:
            # A record of another program, and a role of a later version.
            writer.add_metadata(RECORD, {'admin': 'root'})
            writer.add_metadata(RECORD, {**ROLES.record, 'weather': '/m/battery/status'})
            for entry in mixed:
                try:
                    record_to(writer, [entry])
                except ValueError:
                    assert type(entry.message) is String
        found, refused = read(log)
        assert found == expected
        assert refused == []


NAN = float('nan')


@pytest.mark.slow
@for_each('topic, message, told', [
    ('decision', Decision(header=header(9), probability=NAN), 'probability is nan'),
    ('model', ModelBelief(header=header(9), name=['lethality'], mean=[]), 'mean has 0 values'),
    ('truth/hazard', occupancy_grid(GRID, np.ones(GRID.cells), 9), "frame_id is ''"),
    ('scout_1/truth/target', occupancy_grid(Grid(2, 2), np.ones(4), 9), 'it has 4 cells'),
    ('mission', MissionStatus(header=header(9), author='/p', state=99), 'state is 99: it must'),
    ('operator', OperatorAction(header=header(9), action=99), 'action is 99'),
    ('operator', OperatorAction(action=4), 'header.frame_id'),
    ('scout_1/report', DeploymentReport(header=header(9), agent='scout_2'), "agent is 'scout_2'"),
    ('scout_1/status', AgentStatus(header=header(9), agent='scout_1', state=9), 'state is 9'),
    ('scout_1/path', path_message(GRID, [], 9), 'poses is empty'),
    ('belief', Mission(grid=Grid(2, 2)).sent[1].message, 'joint has'),
])  # fmt: skip
def test_bad_messages_in_a_role_are_refused_by_all_readers(
    whole, expected, tmp_path, topic, message, told
):
    if topic == 'truth/hazard':
        message.header.frame_id = ''
    if topic == 'belief':
        message.joint = array('d', [0.25])
    place = len(whole.sent) // 2
    wrong = replace(whole.sent[0], topic=f'/m/{topic}', message=message)
    log = write(tmp_path / 'mission.mcap', [*whole.sent[:place], wrong, *whole.sent[place:]])
    found, refused = read(log)
    if topic in ('decision', 'model', 'belief'):
        # It should have been recomputed.
        assert told in str(replay(log).mismatches)
        del found['replay']
    else:
        assert any(refusal.startswith(f'/m/{topic}: ') and told in refusal for refusal in refused)
    assert found == {name: expected[name] for name in found}


def test_a_log_of_several_missions_is_read_by_the_namespace_that_is_named(tmp_path, capsys):
    missions = {name: mission(3, seed, namespace=name) for seed, name in enumerate(('/m', '/m/n'))}
    sent = [message for whole in missions.values() for message in whole.sent]
    log = write(tmp_path / 'mission.mcap', sent, None)
    with pytest.raises(LogError, match='has missions in the namespaces /m, /m/n: choose one'):
        MissionLog(log)
    assert replay_main([str(log)]) == 2
    for name, whole in missions.items():
        assert replay_main([str(log), '--namespace', name]) == 0
        assert f'{name}/belief: 4 of 4 messages reproduced' in capsys.readouterr().out
        own = MissionLog(log, name)
        assert read_ledger(own).belief.joint.tobytes() == whole.ledger.belief.joint.tobytes()
    # A log that states its roles needs no name.
    stated = write(tmp_path / 'stated.mcap', sent, Roles.of('/m/n', ['scout_1']))
    assert replay(stated).compared.keys() >= {'/m/n/belief'}


@for_each('namespace, agents, remapped, told', [
    ('/m', ['scout_1'], {}, ''),
    ('/', ['scout_1'], {}, 'standings is /standings, and not /m/standings'),
    ('/m', ['scout_2'], {}, 'agent scout_2 is not in the parameter agents, which names scout_1'),
    ('/m', ['scout_1'], {'belief': '/shared/belief'}, 'belief is /shared/belief, and not /m/b'),
])  # fmt: skip
def test_only_the_mission_of_a_log_is_resumed(whole, tmp_path, namespace, agents, remapped, told):
    def resolve(role):
        return remapped.get(role, f'{namespace.rstrip("/")}/{role}')

    own = Roles.of(namespace, agents, resolve, 'planner')
    for number, roles in enumerate((ROLES, None)):
        log = write(tmp_path / f'{number}.mcap', whole.sent, roles)
        if not told or (roles is None and 'scout_2' in told):
            resumed_log(str(log), own)
        else:
            with pytest.raises(ValueError, match='is of another mission: ') as error:
                resumed_log(str(log), own)
            assert told in str(error.value)


ROOT = Path(__file__).parents[2]


@pytest.mark.processes
def test_the_run_names_its_versions():
    record = run_record('rmw_fastrtps_cpp')
    assert record['python'] == '.'.join(map(str, sys.version_info[:3]))
    assert record['numpy'] == np.__version__
    assert set(numerical_environment()) < record.keys()
    assert record['rmw_implementation'] == 'rmw_fastrtps_cpp'
    for package in ('kbnitp_ros', 'kbnitp_msgs', 'rclpy', 'rmw_fastrtps_cpp'):
        assert re.fullmatch(r'\d+\.\d+\.\d+', record[package]), package
    since = datetime.now(timezone.utc) - datetime.fromisoformat(record['time'])
    assert 0 <= since.total_seconds() < 60


@pytest.mark.processes
def test_a_missing_package_has_no_version():
    assert run_record('rmw_of_nobody')['rmw_of_nobody'] == 'unknown'


@pytest.mark.processes
@pytest.mark.skipif(not ROOT.joinpath('.git').exists(), reason='the source is no checkout')
def test_the_run_names_the_revision_of_a_checkout():
    command = ['git', 'rev-parse', 'HEAD']
    head = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    revision = run_record('rmw_fastrtps_cpp')['git_revision']
    assert revision.removesuffix('-dirty') == head.stdout.strip()


def test_parameters_come_back_as_they_were(tmp_path):
    path = tmp_path / 'mission.mcap'
    planner = {
        'flag': True,
        'count': 3,
        'rate': 3.0,
        'tiny': 5e-324,
        'far': math.inf,
        'text': 'two\nlines, ünïcode and "quotes"',
        'empty': [],
        'cells': [1, 2],
        'origin': [0.1, -2.0],
        'names': ['a', 'b'],
        'unset': None,
    }
    with LogWriter(path) as log:
        log.add_metadata(RUN, {'python': '3.11.7'})
        log.add_metadata(f'{PARAMETERS}/m/planner', parameters_record({'flag': False}))
        log.add_metadata(f'{PARAMETERS}/m/planner', parameters_record(planner))
        log.add_metadata(f'{PARAMETERS}/m/agent', parameters_record({'bytes': [b'\1', b'\2']}))
    parameters = read_parameters(path)
    assert parameters == {'/m/planner': planner, '/m/agent': {'bytes': [1, 2]}}
    assert all(type(parameters['/m/planner'][name]) is type(planner[name]) for name in planner)


def test_a_record_that_is_changed_repeats_nothing(tmp_path):
    """Some tools warn about a name that is in two records."""
    name = f'{PARAMETERS}/planner'
    with LogWriter(tmp_path / 'mission.mcap') as log:
        for values in ({'seed': 1, 'robots': 5}, {'seed': 1}, {'robots': 5, 'rolling': True}):
            log.add_metadata(name, parameters_record(values))
        log.add_metadata(name, parameters_record({'robots': 8}))
    with log.path.open('rb') as file:
        records = [
            each.metadata for each in make_reader(file).iter_metadata() if each.name == name
        ]
    assert records == [{'robots': '5', 'seed': '1'}, {'rolling': 'true'}, {'robots': '8'}]
    assert read_parameters(log.path) == {'/planner': {'seed': 1, 'robots': 8, 'rolling': True}}


def test_parameters_are_read_from_an_unfinished_log(tmp_path):
    log = LogWriter(tmp_path / 'mission.mcap')
    log.add_metadata(f'{PARAMETERS}/agent', parameters_record({'seed': 1}))
    log.sync()
    assert read_parameters(log.path) == {'/agent': {'seed': 1}}
    assert RUN not in read_metadata(log.path)


def test_a_corrupt_record_is_reported(tmp_path):
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        log.add_metadata(f'{PARAMETERS}/agent', {'seed': 'one'})
    with pytest.raises(LogError, match="record 'parameters/agent' is corrupt"):
        read_parameters(path)
