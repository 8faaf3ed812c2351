# SPDX-License-Identifier: Apache-2.0
"""The acknowledged paths of an agent, and the next path of a real robot."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
import time
from typing import Generic, TypeVar

from kbnitp_msgs.msg import Recorded
from kbnitp_ros.base.state import remember
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.headers import content_hash, from_stamp, mission_of_path, named, read_name
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.robot.journal import Journal, JournaledDeployment
from kbnitp_ros.robot.orders import Orders
from nav_msgs.msg import Path
from rclpy.subscription import Subscription

# If several paths have the same stamp, all nodes use the path that the recorder acknowledges. Of
# acknowledgements that arrive before their messages the last ones are remembered; a new
# subscription receives all of them again from their publisher, which keeps them.


P = TypeVar('P')

# First and longest pause between two requests for earlier acknowledgements, seconds.
ASK_FIRST, ASK_LAST = 1.0, 60.0


class RecordedPaths(Generic[P]):
    """The paths sent to an agent; a path is passed on once it is recorded."""

    def __init__(
        self,
        node: FieldNode,
        agent: str,
        read: Callable[[Path], P | None],
        take: Callable[[P], None],
    ) -> None:
        self._node = node
        self.agent = agent
        # Whether this object has subscribed to the paths.
        self.is_listening = False
        self._read = read
        self._take = take
        # Paths that are not acknowledged, by stamp and content.
        self._unacknowledged: dict[tuple[int, int], P] = {}
        # Callbacks of departures and reports that are not acknowledged; and acknowledgements with
        # the time of those without a message, seconds; by stamp and content.
        self._awaited: dict[tuple[int, int], Callable[[], None]] = {}
        self._early: OrderedDict[tuple[int, int], float | None] = OrderedDict()
        self._has_missed = False
        self._interval = ASK_FIRST
        self._ask_at = 0.0

    def listen(self) -> None:
        """Subscribe to the paths."""
        self.is_listening = True
        self._node.subscribe_to_agent(Path, self.agent, self._on_path)
        if self._node.values['recorded']:
            self._recorded = self._subscribe_to_recorded()
            self._node.create_poll(self._ask_again)

    @property
    def pending(self) -> int:
        """Return the number of paths that are not acknowledged."""
        return len(self._unacknowledged)

    @property
    def awaited(self) -> str:
        """Describe the acknowledgement that the first path waits for; empty if no path waits."""
        if not self._unacknowledged:
            return ''
        stamp, _ = next(iter(self._unacknowledged))
        return (
            f'the recorder to acknowledge the path of {DeploymentKey(self.agent, stamp)} on '
            f'{self.agent}/recorded (parameter recorded)'
        )

    def when_recorded(self, stamp: int, content: int, act: Callable[[], None]) -> None:
        """Call `act` once the message of a deployment is on record, or if `recorded` is false."""
        if not self._node.values['recorded'] or (stamp, content) in self._early:
            self._early[stamp, content] = None
            act()
            return
        self._awaited[stamp, content] = act
        if len(self._awaited) > qos.DEPTH:
            del self._awaited[next(iter(self._awaited))]
            self._refuse(ValueError(f'{qos.DEPTH} later messages wait to be recorded, too'))

    def _subscribe_to_recorded(self) -> Subscription:
        self._has_missed = False
        self._ask_at = time.monotonic() + self._interval
        return self._node.subscribe_to_agent(Recorded, self.agent, self._on_recorded)

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
        if not self._unacknowledged:
            self._ask_at = time.monotonic() + self._interval
        name = from_stamp(message.header.stamp), content_hash(message)
        self._unacknowledged[name] = path
        if name in self._early:
            self._take_recorded(*name)
            return
        if len(self._unacknowledged) > qos.DEPTH:
            stamp, content = next(iter(self._unacknowledged))
            self._drop(stamp, content, f'{qos.DEPTH} later paths wait to be recorded, too')

    def _on_recorded(self, message: Recorded) -> None:
        try:
            stamp = read_name('stamp', message.stamp)
        except ValueError as error:
            self._node.diagnostics.refuse(f'{self.agent}/recorded', error)
            return
        self._note_recorded(message.kind, stamp)
        name = stamp, int(message.content)
        if name not in self._early:
            remember(self._early, name, time.monotonic())
        self._take_recorded(*name)

    def _note_recorded(self, kind: int, stamp: int) -> None:
        """Note the kind of a message of a deployment that is on record."""

    def _take_recorded(self, stamp: int, content: int) -> None:
        """Pass on the message that is on record, if it has arrived."""
        if act := self._awaited.pop((stamp, content), None):
            self._early[stamp, content] = None
            act()
            return
        path = self._unacknowledged.pop((stamp, content), None)
        if path is None:
            self._has_missed = True
            return
        self._early[stamp, content] = None
        self._interval = ASK_FIRST
        for other in [content for each, content in self._unacknowledged if each == stamp]:
            self._drop(stamp, other, 'another path with the same stamp was recorded first')
        try:
            self._take(path)
        except ValueError as error:
            self._refuse(error)

    def has_unknown(self) -> bool:
        """Return whether a message is on record that has not arrived; ask only once for each."""
        due = time.monotonic() - ASK_FIRST
        unknown = [name for name, since in self._early.items() if since and since < due]
        for name in unknown:
            self._early[name] = None
        return bool(unknown)

    def _drop(self, stamp: int, content: int, why: str) -> None:
        del self._unacknowledged[stamp, content]
        self._refuse(ValueError(f'deployment {DeploymentKey(self.agent, stamp)}: {why}'))

    def _refuse(self, error: ValueError) -> None:
        self._node.diagnostics.refuse(f'{self.agent}/path', error)

    def _ask_again(self) -> None:
        """Request acknowledgements again if some have arrived before their paths."""
        is_any_awaited = self._unacknowledged or self._awaited
        if is_any_awaited and self._has_missed and time.monotonic() > self._ask_at:
            self._interval = min(2 * self._interval, ASK_LAST)
            self._node.destroy_subscription(self._recorded)
            self._recorded = self._subscribe_to_recorded()


# Seconds without a new path after which the history of a publisher counts as received.
SETTLED = 0.3


class PendingPaths(RecordedPaths[JournaledDeployment]):
    """The recorded paths on which a real robot has not departed yet."""

    # Paths arrive again after a restart of the robot or the base. The base sends no path while the
    # robot is in flight, so the robot follows the newest path that is open.

    def __init__(
        self,
        node: FieldNode,
        agent: str,
        journal: Journal,
        refuse: Callable[[JournaledDeployment, str], object],
    ) -> None:
        super().__init__(node, agent, self._read_path, self._take_path)
        self._journal = journal
        self._refuse_order = refuse
        self.orders = Orders(journal)
        self._last = 0.0

    def _read_path(self, message: Path) -> JournaledDeployment | None:
        key, path = self._node.read_path(self.agent, message)
        deployment = JournaledDeployment(key.stamp, mission_of_path(message), tuple(path.tolist()))
        known = self.orders.find(key.stamp)
        if known is not None and known.path != deployment.path:
            raise ValueError(f'deployment {key} already has another path: the first path counts')
        if known is not None or deployment.stamp in self._journal.refusals:
            return None
        self._node.diagnostics.accepted += 1
        self._last = time.monotonic()
        return deployment

    def _take_path(self, deployment: JournaledDeployment) -> None:
        self._last = time.monotonic()
        own = self._journal.mission
        if own is not None and deployment.mission < own:
            self._refuse_order(
                deployment,
                f'it belongs to {named(deployment.mission)}, but journal {self._journal.path} '
                f'belongs to {named(own)}, which is later (was a clock set back?): to drive for '
                'the earlier mission, set the parameter journal to another file',
            )
            return
        self.orders.take(deployment)

    def _note_recorded(self, kind: int, stamp: int) -> None:
        if kind == Recorded.DEPARTURE:
            self.orders.note_departure(stamp)
        elif kind in (Recorded.REFUSAL, Recorded.REPORT):
            self.orders.note_end(stamp)
        if self.orders.forgotten:
            # The acknowledgement of its report may follow.
            self._last = time.monotonic()

    @property
    def newest(self) -> JournaledDeployment | None:
        """Return the newest open order, which comes next; None if there is none."""
        return self.orders.open_orders[-1] if self.orders.open_orders else None

    @property
    def pending(self) -> int:
        """Return the number of paths on which the robot has not departed."""
        return len(self.orders.open_orders) + super().pending

    @property
    def awaited(self) -> str:
        """Describe the messages that a departure waits for; empty if it need not wait."""
        if not (self.orders.open_orders or self.orders.forgotten):
            return super().awaited
        # Acknowledgements that arrived before their paths are requested again, which takes time.
        settled = 2 * ASK_FIRST if super().pending else SETTLED
        if time.monotonic() < self._last + settled:
            return 'paths that may still arrive'
        return ''
