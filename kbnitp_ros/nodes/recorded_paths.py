# SPDX-License-Identifier: Apache-2.0
"""The paths that an agent is sent, each as it is on record, and the next one of a real robot."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Generic, TypeVar

from kbnitp_msgs.msg import Recorded
from kbnitp_ros.configuration import value_for
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.deployments import read_path
from kbnitp_ros.messages.headers import content_hash, from_stamp, mission_of_path, named, read_name
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.robot.journal import Deployment, Journal
from nav_msgs.msg import Path
from rclpy.subscription import Subscription

# Of several paths of one stamp all nodes take the one that the recorder names. An acknowledgement
# before its path is not kept, since anybody can send any number: the publisher keeps it and is
# asked again.


P = TypeVar('P')

# Seconds after which AGENT/recorded is asked for again, at first and at the most.
ASK_FIRST, ASK_LAST = 1.0, 60.0


class RecordedPaths(Generic[P]):
    """The paths that an agent is sent."""

    def __init__(
        self,
        node: FieldNode,
        agent: str,
        read: Callable[[Path], P | None],
        take: Callable[[P], None],
    ) -> None:
        self._node = node
        self._agent = agent
        self._read = read
        self._take = take
        # Paths that the recorder has not named, by stamp and content.
        self._pending: dict[tuple[int, int], P] = {}
        # What follows from departures that the recorder has not named, by stamp and content.
        self._departures: dict[tuple[int, int], Callable[[], None]] = {}
        self._has_missed = False
        self._interval = ASK_FIRST
        self._ask_at = 0.0

    def listen(self) -> None:
        """Take paths from now on."""
        self._node.hear_agent(Path, self._agent, self._on_path)
        if self._node.values['recorded']:
            self._recorded = self._hear_recorded()
            self._node.create_poll(self._ask_again)

    @property
    def pending(self) -> int:
        """How many paths the recorder has not named."""
        return len(self._pending)

    @property
    def awaited(self) -> str:
        """Return what the first of these waits for; empty when there is none."""
        if not self._pending:
            return ''
        stamp, _ = next(iter(self._pending))
        return (
            f'the recorder to tell on {self._agent}/recorded that the path of '
            f'{DeploymentKey(self._agent, stamp)} is on disk (parameter recorded)'
        )

    def when_recorded(self, stamp: int, content: int, depart: Callable[[], None]) -> None:
        """Have a robot move when its departure is on record; at once without that parameter."""
        if self._node.values['recorded']:
            self._departures[stamp, content] = depart
        else:
            depart()

    def _hear_recorded(self) -> Subscription:
        self._has_missed = False
        self._ask_at = time.monotonic() + self._interval
        return self._node.hear_agent(Recorded, self._agent, self._on_recorded)

    def _on_path(self, message: Path) -> None:
        try:
            path = self._read(message)
            if path is None:
                return
            if not self._node.values['recorded']:
                self._take(path)
                return
        except ValueError as error:
            self._refuse(error)
            return
        if not self._pending:
            self._ask_at = time.monotonic() + self._interval
        self._pending[from_stamp(message.header.stamp), content_hash(message)] = path
        if len(self._pending) > qos.DEPTH:
            stamp, content = next(iter(self._pending))
            self._drop(stamp, content, f'{qos.DEPTH} later paths wait to be recorded as well')

    def _on_recorded(self, message: Recorded) -> None:
        try:
            stamp = read_name('stamp', message.stamp)
        except ValueError as error:
            self._node.diagnostics.refuse(f'{self._agent}/recorded', error)
            return
        if depart := self._departures.pop((stamp, message.content), None):
            depart()
            return
        path = self._pending.pop((stamp, message.content), None)
        if path is None:
            self._has_missed = True
            return
        self._interval = ASK_FIRST
        for other in [content for each, content in self._pending if each == stamp]:
            self._drop(stamp, other, 'another path with the same stamp was recorded first')
        try:
            self._take(path)
        except ValueError as error:
            self._refuse(error)

    def _drop(self, stamp: int, content: int, why: str) -> None:
        del self._pending[stamp, content]
        self._refuse(ValueError(f'deployment {DeploymentKey(self._agent, stamp)}: {why}'))

    def _refuse(self, error: ValueError) -> None:
        self._node.diagnostics.refuse(f'{self._agent}/path', error)

    def _ask_again(self) -> None:
        """Have the recorder say again what it said before a path came."""
        if self._pending and self._has_missed and time.monotonic() > self._ask_at:
            self._interval = min(2 * self._interval, ASK_LAST)
            self._node.destroy_subscription(self._recorded)
            self._recorded = self._hear_recorded()


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
