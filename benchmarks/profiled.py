# SPDX-License-Identifier: Apache-2.0
"""
Profile the four nodes of a mission: where their processor time goes.

    python3 benchmarks/profiled.py

Writes a table into docs/performance.md: milliseconds of processor time a deployment of each node,
without its start, and the share of each part of the code.
"""

from __future__ import annotations

from collections import Counter
import cProfile
import os
from pathlib import Path
import pstats
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any, IO

from cases import write
from kbnitp_ros.cli.processes import Processes
from kbnitp_ros.starting import start
import nodes

DEPLOYMENTS = 1000

# Environment variable of the folder of profiles.
FOLDER = 'KBNITP_PROFILES'

# Parts of the code by words of their files; built-in functions of rclpy are DDS itself.
PARTS = {
    'DDS, and conversion of messages to and from it': ('_rclpy_pybind11', '/msg/_'),
    'rclpy': ('/rclpy/',),
    'hashes of messages': ('messages/headers.py',),
    'the disk': ('fdatasync', '/log/', '/mcap/'),
    'filter and search': ('kbnitp_ros/core/', 'numba', 'numpy'),
    'nodes': ('kbnitp_ros/',),
}
# What nodes need to start is not of a deployment.
IMPORTS = ('importlib', 'marshal', 'builtins.compile', '_imp.', 'posix.stat', 'typing.py')


class Profiled(Processes):
    """Nodes that run under a profiler of processor time."""

    def launch(self, arguments: list[str], output: IO[Any] | None) -> subprocess.Popen[bytes]:
        """Start a node with its profiler."""
        return subprocess.Popen([sys.executable, __file__, *arguments], env=self._environment)


def shares(profile: Path) -> tuple[float, Counter[str]]:
    """Return the seconds of a profile without imports, and those of each part."""
    parts: Counter[str] = Counter()
    for (file, _, name), (_, _, own, _, _) in pstats.Stats(str(profile)).stats.items():
        where = f'{file} {name}'
        if not any(word in where for word in IMPORTS):
            found = (part for part, words in PARTS.items() if any(each in where for each in words))
            parts[next(found, 'the rest of Python')] += own
    return sum(parts.values()), parts


def main() -> None:
    """Run a mission and write the table."""
    with TemporaryDirectory() as folder:
        os.environ[FOLDER] = folder
        nodes.Processes = Profiled  # type: ignore[attr-defined, misc]
        nodes.run_nodes(DEPLOYMENTS)
        found = {name: shares(Path(folder, name)) for name in nodes.ORDER}
    lines = [f'| | {" | ".join(found)} |', f'|---|{"---|" * len(found)}']
    each = (f'{seconds / DEPLOYMENTS * 1e3:.2g} ms' for seconds, _ in found.values())
    lines.append(f'| a deployment | {" | ".join(each)} |')
    for part in (*PARTS, 'the rest of Python'):
        own = (f'{parts[part] / seconds:.0%}' for seconds, parts in found.values())
        lines.append(f'| {part} | {" | ".join(own)} |')
    write('profile', '\n'.join(lines))


if __name__ == '__main__':
    if sys.argv[1:]:
        profiler = cProfile.Profile(time.process_time)
        profiler.runcall(start, sys.argv[1], sys.argv[2:])
        profiler.dump_stats(Path(os.environ[FOLDER], sys.argv[1]))
    else:
        main()
