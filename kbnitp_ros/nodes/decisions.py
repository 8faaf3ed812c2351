# SPDX-License-Identifier: Apache-2.0
"""What the planner says may be relied on, and whether the mission is over by that."""

from __future__ import annotations

from contextlib import suppress

from kbnitp_msgs.msg import Decision as DecisionMessage
from kbnitp_ros.bag import read_log, same_types
from kbnitp_ros.base.knowledge import Knowledge
from kbnitp_ros.configuration import robot_types_of
from kbnitp_ros.core import Decision, Grid, NoPathError, safest_path
from kbnitp_ros.log.evidence import first_belief, PATH, REPORT
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.decisions import decision_message
from kbnitp_ros.messages.deployments import (
    agent_of,
    key_of_path,
    path_message,
    read_path,
    read_report,
)
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import MissionNode
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan


class Decisions:
    """
    The decisions of the planner.

    With a goal it publishes one on `decision` for each belief, and the lane on `decision/lane`
    for people to look at. The service `safest_path` answers for any two places.

    Parameters
    ----------
    node : MissionNode
        The planner.
    grid : Grid
        The field.

    Attributes
    ----------
    knowledge : Knowledge
        The evidence.

    """

    def __init__(self, node: MissionNode, grid: Grid) -> None:
        self.knowledge = Knowledge(
            grid,
            node.values,
            {agent: each for agent, each in robot_types_of(node.values, grid).items() if each.own},
        )
        self._node = node
        self._grid = grid
        self._newest: Snapshot | None = None
        self._decision: Decision | None = None
        self._is_decided = False
        # Why no more robots leave by what was planned on the newest belief, and what was told.
        self._not_worth = ''
        self._told = ''
        self._publisher = node.create_publisher(DecisionMessage, 'decision', qos.LATCHED)
        self._lane = node.create_publisher(Path, 'decision/lane', qos.LATCHED)
        node.create_service(GetPlan, 'safest_path', self._on_safest_path)

    def restore(self, log: str) -> None:
        """Take in the prior and the evidence on record."""
        if prior := first_belief(log):
            self.knowledge.begin(prior)
        with same_types(log):
            for logged in read_log(log, (PATH, REPORT)):
                agent, content = agent_of(logged.topic), content_hash(logged.message)
                # What is none was refused when it came.
                with suppress(ValueError):
                    if logged.type_name == REPORT:
                        self.knowledge.note_report(*read_report(logged.message, agent))
                    elif key_of_path(logged.topic, logged.message):
                        key, cells = read_path(self._grid, agent, logged.message)
                        self.knowledge.note_path(key, cells, content)

    def take(self, newest: Snapshot) -> None:
        """Take note of a belief, the newest."""
        if not newest.deployments:
            self.knowledge.begin(newest)
        self._newest, self._is_decided, self._not_worth = newest, False, ''
        self.is_ready()

    def review(self) -> None:
        """Judge again after a change of parameters."""
        self._is_decided, self._not_worth = False, ''

    def is_ready(self) -> bool:
        """Return whether robots can be planned for the goal on the newest belief, and decide."""
        if self.knowledge.goal is None:
            return True
        if self._newest is None:
            return False
        if not self._is_decided and (decision := self.knowledge.decision(self._newest)):
            self._is_decided, self._decision = True, decision
            self._publish(decision)
        return self._is_decided

    def why_over(self) -> str:
        """Return why no more robots leave; empty if they do."""
        decision = self._decision if self.knowledge.goal is not None else None
        why = self.knowledge.stop.why(decision, self.knowledge.lost) or self._not_worth
        if why != self._told:
            self._told = why
            if why:
                self._node.get_logger().info(f'no more robots leave: {why}')
        return why

    def note_not_worth(self, why: str | NoPathError) -> None:
        """Take note of why what was planned on the newest belief is not flown; empty if it is."""
        self._not_worth = str(why)

    def _publish(self, decision: Decision) -> None:
        newest = self._newest
        assert newest is not None
        message = decision_message(
            self._grid, decision, newest.deployments, newest.stamp, newest.mission
        )
        self._publisher.publish(message)
        self._lane.publish(message.path)
        self._node.get_logger().info(
            f'{decision.goal} free of hazards with probability {decision.p_free:.3f}, '
            f'{decision.hazards_mean:.2f} hazards expected, after {newest.deployments} deployments'
        )

    def _on_safest_path(
        self, request: GetPlan.Request, response: GetPlan.Response
    ) -> GetPlan.Response:
        """Answer with the safest path between two places; without poses if there is none."""
        newest = self._newest
        try:
            if newest is None or (draws := self.knowledge.draws(newest)) is None:
                raise ValueError('no belief is known together with all its evidence')
            start, to = (
                int(self._grid.cells_at([[at.pose.position.x, at.pose.position.y]])[0])
                for at in (request.start, request.goal)
            )
            most = self._node.values['max_steps']
            found = safest_path(self._grid, draws, newest.model, start, to, most)
        except ValueError as error:
            self._node.diagnostics.refuse('safest_path', error)
            return response
        response.plan = path_message(self._grid, found.path, newest.stamp, newest.mission)
        self._node.get_logger().info(
            f'safest path of {found.path.size - 1} steps: free of hazards with probability '
            f'{found.p_free:.3f}, survived with {found.survival:.3f}'
        )
        return response
