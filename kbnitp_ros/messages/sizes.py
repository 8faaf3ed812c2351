# SPDX-License-Identifier: Apache-2.0
"""How large a message of a mission can be, so that a larger one is refused before it is read."""

from __future__ import annotations

from kbnitp_ros.core import LONGEST_WALK

# In bytes: what all but the poses, readings and cells take, names and frames of others included;
# a pose with the header of its own; a reading; a cell with its joint, its prior, its three views
# and its number among those that are blocked. A kbnitp_msgs/Recorded is 28 bytes with its head.
# What a hundred agents have of their own, with names of fifty letters, takes 64 KiB. A deployment
# that a belief names takes its agent's name, a time and two hashes.
REST = 4096
POSE = 256
READING = 8
CELL = 96
RECORDED = 28
STATUS_SIZE = MODEL_SIZE = PROGRESS_SIZE = REST
OWN = 1 << 16
EVIDENCE = 96

# The most deployments of a mission.
MOST_DEPLOYMENTS = 20_000


def largest_path(max_steps: int) -> int:
    """Return the most bytes of a nav_msgs/Path of so many steps."""
    return REST + POSE * (max_steps + 1)


def largest_report(max_steps: int) -> int:
    """Return the most bytes of a kbnitp_msgs/DeploymentReport on orders of so many steps."""
    return REST + READING * LONGEST_WALK * max_steps


def largest_operator_action(robots: int, max_steps: int) -> int:
    """Return the most bytes of a kbnitp_msgs/OperatorAction on the paths of so many robots."""
    return REST + robots * largest_path(max_steps)


def largest_belief(cells: int) -> int:
    """Return the most bytes of a kbnitp_msgs/BeliefMaps of so many cells."""
    return REST + OWN + EVIDENCE * MOST_DEPLOYMENTS + CELL * cells


def largest_map(pixels: int) -> int:
    """Return the most bytes of a nav_msgs/OccupancyGrid of so many pixels."""
    return REST + pixels


def check_size(data: bytes, largest: int) -> None:
    """
    Check that a message is not too large to be what it says.

    Raises
    ------
    ValueError
        If it is larger.

    """
    if len(data) > largest:
        raise ValueError(f'it has {len(data)} bytes: at most {largest} can be')
