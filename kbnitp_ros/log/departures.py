# SPDX-License-Identifier: Apache-2.0
"""Which orders have departed and which were refused, by what their agents say."""

from __future__ import annotations

from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.status import AgentStatus, OrderState


class AtBaseError(ValueError):
    """A robot is reported lost that is at the base, or was when word of it came last."""


class Departures:
    """What became of orders: a fold of the statuses and the reports of all agents."""

    def __init__(self) -> None:
        # The robots that have departed and were not reported.
        self.out: set[DeploymentKey] = set()
        self._statuses: dict[DeploymentKey, AgentStatus] = {}
        # When the agent made its report, by its own clock; None if another one did.
        self._reported: dict[DeploymentKey, int | None] = {}

    def take(self, key: DeploymentKey, status: AgentStatus) -> bool:
        """Record a status; return whether it is news. Raise ValueError for a contradiction."""
        known = self._statuses.get(key)
        if known is not None and not self._follows(key, status, known):
            return False
        if key in self._reported:
            reported = self._reported[key]
            is_late = reported is not None and status.stamp > reported
            if status.state is OrderState.REFUSED or is_late:
                raise ValueError(
                    f'deployment {key} is {status.state.name} after it was reported: the report '
                    'holds'
                )
        elif status.state is OrderState.DEPARTED:
            self.out.add(key)
        self._statuses[key] = status
        return True

    @staticmethod
    def _follows(key: DeploymentKey, status: AgentStatus, known: AgentStatus) -> bool:
        """Return whether a status follows the one known; raises ValueError if it cannot."""
        if status == known or status.state is known.state is OrderState.ACCEPTED:
            return False
        if known.state is OrderState.ACCEPTED:
            return True
        if status.state is OrderState.ACCEPTED and status.stamp <= known.stamp:
            # It was said before, and heard again by one that was restarted.
            return False
        raise ValueError(
            f'deployment {key} is {status.state.name}, and was {known.state.name} before: the '
            f'first counts (do two robots have the name {key.agent}?)'
        )

    def end(self, key: DeploymentKey, reported: int | None) -> None:
        """Take note of a report that its agent made at a time, or others who gave it up (None)."""
        self._reported[key] = self._reported.get(key) if reported is None else reported
        self.out.discard(key)
        if self.is_refused(key):
            # Whoever comes back has been away.
            del self._statuses[key]

    def status(self, key: DeploymentKey) -> AgentStatus | None:
        """Return what was said last of an order; None if nothing was."""
        return self._statuses.get(key)

    def is_refused(self, key: DeploymentKey) -> bool:
        """Return whether the robot stays at the base."""
        status = self._statuses.get(key)
        return status is not None and status.state is OrderState.REFUSED

    def is_at_base(self, key: DeploymentKey) -> bool:
        """Return whether the agent said something of an order, and not that the robot departs."""
        status = self._statuses.get(key)
        return status is not None and status.state is not OrderState.DEPARTED

    def check_loss(self, key: DeploymentKey) -> None:
        """Check that a robot can have been lost; raises `AtBaseError` if it is not known to be."""
        if self.is_refused(key):
            raise ValueError(
                f'deployment {key} is reported lost, and its robot stays at the base: '
                f'{self._statuses[key].reason}'
            )
        if self.is_at_base(key) and key not in self._reported:
            raise AtBaseError(
                f'deployment {key} is reported lost, and its agent has not said that its robot '
                'departs'
            )
