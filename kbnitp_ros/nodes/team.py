# SPDX-License-Identifier: Apache-2.0
"""All simulated agents of a team in one process."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from kbnitp_ros.nodes.agent import AgentNode
from kbnitp_ros.nodes.shell import run


class TeamNode(AgentNode):
    """Send a simulated robot along each path of any agent of the team, and report how it ended."""

    node_name = 'team'

    def agents_played(self, team: Sequence[str]) -> Sequence[str]:
        """Return the names of all agents."""
        return team

    def prefix(self, name: str) -> str:
        """Return what the names of an agent's topics begin with."""
        return f'{name}/'


def main(args: Sequence[str] | None = None) -> int:
    """Run the team; return the exit code."""
    return run('team', TeamNode, args, linger=0.15)


if __name__ == '__main__':
    sys.exit(main())
