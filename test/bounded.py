# SPDX-License-Identifier: Apache-2.0
"""Commands in processes that may take little, to see what a hostile file takes."""

from dataclasses import dataclass
from functools import cache
import os
import re
import subprocess
import sys

# Of address space in bytes and of CPU time in seconds: enough for what is refused, and a process
# that does not refuse takes no more of the machine.
MOST = 3 * 2**30
PATIENCE = 20

WATCHED = f"""
import atexit, pathlib, resource
resource.setrlimit(resource.RLIMIT_AS, ({MOST}, {MOST}))
resource.setrlimit(resource.RLIMIT_CPU, ({PATIENCE}, {PATIENCE}))
atexit.register(lambda: print(pathlib.Path('/proc/self/status').read_text()))
"""

COMMAND = """
import sys
from kbnitp_ros.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


@dataclass(frozen=True)
class Ended:
    """
    How a process ended.

    Attributes
    ----------
    code : int
        Its exit code.
    said : str
        What it said on stderr.
    megabytes : float
        The most memory that it had; NaN if it was killed.

    """

    code: int
    said: str
    megabytes: float


def run_code(code, *arguments, **options):
    """Run Python code in a process of its own."""
    done = subprocess.run(
        [sys.executable, '-c', WATCHED + code, *map(str, arguments)],
        capture_output=True,
        text=True,
        # A thread of OpenBLAS takes address space, and nothing here needs several.
        env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'},
        timeout=10 * PATIENCE,
        **options,
    )
    peak = re.search(r'^VmHWM:\s*(\d+) kB$', done.stdout, re.MULTILINE)
    return Ended(done.returncode, done.stderr, int(peak[1]) / 1024 if peak else float('nan'))


def run_command(*arguments, **options):
    """Run a command of the package in a process of its own."""
    return run_code(COMMAND, *arguments, **options)


@cache
def megabytes_at_start(command):
    """Return the most memory that a command has which does nothing but help."""
    ended = run_command(command, '--help')
    assert ended.code == 0, ended
    return ended.megabytes
