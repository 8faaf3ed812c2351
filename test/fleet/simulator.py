# SPDX-License-Identifier: Apache-2.0
"""
Robots on differential drives among obstacles, simulated by ir-sim, behind the actions of Nav2.

    python3 simulator.py CONFIG

The configuration is JSON: width, height and blocked of a field of 1 m cells; robots, by namespace,
the x and y where each begins; targets, the cells where detectors see something; detection_type, as
the parameter of robots; speed in m/s; lifecycle, whether the nodes of Nav2 tell their states;
wrong, what is injected at first; placed, where the corner of the simulated world lies in the frame
map, x, y and yaw; datum, as the parameter of robots; and track, the file that the true positions,
in that world, go to. Each robot has a world of its own with the same obstacles, since all leave
from one base. Its namespace has tf, tf_static, fix (with a datum), detections, the three actions
and the states of the nodes that serve them; and inject, on which a text tells what is to go wrong
with the next goal:

    reject, abort, silent (it is driven, and no word is said), lie (reached, it says at once),
    inactive (all goals are rejected, as by a node that is not active),
    stuck (it is driven out of the first cell, and stands),
    die (the action servers go, and their goal), live (they are back, and active)

With jump all that is told of where the robot is is `JUMP` m too far along x, until live; with
blind nothing is told of it.

With an exclamation mark, such as reject!, with all goals until another text comes.
"""

from cmath import exp
from collections import deque
from functools import partial
import json
from math import atan2, cos, degrees, hypot, pi, sin
from pathlib import Path
import signal
import sys
import time

from geometry_msgs.msg import PoseStamped, Quaternion, Transform, TransformStamped, Vector3
import irsim
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from nav2_msgs.action import FollowPath, FollowWaypoints, NavigateThroughPoses
import numpy as np
from pyproj import Geod
import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import (
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)

EARTH = Geod(ellps='WGS84')

TICK = 0.02  # seconds

# Ticks that a detector takes to process an image.
LATE = 5

# Distance in metres to a pose, and to the last one, at which Nav2 counts it as reached by default.
NEAR, GOAL = 0.2, 0.15

# Pose of the frame odom in the frame map: shifted and turned, as after a start.
ODOM = (3.0, -2.0, 0.7)

JUMP = 4.0

WORLD = """
world: {{width: {width}, height: {height}, step_time: {tick}, sample_time: {tick},
  collision_mode: stop}}
robot:
  - kinematics: {{name: diff}}
    shape: {{name: circle, radius: 0.15}}
    state: [{x}, {y}, 0.0]
    goal: [{x}, {y}, 0.0]
    vel_max: [{speed}, 12.0]
    vel_min: [-{speed}, -12.0]
obstacle:
{obstacles}
"""

SERVERS = ('waypoint_follower', 'bt_navigator', 'controller_server')

ACTIONS = {
    'follow_waypoints': FollowWaypoints,
    'navigate_through_poses': NavigateThroughPoses,
    'follow_path': FollowPath,
}


def in_map(placed, x, y):
    """Return the position of a point of the simulated world in the frame map."""
    begin_x, begin_y, turn = placed
    at = complex(begin_x, begin_y) + exp(1j * turn) * complex(x, y)
    return at.real, at.imag


def in_world(placed, x, y):
    """Return the position of a point of the frame map in the simulated world."""
    begin_x, begin_y, turn = placed
    at = exp(-1j * turn) * (complex(x, y) - complex(begin_x, begin_y))
    return at.real, at.imag


class Goal:
    """A goal that a robot drives to."""

    def __init__(self, handle, kind, wrong, placed):
        self.handle = handle
        self.kind = kind
        self.wrong = wrong
        self.begun = time.monotonic()
        request = handle.request
        poses = request.path.poses if kind is FollowPath else request.poses
        self.last = poses[-1]
        self.points = [
            in_world(placed, pose.pose.position.x, pose.pose.position.y) for pose in poses
        ]


class Robot:
    """A robot in its own world."""

    def __init__(self, node, namespace, begin, config, folder):
        self._node = node
        self._namespace = namespace
        self._config = config
        self._speed = config.get('speed', 5.0)
        self._goal = None
        self._wrong = config.get('wrong', '')
        self._jump, self._is_blind = 0.0, False
        self._servers = []
        obstacles = '\n'.join(
            '  - {shape: {name: rectangle, length: 0.9, width: 0.9}, state: '
            f'[{cell % config["width"] + 0.5}, {cell // config["width"] + 0.5}, 0.0]}}'
            for cell in config['blocked']
        )
        world = folder / f'{namespace.strip("/").replace("/", "_")}.yaml'
        size = {name: config[name] for name in ('width', 'height')}
        world.write_text(
            WORLD.format(
                x=begin[0], y=begin[1], speed=self._speed, tick=TICK, obstacles=obstacles, **size
            )
        )
        self._world = irsim.make(str(world), headless=True, log_level='ERROR')
        self._track = Path(config['track']).open('a')  # noqa: SIM115
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._tf = node.create_publisher(TFMessage, f'{namespace}/tf', 100)
        self._static = node.create_publisher(TFMessage, f'{namespace}/tf_static', latched)
        self._fixes = node.create_publisher(NavSatFix, f'{namespace}/fix', 10)
        self._goals = node.create_publisher(PoseStamped, f'{namespace}/goal', latched)
        self._pictures = deque()
        self._is_array = config['detection_type'] == 'detection2d_array'
        kind = Detection2DArray if self._is_array else Bool
        self._detections = node.create_publisher(kind, f'{namespace}/detections', 10)
        node.create_subscription(String, f'{namespace}/inject', self._on_inject, 10)
        self._static.publish(self._transform('base_footprint', 'base_link', 0.0, 0.0, 0.0))
        for name in SERVERS if config['lifecycle'] else ():
            node.create_service(GetState, f'{namespace}/{name}/get_state', self._tell_state)
        self._live()

    def _tell_state(self, _, response):
        is_active = self._wrong != 'inactive'
        response.current_state = (
            State(id=State.PRIMARY_STATE_ACTIVE, label='active')
            if is_active
            else State(id=State.PRIMARY_STATE_INACTIVE, label='inactive')
        )
        return response

    def _live(self):
        self._servers = [
            ActionServer(
                self._node,
                kind,
                f'{self._namespace}/{name}',
                # Goals are executed by `_end`, each with its own function.
                print,
                goal_callback=self._judge,
                handle_accepted_callback=partial(self._take, kind),
                cancel_callback=lambda _: CancelResponse.ACCEPT,
            )
            for name, kind in ACTIONS.items()
        ]

    def _on_inject(self, message):
        if message.data == 'die':
            self._goal = None
            for server in self._servers:
                server.destroy()
            self._servers = []
        elif message.data == 'jump':
            self._jump = JUMP
        elif message.data == 'blind':
            self._is_blind = True
        elif message.data == 'live':
            self._wrong, self._jump, self._is_blind = '', 0.0, False
            if not self._servers:
                self._live()
        else:
            self._wrong = message.data

    def _take_wrong(self):
        """Return the failure to inject into this goal."""
        wrong = self._wrong
        if not wrong.endswith('!'):
            self._wrong = ''
        return wrong.removesuffix('!')

    def _judge(self, _):
        if self._wrong == 'inactive':
            return GoalResponse.REJECT
        if self._wrong.startswith('reject'):
            self._take_wrong()
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _take(self, kind, handle):
        """Drive to a goal from now on; it replaces the one before, as in Nav2."""
        if self._goal is not None:
            self._end('abort')
        self._goal = Goal(handle, kind, self._take_wrong(), self._config['placed'])
        self._goals.publish(self._goal.last)

    def _end(self, how, error=0):
        """End a goal: for rclpy its execution happens only now, in one step."""
        goal, self._goal = self._goal, None

        def execute(handle):
            result = goal.kind.Result()
            if how == 'abort':
                handle.abort()
                # Nav2 of Jazzy fills in no message.
                result.error_code = error
            elif how == 'cancel':
                handle.canceled()
            else:
                handle.succeed()
            return result

        goal.handle.execute(execute)

    @property
    def place(self):
        x, y, yaw = np.ravel(self._world.robot.state)[:3].tolist()
        return x, y, yaw

    def tick(self):
        x, y, yaw = self.place
        linear = turn = 0.0
        goal = self._goal
        if goal is not None:
            if goal.handle.is_cancel_requested:
                self._end('cancel')
            elif goal.wrong == 'lie':
                self._end('succeed')
            elif goal.wrong == 'abort' and time.monotonic() > goal.begun + 0.25:
                self._end('abort', FollowPath.Result.NO_VALID_CONTROL)
            elif goal.wrong != 'stuck' or max(x, y) < 1:
                linear, turn = self._steer(goal, x, y, yaw)
        self._world.step(np.array([[linear], [turn]]))

    def _steer(self, goal, x, y, yaw):
        while goal.points and hypot(goal.points[0][0] - x, goal.points[0][1] - y) < (
            GOAL if len(goal.points) == 1 or goal.kind is FollowWaypoints else NEAR
        ):
            goal.points.pop(0)
        if not goal.points:
            if goal.wrong != 'silent':
                self._end('succeed')
            return 0.0, 0.0
        if goal.wrong != 'silent':
            goal.handle.publish_feedback(goal.kind.Feedback())
        to_x, to_y = goal.points[0]
        off = (atan2(to_y - y, to_x - x) - yaw + pi) % (2 * pi) - pi
        away = hypot(to_x - x, to_y - y)
        linear = min(self._speed, 8 * away) * max(0.0, cos(off)) ** 8
        return linear, 12 * off

    def tell(self):
        """Publish position and detections, and record the truth."""
        x, y, yaw = self.place
        self._track.write(f'{json.dumps([self._namespace, x, y])}\n')
        self._track.flush()
        if not self._is_blind:
            self._tell_place(x, y, yaw)
        cell = int(y) * self._config['width'] + int(x)
        sees = cell in self._config['targets']
        if not self._is_array:
            self._detections.publish(Bool(data=sees))
            return
        self._pictures.append(self._picture(sees))
        if len(self._pictures) > LATE:
            self._detections.publish(self._pictures.popleft())

    def _tell_place(self, x, y, yaw):
        placed = self._config['placed']
        map_x, map_y = in_map(placed, x, y)
        map_yaw = yaw + placed[2]
        moved_x, moved_y, turned = ODOM
        dx, dy = map_x - moved_x, map_y - moved_y
        seen_x = dx * cos(turned) + dy * sin(turned)
        seen_y = dy * cos(turned) - dx * sin(turned)
        self._tf.publish(self._transform('map', 'odom', moved_x + self._jump, moved_y, turned))
        self._tf.publish(
            self._transform('odom', 'base_footprint', seen_x, seen_y, map_yaw - turned)
        )
        if self._config['datum']:
            self._fixes.publish(self._fix(map_x, map_y))

    def _fix(self, x, y):
        latitude, longitude, heading = self._config['datum']
        azimuth = 90 - degrees(heading + atan2(y, x))
        fix = NavSatFix(position_covariance_type=NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN)
        fix.longitude, fix.latitude, _ = EARTH.fwd(longitude, latitude, azimuth, hypot(x, y))
        fix.position_covariance = np.diag([1e-4, 1e-4, 4e-4]).ravel()
        fix.status.status = NavSatStatus.STATUS_FIX
        fix.header.frame_id = 'base_link'
        fix.header.stamp = self._node.get_clock().now().to_msg()
        return fix

    def _picture(self, sees):
        """Return a detector's objects: rocks everywhere, some with a small target score."""
        rock = [hypothesis('rock', 0.9), hypothesis('target', 0.1)]
        detections = [Detection2D(results=rock)]
        if sees:
            detections.append(Detection2D(results=[hypothesis('target', 0.8)]))
        picture = Detection2DArray(detections=detections)
        picture.header.stamp = self._node.get_clock().now().to_msg()
        return picture

    def _transform(self, parent, child, x, y, yaw):
        transform = TransformStamped(
            child_frame_id=child,
            transform=Transform(
                translation=Vector3(x=x, y=y), rotation=Quaternion(z=sin(yaw / 2), w=cos(yaw / 2))
            ),
        )
        transform.header.frame_id = parent
        transform.header.stamp = self._node.get_clock().now().to_msg()
        return TFMessage(transforms=[transform])


def hypothesis(name, score):
    """Return the hypothesis that an object is of a class."""
    return ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=score))


def simulate(path):
    config = json.loads(path.read_text())
    signals = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: signals.append(received))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('simulator')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    robots = [
        Robot(node, namespace, begin, config, path.parent)
        for namespace, begin in config['robots'].items()
    ]
    due = time.monotonic()
    while not signals:
        for robot in robots:
            robot.tick()
            robot.tell()
        due += TICK
        # Handle callbacks until the next tick; lost time is not made up for.
        due = max(due, time.monotonic() - TICK)
        while (left := due - time.monotonic()) > 0:
            executor.spin_once(timeout_sec=left)
        executor.spin_once(timeout_sec=0)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    simulate(Path(sys.argv[1]))
