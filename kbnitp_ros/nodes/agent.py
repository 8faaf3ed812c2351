# SPDX-License-Identifier: Apache-2.0
"""The simulated agents: their robots go into a hidden world, and some come back."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from kbnitp_ros.log.deployments import read_deployments
from kbnitp_ros.nodes.shell import run, Shell
from kbnitp_ros.nodes.simulation import SimulatedAgent, Simulation


class AgentNode(Shell):
    """Send a simulated robot along each path of one agent, and report how that ended."""

    node_name = 'agent'

    def __init__(self) -> None:
        super().__init__(self.node_name)
        simulation = Simulation(self)
        log = self.values['resume']
        recorded = read_deployments(log, simulation.grid, self.values['max_steps']) if log else {}
        self._agents = [
            SimulatedAgent(simulation, name, self.prefix(name), recorded)
            for name in self.agents_played(simulation.agents)
        ]
        self._awaiting = self.create_poll(self._listen)

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

    def _listen(self) -> None:
        """Take paths, which are kept until then, as soon as somebody takes the reports."""
        self.diagnostics.state = self.waiting_for([agent.reports for agent in self._agents])
        if not self.diagnostics.state:
            self._awaiting.cancel()
            self.diagnostics.state = f'taking paths of {", ".join(a.name for a in self._agents)}'
            for agent in self._agents:
                agent.listen()


def main(args: Sequence[str] | None = None) -> int:
    """Run the agent; return the exit code."""
    return run('agent', AgentNode, args, linger=0.15)


if __name__ == '__main__':
    sys.exit(main())
