# SPDX-License-Identifier: Apache-2.0
"""Nav2, detectors and network links of a real robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fcntl import ioctl
from functools import partial
from itertools import pairwise
from math import ceil, hypot
import socket
import struct
import time
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.grids import orientation_fields
from kbnitp_ros.messages.headers import header, read_stamp, shown
from kbnitp_ros.nodes.recorded_topics import message_class
from kbnitp_ros.nodes.runtime.node import MissionNode
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from nav2_msgs.action import FollowPath, FollowWaypoints, NavigateThroughPoses
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters
from rclpy.action.client import ActionClient, ClientGoalHandle
from rclpy.task import Future

PERIOD = 1.0  # Seconds between two requests.


# From linux/sockios.h and linux/if.h.
SIOCGIFFLAGS, SIOCGIFADDR = 0x8913, 0x8915
IFF_LOOPBACK, IFF_RUNNING = 0x8, 0x40

# A `struct ifreq` begins with a name; flags, or the family and port of an address, follow.
REQUEST, FLAGS, ADDRESS = struct.Struct('16s24x'), struct.Struct('16xH'), struct.Struct('20x4s')


def addresses() -> dict[str, str]:
    """Return the IPv4 address of each network interface with a link, by name, except lo."""
    found = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            request = REQUEST.pack(name.encode())
            try:
                (flags,) = FLAGS.unpack_from(ioctl(asked, SIOCGIFFLAGS, request))
                (address,) = ADDRESS.unpack_from(ioctl(asked, SIOCGIFADDR, request))
            except OSError:
                # The interface has no address, or is gone.
                continue
            if flags & IFF_RUNNING and not flags & IFF_LOOPBACK:
                found[name] = socket.inet_ntoa(address)
    return found


# Message types by the parameter detection_type; vision_msgs may not be installed.
TYPES = {'bool': 'std_msgs/msg/Bool', 'detection2d_array': 'vision_msgs/msg/Detection2DArray'}


def detection_class(name: str) -> type:
    """Return the message class of a value of the parameter detection_type."""
    try:
        return message_class(TYPES[name])
    except LookupError as error:
        package = TYPES[name].partition('/')[0]
        raise ValueError(
            f'parameter detection_type is {name!r}: {error}; install {package} (by rosdep, or as '
            f'ros-jazzy-{package.replace("_", "-")}), make robots, or use a detector that '
            'publishes std_msgs/Bool'
        ) from error


def read_detection(message: Any, values: Mapping[str, Any]) -> tuple[bool, int | None]:
    """Return whether a detector saw a target, and the stamp in ns (None if there is no stamp)."""
    if values['detection_type'] == 'bool':
        return bool(message.data), None
    wanted, least = values['detection_class'], values['detection_score']
    seen = any(
        result.hypothesis.class_id == (wanted or result.hypothesis.class_id)
        and result.hypothesis.score >= least
        for detection in message.detections
        for result in detection.results
    )
    stamp = read_stamp('header.stamp', message.header.stamp)
    # The stamp is 0 if the detector does not fill the header.
    return seen, stamp or None


# Maximum distance between poses of a path for a controller, in metres.
SPACING = 0.1

ENDINGS = {
    GoalStatus.STATUS_ABORTED: 'aborted',
    GoalStatus.STATUS_CANCELED: 'cancelled',
}


# Action type and serving node of Nav2, by value of the parameter driver.
DRIVERS: dict[str, tuple[Any, str]] = {
    'follow_waypoints': (FollowWaypoints, 'waypoint_follower'),
    'navigate_through_poses': (NavigateThroughPoses, 'bt_navigator'),
    'follow_path': (FollowPath, 'controller_server'),
}

# Names of the error codes in results, which Nav2 numbers across its actions.
ERRORS = {
    code: name
    for action, _ in DRIVERS.values()
    for name, code in vars(action.Result).items()
    if isinstance(code, int) and code
}


def describe_error(result: Any) -> str:
    """Return the error code of a result with its name, and its message; empty without both."""
    # The servers of Jazzy state the code, and hardly ever a message.
    code = f'error {result.error_code} {ERRORS.get(result.error_code, "")}'.strip()
    message = shown(result.error_msg) if result.error_msg else ''
    return ', '.join(filter(None, [code if result.error_code else '', message]))


# Nav2 would place a goal by the transform at its stamp, and not see later corrections of the map.
NO_STAMP = 0


def goal_along(action: Any, points: NDArray[np.float64], yaws: Sequence[float] = ()) -> Any:
    """Return the goal along points (n, 2), the robot's first; `yaws`: that of the last, if any."""
    if action is not FollowPath:
        return action.Goal(poses=poses_along(points, yaws)[1:])
    stretches = [
        np.linspace(start, end, max(1, ceil(hypot(*(end - start)) / SPACING)), endpoint=False)
        for start, end in pairwise(points)
    ]
    dense = np.concatenate([*stretches, points[-1:]])
    return action.Goal(path=Path(header=header(NO_STAMP), poses=poses_along(dense, yaws)))


def poses_along(points: NDArray[np.float64], yaws: Sequence[float] = ()) -> list[PoseStamped]:
    """Return a pose at each point, heading from the point before it; `yaws`: the last one's."""
    moves = np.diff(points, axis=0)
    directions = np.arctan2(moves[:, 1], moves[:, 0]).tolist()
    if yaws:
        directions[-1:] = yaws
    return [
        PoseStamped(
            header=header(NO_STAMP),
            pose=Pose(
                position=Point(x=x, y=y),
                orientation=Quaternion(**vars(orientation_fields(yaw))),
            ),
        )
        for (x, y), yaw in zip(points.tolist(), [*directions[:1], *directions])
    ]


# Parameters of Nav2 with the distance from a goal at which it counts as reached, in metres.
TOLERANCES = ('goal_checker.xy_goal_tolerance', 'general_goal_checker.xy_goal_tolerance')

# Parameters of Nav2 with its maximum speed, in m/s, and those, by node.
LIMITS = {
    'controller_server': (
        'FollowPath.desired_linear_vel', 'FollowPath.max_vel_x', 'FollowPath.vx_max', *TOLERANCES,
    ),
    'velocity_smoother': ('max_velocity',),
}  # fmt: skip


class Driver:
    """A client that drives the robot along legs, one goal at a time."""

    def __init__(
        self,
        node: MissionNode,
        name: str,
        namespace: str,
        grid: Grid,
        home: Sequence[float],
        patience: float,
    ) -> None:
        # Whether a goal is active.
        self.is_busy = False
        # Why the last goal failed; empty if it succeeded.
        self.failure = ''
        # Whether another client cancelled the last goal.
        self.was_cancelled = False
        self._node = node
        self._grid = grid
        # Place where legs into the base end: x, y and, if it matters, yaw.
        self._home = home
        self._patience = patience
        action, server = DRIVERS[name]
        above = f'/{namespace.strip("/")}'.rstrip('/')
        self.name = node.resolve_topic_name(f'{above}/{name}' if namespace else name)
        self._goal_along = partial(goal_along, action)
        self._client = ActionClient(node, action, self.name)
        # The node of the action server, and its lifecycle state.
        self._server = f'{self.name.rpartition("/")[0]}/{server}'
        self._states = node.create_client(GetState, f'{self._server}/get_state')
        self._state: State | None = None
        self._asked_at = 0.0
        # The largest speed and goal tolerance that nodes of Nav2 have as parameters, in m/s and m;
        # 0 while it is unknown.
        self.max_speed = self.goal_tolerance = 0.0
        nodes = self.name.rpartition('/')[0]
        self._limits = {
            node.create_client(GetParameters, f'{nodes}/{each}/get_parameters'): names
            for each, names in LIMITS.items()
        }
        # Unanswered requests for a limit, with their times.
        self._limit_requests: dict[Future, float] = {}
        # Whether the server accepted the last goal that probed it; None before its answer.
        self._takes_goals: bool | None = None
        self._tried_at = 0.0
        self._handle: ClientGoalHandle | None = None
        # Number of the goal whose answers count; a new goal or a cancellation increases it.
        self._number = 0
        self._fed_back_at = 0.0

    @property
    def awaited(self) -> str:
        """Describe the missing action server; empty if it is there."""
        if self._client.server_is_ready():
            return ''
        return f'the action server {self.name} (parameters driver and nav_namespace)'

    def not_ready(self, place: tuple[float, float]) -> str:
        """Describe the condition of Nav2 that blocks the first goal; empty if there is none."""
        # An action server of Nav2 exists before it is active, and rejects goals until then.
        if awaited := self.awaited:
            return awaited
        if any(time.monotonic() < asked + PERIOD for asked in self._limit_requests.values()):
            return 'Nav2 to state its maximum speed and goal tolerance'
        if self._states.service_is_ready():
            return self._not_active()
        # A server without a lifecycle is probed by a goal at the robot's own place.
        if self._takes_goals:
            self._takes_goals = None
            return ''
        if time.monotonic() > self._tried_at + PERIOD:
            self._tried_at = time.monotonic()
            goal = self._goal_along(np.array([place, place]))
            self._client.send_goal_async(goal).add_done_callback(
                self._node.guarded(self._on_tried)
            )
        if self._takes_goals is None:
            return f'the action server {self.name} to answer'
        return f'Nav2 to be ready: the action server {self.name} rejects goals'

    @property
    def is_down(self) -> bool:
        """Return whether Nav2 is known to be absent or inactive."""
        if self.awaited:
            return True
        is_inactive = self._states.service_is_ready() and bool(self._not_active())
        return is_inactive and self._state is not None

    def _ask_limits(self) -> None:
        """Ask the nodes of Nav2 for their limits; each is asked once, name by name."""
        for client in [each for each in self._limits if each.service_is_ready()]:
            # Nav2 answers nothing if it lacks one of the names.
            for name in self._limits.pop(client):
                request = client.call_async(GetParameters.Request(names=[name]))
                self._limit_requests[request] = time.monotonic()
                request.add_done_callback(self._node.guarded(partial(self._on_limit, name)))

    def _on_limit(self, name: str, answer: Future) -> None:
        self._limit_requests.pop(answer, None)
        for value in answer.result().values:
            limits = [value.double_value, *value.double_array_value[:1]]
            if name in TOLERANCES:
                self.goal_tolerance = max(self.goal_tolerance, *limits)
            else:
                self.max_speed = max(self.max_speed, *limits)

    def _not_active(self) -> str:
        """Describe the lifecycle state of the action server's node; empty if it is active."""
        now = time.monotonic()
        if now > self._asked_at + PERIOD:
            if now > self._asked_at + 2 * PERIOD:
                # A state from before a pause in the requests may be outdated.
                self._state = None
            self._asked_at = now
            answer = self._states.call_async(GetState.Request())
            answer.add_done_callback(self._node.guarded(self._on_state))
        if self._state is None:
            return f'{self._server} to report its lifecycle state'
        if self._state.id == State.PRIMARY_STATE_ACTIVE:
            return ''
        return f'{self._server} to be active: its lifecycle state is {shown(self._state.label)}'

    def _on_state(self, answer: Future) -> None:
        self._state = answer.result().current_state

    def _on_tried(self, answer: Future) -> None:
        handle = answer.result()
        self._takes_goals = handle.accepted
        if handle.accepted:
            handle.cancel_goal_async()

    def drive(self, start: tuple[float, float], leg: Sequence[int]) -> None:
        """Send the robot from its position x, y along a leg that starts in its cell."""
        points = np.concatenate([[start], self._grid.centers(leg[1:] or leg)])
        yaws: Sequence[float] = ()
        if leg[-1] == self._grid.base:
            points[-1], yaws = self._home[:2], self._home[2:]
        self._number += 1
        number = self._number
        self.is_busy, self.failure, self.was_cancelled, self._handle = True, '', False, None
        self._fed_back_at = time.monotonic()
        goal = self._goal_along(points, yaws)

        def on_feedback(_: object) -> None:
            if number == self._number:
                self._fed_back_at = time.monotonic()

        answer = self._client.send_goal_async(goal, on_feedback)
        answer.add_done_callback(self._node.guarded(partial(self._on_answer, number)))

    def look(self) -> None:
        """End the drive if the action server is gone or silent; to be called repeatedly."""
        self._ask_limits()
        if not self.is_busy:
            return
        if not self._client.server_is_ready():
            self._end(self._number, f'the action server {self.name} has left the graph')
        elif (silent := time.monotonic() - self._fed_back_at) > self._patience:
            self._end(
                self._number,
                f'the action server {self.name} has been silent for {silent:.0f} s '
                '(parameter server_timeout)',
            )
            self.cancel()

    def cancel(self) -> None:
        """Stop the robot where it is."""
        if self._handle is not None:
            self._handle.cancel_goal_async()
        self._number += 1
        self.is_busy = False

    def _on_answer(self, number: int, answer: Future) -> None:
        handle = answer.result()
        if number != self._number:
            # The goal was cancelled before it was accepted.
            if handle.accepted:
                handle.cancel_goal_async()
            return
        self._fed_back_at = time.monotonic()
        if not handle.accepted:
            self._end(number, f'the action server {self.name} rejected the goal')
            return
        self._handle = handle
        result = handle.get_result_async()
        result.add_done_callback(self._node.guarded(partial(self._on_result, number)))

    def _on_result(self, number: int, result: Future) -> None:
        ended = result.result()
        error = describe_error(ended.result)
        why = f': {error}' if error else ''
        missed = [each.index for each in getattr(ended.result, 'missed_waypoints', ())]
        if ended.status != GoalStatus.STATUS_SUCCEEDED:
            how = ENDINGS.get(ended.status, f'ended with status {ended.status}')
            if number == self._number:
                self.was_cancelled = ended.status == GoalStatus.STATUS_CANCELED
            self._end(number, f'the goal of {self.name} was {how}{why}')
        elif ended.result.error_code:
            self._end(number, f'the goal of {self.name} failed{why}')
        elif missed:
            self._end(number, f'waypoints {missed} of the goal of {self.name} were missed')
        else:
            self._end(number, '')

    def _end(self, number: int, failure: str) -> None:
        if number == self._number and self.is_busy:
            self.is_busy, self.failure = False, failure
