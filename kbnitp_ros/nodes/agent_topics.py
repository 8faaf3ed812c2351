# SPDX-License-Identifier: Apache-2.0
"""The topics by which an agent is told its paths, and which of them are on disk."""

from __future__ import annotations

from collections.abc import Callable

from builtin_interfaces.msg import Time
from kbnitp_ros.messages.headers import read_name
from kbnitp_ros.messages.sizes import largest_path, TIME
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.field import FieldNode
from kbnitp_ros.nodes.parameters import value_for
from nav_msgs.msg import Path


def hear_orders(
    node: FieldNode,
    agent: str,
    prefix: str,
    on_path: Callable[[Path], None],
    on_recorded: Callable[[int], None],
) -> None:
    """
    Take the paths of an agent from now on and, with the parameter `recorded`, which are on disk.

    Parameters
    ----------
    node : FieldNode
        Hears them.
    agent : str
        Whose they are.
    prefix : str
        What the names of its topics begin with.
    on_path : callable
        Called with each path.
    on_recorded : callable
        Called with the stamp of each path that is on disk, in nanoseconds.

    """

    def take_recorded(message: Time) -> None:
        try:
            stamp = read_name('stamp', message)
        except ValueError as error:
            node.diagnostics.refuse(f'{agent}/recorded', error)
        else:
            on_recorded(stamp)

    largest = largest_path(value_for(node.values, 'max_steps', agent))
    node.hear(Path, f'{prefix}path', on_path, qos.EVIDENCE, largest)
    if node.values['recorded']:
        node.hear(Time, f'{prefix}recorded', take_recorded, qos.EVIDENCE, TIME)
