# SPDX-License-Identifier: Apache-2.0
"""Start, run and end of a node's process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
import ctypes
import faulthandler
import struct
import sys
import time
import traceback

from kbnitp_ros.configuration.given import check_given, names_given, rules_last
from kbnitp_ros.core.field.compiled import WHILE_COMPILING
from kbnitp_ros.files import in_words, OutputError
from kbnitp_ros.nodes.runtime.command_line import node_parser
from kbnitp_ros.nodes.runtime.diagnostics import Diagnostics
from kbnitp_ros.nodes.runtime.node import MissionNode, SPIN, spin_once
from kbnitp_ros.nodes.runtime.signals import (
    ignore_signals,
    note_signals,
    SIGNALS,
    stop_on_signal,
)
import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, remove_ros_args, try_shutdown

# Seconds after which a start that hangs prints its stack: Fast DDS 2.14 waits forever for shared
# memory that a killed process left locked, with Python's lock held.
STARTUP = 60

# Seconds that a node may take to leave the graph.
TEARDOWN = 3

LIBC = ctypes.CDLL(None)
SIGEV_THREAD = 2

# Errors that a user can cause: rclpy reports bad arguments as RuntimeError.
START_ERRORS = (
    ValueError,
    OSError,
    OutputError,
    RuntimeError,
    ParameterException,
    NameValidationException,
)


def run(
    name: str,
    make: Callable[[], MissionNode],
    args: Sequence[str] | None = None,
    linger: float = 0.0,
) -> int:
    """Run a node until SIGINT, SIGTERM or its end; return the exit code."""
    note_signals()
    WHILE_COMPILING.append(stop_on_signal)
    try:
        return _run(name, make, list(sys.argv[1:] if args is None else args), linger)
    finally:
        ignore_signals()


def _run(name: str, make: Callable[[], MissionNode], arguments: list[str], linger: float) -> int:
    """Run a node; return the exit code."""
    parser = node_parser(name, str(make.__doc__))
    try:
        # Checked first, since ROS describes a missing file badly.
        check_given(name, arguments)
        parser.parse_args(remove_ros_args(arguments))
        faulthandler.dump_traceback_later(STARTUP, file=2)
        ordered = rules_last(arguments)
        rclpy.init(args=ordered, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
    except KeyboardInterrupt:
        _leave(0)
        return 0
    except START_ERRORS as error:
        _complain(name, error)
        _publish_startup_error(name, arguments, error)
        _leave(2)
        return 2
    finally:
        faulthandler.cancel_dump_traceback_later()
    executor = node.make_executor()
    executor.add_node(node)
    code = 1
    try:
        broken = _live(node, executor, linger)
        if broken:
            if not isinstance(broken, OSError):
                # A fault of this package, since no message and no user can cause it.
                traceback.print_exception(broken)
            _complain(name, broken)
            node.diagnostics.fail(broken)
        else:
            code = node.exit_code
    finally:
        _leave(code, executor, node)
    return code


def _live(node: MissionNode, executor: Executor, linger: float) -> Exception | None:
    """Run a node until a signal, and close it; return the exception that ended it, if any."""
    broken: Exception | None = None
    try:
        with suppress(KeyboardInterrupt):
            while not (SIGNALS or node.is_over):
                spin_once(node, executor, SPIN)
            end = time.monotonic() + linger
            while time.monotonic() < end:
                spin_once(node, executor, linger)
        # A signal also ends the compilation of a kernel for what is published last.
        with suppress(KeyboardInterrupt):
            node.finish()
    except Exception as error:
        broken = error
    try:
        node.close()
    except Exception as error:
        # Later failures are usually caused by the first one.
        broken = broken or error
    return broken


def _complain(name: str, error: Exception) -> None:
    print(f'{name}: {in_words(error)}', file=sys.stderr, flush=True)


def _publish_startup_error(name: str, arguments: Sequence[str], error: Exception) -> None:
    """Publish a startup error on diagnostics, from a temporary node."""
    # A wrong argument may prevent the temporary node as well.
    with suppress(*START_ERRORS):
        if not ok():
            # Refused parameters must not reach ROS.
            names = names_given(arguments)
            rclpy.init(args=names, signal_handler_options=SignalHandlerOptions.NO)
        node = Node(name, enable_rosout=False, start_parameter_services=False)
        Diagnostics(node).fail(error)


def _leave(code: int, executor: Executor | None = None, node: MissionNode | None = None) -> None:
    """Leave the graph; if that hangs, end the process with its exit code."""
    # When several processes leave at once, one in a thousand hangs forever in Fast DDS 2.14 with
    # Python's lock held, so the C library ends it.
    exit_function = ctypes.cast(LIBC._exit, ctypes.c_void_p).value
    event = struct.pack('QiiQQ32x', code, 0, SIGEV_THREAD, exit_function, 0)
    timer = ctypes.c_void_p()
    LIBC.timer_create(time.CLOCK_MONOTONIC, event, ctypes.byref(timer))
    LIBC.timer_settime(timer, 0, struct.pack('4q', 0, 0, TEARDOWN, 0), None)
    if executor:
        executor.shutdown()
    if node:
        node.destroy_node()
    try_shutdown()
    LIBC.timer_delete(timer)
