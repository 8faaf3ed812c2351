# SPDX-License-Identifier: Apache-2.0
"""Few messages of somebody on the network neither stop a mission nor bend it."""

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import PATH
from kbnitp_ros.messages.deployments import path_message, read_report
from kbnitp_ros.messages.headers import content_hash, from_stamp, SECOND, to_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
from samples import changed, FIELD, GRID, HOME, key, on_disk, path, prior

WALKS = (HOME, [0, 4, 8, 4, 0])


def test_of_two_paths_of_one_stamp_that_on_disk_first_holds_for_all(field):
    log = field.folder / 'mission.mcap'
    told = field.listen(Recorded, '/scout_1/recorded')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    beliefs = field.listen(BeliefMaps, '/belief')
    parameters = {**FIELD, 'recorded': True, 'file': str(log)}
    field.start('recorder', parameters)
    field.start('estimator', {**parameters, 'await_nodes': ['recorder']})
    field.start('agent', {**parameters, 'await_nodes': ['estimator', 'recorder']})
    field.until(lambda: beliefs, 'prior')
    begun = from_stamp(beliefs[0].header.stamp)
    field.let_depart()
    planners = [field.talk(Path, '/scout_1/path') for _ in WALKS]
    for number in range(1, 4):
        sent = [path_message(GRID, walk, begun + number * SECOND, begun) for walk in WALKS]
        for planner, message in zip(planners, sent):
            planner.publish(message)
        field.until(lambda n=number: len(reports) == n, f'report {number}')
        by_content = {content_hash(message): walk for message, walk in zip(sent, WALKS)}

        def counted(by_content=by_content):
            return [by_content[each.content] for each in told if each.content in by_content]

        field.until(counted, f'acknowledgement {number}')
        walked = counted()[0]
        report = read_report(reports[-1])[1]
        assert not report.survived or [cell for cell, _ in report.readings] == walked[1:]
    field.until(lambda: beliefs[-1].deployments == 3, 'belief')
    field.processes.stop()
    assert len(list(read_log(log, [PATH]))) == 3
    assert replay(log).reproduced


def test_forged_acknowledgements_keep_no_robot_at_home(field):
    reports = field.listen(DeploymentReport, '/scout_1/report')
    recorder, forger = (
        field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE) for _ in range(2)
    )
    # Heard before the path, and then pushed out by what is forged.
    recorder.publish(on_disk(path(1)))
    for number in range(5200):
        forger.publish(Recorded(stamp=to_stamp(number + 1)))
    field.start('agent', {**FIELD, 'recorded': True, 'await_nodes': ['test']})
    field.let_depart()
    field.record_departures('scout_1')
    field.talk(Path, '/scout_1/path').publish(path(1))
    field.until(lambda: reports, 'report')
    assert read_report(reports[0])[0] == key(1)


def test_a_planner_acknowledges_its_own_paths_only_and_gives_up_what_left(field):
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    recorder, forger = (
        field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE) for _ in range(2)
    )
    field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    silent = {'silent_loss': True, 'return_deadline': 0.5, 'recorded': True}
    silent |= {'presume_departure': True, 'step_period': 0.001}
    field.start('planner', {**FIELD, **silent, 'robots': 1, 'await_nodes': ['test']})
    field.talk(BeliefMaps, '/belief', qos.LATCHED).publish(prior())
    field.until(lambda: paths, 'path')
    recorder.publish(on_disk(paths[0]))
    for number in range(5200):
        forger.publish(Recorded(stamp=to_stamp(number + 10**12)))
    field.until(lambda: reports, 'loss')
    assert not reports[0].survived


def test_a_second_planner_is_named(field):
    field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    field.start('planner', {**FIELD, 'await_nodes': ['test']})
    field.talk(Path, '/scout_1/path')
    told = field.until_refused('/planner', 1)
    assert '2 planners publish it, nodes /planner, /test/test: ' in told
    assert told in field.said('/planner')


def test_paths_of_other_missions_are_never_said_to_be_on_disk(field):
    log = field.folder / 'mission.mcap'
    told = field.listen(Recorded, '/scout_1/recorded')
    field.start('recorder', {'file': str(log)})
    paths = field.talk(Path, '/scout_1/path')
    for mission in range(1, 101):
        paths.publish(path_message(GRID, HOME, key(mission).stamp + 1, mission))
    beliefs = field.talk(BeliefMaps, '/belief', qos.LATCHED)
    beliefs.publish(prior(5 * SECOND))
    own = path_message(GRID, HOME, key(200).stamp, 5 * SECOND)
    paths.publish(own)
    field.until(lambda: told, 'acknowledgement')
    assert told == [changed(on_disk(own), mission=to_stamp(5 * SECOND))]


def test_a_planner_does_not_take_itself_for_the_agent_that_it_awaits(field):
    """It publishes reports, of losses, and hears paths, of other planners."""
    field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    field.start('planner', {**FIELD, 'await_nodes': ['agent']})
    field.talk(BeliefMaps, '/belief', qos.LATCHED).publish(prior())
    wait = 'waiting for agent to listen to /scout_1/path'
    field.until(lambda: field.state('/planner').startswith(wait), wait)
