# SPDX-License-Identifier: Apache-2.0
"""Two robots of one name that leave on one path, since neither knew of the other."""

from apart import apart
from base import Base, GRID
from extent import FULL, some
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import Observation
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import pytest
import samples

pytestmark = pytest.mark.processes


def differing(key):
    """Return what is said of two returns of one deployment."""
    return (
        f'reports of deployment {key} differ: that with more readings counts '
        f'(do two robots have the name {key.agent}?)'
    )


def test_of_two_robots_on_one_path_that_with_more_readings_counts(field):
    base = Base(field)
    base.until_sent(1)
    key, cells = read_path(GRID, 'scout_1', base.paths['scout_1'][-1])
    other = field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    # The three nodes of the base, and the test.
    field.until(lambda: other.get_subscription_count() == 4, 'whole base')
    base.come_back()
    base.until_held(1)
    base.until_sent(2)
    # The other one turned back half way.
    half = cells[: cells.size // 2]
    walk = [*half, *half[-2::-1]]
    home = Observation(walk, True, [True] * (len(walk) - 1))
    other.publish(report_message(key, home, key.stamp + 2))
    told = field.until_refused('/estimator', 1)
    assert told == f'scout_1/report refused: {differing(key)}'
    if FULL:
        base.crash()
        base.until_held(1)
    # Nor does it end the deployment that its name is on now.
    base.until_state('to be reported on /scout_1/report')
    base.come_back()
    base.until_held(2)
    field.processes.stop(60)
    report = replay(base.log)
    assert report.reproduced
    assert len(report.evidence.reports) == 2
    # A recorder that was started again has heard it again.
    (refused,) = set(report.evidence.refused)
    assert refused == told.replace('scout_1/report refused', '/scout_1/report')


@pytest.mark.parametrize('first, second', some([(5, 5), (5, 6), (6, 5)]))
@pytest.mark.parametrize('heard', [(0, 1), (1, 0)], ids=['as recorded', 'the other way round'])
def test_it_does_not_matter_whose_report_is_heard_first(field, heard, first, second):
    """Live, replayed and resumed beliefs agree also if recorder and estimator heard otherwise."""
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    # What the estimator hears and when is up to the test.
    parameters = {**samples.FIELD, 'await_nodes': ['test', 'recorder']}
    field.start('estimator', parameters, '/m', {'scout_1/report': '/heard/report'})
    beliefs = field.listen(BeliefMaps, '/m/belief')
    paths = field.talk(Path, '/m/scout_1/path')
    field.until(lambda: beliefs, 'prior')
    paths.publish(samples.path(1))
    key = samples.key(1)
    walks = Observation(samples.HOME, True, [True] * 4), Observation([0, 4, 0], True, [False] * 2)
    reports = [report_message(key, *each) for each in zip(walks, (first, second))]
    for node, topic, order in (
        ('/m/recorder', '/m/scout_1/report', (0, 1)),
        ('/m/estimator', '/heard/report', heard),
    ):
        robots = [field.talk(DeploymentReport, topic) for _ in reports]
        for number in order:
            told = field.count(node, 'accepted') + field.count(node, 'refused')
            robots[number].publish(reports[number])
            field.until(
                lambda node=node, told=told: (
                    field.count(node, 'accepted') + field.count(node, 'refused') > told
                ),
                f'report {number} at {node}',
            )
    assert field.diagnosed('/m/estimator').message == f'scout_1/report refused: {differing(key)}'
    # The shorter walk is replaced.
    field.until(lambda: len(beliefs) == (2 if heard == (0, 1) else 3), 'belief in the longer walk')
    for name, code in field.processes.stop(60).items():
        assert code == 0, field.said(name)
    told = replay(log)
    assert told.reproduced, (told.mismatches, told.not_yet_held)
    assert told.evidence.refused
    resumed = field.listen(BeliefMaps, '/m/belief')
    field.start('estimator', {**samples.FIELD, 'await_nodes': ['test'], 'resume': str(log)}, '/m')
    field.until(lambda: resumed and resumed[-1].deployments == 1, 'resumed belief', may_end=True)
    assert resumed[-1].joint == beliefs[-1].joint


@pytest.mark.full
@pytest.mark.campaign
def test_of_two_robots_that_do_not_hear_each_other_one_moves(tmp_path):
    robots = 4
    with apart(tmp_path, robots, namesakes=2) as mission:
        mission.until(lambda: len(mission.reports()) == robots, 'reports')
        mission.until(lambda: mission.count('that the departure of scout_1 at'), 'wait')
        assert mission.count('leaving on') == robots
    told = replay(mission.log)
    assert told.reproduced
    assert len(told.evidence.reports) == robots
    assert not told.evidence.refused
