# SPDX-License-Identifier: Apache-2.0
"""Positions and detections of robots, in any order of arrival."""

from collections import deque
from contextlib import closing
from math import cos, sin
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import time

from extent import some
from fleet import FIELD, Fleet, GRID
from geometry_msgs.msg import TransformStamped
from kbnitp_msgs.msg import AgentStatus, BeliefMaps
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.headers import from_stamp, to_stamp
from kbnitp_ros.nodes.driver import detection_class, DRIVERS, goal_along, read_detection
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.robot.journal import Journal, JournaledDeployment, Step
from laws import for_each
from nav2_msgs.action import FollowWaypoints
from nav_msgs.msg import Path as PathMessage
import numpy as np
import pytest
from rclpy.action.server import ActionServer
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import (
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)

TARGET = ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id='target', score=0.8))


def transform(field, x, y, parent='map', child='base_link', turned=1.0):
    told = TransformStamped(child_frame_id=child)
    told.header.frame_id = parent
    told.header.stamp = field.node.get_clock().now().to_msg()
    told.transform.translation.x, told.transform.translation.y = x, y
    told.transform.rotation.w = turned
    return TFMessage(transforms=[told])


def test_impossible_positions_make_no_step(field):
    """The test sets the position; no Nav2 drives the robot, so it waits for its action server."""
    fleet = Fleet(field)
    deployment = JournaledDeployment(10**9, 5, (0, 1, 2, 1, 0), 1, [Step(1, 1), Step(2, 2)])
    journal = Journal(fleet.journal('scout_1'), 'scout_1', GRID)
    journal.depart(deployment)
    for number in (1, 2):
        journal.step(deployment, number)
    journal.close()
    reports = fleet.reports()
    poses = field.node.create_publisher(TFMessage, '/scout_1/tf', 10)
    fleet.start(tf_timeout=0.5)
    field.until(lambda: 'it goes home' in field.said('/scout_1/robot'), 'robot in the field')

    def warned(words):
        return lambda: words in field.diagnosed('/scout_1/robot').message

    field.until(warned("no transform leads from 'map' to 'base_link'"), 'word of TF')
    poses.publish(transform(field, 2.5, 0.5))
    field.until(warned('is older than 0.5 s (parameter tf_timeout)'), 'word of its age')
    assert "/tf: the last transform from 'map' to 'base_link'" in field.said('/scout_1/robot')

    def stand(x, y, condition, what):
        def stands():
            poses.publish(transform(field, x, y))
            return condition()

        field.until(stands, what)

    stand(-40.0, 0.5, warned('outside the grid'), 'word of a place off the map')
    stand(2.5, 2.5, warned('in cell 26, which is blocked'), 'word of a blocked cell')
    poses.publish(transform(field, float('nan'), 0.5))
    poses.publish(transform(field, 2.5, 0.5, turned=7.0))
    field.until(lambda: field.count('/scout_1/robot', 'refused') == 2, 'two refusals')
    assert not reports
    # After tf_timeout far away, it has been there, by some way.
    stand(0.5, 0.5, lambda: reports, 'report')
    report = fleet.wait_for_report(reports, fleet.key(1))
    assert report.readings == ((1, -1), (2, -1), (1, -1), (0, -1))


def test_an_endless_walk_is_reported_up_to_the_maximum(field):
    """The robot was lost for hours and is at its base, where its power was off."""
    fleet = Fleet(field)
    deployment = JournaledDeployment(10**9, 5, (0, 1, 2, 1, 0))
    journal = Journal(fleet.journal('scout_1'), 'scout_1', GRID)
    journal.depart(deployment)
    for number in range(1, 302):
        deployment.steps.append(Step(1 + (number + 1) % 2, number, reading=1))
        journal.step(deployment, number)
    journal.close()
    reports, beliefs = fleet.reports(), field.listen(BeliefMaps, '/belief')
    field.start('estimator', {**FIELD, 'await_nodes': ['test']})
    paths = field.talk(PathMessage, '/scout_1/path', qos.EVIDENCE)
    paths.publish(path_message(GRID, deployment.path, deployment.stamp, deployment.mission))
    poses = field.node.create_publisher(TFMessage, '/scout_1/tf', 10)
    words = 'has 302 steps, more than a report may have (10 * max_steps = 200): '
    for starts in (1, 2):
        fleet.start()

        def is_told(starts=starts):
            poses.publish(transform(field, 0.5, 0.5))
            return len(reports) == starts

        field.until(is_told, 'report')
        field.until(lambda: beliefs and beliefs[-1].deployments == 1, 'belief')
        field.until(lambda: words in str(field.diagnosed('/scout_1/robot').values), 'word of it')
        assert field.said('/scout_1/robot').count(words) == starts
        field.kill('/scout_1/robot')
    field.until(lambda: '1 duplicate message' in field.state('/estimator'), 'repetition')
    assert field.count('/estimator', 'refused') == 0
    report = fleet.wait_for_report(reports, fleet.key(1))
    # It cannot vouch for steps before it was switched off.
    assert report.readings == (*[(1, -1), (2, -1)] * 99, (1, -1), (0, -1))
    assert not any(report.entered)
    kept = Journal(journal.path, 'scout_1', GRID)
    kept.close()
    assert [len(each.steps) for each in kept.deployments] == [302]
    assert kept.deployments[0].is_home


# Delay of positions in seconds, whether the robot is stopped repeatedly, and the speed of a
# simulated clock.
RACES = {
    'late positions': (0.3, False, 0.0),
    'a busy robot': (0.0, True, 0.0),
    'a simulated clock': (0.0, False, 0.4),
}


@pytest.mark.parametrize('detection_type', some(['bool', 'detection2d_array'], 2))
@pytest.mark.parametrize('late, is_busy, rate', RACES.values(), ids=RACES)
def test_detections_count_in_the_robot_s_cell_in_any_order(
    field, detection_type, late, is_busy, rate
):
    """The robot returns from cell 5 under control of the test; the only target is in cell 2."""
    fleet = Fleet(field, detection_type=detection_type)
    deployment = JournaledDeployment(10**9, 5, (0, 5, 0), 1, [Step(5, 1)])
    with closing(Journal(fleet.journal('scout_1'), 'scout_1', GRID)) as journal:
        journal.depart(deployment)
        journal.step(deployment, 1)
    reports = fleet.reports()
    poses = field.node.create_publisher(TFMessage, '/scout_1/tf', 100)
    clock = field.node.create_publisher(Clock, '/clock', 10)
    robot = fleet.start(use_sim_time=bool(rate))
    field.until(lambda: 'it goes home' in field.said('/scout_1/robot'), 'robot in the field')
    # The time of the robot's motion: it waits while a busy processor stops the test.
    now, last = 0.0, time.monotonic()

    def stamp():
        """Return the ROS time."""
        if not rate:
            return field.node.get_clock().now().to_msg()
        return to_stamp(10**9 + round(rate * now * 10**9))

    kind = Bool if detection_type == 'bool' else Detection2DArray
    detections = field.talk(kind, '/scout_1/detections', 10)
    is_home = Future()

    async def drive(goal):
        await is_home
        goal.succeed()
        return FollowWaypoints.Result()

    # Nav2 drives the robot, so that the steps are its own.
    server = ActionServer(field.node, FollowWaypoints, '/scout_1/follow_waypoints', drive)

    def detection(is_seen):
        if kind is Bool:
            return Bool(data=is_seen)
        message = Detection2DArray(detections=[Detection2D(results=[TARGET])] * is_seen)
        message.header.stamp = stamp()
        return message

    queue = deque()

    def goes_home():
        nonlocal now, last
        passed, last = time.monotonic() - last, time.monotonic()
        now += min(passed, 0.05)
        clock.publish(Clock(clock=stamp()))
        # A second in cell 5, then home at about 2 m/s, slower in the target's cell.
        x = float(np.interp(now, [1.0, 2.3, 2.7, 4.0], [5.5, 2.7, 2.2, 0.5]))
        pose = transform(field, 0.0, 0.0, 'map', 'odom')
        pose.transforms += transform(field, x, 0.5, 'odom').transforms
        for link in pose.transforms:
            link.header.stamp = stamp()
        if now > 4.2 + late and not is_home.done():
            is_home.set_result(None)
        # A busy robot misses the oldest of many messages.
        queue.extend([(now + late, pose)] * (10 if is_busy else 1))
        while queue and queue[0][0] <= now:
            poses.publish(queue.popleft()[1])
        detections.publish(detection(2.0 <= x < 3.0))
        if is_busy and now > 0.5:
            robot.send_signal(signal.SIGSTOP if now % 1.0 < 0.6 else signal.SIGCONT)
        return reports

    field.until(goes_home, 'report')
    robot.send_signal(signal.SIGCONT)
    readings = [
        each for each in fleet.wait_for_report(reports, fleet.key(1)).readings if each[1] >= 0
    ]
    assert readings
    server.destroy()
    # The step into cell 5 was made before the node started.
    assert set(readings) <= {(4, False), (3, False), (2, True), (1, False), (0, False)}
    if not is_busy:
        # A Bool has no stamp: it counts only in a cell that takes longer than poses are late.
        takes_long = {(2, True), (1, False)}
        assert takes_long | ({(3, False)} if kind is not Bool or not late else set()) <= set(
            readings
        )


def test_detections_at_1_khz_and_none_at_all(field):
    fleet = Fleet(field, speed=2.0)
    reports = fleet.reports()
    detections = field.node.create_publisher(Bool, '/detections', 10)
    fleet.simulate()
    fleet.start(remapped={'detections': '/detections'})
    report = fleet.wait_for_report(reports, fleet.send(1, [0, 1, 0]))
    assert report.readings == ((1, -1), (0, -1))
    key = fleet.send(2, [0, 1, 2, 1, 0])
    sent = 0
    begun = time.monotonic()
    while len(reports) < 2 and time.monotonic() < begun + 60:
        # As many as are due, between other callbacks.
        while sent < 1000 * (time.monotonic() - begun):
            detections.publish(Bool(data=True))
            sent += 1
        field.executor.spin_once(timeout_sec=0.001)
    report = fleet.wait_for_report(reports, key)
    fleet_walk = [cell for cell, _ in report.readings]
    assert fleet_walk == [1, 2, 1, 0]
    # A busy processor may stop the test for longer than a cell takes.
    assert 1 in (readings := {reading for _, reading in report.readings[:-1]})
    assert readings <= {1, -1}
    assert sent > 500


def test_a_path_for_another_field_or_an_earlier_mission_is_refused(field):
    fleet, reports = Fleet.simulated(field)
    fleet.start()
    field.until(lambda: '/tf: the problem is over' in field.said('/scout_1/robot'), 'TF')
    paths = field.talk(PathMessage, '/scout_1/path', qos.EVIDENCE)
    other = Grid(30, 30, base=899)
    paths.publish(path_message(other, [899, 898, 899], 10**9, 5))
    assert 'is outside the grid of 12 x 12' in field.until_refused('/scout_1/robot', 1)
    paths.publish(path_message(GRID, [0, 13, 26, 13, 0], 10**9, 5))
    assert 'enters a blocked cell' in field.until_refused('/scout_1/robot', 2)
    fleet.wait_for_report(reports, fleet.send(1, [0, 1, 0]))
    # The clock of its base was set back. The robot refuses there, for good.
    key = fleet.send(2, [0, 1, 0], mission=4)
    journal = fleet.journal('scout_1')
    why = (
        f'it belongs to the mission begun at 0.000000004, but journal {journal} belongs to '
        'the mission begun at 0.000000005, which is later'
    )

    def refusals():
        said = fleet.statuses['scout_1']
        return [each for each in said if each.state == AgentStatus.REFUSED]

    field.until(refusals, 'refusal')
    field.kill('/scout_1/robot')
    fleet.start()
    field.until(lambda: len(refusals()) == 2, 'the refusal again')
    assert {from_stamp(refusal.deployment) for refusal in refusals()} == {key.stamp}
    assert all(why in each.reason for each in refusals())
    fleet.wait_for_report(reports, fleet.send(3, [0, 1, 0]))


def test_a_robot_departs_in_a_new_mission_and_keeps_the_last_journal(field):
    fleet, reports = Fleet.simulated(field)
    for number, mission in ((1, 5), (2, 7), (3, 9)):
        fleet.start()
        fleet.wait_for_report(reports, fleet.send(number, [0, 1, 0], mission=mission))
        journal = fleet.journal('scout_1')
        field.kill('/scout_1/robot')
        kept = {int(each.parent.name): each for each in journal.parent.glob(f'*/{journal.name}')}
        assert sorted(kept) == [each for each in (5, 7) if each < mission]
        for begun, path in {**kept, mission: journal}.items():
            opened = Journal(path, 'scout_1', GRID)
            assert [(each.mission, each.is_home) for each in opened.deployments] == [(begun, True)]
            opened.close()


def test_a_full_disk_loses_no_step(field):
    fleet, reports = Fleet.simulated(field)
    robot = fleet.start()
    field.until(lambda: fleet.state().startswith('taking paths'), 'robot at home')
    journal = fleet.journal('scout_1')
    # Room for the orders and a step or two.
    size = journal.stat().st_size + 200
    resource.prlimit(robot.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    report = fleet.wait_for_report(reports, fleet.send(1, [0, 1, 2, 14, 13, 0]))
    fleet.see_that_it_is_true(report)
    assert [cell for cell, _ in report.readings] == [1, 2, 14, 13, 0]
    field.until(lambda: 'journal' in field.diagnosed('/scout_1/robot').message, 'word of the disk')
    # The console is a file with the same limit.
    told = field.diagnosed('/scout_1/robot').message
    assert f'{journal}: File too large (raise the limit' in told
    assert 'further records are kept in memory' in told
    # Without room it does not depart.
    key = fleet.send(2, [0, 1, 0])
    field.until(lambda: 'waiting for room on the disk' in fleet.state(), 'word of it')
    resource.prlimit(
        robot.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    )
    fleet.wait_for_report(reports, key)
    field.kill('/scout_1/robot')
    kept = Journal(journal, 'scout_1', GRID)
    kept.close()
    assert [deployment.is_home for deployment in kept.deployments] == [True, True]
    assert kept.deployments[0].cells == [0, 1, 2, 14, 13, 0]


ROCK, TARGET_CLASS, DOUBTFUL = ('rock', 0.9), ('target', 0.5), ('target', 0.49)
NOT_A_NUMBER = ('target', float('nan'))


def array(*objects, sec=0):
    """Return a message with objects, each with some classes and scores."""
    message = Detection2DArray(
        detections=[
            Detection2D(
                results=[
                    ObjectHypothesisWithPose(
                        hypothesis=ObjectHypothesis(class_id=name, score=score)
                    )
                    for name, score in classes
                ]
            )
            for classes in objects
        ]
    )
    message.header.stamp.sec = sec
    return message


@for_each('name', DRIVERS)
def test_goals_have_no_stamp_so_that_nav2_follows_corrections_of_the_map(name):
    """Nav2's controller places a goal with a stamp by the transform of that time."""
    action, _ = DRIVERS[name]
    goal = goal_along(action, np.array([[0.4, 0.5], [1.5, 0.5], [2.5, 1.5]]), [1.0])
    is_path = name == 'follow_path'
    poses = goal.path.poses if is_path else goal.poses
    headers = [each.header for each in [*poses, *([goal.path] if is_path else [])]]
    assert {from_stamp(header.stamp) for header in headers} == {0}
    assert {header.frame_id for header in headers} == {'map'}
    last = poses[-1].pose
    assert (last.position.x, last.position.y) == (2.5, 1.5)
    assert (last.orientation.z, last.orientation.w) == pytest.approx((sin(0.5), cos(0.5)))


@for_each('wanted, objects, seen', [
    ('target', [], False),
    ('target', [[]], False),
    ('target', [[ROCK], [ROCK, DOUBTFUL, NOT_A_NUMBER]], False),
    ('target', [[ROCK], [ROCK, TARGET_CLASS]], True),
    ('', [[ROCK]], True),
    ('', [[DOUBTFUL]], False),
])  # fmt: skip
def test_a_target_is_an_object_of_the_class_that_is_sure_enough(wanted, objects, seen):
    values = {
        'detection_type': 'detection2d_array',
        'detection_class': wanted,
        'detection_score': 0.5,
    }
    assert detection_class('detection2d_array') is Detection2DArray
    assert read_detection(array(*objects), values) == (seen, None)
    assert read_detection(array(*objects, sec=7), values) == (seen, 7 * 10**9)


@pytest.mark.processes
def test_a_robot_without_vision_msgs_names_the_package(tmp_path):
    folders = os.environ['PYTHONPATH'].split(os.pathsep)
    others = [each for each in folders if not Path(each, 'vision_msgs').exists()]
    assert others != folders
    given = {
        'agent': 'scout_1',
        'journal': tmp_path / 'scout_1.journal',
        'detection_type': 'detection2d_array',
    }
    command = [sys.executable, '-m', 'kbnitp_ros', 'robot', '--ros-args']
    for name, value in given.items():
        command += ['-p', f'{name}:={value}']
    ended = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(others)},
    )
    assert ended.returncode == 2
    assert (
        "robot: parameter detection_type is 'detection2d_array': type "
        "'vision_msgs/msg/Detection2DArray' has no Python class: No module named 'vision_msgs'; "
        'install vision_msgs (by rosdep, or as ros-jazzy-vision-msgs), make robots, or use a '
        'detector that publishes std_msgs/Bool'
    ) in ended.stderr
    assert not given['journal'].exists()
