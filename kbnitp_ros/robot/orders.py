# SPDX-License-Identifier: Apache-2.0
"""The orders of a robot, and the next one that it takes."""

from __future__ import annotations

from kbnitp_ros.robot.journal import Journal, JournaledDeployment


class Orders:
    """The orders on record that a robot's journal does not know."""

    # Robots are replaced under one name. The base sends an agent one order after another, so that
    # an order has ended, or another robot is out on it, if anything was recorded of it or of a
    # later one: a departure, a refusal or a report.

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._orders: dict[int, JournaledDeployment] = {}
        # Stamps of the newest orders with a departure on record, and with a refusal or a report.
        self._departed = self._ended = 0

    def find(self, stamp: int) -> JournaledDeployment | None:
        """Return a deployment with an order or in the journal; None if it is not known."""
        driven = (each for each in self._journal.deployments if each.stamp == stamp)
        return self._orders.get(stamp) or next(driven, None)

    def take(self, deployment: JournaledDeployment) -> None:
        """Take an order that is on record."""
        self._orders[deployment.stamp] = deployment

    def note_departure(self, stamp: int) -> None:
        """Note that a robot of this name departed, by the record of the base."""
        self._departed = max(self._departed, stamp)

    def note_end(self, stamp: int) -> None:
        """Note that an order was refused, or that a report of its deployment is on record."""
        self._ended = max(self._ended, stamp)

    @property
    def open_orders(self) -> list[JournaledDeployment]:
        """Return the orders on which the robot may leave, the newest last."""
        over = max(self._departed, self._ended)
        return [self._orders[stamp] for stamp in sorted(self._orders) if stamp > over]

    @property
    def superseded(self) -> list[JournaledDeployment]:
        """Return the open orders that the newest one supersedes."""
        # With a new journal, and nothing on record, an earlier robot may have left on them.
        if not self._journal.deployments:
            return []
        driven = self._journal.deployments[-1].stamp
        return [order for order in self.open_orders[:-1] if order.stamp > driven]

    @property
    def forgotten(self) -> JournaledDeployment | None:
        """Return the deployment that is out by the record of the base, but not by the journal."""
        return self._orders.get(self._departed) if self._departed > self._ended else None

    def close(self, deployment: JournaledDeployment) -> None:
        """Remove an order that is in the journal, and all earlier ones."""
        self._orders = {
            stamp: each for stamp, each in self._orders.items() if stamp > deployment.stamp
        }
