# SPDX-License-Identifier: Apache-2.0
"""Base classes of the nodes of a mission."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent import futures
from functools import partial, wraps
import os
from threading import Thread
import time
import traceback
from typing import Any, TypeVar

from kbnitp_msgs.msg import AgentHealth, AgentState, AgentStatus, DeploymentReport, Recorded
from kbnitp_ros.configuration import make_grid, value_for
from kbnitp_ros.configuration.agents import own_base
from kbnitp_ros.configuration.field import graded_note
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.files import some, Waiting, waiting_for
from kbnitp_ros.log.roles import Roles
from kbnitp_ros.log.write import check_size
from kbnitp_ros.maps import Map
from kbnitp_ros.messages.deployments import read_path
from kbnitp_ros.messages.grids import read_map_message
from kbnitp_ros.messages.headers import check_texts, LATEST, shown
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.declared import declare, state
from kbnitp_ros.nodes.runtime.diagnostics import Diagnostics
from kbnitp_ros.nodes.runtime.graph import (
    decodable,
    discovery_warning,
    full_name,
    listening_roles,
    NAMELESS,
)
from kbnitp_ros.nodes.runtime.signals import stop_on_signal
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer
from rclpy.validate_full_topic_name import validate_full_topic_name

# Seconds: longest delay until a signal is handled, and period of polls.
SPIN = 0.2
POLL = 0.05

# Seconds that a message waits for the message that it refers to, since DDS keeps the order only
# within a topic; and the maximum number of waiting messages.
PATIENCE = 2.0
MAX_EARLY = 20

# Seconds to wait for the name of an author before it is reported without a name.
MAX_NAMELESS = 1.0

# Pause after a scan of the graph, in multiples of its duration.
REST = 4.0

# Seconds that a node stays for its last responses of services, which DDS does not acknowledge, and
# maximum seconds that it stays until subscribers have acknowledged its last messages.
FAREWELL = 0.3
ACKNOWLEDGED = 2.0

# Seconds until a node logs that it is waiting or reading (short waits are normal at a start), and
# seconds until it logs this again.
LOG_FIRST = 3.0
LOG_AGAIN = 10.0

# Name of the child logger for lines about deployments, which can be silenced separately.
DEPLOYMENTS = 'deployments'

T = TypeVar('T')

PACKAGE = __name__.partition('.')[0]


class MissionNode(Node):
    """A node of the mission, with its parameters and diagnostics."""

    make_executor: Callable[[], Executor] = staticmethod(EventsExecutor)

    get_publishers_info_by_topic = decodable(Node.get_publishers_info_by_topic)
    get_subscriptions_info_by_topic = decodable(Node.get_subscriptions_info_by_topic)
    get_node_names_and_namespaces = decodable(Node.get_node_names_and_namespaces)

    def __init__(self, name: str) -> None:
        # The first error of a callback.
        self.broken: BaseException | None = None
        super().__init__(name)
        # Parameters by name, kept up to date.
        self.values = declare(self, name)
        # Namespace of the mission: the node's namespace without the name of its agent.
        own = self.values.get('agent', '')
        self.above = self.get_namespace().rstrip('/').removesuffix(f'/{own}')
        # Topics of the node by role, stated in its parameters.
        self.roles = Roles.of(
            self.above,
            [own] if own else self.values['agents'],
            lambda role: self.resolve_topic_name(f'{self.above}/{role}'),
            name,
        )
        state(self, self.roles.names)
        self.diagnostics = Diagnostics(self)
        # Whether the node's work is done, so that the process ends; and its exit code.
        self.is_over, self.exit_code = False, 0
        self._refused_once: set[str] = set()
        # Time at which an author without a name was first seen, by topic, seconds.
        self._nameless_since: dict[str, float] = {}
        self._publisher_counts: dict[str, int] = {}
        self._author_counts: dict[str, int] = {}
        self.deployment_logger = self.get_logger().get_child(DEPLOYMENTS)
        self._awaited = ''
        self._log_at = 0.0
        self.create_poll(self._log_wait)
        if warning := discovery_warning(os.environ):
            self.get_logger().warning(warning)

    def now(self) -> int:
        """Return the ROS time in nanoseconds; 0 until a simulated clock has started."""
        return min(self.get_clock().now().nanoseconds, LATEST)

    def elapsed(self) -> int:
        """Return the time for deadlines, in nanoseconds from an arbitrary start."""
        is_simulated = self.get_parameter('use_sim_time').value
        return self.now() if is_simulated else time.monotonic_ns()

    def subscribe(
        self,
        kind: type,
        topic: str,
        callback: Callable[..., None],
        profile: QoSProfile,
        *,
        keeps_all: bool = True,
        is_timed: bool = False,
    ) -> Subscription:
        """Subscribe to a topic, with an unlimited queue of unread messages if `keeps_all`."""
        # A timed callback also takes the time of publication, in nanoseconds of the publisher's
        # system clock.
        kept = qos.unread_kept(profile) if keeps_all else profile

        def read(data: bytes, info: Any) -> None:
            # A message that cannot be recorded counts for nobody.
            try:
                check_size(data)
                message = deserialize_message(data, kind)
                check_texts(message)
            except (ValueError, RuntimeError) as error:
                self.diagnostics.refuse(topic, error)
            else:
                callback(message, *([info['source_timestamp']] if is_timed else ()))

        return self.create_subscription(kind, topic, read, kept, raw=True)

    def refuse_once(self, what: str, why: object) -> None:
        """Refuse something in the graph, unless it was refused with this reason before."""
        text = f'{what}: {why}'
        if text not in self._refused_once:
            self._refused_once.add(text)
            self.diagnostics.refuse(what, why)

    def get_topic_names_and_types(self, no_demangle: bool = False) -> list[tuple[str, list[str]]]:
        """Return the topics that have valid names, and their types."""
        valid = []
        for topic, types in decodable(Node.get_topic_names_and_types)(self, no_demangle):
            try:
                validate_full_topic_name(topic)
                valid.append((topic, types))
            except InvalidTopicNameException:
                self.refuse_once('the graph', f'{shown(topic)} is not a valid topic name')
        return valid

    def authors(self, topic: str, type_name: str) -> list[str]:
        """Return the sorted full names of the nodes that publish a type on a topic."""
        return sorted(
            full_name(each.node_namespace, each.node_name)
            for each in self.get_publishers_info_by_topic(topic)
            if each.topic_type == type_name
        )

    def named_authors(self, topic: str, type_name: str) -> list[str]:
        """Return the authors of a topic; empty until all are named, at most for `MAX_NAMELESS`."""
        # DDS discovers the publishers of a node a moment before its name.
        authors, now = self.authors(topic, type_name), time.monotonic()
        if NAMELESS not in authors:
            self._nameless_since.pop(topic, None)
            return authors
        return authors if now > self._nameless_since.setdefault(topic, now) + MAX_NAMELESS else []

    def count_authors(self, topic: str, type_name: str) -> int:
        """Return the number of publishers of a type on a topic."""
        # Query the types only if the count has changed: the query takes a hundred times as long.
        publishers = self.count_publishers(topic)
        if self._publisher_counts.get(topic) != publishers:
            self._publisher_counts[topic] = publishers
            known = self.get_publishers_info_by_topic(topic)
            self._author_counts[topic] = sum(each.topic_type == type_name for each in known)
        return self._author_counts[topic]

    def missing_listeners(self, publishers: Iterable[Publisher]) -> str | None:
        """Describe the nodes in `await_nodes` that do not subscribe yet; None if all do."""
        unread: dict[str, list[str]] = {}
        topics = [publisher.topic_name for publisher in publishers]
        for topic, listening in listening_roles(self, topics).items():
            for awaited in self.values['await_nodes']:
                if awaited not in listening:
                    unread.setdefault(awaited, []).append(topic)
        missing = [
            f'{awaited} to subscribe to {some(topics)}' for awaited, topics in unread.items()
        ]
        return f'{" and ".join(missing)} (parameter await_nodes)' if missing else None

    def _log_wait(self) -> None:
        """Log the state of a waiting node after `LOG_FIRST`, then every `LOG_AGAIN`."""
        state = self.diagnostics.state
        awaited = state if isinstance(state, Waiting) else ''
        now = time.monotonic()
        if awaited != self._awaited:
            self._awaited, self._log_at = awaited, now + LOG_FIRST
        elif awaited and now > self._log_at:
            self._log_at = now + LOG_AGAIN
            self.get_logger().info(awaited)

    def log_progress(self, items: Iterable[T], doing: str) -> Iterator[T]:
        """Yield items, and log their number if reading them takes long."""
        log_at = time.monotonic() + LOG_FIRST
        for number, item in enumerate(items):
            stop_on_signal()
            if time.monotonic() > log_at:
                log_at = time.monotonic() + LOG_AGAIN
                self.get_logger().info(f'{doing}: {number} messages so far')
            yield item

    def call_next(self, callback: Callable[[], object]) -> None:
        """Schedule a callback on the executor, from any thread."""
        if self.executor is not None:
            self.executor.create_task(self.guarded(callback))

    def compute(
        self, function: Callable[[], T], take: Callable[[futures.Future[T]], object]
    ) -> futures.Future[T]:
        """Run a function in a thread; `take` its future on the executor at its end."""
        future: futures.Future[T] = futures.Future()
        future.add_done_callback(lambda done: self.call_next(partial(take, done)))

        def run() -> None:
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)

        # A daemon thread, since a process waits for the threads of a pool before it ends.
        Thread(target=run, daemon=True).start()
        return future

    def guarded(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a callback: `spin_once` raises its errors; errors in rclpy are only reported."""
        # EventsExecutor crashes if the callback of a future or a task raises, and logs a fatal
        # error for other callbacks.

        @wraps(callback)
        def call(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except (Exception, KeyboardInterrupt) as error:
                # rclpy's own callbacks are for the clock and parameter services.
                frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][1:]
                rooms = [frame.f_globals.get('__name__', '').partition('.')[0] for frame in frames]
                if rooms[:1] == ['rclpy'] and PACKAGE not in rooms:
                    self.diagnostics.refuse('a clock message or parameter request', error)
                else:
                    self.broken = self.broken or error
            # The last argument of a service's callback is the response.
            return arguments[-1] if arguments else None

        return call

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *arguments: Any, **options: Any
    ) -> Subscription:
        """Subscribe to a topic, with a guarded callback."""
        guarded = self.guarded(callback)

        @wraps(callback)
        def call(message: Any, *info: Any) -> Any:
            # EventsExecutor passes a message and its info as one tuple.
            return guarded(*(message if isinstance(message, tuple) else (message, *info)))

        return super().create_subscription(msg_type, topic, call, *arguments, **options)

    def create_timer(
        self, timer_period_sec: float, callback: Any, *arguments: Any, **options: Any
    ) -> Timer:
        """Create a timer, with a guarded callback."""
        guarded = self.guarded(callback)
        return super().create_timer(timer_period_sec, guarded, *arguments, **options)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Any, *arguments: Any, **options: Any
    ) -> Any:
        """Create a service, whose guarded callback returns the response or its future."""
        guarded = self.guarded(callback)
        service: Any = super().create_service(srv_type, srv_name, guarded, *arguments, **options)
        send = service.send_response

        def answer(response: Any, header: Any) -> None:
            if isinstance(response, Future):
                response.add_done_callback(self.guarded(lambda done: send(done.result(), header)))
            else:
                send(response, header)

        service.send_response = answer
        return service

    def create_poll(self, callback: Callable[[], None], period: float = POLL) -> Timer:
        """Call back with this period, in seconds, also when simulated time stands still."""
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def create_look(self, look: Callable[[], None]) -> Timer:
        """Call back like `create_poll` to scan the graph, but less often if a scan takes long."""
        due = 0.0

        def look_if_due() -> None:
            nonlocal due
            if time.monotonic() < due:
                return
            # CPU time, since time of other processes must not count.
            begun = time.thread_time()
            look()
            due = time.monotonic() + REST * (time.thread_time() - begun)

        return self.create_poll(look_if_due)

    def end(self, exit_code: int = 0) -> None:
        """End the process after a last diagnostics message."""
        self.is_over, self.exit_code = True, exit_code
        self.diagnostics.publish()

    def finish(self) -> None:
        """Complete pending work before the node is closed."""

    def close(self) -> None:
        """Wait until the last messages have been received: DDS drops them with the publisher."""
        if self.is_over:
            time.sleep(FAREWELL)
        end = time.monotonic() + ACKNOWLEDGED
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))


# Topics of an agent's evidence, by type.
AGENT_TOPICS: dict[type, str] = {
    Path: 'path',
    DeploymentReport: 'report',
    AgentHealth: 'health',
    AgentState: 'state',
    AgentStatus: 'status',
    Recorded: 'recorded',
}


class FieldNode(MissionNode):
    """A node of the mission that knows the field."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._grid: Grid | None = None
        self._map: Map | None = None
        if self.values['map_topic']:
            topic = self._topic = self.resolve_topic_name(self.values['map_topic'])
            self.subscribe(OccupancyGrid, topic, self._on_map, qos.LATCHED)
            self.diagnostics.state = waiting_for(f'a map on {topic} (parameter map_topic)')
            executor = self.make_executor()
            executor.add_node(self)
            try:
                while self._grid is None:
                    stop_on_signal()
                    spin_once(self, executor, SPIN)
            finally:
                executor.remove_node(self)
                executor.shutdown()
        else:
            self._grid = make_grid(self.values)
        self._warn_of_graded(name)

    def _warn_of_graded(self, name: str) -> None:
        """Warn of pixels that are neither free nor occupied, in one node of the mission."""
        if name == 'planner' and (note := graded_note(self.values, self._map)):
            self.get_logger().warning(note)

    @property
    def grid(self) -> Grid:
        """Return the grid, the same for all nodes of a mission."""
        assert self._grid is not None
        return self._grid

    def read_path(self, agent: str, message: Path) -> tuple[DeploymentKey, NDArray[np.intp]]:
        """Return the deployment and the cells of a path, after checking it for the agent."""
        key, cells = read_path(self.grid, agent, message)
        grid = self.grid.at(own_base(self.values, agent, self.grid))
        return key, grid.check_path(cells, value_for(self.values, 'max_steps', agent))

    def subscribe_to_agent(
        self, kind: type, agent: str, callback: Callable[[Any], None]
    ) -> Subscription:
        """Subscribe to a topic of an agent."""
        topic = f'{self.above}/{agent}/{AGENT_TOPICS[kind]}'
        profile = {AgentState: qos.LATCHED, AgentHealth: qos.READINGS}.get(kind, qos.EVIDENCE)
        return self.subscribe(kind, topic, callback, profile)

    def _on_map(self, message: OccupancyGrid) -> None:
        try:
            read = Map(*read_map_message(message))
            grid = make_grid(self.values, read)
            if self._grid not in (None, grid):
                raise ValueError(
                    'the map has changed: this mission continues with its first map; begin '
                    'another mission for the new map'
                )
        except ValueError as error:
            self.diagnostics.refuse(self._topic, error)
        else:
            self._grid, self._map = grid, read


def spin_once(node: MissionNode, executor: Executor, seconds: float) -> None:
    """Wait for a callback and call it; raise its exceptions."""
    executor.spin_once(timeout_sec=seconds)
    if node.broken:
        raise node.broken
