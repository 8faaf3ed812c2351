# SPDX-License-Identifier: Apache-2.0
"""A topic is of a mission by its full name and its type; nothing else on record means anything."""

from array import array
from dataclasses import replace

from kbnitp_msgs.msg import (
    AgentStatus,
    Decision,
    DeploymentReport,
    ModelBelief,
    OperatorAction,
    Progress,
)
from kbnitp_ros.cli.replay import main as replay_main
from kbnitp_ros.core import DeploymentKey, Grid, Observation
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.history import read_history
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
from kbnitp_ros.report.mission import read_mission
from laws import for_each
from mission_log import GRID, MAX_STEPS, Mission, mission, QOS, record_to
import numpy as np
import pytest
from std_msgs.msg import String

NEAR = [2, 7, 2]
ROLES = Roles.of('/m', ['scout_1'])


def write(path, sent, roles=ROLES):
    """Write messages to a log, with the roles of its mission if it states them."""
    with LogWriter(path) as log:
        if roles is not None:
            log.add_metadata(RECORD, roles.record)
        record_to(log, sent, QOS)
    return path


def shown(value):
    """Return all that an object holds, in words."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {str(key): shown(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [shown(each) for each in value]
    return shown(vars(value)) if hasattr(value, '__dict__') else repr(value)


def read(path):
    """Return what each reader of a log takes from it, and what they leave out."""
    log = MissionLog(path)
    record = read_resumed(log, GRID, MAX_STEPS)
    report, history, page = replay(log), read_history(log), read_mission(path)
    taken = {
        'replay': [
            report.grade, report.compared, report.standing, report.not_yet_held,
            report.evidence.reports, report.evidence.operator, report.evidence.departures,
        ],
        'history': [history.observations, history.beliefs, history.models, history.decision,
                    history.world, history.bounds],
        'resumed': [record.paths, record.outcomes, record.departures, record.operator,
                    record.mission],
        'ledger': read_ledger(log).belief.joint,
        'page': [[each.held for each in page.moments], page.deployments, page.world],
    }  # fmt: skip
    # When something was read is not what was read.
    refused = report.evidence.refused + history.evidence.refused
    return {name: shown(each) for name, each in taken.items()}, refused


@pytest.fixture(scope='module')
def whole():
    """Return a mission in a namespace, with a robot that is out at its end."""
    whole = mission(5, namespace='/m')
    key = whole.send_out(NEAR)
    whole.publish('scout_1/status', status_message(key, OrderState.DEPARTED, whole.now))
    return whole


def of_all(whole):
    """Return messages that would change a mission if their topics were its own."""
    out = DeploymentKey('scout_1', whole.now - 1000)
    end = Decided(whole.now, Action.END, 6, {}, 0)
    give_up = Decided(whole.now, Action.GIVE_UP, 6, {out: np.array(NEAR)}, 0)
    other = Mission(namespace='/m/evil', grid=Grid(3, 3))
    first = min(each.message.header.stamp.sec for each in whole.sent)
    back = report_message(out, Observation(NEAR, True, [True, True]), whole.now)
    return {
        'operator': operator_action_message(GRID, end),
        'm/operator': operator_action_message(GRID, give_up),
        'evil/operator': operator_action_message(GRID, give_up),
        'x/scout_1/report': back,
        'scout_1/scout_1/report': back,
        'evil/path': path_message(GRID, NEAR, whole.now + 5),
        'evil/scout_1/path': path_message(GRID, [2, 7, 12, 7, 2], out.stamp),
        'evil/belief': other.sent[0].message,
        'belief/belief': other.sent[0].message,
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


def test_what_has_no_role_changes_nothing_wherever_it_stands(whole, tmp_path):
    expected, _ = read(write(tmp_path / 'clean.mcap', whole.sent))
    sent = [
        replace(whole.sent[0], topic=f'/m/{name}' if name != 'operator' else '/operator',
                message=message, time=whole.sent[0].time)
        for name, message in of_all(whole).items()
    ]  # fmt: skip
    for number, place in enumerate((0, len(whole.sent) // 2, len(whole.sent))):
        mixed = [*whole.sent[:place], *sent, *whole.sent[place:]]
        # What is another type on a topic of the mission no recorder of ours takes.
        log = tmp_path / f'{number}.mcap'
        with LogWriter(log) as writer:
            writer.add_metadata(RECORD, ROLES.record)
            for each in mixed:
                try:
                    record_to(writer, [each])
                except ValueError:
                    assert type(each.message) is String
        found, refused = read(log)
        assert found == expected
        assert refused == []


NAN = float('nan')


@for_each('topic, message, told', [
    ('decision', Decision(header=header(9), probability=NAN), 'probability is nan'),
    ('model', ModelBelief(header=header(9), name=['lethality'], mean=[]), 'mean has 0 values'),
    ('truth/hazard', occupancy_grid(GRID, np.ones(GRID.cells), 9), "frame_id is ''"),
    ('scout_1/truth/target', occupancy_grid(Grid(2, 2), np.ones(4), 9), 'it has 4 cells'),
    ('progress', Progress(header=header(9), state=99), '99 is not a valid MissionState'),
    ('operator', OperatorAction(header=header(9), action=99), 'action is 99'),
    ('operator', OperatorAction(action=4), 'header.frame_id'),
    ('scout_1/report', DeploymentReport(header=header(9), agent='scout_2'), "agent is 'scout_2'"),
    ('scout_1/status', AgentStatus(header=header(9), agent='scout_1', state=9), 'state is 9'),
    ('scout_1/path', path_message(GRID, [], 9), 'poses is empty'),
    ('belief', Mission(grid=Grid(2, 2)).sent[0].message, 'joint has'),
])  # fmt: skip
def test_what_is_wrong_in_a_role_is_left_out_by_all_and_named(
    whole, tmp_path, topic, message, told
):
    if topic == 'truth/hazard':
        message.header.frame_id = ''
    if topic == 'belief':
        message.joint = array('d', [0.25])
    expected, _ = read(write(tmp_path / 'clean.mcap', whole.sent))
    place = len(whole.sent) // 2
    wrong = replace(whole.sent[0], topic=f'/m/{topic}', message=message)
    log = write(tmp_path / 'mission.mcap', [*whole.sent[:place], wrong, *whole.sent[place:]])
    found, refused = read(log)
    if topic in ('decision', 'model', 'belief'):
        # It was to be computed again.
        assert told in str(replay(log).mismatches)
        found['replay'] = expected['replay']
    else:
        assert any(each.startswith(f'/m/{topic}: ') and told in each for each in refused)
    assert found == expected


def test_a_log_of_several_missions_is_read_by_the_namespace_that_is_named(tmp_path, capsys):
    missions = {name: mission(3, seed, namespace=name) for seed, name in enumerate(('/m', '/m/n'))}
    sent = [each for whole in missions.values() for each in whole.sent]
    log = write(tmp_path / 'mission.mcap', sent, None)
    with pytest.raises(LogError, match='has missions in the namespaces /m, /m/n: name one'):
        MissionLog(log)
    assert replay_main([str(log)]) == 2
    for name, whole in missions.items():
        assert replay_main([str(log), '--namespace', name]) == 0
        assert f'{name}/belief: 4 of 4 messages reproduced' in capsys.readouterr().out
        own = MissionLog(log, name)
        assert read_ledger(own).belief.joint.tobytes() == whole.ledger.belief.joint.tobytes()
    # What it says itself needs no name.
    stated = write(tmp_path / 'stated.mcap', sent, Roles.of('/m/n', ['scout_1']))
    assert replay(stated).compared.keys() >= {'/m/n/belief'}


@for_each('namespace, agents, remapped, told', [
    ('/m', ['scout_1'], {}, ''),
    ('/', ['scout_1'], {}, 'belief is /belief, and not /m/belief'),
    ('/m', ['scout_2'], {}, 'agent scout_2 is none of agents, which names scout_1'),
    ('/m', ['scout_1'], {'belief': '/shared/belief'}, 'belief is /shared/belief, and not /m/b'),
])  # fmt: skip
def test_only_the_mission_of_a_log_is_gone_on_with(
    whole, tmp_path, namespace, agents, remapped, told
):
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
