# SPDX-License-Identifier: Apache-2.0
"""The simulated agents: their robots go into a hidden world, and some come back."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from kbnitp_ros.log.deployments import read_deployments, read_mission
from kbnitp_ros.nodes.field import FieldNode
from kbnitp_ros.nodes.parameters import kinds_of
from kbnitp_ros.nodes.shell import run
from kbnitp_ros.nodes.simulation import SimulatedAgent, Simulation


class AgentNode(FieldNode):
    """Send a simulated robot along each path of one agent, and report how that ended."""

    node_name = 'agent'

    def __init__(self) -> None:
        super().__init__(self.node_name)
        simulation = Simulation(self)
        log = self.values['resume']
        rules = simulation.grid, self.values['max_steps'], kinds_of(self.values)
        recorded = read_deployments(log, *rules) if log else {}
        mission = read_mission(log) if log else None
        self._agents = [
            SimulatedAgent(simulation, name, self.prefix(name), recorded, mission)
            for name in self.agents_played(simulation.agents)
        ]
        self._is_deaf = True
        self.create_poll(self._look)

    def agents_played(self, team: Sequence[str]) -> Sequence[str]:
        """
        Return the names of the agents that this node plays.

        Raises
        ------
        ValueError
            If it is none of the team.

        """
        if self.values['agent'] not in team:
            raise ValueError(
                f'parameter agent is {self.values["agent"]}: it must be one of agents, '
                f'{", ".join(team)}'
            )
        return [self.values['agent']]

    def prefix(self, name: str) -> str:
        """Return what the names of an agent's topics begin with."""
        # In a namespace of its own they are not once more below it.
        return '' if self.get_namespace().endswith(f'/{name}') else f'{name}/'

    def _look(self) -> None:
        """Take paths, which are kept until then, as soon as somebody takes the reports."""
        if self._is_deaf:
            self.diagnostics.state = self.waiting_for([agent.reports for agent in self._agents])
            if self.diagnostics.state:
                return
            self._is_deaf = False
            for agent in self._agents:
                agent.listen()
        awaited = [agent.awaited for agent in self._agents if agent.awaited]
        names = ', '.join(agent.name for agent in self._agents)
        self.diagnostics.waiting = sum(agent.waiting for agent in self._agents)
        self.diagnostics.state = next(iter(awaited), f'taking paths of {names}')


def main(args: Sequence[str] | None = None) -> int:
    """Run the agent; return the exit code."""
    return run('agent', AgentNode, args, linger=0.15)


if __name__ == '__main__':
    sys.exit(main())
