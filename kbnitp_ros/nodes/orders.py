# SPDX-License-Identifier: Apache-2.0
"""The paths that a robot is sent and has not left on."""

from __future__ import annotations

import time

from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.deployments import read_path
from kbnitp_ros.messages.missions import check_mission, mission_of_path
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.agent_topics import hear_orders
from kbnitp_ros.nodes.field import FieldNode
from kbnitp_ros.nodes.parameters import value_for
from kbnitp_ros.nodes.recent import Recent
from kbnitp_ros.robot import Journal, Trip
from nav_msgs.msg import Path

# Seconds without a new path after which what a publisher kept for those who join late has come.
SETTLED = 0.3


class Orders:
    """
    What the base wants of a robot.

    Paths come again when the robot or the base was restarted. Those in the journal were driven; of
    the others the robot is sent on the newest only, since the base sends none while it waits for
    an earlier one.

    Parameters
    ----------
    node : FieldNode
        Whose parameters and topics are used.
    agent : str
        Whose paths they are.
    prefix : str
        What the names of its topics begin with.
    journal : Journal
        What the robot did before.

    Attributes
    ----------
    is_listening : bool
        Whether paths are taken.

    """

    def __init__(self, node: FieldNode, agent: str, prefix: str, journal: Journal) -> None:
        self.is_listening = False
        self._node = node
        self._agent = agent
        self._prefix = prefix
        self._journal = journal
        self._max_steps = value_for(node.values, 'max_steps', agent)
        self._waiting: dict[int, Trip] = {}
        self._recorded = Recent(qos.DEPTH)
        self._last = 0.0

    def listen(self) -> None:
        """Take paths from now on."""
        self.is_listening = True
        hear_orders(self._node, self._agent, self._prefix, self._on_path, self._recorded.add)

    def _on_path(self, message: Path) -> None:
        try:
            key, cells = read_path(self._node.grid, self._agent, message)
            path = self._node.grid.check_path(cells, self._max_steps)
            trip = Trip(key.stamp, mission_of_path(message), tuple(path.tolist()))
            self._check_mission(trip.mission)
            known = self._known(trip.stamp)
            if known is not None and known.orders != trip.orders:
                raise ValueError(f'deployment {key} is known along another path: the first holds')
        except ValueError as error:
            self._node.diagnostics.refuse(f'{self._agent}/path', error)
            return
        if known is not None:
            return
        self._node.diagnostics.accept()
        self._last = time.monotonic()
        self._waiting[trip.stamp] = trip

    def _check_mission(self, mission: int) -> None:
        try:
            check_mission(mission, self._journal.mission)
        except ValueError as error:
            raise ValueError(
                f'{error}; journal {self._journal.path} is of that one: for a new mission move it '
                'away, or name another file by the parameter journal'
            ) from error

    def _known(self, stamp: int) -> Trip | None:
        """Return the deployment of this name, driven or not, if it is known."""
        driven = (trip for trip in self._journal.trips if trip.stamp == stamp)
        return self._waiting.get(stamp) or next(driven, None)

    @property
    def newest(self) -> Trip | None:
        """Return the deployment to leave on; None when there is none."""
        return self._waiting[max(self._waiting)] if self._waiting else None

    @property
    def waiting(self) -> int:
        """Return how many paths the robot has not left on."""
        return len(self._waiting)

    @property
    def awaited(self) -> str:
        """Return what the robot must wait for before it leaves; empty when for nothing."""
        trip = self.newest
        if trip is None:
            return f'taking paths of {self._agent}'
        if self._node.values['recorded'] and trip.stamp not in self._recorded:
            key = DeploymentKey(self._agent, trip.stamp)
            return (
                f'waiting for the recorder to tell on {self._agent}/recorded that the path of '
                f'{key} is on disk (parameter recorded)'
            )
        if time.monotonic() < self._last + SETTLED:
            return 'waiting for the last of the paths to come'
        return ''

    def superseded(self) -> list[Trip]:
        """
        Return the deployments that this robot will not leave on, since a newer one came.

        Of those that were sent before it left for the first time nothing is known: another robot
        of its name may have.
        """
        driven = self._journal.trips[-1].stamp if self._journal.trips else max(self._waiting)
        return [self._waiting[stamp] for stamp in sorted(self._waiting)[:-1] if stamp > driven]

    def close(self, trip: Trip) -> None:
        """Take note that a deployment is in the journal, and leave out all before it."""
        self._waiting = {
            stamp: each for stamp, each in self._waiting.items() if stamp > trip.stamp
        }
