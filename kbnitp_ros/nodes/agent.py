# SPDX-License-Identifier: Apache-2.0
"""The node of simulated agents, whose robots enter a hidden world."""

from __future__ import annotations

from functools import partial

from kbnitp_ros.configuration.agents import make_robot_types
from kbnitp_ros.log.record import read_resumed, RecordedMission
from kbnitp_ros.log.roles import resumed_log
from kbnitp_ros.nodes.recorded_paths import RecordedPaths
from kbnitp_ros.nodes.runtime.diagnostics import waiting_for
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.runtime.process import run
from kbnitp_ros.nodes.simulation import PATIENCE, SimulatedAgent, Simulation


class AgentNode(FieldNode):
    """Send a simulated robot along each path of one agent, or of all, and report its outcome."""

    def __init__(self) -> None:
        super().__init__('agent')
        resume = self.values['resume']
        log = resumed_log(resume, self.roles) if resume else None
        rules = self.grid, self.values['max_steps'], make_robot_types(self.values, self.grid)
        record = read_resumed(log, *rules) if log else RecordedMission(*rules)
        self._simulation = simulation = Simulation(self, record)
        name, team = self.values['agent'], simulation.agents
        if name and name not in team:
            raise ValueError(
                f'parameter agent is {name}: it must be one of agents, {", ".join(team)}, '
                'or empty for all of them'
            )
        played = [name] if name else team
        self._agents = [SimulatedAgent(simulation, name, record) for name in played]
        # Robots of other nodes change the field as well, unless hazards stay.
        others = () if simulation.is_static else set(team).difference(played)
        self._others = [
            RecordedPaths(
                self,
                other,
                partial(simulation.read_path, other),
                lambda sent: simulation.take(simulation.accept(sent)),
            )
            for other in sorted(others)
        ]
        self.create_poll(self._look)

    def _look(self) -> None:
        """Accept paths, which are kept until then, once the reports have subscribers."""
        if not self._agents[0].is_listening:
            if missing := self.missing_listeners([agent.reports for agent in self._agents]):
                self.diagnostics.state = waiting_for(missing)
                return
            for agent in (*self._agents, *self._others):
                agent.listen()
        awaited = [agent.awaited for agent in (*self._agents, *self._others) if agent.awaited]
        if agent_awaited := self._simulation.awaited:
            awaited.append(
                f'the path of {agent_awaited} in the same round, at most {PATIENCE} s: robots '
                'change the field in their order (parameter hazards.dynamics)'
            )
        names = ', '.join(each.agent for each in self._agents)
        self.diagnostics.waiting = sum(agent.pending for agent in self._agents)
        self.diagnostics.state = waiting_for(awaited[0]) if awaited else f'taking paths of {names}'


main = partial(run, 'agent', AgentNode, linger=0.15)
