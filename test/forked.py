# SPDX-License-Identifier: Apache-2.0
"""Processes forked from one that has imported their modules, to save time."""

from collections.abc import Callable, Mapping
from contextlib import suppress
import ctypes
import multiprocessing
import os
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any, IO

from kbnitp_ros.__main__ import main
from kbnitp_ros.cli.processes import Processes
from kbnitp_ros.nodes.runtime import qos

CONTEXT = multiprocessing.get_context('forkserver')
CONTEXT.set_forkserver_preload(['forked', 'ready', 'simulator'])

PR_SET_PDEATHSIG = 1

# Coverage starts with the interpreter, so nothing is forked under it.
COVERED = 'COVERAGE_PROCESS_CONFIG' in os.environ


def _run(
    function: Callable[..., int],
    arguments: tuple[Any, ...],
    environment: Mapping[str, str],
    folder: Path,
    output: str,
) -> None:
    """Set folder and environment of this process like a shell."""
    assert 'ready' in sys.modules, 'the server of forks did not import what nodes need'
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    written = os.open(output, os.O_WRONLY | os.O_APPEND)
    os.dup2(written, sys.stdout.fileno())
    os.dup2(written, sys.stderr.fileno())
    sys.exit(function(*arguments))


def run_node(arguments: list[str], depth: int = qos.DEPTH) -> int:
    qos.DEPTH = qos.EVIDENCE.depth = depth
    return main(arguments)


def run_simulator(file: Path) -> int:
    # Import here: it takes a second, and only the fork server does it earlier.
    from simulator import simulate

    return simulate(file)


class ForkedProcess:
    """A forked process with the used part of `subprocess.Popen`."""

    def __init__(
        self,
        function: Callable[..., int],
        arguments: tuple[Any, ...],
        environment: Mapping[str, str],
        output: str,
    ) -> None:
        """Start a function that returns the exit code, from a module that can be imported."""
        self._process = CONTEXT.Process(
            target=_run, args=(function, arguments, environment, Path.cwd(), output), daemon=True
        )
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int | None:
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class ForkedProcesses(Processes):
    """Nodes of this package in forked processes, with output to files."""

    # Paths and reports that nodes started from now on keep for late joiners.
    depth = qos.DEPTH

    def launch(self, arguments: list[str], output: IO[Any] | None) -> Any:
        """Fork a process that runs ``python3 -m kbnitp_ros`` with these arguments."""
        assert output is not None
        whole = (arguments, self.depth)
        return ForkedProcess(run_node, whole, self._environment, output.name)
