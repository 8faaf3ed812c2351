# SPDX-License-Identifier: Apache-2.0
"""What the four nodes have in common: how they start, run and end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
import ctypes
import signal
import sys
import time
import traceback
from typing import Any, TypeVar

from kbnitp_ros.core import while_compiling
from kbnitp_ros.files import in_words
from kbnitp_ros.messages.headers import LATEST
from kbnitp_ros.messages.sizes import check_size
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.command_line import node_parser
from kbnitp_ros.nodes.diagnostics import Diagnostics
from kbnitp_ros.nodes.executor import frames_of_callback, OneByOne
from kbnitp_ros.nodes.exit_timer import exit_at_the_latest
from kbnitp_ros.nodes.given import check_given, names_given
from kbnitp_ros.nodes.parameters import declare
from kbnitp_ros.nodes.roles import Listeners
import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.utilities import ok, remove_ros_args, try_shutdown

# In seconds: how long a signal may have to wait, and how often a node looks at the graph.
SPIN = 0.2
POLL = 0.05

# How long a node may take to leave the graph, in seconds.
TEARDOWN = 3.0

# How long a node waits for the readers of its last messages, in seconds: they may have died.
FAREWELL = 0.3

# In seconds: how long a node waits, or reads, before it says so, since all do for a moment when a
# mission begins, and how often it says so again.
SAY_FIRST = 3.0
SAY_AGAIN = 10.0

# The logger, below that of its node, which has a line for each deployment.
DEPLOYMENTS = 'deployments'

# How many of many topics, or robots, a line on the console names.
NAMED = 3

T = TypeVar('T')

PACKAGE = __name__.partition('.')[0]

# What a user can cause: rclpy reports bad arguments as RuntimeError.
START_ERRORS = (
    ValueError,
    OSError,
    RuntimeError,
    ParameterException,
    NameValidationException,
)


# What ends a node, and what of it this process was sent, one after another.
ENDING = (signal.SIGINT, signal.SIGTERM)
SIGNALS: list[int] = []


class StoppedError(BaseException):
    """A signal came before the node was made or while it compiles; no error to be handled."""


def _stop_on_signal() -> None:
    """End what takes long after a signal, such as a compilation of up to a minute."""
    if SIGNALS:
        raise StoppedError


class Shell(Node):
    """
    A node of the mission: its parameters and its diagnostics.

    Attributes
    ----------
    values : dict
        The parameters by name, kept up to date.
    diagnostics : Diagnostics
        What it has accepted and refused.
    is_over : bool
        Whether its work is done, so that its process ends.

    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.values = declare(self, name)
        self.diagnostics = Diagnostics(self)
        self.is_over = False
        self._publisher_counts: dict[str, int] = {}
        self._author_counts: dict[str, int] = {}
        self._deployments = self.get_logger().get_child(DEPLOYMENTS)
        self._awaited = ''
        self._say_at = 0.0
        self.create_poll(self._say_what_is_awaited)

    def now(self) -> int:
        """
        Return the ROS time in nanoseconds; 0 as long as a simulated clock has not started.

        It is never later than the last time that a message may tell.
        """
        return min(self.get_clock().now().nanoseconds, LATEST)

    def hear(
        self,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        profile: QoSProfile,
        largest: int,
    ) -> Subscription:
        """
        Subscribe to messages of which anybody may send any.

        One that is too large, or not of the type, is refused here. None that waits to be read is
        given up for another, however many are sent: publishers are told to send it again.

        Parameters
        ----------
        kind : type
            Of the messages.
        topic : str
            Its name.
        callback : callable
            Called with each message.
        profile : QoSProfile
            Of the publisher.
        largest : int
            The most bytes that a message can have.

        """
        return self.hear_newest(kind, topic, callback, qos.unread_kept(profile), largest)

    def hear_newest(
        self,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        profile: QoSProfile,
        largest: int,
    ) -> Subscription:
        """
        Subscribe as `hear` does, but to as many unread messages as the profile says.

        Of what comes all the time, such as poses, the newest count.
        """

        def read(data: bytes) -> None:
            try:
                check_size(data, largest)
                message = deserialize_message(data, kind)
            except (ValueError, RuntimeError) as error:
                self.diagnostics.refuse(topic, error)
            else:
                callback(message)

        return self.create_subscription(kind, topic, read, profile, raw=True)

    def count_authors(self, topic: str, type_name: str) -> int:
        """Return how many publish messages of this type on a topic; others do not count."""
        # To ask who they are takes a hundred times as long, and they seldom change.
        publishers = self.count_publishers(topic)
        if self._publisher_counts.get(topic) != publishers:
            self._publisher_counts[topic] = publishers
            known = self.get_publishers_info_by_topic(topic)
            self._author_counts[topic] = sum(each.topic_type == type_name for each in known)
        return self._author_counts[topic]

    def waiting_for(self, publishers: Iterable[Publisher]) -> str:
        """
        Return which of the parameter `await_nodes` do not listen yet; empty when all do.

        It names nodes, or the roles that they serve.
        """
        listeners = Listeners(self)
        deaf: dict[str, list[str]] = {}
        for topic in (publisher.topic_name for publisher in publishers):
            listening = listeners.roles(topic)
            for awaited in self.values['await_nodes']:
                if awaited not in listening:
                    deaf.setdefault(awaited, []).append(topic)
        missing = [f'{awaited} to listen to {some(topics)}' for awaited, topics in deaf.items()]
        return f'waiting for {" and ".join(missing)} (parameter await_nodes)' if missing else ''

    def _say_what_is_awaited(self) -> None:
        """Say on the console what the node waits for, when it has for a while and again later."""
        awaited = self.diagnostics.state if self.diagnostics.state.startswith('waiting') else ''
        now = time.monotonic()
        if awaited != self._awaited:
            self._awaited, self._say_at = awaited, now + SAY_FIRST
        elif awaited and now > self._say_at:
            self._say_at = now + SAY_AGAIN
            self.get_logger().info(awaited)

    def tell_deployment(self, words: str) -> None:
        """Say something of a deployment on the console, by a logger that can be silenced alone."""
        # The logger's own methods look for the source of each of their callers, which takes longer
        # than to take a deployment in.
        here = sys._getframe()
        rclpy_implementation.rclpy_logging_rcutils_log(
            LoggingSeverity.INFO,
            self._deployments.name,
            words,
            here.f_code.co_name,
            here.f_code.co_filename,
            here.f_lineno,
        )

    def tell_progress(self, items: Iterable[T], doing: str) -> Iterator[T]:
        """
        Pass items on, and say on the console how many, as long as it takes.

        Parameters
        ----------
        items : iterable
            Such as the messages of a log.
        doing : str
            What is done with them: 'taking in FILE'.

        Yields
        ------
        object
            Each of the items.

        Raises
        ------
        StoppedError
            If a signal comes before the last.

        """
        say_at = time.monotonic() + SAY_FIRST
        for number, item in enumerate(items):
            _stop_on_signal()
            if time.monotonic() > say_at:
                say_at = time.monotonic() + SAY_AGAIN
                self.get_logger().info(f'{doing}: {number} messages so far')
            yield item

    def create_poll(self, callback: Callable[[], None]) -> Timer:
        """Call back every `POLL` seconds, also when simulated time stands still."""
        return self.create_timer(POLL, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def spin_until(self, condition: Callable[[], bool]) -> None:
        """
        Take messages until something holds that the node cannot be made without.

        Raises
        ------
        StoppedError
            If a signal comes before.

        """
        executor = OneByOne()
        executor.add_node(self)
        try:
            while not condition():
                _stop_on_signal()
                _spin(self, executor, SPIN)
        finally:
            executor.remove_node(self)
            executor.shutdown()

    def end(self) -> None:
        """End the process, with exit code 0, once it is known why."""
        self.is_over = True
        self.diagnostics.publish()

    def finish(self) -> None:
        """Do what is left to do, before the node is closed."""

    def close(self) -> None:
        """Stay until what was published last has arrived: DDS drops it with the publisher."""
        if self.is_over:
            # Nobody tells when the answer of a service has arrived.
            time.sleep(FAREWELL)
        end = time.monotonic() + FAREWELL
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))


def some(items: Iterable[object]) -> str:
    """Return the first few of some items in words, and how many more there are."""
    first = [str(each) for each in items]
    more = len(first) - NAMED
    return ', '.join(first[:NAMED]) + (f' and {more} more' if more > 0 else '')


def run(
    name: str, make: Callable[[], Shell], args: Sequence[str] | None, linger: float = 0.0
) -> int:
    """
    Run a node until SIGINT or SIGTERM, or its end, and return the exit code of its process.

    Parameters
    ----------
    name : str
        The executable, which its messages on stderr begin with.
    make : callable
        Makes the node, once ROS is up; its docstring is the executable's help.
    args : sequence of str, optional
        The command line without the program; that of the process when None.
    linger : float
        How long the node still listens after the signal, in seconds: what was sent before is still
        on its way, and nodes that end one after another do not get in each other's way.

    Returns
    -------
    int
        0 after a signal or when its work is done; 2 if the node could not start, 1 if it could not
        go on: then one line on stderr says why, and so does diagnostics.

    """
    SIGNALS.clear()
    for number in ENDING:
        signal.signal(number, lambda received, _: SIGNALS.append(received))
    while_compiling(_stop_on_signal)
    try:
        return _run(name, make, list(sys.argv[1:] if args is None else args), linger)
    finally:
        # Python gives up its handlers before it ends: a second Ctrl-C would kill what ended well.
        # It would complain of one that comes in this very moment, in whatever thread, so the
        # process ignores them before Python does.
        for number in ENDING:
            ctypes.pythonapi.PyOS_setsig(number, ctypes.c_void_p(signal.SIG_IGN))
            signal.signal(number, signal.SIG_IGN)


def _run(name: str, make: Callable[[], Shell], arguments: list[str], linger: float) -> int:
    """Run a node, and return the exit code of its process."""
    parser = node_parser(name, str(make.__doc__))
    try:
        # ROS has worse words for a file that is not there.
        check_given(name, arguments)
        parser.parse_args(remove_ros_args(arguments))
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
    except StoppedError:
        _leave(0)
        return 0
    except START_ERRORS as error:
        _complain(name, error)
        _say_why_not_started(name, arguments, error)
        _leave(2)
        return 2
    executor = OneByOne()
    executor.add_node(node)
    code = 1
    try:
        broken = _live(node, executor, linger)
        if broken:
            if not isinstance(broken, OSError):
                # No message and no user may cause it: a fault of this package.
                traceback.print_exception(broken)
            _complain(name, broken)
            node.diagnostics.fail(broken)
        else:
            code = 0
    finally:
        _leave(code, executor, node)
    return code


def _live(node: Shell, executor: Executor, linger: float) -> Exception | None:
    """Run a node until a signal comes, and close it; return what broke, if anything did."""
    broken: Exception | None = None
    try:
        with suppress(StoppedError):
            while not (SIGNALS or node.is_over):
                _spin(node, executor, SPIN)
            end = time.monotonic() + linger
            while time.monotonic() < end:
                _spin(node, executor, linger)
        node.finish()
    except Exception as error:
        broken = error
    try:
        node.close()
    except Exception as error:
        # What breaks after something else did, breaks because of it.
        broken = broken or error
    return broken


def _spin(node: Shell, executor: Executor, seconds: float) -> None:
    """Wait for a callback and make it; what rclpy cannot handle of others is refused."""
    try:
        executor.spin_once(timeout_sec=seconds)
    except Exception as error:
        if not _is_of_rclpy_alone(error):
            raise
        node.diagnostics.refuse('what rclpy was sent, a clock or a request,', error)


def _is_of_rclpy_alone(error: Exception) -> bool:
    """
    Say whether an error comes of what rclpy itself was sent, and not of this package.

    rclpy reads the clock and what is asked of parameters, and raises what comes of values that it
    does not know: then a callback was made, and none of this package is on the way to the error.
    """
    frames = frames_of_callback(error)
    return bool(frames) and not any(
        frame.f_globals.get('__name__', '').startswith(PACKAGE) for frame in frames
    )


def _complain(name: str, error: Exception) -> None:
    print(f'{name}: {in_words(error)}', file=sys.stderr, flush=True)


def _say_why_not_started(name: str, arguments: Sequence[str], error: Exception) -> None:
    """Show an error on diagnostics, from a node made for that: there may be none yet."""
    # What is wrong with the arguments may be wrong with this node, too.
    with suppress(*START_ERRORS):
        if not ok():
            # Parameters that were refused are not for ROS to read.
            names = names_given(arguments)
            rclpy.init(args=names, signal_handler_options=SignalHandlerOptions.NO)
        node = Node(name, enable_rosout=False, start_parameter_services=False)
        Diagnostics(node).fail(error)


def _leave(code: int, executor: Executor | None = None, node: Shell | None = None) -> None:
    """
    Leave the graph; should that not end, the process does, with its exit code.

    Everything that matters is closed by now. When several processes leave at once, Fast DDS 2.14
    may wait here for good, about once in a thousand times: `set_listener` for a callback, and
    that for its lock.
    """
    with exit_at_the_latest(TEARDOWN, code):
        if executor:
            executor.shutdown()
        if node:
            node.destroy_node()
        try_shutdown()
