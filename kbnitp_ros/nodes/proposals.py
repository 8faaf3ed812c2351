# SPDX-License-Identifier: Apache-2.0
"""The plans that wait to be approved, shown to the operator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.headers import header
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.rounds import in_words, Plans
from kbnitp_ros.nodes.shell import Shell
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray


class Proposals:
    """
    The plans of the next round, on AGENT/proposal until they are approved or refused.

    Parameters
    ----------
    node : Shell
        The planner.
    grid : Grid
        The field.
    agents : sequence of str
        Those of the team.

    Attributes
    ----------
    plans : dict of DeploymentKey to Plan
        Empty when nothing is proposed.

    """

    def __init__(self, node: Shell, grid: Grid, agents: Sequence[str]) -> None:
        self.plans: Plans = {}
        self._node = node
        self._grid = grid
        self._made_for: Any = None
        self._publishers = {
            agent: node.create_publisher(Path, f'{agent}/proposal', qos.LATCHED)
            for agent in agents
        }

    @property
    def paths(self) -> dict[DeploymentKey, NDArray[np.intp]]:
        """Return the paths that are proposed."""
        return {key: plan.path for key, plan in self.plans.items()}

    def are_for(self, situation: Any) -> bool:
        """Return whether there are plans, and they were made for this situation."""
        return bool(self.plans) and self._made_for == situation

    def show(self, plans: Plans, situation: Any) -> None:
        """Propose plans that were made for a situation."""
        self.withdraw()
        self.plans, self._made_for = plans, situation
        for key, plan in plans.items():
            self._publishers[key.agent].publish(path_message(self._grid, plan.path, key.stamp))
            self._node.get_logger().info(f'proposed for {key.agent}: {in_words(self._grid, plan)}')

    def withdraw(self) -> None:
        """Propose nothing."""
        for key in self.plans:
            self._publishers[key.agent].publish(Path(header=header(key.stamp)))
        self.plans = {}
