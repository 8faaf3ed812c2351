# SPDX-License-Identifier: Apache-2.0
"""A mission whose nodes have all died resumes with all deployments of its log."""

from extent import FULL, LONG
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Standings
from kbnitp_ros.configuration.table import MAX_ROBOTS
from kbnitp_ros.core import Belief, Estimator, Ledger, SensorModel
from kbnitp_ros.log.record import fold_evidence
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import pytest
from rclpy.serialization import serialize_message
from samples import belief, changed, FIELD, GRID, HOME, key, lost, path, returned, standings

NODES = ('estimator', 'agent', 'planner')


def ledger():
    prior = Belief.prior(GRID, 0.5, 0.45, 0.8)
    return Ledger(GRID, FIELD['max_steps'], Estimator(prior, SensorModel(0.5)))


def write(log, messages, *, resume=False):
    """Write a log with a prior and these messages of the agent, or append the messages."""
    topics = {
        Standings: '/m/standings',
        BeliefMaps: '/m/belief',
        Path: '/m/scout_1/path',
        DeploymentReport: '/m/scout_1/report',
    }
    prior = [] if resume else [standings(ledger()), belief(ledger())]
    with LogWriter(log, resume=resume) as writer:
        for kind, topic in topics.items():
            package = kind.__module__.split('.')[0]
            writer.add_topic(topic, f'{package}/msg/{kind.__name__}', '[]')
        for time, message in enumerate([*prior, *messages]):
            writer.write(topics[type(message)], serialize_message(message), time, time)


def start(field, name, log, robots, *, resumed=True):
    awaited = {'estimator': ['planner'], 'agent': ['planner', 'estimator'], 'recorder': []}
    field.start(
        name,
        {
            **FIELD,
            'robots': robots,
            'recorded': True,
            'await_nodes': awaited.get(name, ['agent', 'estimator']),
            'resume': str(log) if resumed else '',
        },
        '/m',
    )


def until_done(field, robots):
    done = f'done: {robots} of {robots} robots deployed'
    field.until(lambda: field.state('/m/planner') == done, done, patience=300)


def reported(log):
    return {from_stamp(each.message.deployment) for _, each in MissionLog(log).read('report')}


def folded(log):
    register = ledger()
    fold_evidence(register, MissionLog(log).read('path', 'report', 'status'), None)
    return register.belief.joint.tobytes()


def test_a_refused_report_takes_no_deployment_away(field):
    log = field.folder / 'mission.mcap'
    refused = [
        changed(lost(1), survived=True),
        returned(2, [0, 6, 0]),
        changed(lost(3), readings=returned(3).readings),
        changed(lost(4), steps_survived=4),
    ]
    # A loss would not count beside a refused return.
    reports = [returned(1), returned(2), lost(3), returned(4)]
    write(log, [*(path(number) for number in (1, 2, 3, 4)), *refused, *reports])
    beliefs = field.listen(BeliefMaps, '/m/belief')
    for name in ('recorder', *NODES):
        start(field, name, log, 4)
    until_done(field, 4)
    field.until(lambda: beliefs and beliefs[-1].deployments == 4, 'belief in all')
    expected = ledger()
    for number, report in enumerate(reports, 1):
        expected.record_path(key(number), HOME)
        expected.record_report(*read_report(report))
    assert read_belief_maps(beliefs[-1]).belief.joint.tobytes() == (
        expected.belief.joint.tobytes()
    )


def test_reports_during_the_start_of_an_estimator_are_assimilated(field):
    log = field.folder / 'mission.mcap'
    write(log, [path(1), lost(1)])
    given = {**FIELD, 'recorded': True, 'await_nodes': ['test'], 'resume': str(log)}
    field.start('estimator', given, '/m')
    field.until(lambda: 'waiting for test' in field.state('/m/estimator'), 'wait')
    # The robot returns, and its node dies.
    write(log, [returned(1)], resume=True)
    beliefs = field.listen(BeliefMaps, '/m/belief')
    field.until(lambda: beliefs and beliefs[-1].deployments == 1, 'belief')
    assert read_belief_maps(beliefs[-1]).belief.joint.tobytes() == folded(log)


@pytest.mark.parametrize('before, depth', [
    (12, 8),
    pytest.param(qos.DEPTH + 60, qos.DEPTH, marks=LONG),
    pytest.param(MAX_ROBOTS - 10, qos.DEPTH, marks=LONG),
])  # fmt: skip
def test_deployments_survive_every_restart(field, before, depth):
    """Publishers keep the newest `depth`; the log has all."""
    if depth < qos.DEPTH:
        field.keep_fewer(depth)
    log = field.folder / 'mission.mcap'
    messages = []
    for number in range(1, before + 1):
        report = returned(number) if number % 3 else lost(number)
        messages += [path(number), report]
    write(log, messages)
    beliefs = field.listen(BeliefMaps, '/m/belief')
    robots = before + 3
    for name in ('recorder', *NODES):
        start(field, name, log, robots)
    until_done(field, robots)
    field.until(lambda: beliefs and beliefs[-1].deployments == robots, 'belief in all')
    last = read_belief_maps(beliefs[-1]).belief.joint.tobytes()
    # The belief may include the last reports before they are recorded.
    field.until(lambda: len(reported(log)) == robots, 'all reports on record')
    assert last == folded(log)
    for name in ('recorder', *NODES):
        field.kill(f'/m/{name}')
        beliefs.clear()
        start(field, name, log, robots)
        if name == 'estimator':
            field.until(
                lambda: beliefs and beliefs[-1].deployments == robots, 'belief in all', 300
            )
            if before > 10_000:
                assert f'reading {log}: ' in field.said('/m/estimator')
            assert read_belief_maps(beliefs[-1]).belief.joint.tobytes() == last
        field.until(lambda name=name: field.state(f'/m/{name}'), f'word of {name}', 300)
    until_done(field, robots)
    assert replay(log).reproduced
    field.kill('/m/estimator')
    start(field, 'estimator', log, robots, resumed=False)
    remedy = 'start it with the parameter resume set to the log'
    if FULL:
        # DDS takes the killed one for alive for 20 s.
        field.until(lambda: remedy in field.state('/m/planner'), 'word of what is lost')
    field.kill('/m/planner')
    start(field, 'planner', log, robots)
    field.until(
        lambda: 'standings on /m/standings, which are not followed' in field.state('/m/planner'),
        'planner that says what it waits for',
        patience=300,
    )
    assert remedy in field.state('/m/planner')
