# SPDX-License-Identifier: Apache-2.0
"""Planners and a goal as tests want them; some wait until the test makes a file beside them."""

from pathlib import Path
import time

from kbnitp_ros.core import Lane
from kbnitp_ros.core.planning.objective import Candidate
from kbnitp_ros.core.planning.planners import beam

OPEN = Path('open')


def wait():
    while not OPEN.exists():
        time.sleep(0.01)


def search(finder, objective):
    """Search like `beam` once the gate is open."""
    wait()
    return beam(finder, objective)


def stay(finder, objective):
    """Return a path that never leaves the base."""
    return [Candidate.along([finder.grid.base] * 4, objective)]


class Slow(Lane):
    """A lane that is decided on once the gate is open."""

    def decide(self, *arguments):
        wait()
        return super().decide(*arguments)


def lane(cells, confidence):
    return Slow(cells[0], confidence)
