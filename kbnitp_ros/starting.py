# SPDX-License-Identifier: Apache-2.0
"""Start of the executables by name, during which a signal ends them cleanly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import partial
from importlib import import_module
from importlib.util import find_spec
import os
import signal
import sys
from types import FrameType

from kbnitp_ros.plugins import extra

# Extras of pip that install the imports of a command; other executables need ROS 2.
EXTRAS = {
    'replay': 'report', 'report': 'report', 'watch': 'report', 'study': 'study', 'forecast': 'all',
    'layout': 'report',
}  # fmt: skip

# Each module has main(argv=None), which returns the exit code.
COMMANDS = {
    name: f'kbnitp_ros.cli.{name}'
    for name in ('demo', 'study', 'replay', 'report', 'watch', 'forecast', 'preflight', 'layout')
}
NODES = {
    name: f'kbnitp_ros.nodes.{name}'
    for name in ('planner', 'agent', 'robot', 'estimator', 'recorder')
}
EXECUTABLES = {**COMMANDS, **NODES}


def start(name: str, argv: Sequence[str] | None = None) -> int:
    """Import and run one of `EXECUTABLES`; return its exit code."""
    # Set before numpy is imported. Further threads slow down products of small matrices, and
    # make their rounding depend on the number of processors.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    # In a container a user may have no home, which matplotlib and the logs of ROS need. The
    # journal of a robot must outlive a restart.
    home = os.path.expanduser('~')  # noqa: PTH111, since Path.home() raises
    is_writable = os.access(home, os.W_OK)
    if not is_writable and name == 'robot' and 'ROS_HOME' not in os.environ:
        print(
            f'robot: the home {home} cannot be written to: set HOME or ROS_HOME to a folder that '
            'is kept, for the journal',
            file=sys.stderr,
        )
        return 2
    os.environ['HOME'] = home if is_writable else os.environ.get('TMPDIR', '/tmp')

    def end(number: int, _frame: FrameType | None) -> None:
        os._exit(0 if name in NODES else 128 + number)

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    if unknown := '' if name in EXTRAS else missing_rmw():
        print(f'{name}: {unknown}', file=sys.stderr)
        return 2
    try:
        # Commands import slow modules after they have parsed their options.
        with extra(EXTRAS[name]) if name in EXTRAS else nullcontext():
            main: Callable[[Sequence[str] | None], int] = import_module(EXECUTABLES[name]).main
            if name in COMMANDS:
                # A node handles signals itself; a command has Python's default handlers.
                for number, each in before.items():
                    signal.signal(number, each)
            return main(argv)
    except ModuleNotFoundError as error:
        is_ros_here = error.name == 'kbnitp_msgs' and find_spec('rclpy')
        lacking = 'build it as well' if is_ros_here else 'source ROS 2'
        if error.name == 'nav2_msgs':
            lacking = 'install it (by rosdep, or as ros-jazzy-nav2-msgs), or make robots'
        print(f'{name}: {error}{"" if name in EXTRAS else f"; {lacking}"}', file=sys.stderr)
        return 2


def missing_rmw() -> str:
    """Explain that the configured middleware is missing; empty if it is installed."""
    # Without it, rcl ends the process on import.
    rmw = os.environ.get('RMW_IMPLEMENTATION')
    if not (rmw and os.environ.get('AMENT_PREFIX_PATH')):
        return ''
    from ament_index_python import get_resources

    installed = sorted(get_resources('rmw_typesupport').keys() - {'rmw_implementation'})
    if rmw in installed:
        return ''
    return (
        f'RMW_IMPLEMENTATION is {rmw!r}, which is not installed: install it, or set it to one of '
        f'{", ".join(installed)}'
    )


# Called by `ros2 run kbnitp_ros NAME`.
demo, study, replay, report, watch, forecast, preflight, layout = (
    partial(start, name) for name in COMMANDS
)
planner, agent, robot, estimator, recorder = (partial(start, name) for name in NODES)
