# SPDX-License-Identifier: Apache-2.0
"""What makes the callbacks of a node."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from functools import partial
from itertools import dropwhile
import time
import traceback
from types import FrameType
from typing import Any

from rclpy.client import Client
from rclpy.event_handler import EventHandler
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future, Task
from rclpy.timer import Timer
from rclpy.utilities import timeout_sec_to_nsec
from rclpy.waitable import NumberOfEntities, Waitable

# How often it is looked whether DDS has an event to tell, such as a publisher that nobody can hear
# for its quality of service, in seconds. A node has two for each topic, and to wait for them with
# each message takes longer than to wait for all else.
LOOK = 0.05


class OneByOne(Executor):
    """
    Makes the callbacks of nodes one after another, in the thread that spins.

    rclpy's own executors collect all that they wait for anew, several times for each callback, and
    make a task of it, which takes longer than most callbacks of this package. This one collects it
    when something has been created or destroyed. Callbacks are functions and no coroutines.
    The experimental `EventsExecutor` of rclpy 7.1.5 ends with a SystemError in the recorder.
    """

    def __init__(self) -> None:
        self._has_changed = True
        self._held = ExitStack()
        self._ready: deque[Callable[[], None]] = deque()
        self._waitables: list[Waitable] = []
        self._events: list[Waitable] = []
        self._look_at = 0.0
        super().__init__()

    def wake(self) -> None:
        """Take note that something was created or destroyed."""
        self._has_changed = True
        super().wake()

    def call_next(self, callback: Callable[[], object]) -> None:
        """Have a callback made, as another thread asks for it; none after the shutdown."""
        with suppress(AttributeError, rclpy_implementation.InvalidHandle):
            self.create_task(callback)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Let go of all that was waited for."""
        self._ready.clear()
        self._held.close()
        return bool(super().shutdown(timeout_sec))

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Make the callback that is next, or wait for one; an error in it is raised."""
        if not self._ready:
            self._wait(timeout_sec)
        if self._ready:
            self._ready.popleft()()

    def _collect(self) -> None:
        """Collect all that is waited for; what is held is not destroyed before the next time."""
        self._has_changed = False
        self._held.close()
        nodes = self.get_nodes()

        def held(entities: Iterable[Any]) -> list[Any]:
            return [each for each in entities if self._hold(each.handle)]

        self._subscriptions = held(each for node in nodes for each in node.subscriptions)
        self._timers = held(each for node in nodes for each in node.timers)
        self._clients = held(each for node in nodes for each in node.clients)
        self._services = held(each for node in nodes for each in node.services)
        waitables = [each for node in nodes for each in node.waitables if self._hold(each)]
        self._events = [each for each in waitables if isinstance(each, EventHandler)]
        self._waitables = [each for each in waitables if not isinstance(each, EventHandler)]
        self._hold(self._guard.handle)
        self._hold(self._context.handle)
        count = NumberOfEntities(
            len(self._subscriptions),
            1,
            len(self._timers),
            len(self._clients),
            len(self._services),
        )
        for waitable in waitables:
            count += waitable.get_num_entities()
        self._wait_set = rclpy_implementation.WaitSet(
            count.num_subscriptions,
            count.num_guard_conditions,
            count.num_timers,
            count.num_clients,
            count.num_services,
            count.num_events,
            self._context.handle,
        )
        self._hold(self._wait_set)

    def _hold(self, handle: Any) -> bool:
        """Keep something from being destroyed, and say whether it has not been already."""
        try:
            self._held.enter_context(handle)
        except rclpy_implementation.InvalidHandle:
            return False
        return True

    def _wait(self, timeout_sec: float | None) -> None:
        """Wait until callbacks are to be made, and remember them."""
        with self._tasks_lock:
            tasks, self._tasks = self._tasks, []
        if tasks:
            self._ready.extend(partial(run_task, task) for task, _, _ in tasks)
            return
        if self._has_changed:
            self._collect()
        wait_set = self._wait_set
        wait_set.clear_entities()
        for each in self._subscriptions:
            wait_set.add_subscription(each.handle)
        for each in self._timers:
            wait_set.add_timer(each.handle)
        for each in self._clients:
            wait_set.add_client(each.handle)
        for each in self._services:
            wait_set.add_service(each.handle)
        wait_set.add_guard_condition(self._guard.handle)
        waitables = self._waitables
        if (now := time.monotonic()) > self._look_at:
            self._look_at = now + LOOK
            waitables = waitables + self._events
        for each in waitables:
            each.add_to_wait_set(wait_set)
        wait_set.wait(timeout_sec_to_nsec(timeout_sec))
        if not self._context.ok():
            raise ExternalShutdownException
        for each in waitables:
            if each.is_ready(wait_set):
                self._ready.append(partial(self._handle_waitable, each))
        for kind, entities, handle in (
            ('timer', self._timers, handle_timer),
            ('subscription', self._subscriptions, handle_subscription),
            ('client', self._clients, self._handle_client),
            ('service', self._services, handle_service),
        ):
            if pointers := wait_set.get_ready_entities(kind):
                self._ready.extend(
                    partial(handle, each) for each in entities if each.handle.pointer in pointers
                )
        if not self._ready:
            # An event ends the wait of what it is about, again and again until it is looked at.
            self._look_at = 0.0

    def _handle_waitable(self, waitable: Waitable) -> None:
        run_task(Task(waitable.execute, (waitable.take_data(),)))

    def _handle_client(self, client: Client) -> None:
        kind: Any = client.srv_type
        taken = take(client.handle, lambda handle: handle.take_response(kind.Response))
        if taken is None or taken[0] is None:
            return
        header, response = taken
        try:
            future = client.get_pending_request(header.request_id.sequence_number)
        except KeyError:
            # Nobody waits for the answer any more.
            return
        future._set_executor(self)
        future.set_result(response)


def call(callback: Callable[..., Any], *arguments: Any) -> Any:
    """Make a callback: what is below this in a traceback is of who gave it."""
    return callback(*arguments)


def frames_of_callback(error: BaseException) -> list[FrameType]:
    """Return where an error was raised, from the callback on; nothing if it was in none."""
    frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
    # Those up to the first call are of this module and of who spins.
    return list(dropwhile(lambda frame: frame.f_code is not call.__code__, frames))[1:]


def take(handle: Any, taken: Callable[[Any], Any]) -> Any:
    """Return what is taken of an entity; None if it has been destroyed."""
    try:
        with handle:
            return taken(handle)
    except rclpy_implementation.InvalidHandle:
        return None


def run_task(task: Task) -> None:
    """Run what rclpy calls a task; an error in it is raised."""
    task()
    if task.exception() is not None:
        raise task.exception()


def handle_timer(timer: Timer) -> None:
    """Make the callback of a timer, unless it has been cancelled or has been called."""

    def is_due(handle: Any) -> bool:
        if not handle.is_timer_ready():
            return False
        handle.call_timer()
        return True

    if take(timer.handle, is_due):
        call(timer.callback)


def handle_subscription(subscription: Subscription) -> None:
    """Make the callback of a subscription, unless its message has been taken."""
    taken = take(
        subscription.handle,
        lambda handle: handle.take_message(subscription.msg_type, subscription.raw),
    )
    if taken is not None:
        wants_message_only = subscription._callback_type is Subscription.CallbackType.MessageOnly
        call(subscription.callback, *(taken[:1] if wants_message_only else taken))


def handle_service(service: Service) -> None:
    """Answer what a service was asked, at once or when the callback's future is done."""
    kind: Any = service.srv_type
    taken = take(service.handle, lambda handle: handle.service_take_request(kind.Request))
    if taken is not None and taken[1] is not None:
        request, header = taken
        answer = call(service.callback, request, kind.Response())
        if isinstance(answer, Future):
            answer.add_done_callback(lambda done: service.send_response(done.result(), header))
        else:
            service.send_response(answer, header)
