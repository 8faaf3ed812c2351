# SPDX-License-Identifier: Apache-2.0
"""The next deployment of a real robot, from the paths that it is sent."""

from __future__ import annotations

from collections.abc import Callable
import time

from kbnitp_ros.configuration import value_for
from kbnitp_ros.messages.deployments import read_path
from kbnitp_ros.messages.missions import mission_of_path, named
from kbnitp_ros.nodes.recorded_paths import ASK_FIRST, RecordedPaths
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.robot import Deployment, Journal
from nav_msgs.msg import Path

# Seconds without a new path after which what a publisher kept for those who join late has come.
SETTLED = 0.3


class PendingPaths:
    """The paths that a robot was sent and has not left on."""

    # Paths come again when the robot or the base was restarted. The base sends none while it waits
    # for an earlier one, so the robot leaves on the newest that is not in the journal.

    def __init__(
        self,
        node: FieldNode,
        agent: str,
        journal: Journal,
        accept: Callable[[Deployment], None],
        refuse: Callable[[Deployment, str], object],
    ) -> None:
        # Whether paths are taken.
        self.is_listening = False
        self._node = node
        self._agent = agent
        self._journal = journal
        self._accept = accept
        self._refuse = refuse
        self._max_steps = value_for(node.values, 'max_steps', agent)
        self._pending: dict[int, Deployment] = {}
        self._sent = RecordedPaths(node, agent, self._read_path, self._take_path)
        # Has a robot move when its departure is on record.
        self.when_recorded = self._sent.when_recorded
        self._last = 0.0

    def listen(self) -> None:
        """Take paths from now on."""
        self.is_listening = True
        self._sent.listen()

    def _read_path(self, message: Path) -> Deployment | None:
        key, cells = read_path(self._node.grid, self._agent, message)
        path = self._node.grid.check_path(cells, self._max_steps)
        deployment = Deployment(key.stamp, mission_of_path(message), tuple(path.tolist()))
        known = self._known(deployment.stamp)
        if known is not None and known.path != deployment.path:
            raise ValueError(f'deployment {key} is known with another path: the first path counts')
        if known is not None or deployment.stamp in self._journal.refusals:
            return None
        self._node.diagnostics.accept()
        self._last = time.monotonic()
        return deployment

    def _take_path(self, deployment: Deployment) -> None:
        self._last = time.monotonic()
        if why := self._why_earlier(deployment.mission):
            self._refuse(deployment, why)
            return
        self._pending[deployment.stamp] = deployment
        self._accept(deployment)

    def _why_earlier(self, mission: int) -> str:
        """Return that a mission is an earlier one than that of the journal; empty if it is not."""
        own = self._journal.mission
        if own is None or mission >= own:
            return ''
        return (
            f'it belongs to {named(mission)}, and journal {self._journal.path} to {named(own)}, '
            'which is later (was a clock set back?): for this mission name another file by the '
            'parameter journal'
        )

    def _known(self, stamp: int) -> Deployment | None:
        """Return the deployment of this name, driven or not, if it is known."""
        driven = (
            deployment for deployment in self._journal.deployments if deployment.stamp == stamp
        )
        return self._pending.get(stamp) or next(driven, None)

    @property
    def newest(self) -> Deployment | None:
        """Return the deployment to leave on; None when there is none."""
        return self._pending[max(self._pending)] if self._pending else None

    @property
    def pending(self) -> int:
        """Return how many paths the robot has not left on."""
        return len(self._pending) + self._sent.pending

    @property
    def awaited(self) -> str:
        """Return what the robot must wait for before it leaves; empty when for nothing."""
        if not self._pending:
            return self._sent.awaited
        # What the recorder said of later paths is asked for again if it came before them.
        settled = 2 * ASK_FIRST if self._sent.pending else SETTLED
        if time.monotonic() < self._last + settled:
            return 'the last of the paths to come'
        return ''

    def superseded(self) -> list[Deployment]:
        """Return the deployments that this robot will not leave on, since a newer one came."""
        driven = (
            self._journal.deployments[-1].stamp
            if self._journal.deployments
            else max(self._pending)
        )
        return [self._pending[stamp] for stamp in sorted(self._pending)[:-1] if stamp > driven]

    def close(self, deployment: Deployment) -> None:
        """Take note that a deployment is in the journal, and leave out all before it."""
        self._pending = {
            stamp: each for stamp, each in self._pending.items() if stamp > deployment.stamp
        }
