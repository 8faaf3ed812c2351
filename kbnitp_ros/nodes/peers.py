# SPDX-License-Identifier: Apache-2.0
"""The planner's watch over the graph: who answers for its agents, and who publishes beliefs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from kbnitp_ros.log.roles import BELIEF, PATH, REPORT, STATUS
from kbnitp_ros.nodes.parameter_watch import NAMELESS
from kbnitp_ros.nodes.runtime.node import MissionNode

# How often the planner looks for the names of other planners before it reports them.
LOOKS = 20


class Peers:
    """Who takes part in the mission besides the planner, as last seen in the graph."""

    def __init__(self, node: MissionNode, agents: Sequence[str]) -> None:
        # How many nodes publish beliefs.
        self.estimators = 0
        self._node = node
        self._agents = agents
        self._answering: dict[str, int] = {}
        self._unknown_agents: set[str] = set()
        self._planners: dict[str, int] = {}
        self._looks: Counter[str] = Counter()

    def is_present(self, agent: str) -> bool:
        """Return whether somebody answers for an agent."""
        return self._answering.get(agent, 0) > 0

    def says_status(self, agent: str) -> bool:
        """Return whether somebody tells when robots of an agent depart."""
        return self._node.count_authors(f'{agent}/status', STATUS) > 0

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

    def look_for_planners(self) -> None:
        """Notice when others publish paths of an agent, and say which nodes do."""
        for agent in self._agents:
            before = self._planners.get(agent, 1)
            planners = self._node.count_authors(f'{agent}/path', PATH)
            if planners > max(before, 1):
                nodes = self._node.authors(f'{agent}/path', PATH)
                self._looks[agent] += 1
                # DDS tells the name of a node a moment after its publishers, if it has one.
                if NAMELESS in nodes and self._looks[agent] < LOOKS:
                    continue
                self._node.diagnostics.refuse(
                    f'{agent}/path',
                    f'{len(nodes)} planners publish it, nodes {", ".join(nodes)}: stop all but '
                    'one, unless one has just died; of two paths with the same stamp the one '
                    'recorded first counts',
                )
            self._planners[agent] = planners

    def look_for_unknown_agents(self) -> None:
        """Notice who reports for an agent that is none of the team."""
        for topic, types in self._node.get_topic_names_and_types():
            agent = topic.removeprefix(f'{self._node.above}/').removesuffix('/report')
            is_known = '/' in agent or agent in self._agents or agent in self._unknown_agents
            if REPORT in types and not is_known and self._node.count_publishers(topic):
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
