# SPDX-License-Identifier: Apache-2.0
"""The planner's watch over the graph: who answers for its agents, and who publishes beliefs."""

from __future__ import annotations

from collections.abc import Sequence

from kbnitp_ros.log.evidence import BELIEF, REPORT
from kbnitp_ros.messages.deployments import agent_of
from kbnitp_ros.nodes.shell import Shell


class Peers:
    """
    Who takes part in the mission besides the planner, as the last look at the graph found them.

    Parameters
    ----------
    node : Shell
        The planner.
    agents : sequence of str
        Those of the team.

    Attributes
    ----------
    estimators : int
        How many nodes publish beliefs.

    """

    def __init__(self, node: Shell, agents: Sequence[str]) -> None:
        self.estimators = 0
        self._node = node
        self._agents = agents
        self._answering: dict[str, int] = {}
        self._unknown_agents: set[str] = set()

    def is_present(self, agent: str) -> bool:
        """Return whether somebody answers for an agent."""
        return self._answering.get(agent, 0) > 0

    def look_for_agents(self) -> None:
        """Notice which agents somebody answers for, and who answers for one that is taken."""
        for agent in self._agents:
            # The planner itself reports robots that are given up.
            answering = self._node.count_authors(f'{agent}/report', REPORT) - 1
            answering = max(answering, 0)
            before = self._answering.get(agent, 0)
            self._answering[agent] = answering
            if answering > max(before, 1):
                self._node.diagnostics.refuse(
                    f'{agent}/report',
                    f'{answering} nodes answer for agent {agent}: unless one has just died, '
                    'each needs a name of its own',
                )
            elif before and not answering:
                self._node.diagnostics.refuse(
                    f'{agent}/path',
                    f'agent {agent} has left the graph: the others carry on, and so does '
                    f'{agent} when it is back',
                )

    def look_for_unknown_agents(self) -> None:
        """Notice who reports for an agent that is none of the team."""
        for topic, types in self._node.get_topic_names_and_types():
            agent = agent_of(topic)
            is_known = not agent or agent in self._agents or agent in self._unknown_agents
            if REPORT not in types or is_known:
                continue
            reports = self._node.resolve_topic_name(f'{agent}/report')
            if topic == reports and self._node.count_publishers(topic):
                self._unknown_agents.add(agent)
                self._node.diagnostics.refuse(
                    f'{agent}/report',
                    f'agent {agent} is unknown, and nobody hears it: the parameter agents names '
                    f'{", ".join(self._agents)}',
                )

    def look_for_estimators(self) -> bool:
        """Notice when more than one node publishes beliefs; return whether one of them left."""
        before = self.estimators
        self.estimators = self._node.count_authors('belief', BELIEF)
        if self.estimators > max(before, 1):
            self._node.diagnostics.refuse(
                'belief',
                f'{self.estimators} nodes publish beliefs: unless one has just died, '
                'end all but one',
            )
        return 0 < self.estimators < before
