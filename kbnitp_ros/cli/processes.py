# SPDX-License-Identifier: Apache-2.0
"""Nodes as child processes, in a ROS domain of their own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import json
import os
from pathlib import Path
import random
import signal
import socket
import subprocess
import sys
import time
from typing import Any, IO

from kbnitp_ros.configuration.starts import parameters_for
from kbnitp_ros.files import share
from kbnitp_ros.nodes.runtime.graph import udp_only

# Domains above 101 use ports that Linux assigns to other programs.
DOMAINS = range(1, 102)

# Highest domain that Fast DDS has ports for.
MAX_DOMAIN = 232

# Command by which Linux interrupts a node when its parent process is killed.
END_WITH_PARENT = ('setpriv', '--pdeathsig', 'SIGINT')

# Seconds that nodes may take to end after a signal: a planner completes its plan first, and a
# machine under load is ten times slower.
PATIENCE = 30.0


def environment(domain: int) -> dict[str, str]:
    """Return the environment of a process in a ROS domain that is limited to this machine."""
    paths = [str(Path(__file__).parents[2]), os.environ.get('PYTHONPATH', '')]
    # The user's DDS profiles and peers are for nodes on other machines.
    local = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    local |= {name: os.environ[name] for name in os.environ.keys() & {'ROS_LOCALHOST_ONLY'}}
    return {
        **os.environ,
        'ROS_DOMAIN_ID': str(domain),
        **udp_only(local, share('config')),
        'PYTHONPATH': os.pathsep.join(filter(None, paths)),
    }


@contextmanager
def given_domain() -> Iterator[int]:
    """Yield the domain of ROS_DOMAIN_ID, or reserve a free one."""
    if given := os.environ.get('ROS_DOMAIN_ID'):
        if not given.isdecimal() or int(given) > MAX_DOMAIN:
            raise OSError(f'ROS_DOMAIN_ID is {given!r}: it must be from 0 to {MAX_DOMAIN}')
        yield int(given)
        return
    with free_domain() as domain:
        yield domain


@contextmanager
def free_domain() -> Iterator[int]:
    """Reserve a ROS domain that nothing else on this machine uses."""
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        first_port = 7400 + 250 * domain
        # Ports of the domain's first 32 participants.
        ports = range(first_port + 10, first_port + 74, 2)
        # DDS uses UDP, so the TCP port of the same number serves as a lock.
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as lock:
            if _bind(lock, first_port) and all(map(_is_free, ports)):
                yield domain
                return
    raise OSError('every ROS domain from 1 to 101 is in use on this machine')


def _is_free(port: int) -> bool:
    """Return whether no participant has a port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        return _bind(probe, port)


def _bind(to_bind: socket.socket, port: int) -> bool:
    try:
        to_bind.bind(('', port))
    except OSError:
        return False
    return True


class Processes:
    """Child processes, which end with the ``with`` statement."""

    def __init__(self, domain: int) -> None:
        self._environment = environment(domain)
        # All processes started, by the full names of their nodes.
        self.started: dict[str, subprocess.Popen[bytes]] = {}

    def start(
        self,
        node: str,
        parameters: Mapping[str, Any] | None = None,
        *,
        namespace: str = '/',
        remaps: Mapping[str, str] | None = None,
        levels: Mapping[str, str] | None = None,
        output: IO[Any] | None = None,
    ) -> subprocess.Popen[bytes]:
        """Start a node with those of the parameters that it has."""
        full_name = f'{namespace.rstrip("/")}/{node}'
        arguments = [node, '--ros-args', '--enclave', full_name]
        for name, other in {'__ns': namespace, **(remaps or {})}.items():
            arguments += ['--remap', f'{name}:={other}']
        for name, value in parameters_for(node, parameters or {}).items():
            # ROS parses values as YAML, which includes JSON.
            arguments += ['--param', f'{name}:={json.dumps(value)}']
        for logger, level in (levels or {}).items():
            arguments += ['--log-level', f'{logger}:={level}']
        process = self.launch(arguments, output)
        self.started[full_name] = process
        return process

    def launch(self, arguments: list[str], output: IO[Any] | None) -> subprocess.Popen[bytes]:
        """Start ``python3 -m kbnitp_ros`` with these arguments."""
        return subprocess.Popen(
            [*END_WITH_PARENT, sys.executable, '-m', 'kbnitp_ros', *arguments],
            env=self._environment,
            stdout=output,
            stderr=output and subprocess.STDOUT,
        )

    def ended(self) -> dict[str, int]:
        """Return the exit codes of the nodes that have ended, by full name."""
        codes = {name: process.poll() for name, process in self.started.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def stop(self, patience: float = PATIENCE) -> dict[str, int]:
        """Interrupt all nodes, and kill nodes that do not end in time."""
        for process in self.started.values():
            process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + patience
        while len(self.ended()) < len(self.started) and time.monotonic() < deadline:
            time.sleep(0.02)
        for process in self.started.values():
            process.kill()
            process.wait()
        return self.ended()

    def __enter__(self) -> Processes:
        """Return this object."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all nodes."""
        self.stop()
