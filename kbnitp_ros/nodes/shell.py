# SPDX-License-Identifier: Apache-2.0
"""What the four nodes have in common: how they start, run and end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
import signal
import sys
import time

from kbnitp_ros.files import in_words
from kbnitp_ros.nodes.command_line import node_parser
from kbnitp_ros.nodes.diagnostics import Diagnostics
from kbnitp_ros.nodes.exit_timer import exit_at_the_latest
from kbnitp_ros.nodes.given import check_given
from kbnitp_ros.nodes.parameters import declare
import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args

# In seconds: how long a signal may have to wait, and how often a node looks at the graph.
SPIN = 0.2
POLL = 0.05

# How long a node may take to leave the graph, in seconds.
TEARDOWN = 3.0

# How long a node waits for the readers of its last messages, in seconds: they may have died.
FAREWELL = 0.3

# What a user can cause: rclpy reports bad arguments as RuntimeError.
START_ERRORS = (
    ValueError,
    OSError,
    RuntimeError,
    ParameterException,
    NameValidationException,
)


class Shell(Node):
    """
    A node of the mission: its parameters and its diagnostics.

    Attributes
    ----------
    values : dict
        The parameters by name, kept up to date.
    diagnostics : Diagnostics
        What it has accepted and refused.

    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.values = declare(self, name)
        self.diagnostics = Diagnostics(self)

    def now(self) -> int:
        """Return the ROS time in nanoseconds; 0 as long as a simulated clock has not started."""
        return self.get_clock().now().nanoseconds

    def waiting_for(self, publishers: Iterable[Publisher]) -> str:
        """Return which of the parameter `await_nodes` do not listen yet; empty when all do."""
        missing = []
        for topic in (publisher.topic_name for publisher in publishers):
            listening = {each.node_name for each in self.get_subscriptions_info_by_topic(topic)}
            absent = [node for node in self.values['await_nodes'] if node not in listening]
            missing += [f'{node} to listen to {topic}' for node in absent]
        return f'waiting for {", ".join(missing)}' if missing else ''

    def create_poll(self, callback: Callable[[], None]) -> Timer:
        """Call back every `POLL` seconds, also when simulated time stands still."""
        return self.create_timer(POLL, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def finish(self) -> None:
        """Do what is left to do after a signal, before the node is closed."""

    def close(self) -> None:
        """Stay until what was published last has arrived: DDS drops it with the publisher."""
        end = time.monotonic() + FAREWELL
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))


def run(
    name: str, make: Callable[[], Shell], args: Sequence[str] | None, linger: float = 0.0
) -> int:
    """
    Run a node until SIGINT or SIGTERM and return the exit code of its process.

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
        0 after a signal; 2 if the node could not start, 1 if it could not go on: then one line on
        stderr says why, and so does diagnostics.

    """
    arguments = list(sys.argv[1:] if args is None else args)
    parser = node_parser(name, str(make.__doc__))
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: signals.append(received))
    try:
        # ROS has worse words for a file that is not there.
        check_given(name, arguments)
        parser.parse_args(remove_ros_args(arguments))
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
    except START_ERRORS as error:
        _complain(name, error)
        _say_why_not_started(name, arguments, error)
        _leave(2)
        return 2
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    code = 1
    try:
        broken = _live(node, executor, signals, linger)
        if broken:
            _complain(name, broken)
            node.diagnostics.fail(broken)
        else:
            code = 0
    finally:
        _leave(code, executor, node)
        # Python gives up its handlers before it ends: a second Ctrl-C would kill what ended well.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    return code


def _live(
    node: Shell, executor: SingleThreadedExecutor, signals: Sequence[int], linger: float
) -> OSError | None:
    """Run a node until a signal comes, and close it; return what broke, if anything did."""
    broken: OSError | None = None
    try:
        try:
            while not signals:
                executor.spin_once(timeout_sec=SPIN)
            end = time.monotonic() + linger
            while time.monotonic() < end:
                executor.spin_once(timeout_sec=linger)
            node.finish()
        except OSError as error:
            broken = error
        finally:
            node.close()
    except OSError as error:
        # What breaks after something else did, breaks because of it.
        broken = broken or error
    return broken


def _complain(name: str, error: Exception) -> None:
    print(f'{name}: {in_words(error)}', file=sys.stderr, flush=True)


def _say_why_not_started(name: str, arguments: Sequence[str], error: Exception) -> None:
    """Show an error on diagnostics, from a node made for that: there may be none yet."""
    # What is wrong with the arguments may be wrong with this node, too.
    with suppress(*START_ERRORS):
        if not rclpy.ok():
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = Node(name, enable_rosout=False, start_parameter_services=False)
        Diagnostics(node).fail(error)


def _leave(
    code: int, executor: SingleThreadedExecutor | None = None, node: Shell | None = None
) -> None:
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
        rclpy.try_shutdown()
