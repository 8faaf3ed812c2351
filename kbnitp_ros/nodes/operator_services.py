# SPDX-License-Identifier: Apache-2.0
"""The services by which an operator decides what the planner does, and what they decided."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from kbnitp_msgs.msg import OperatorAction
from kbnitp_msgs.srv import GiveUp
from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.log.decisions import Decisions, Paths
from kbnitp_ros.messages.decisions import Action, Decision, decision_message
from kbnitp_ros.messages.headers import next_name, read_name
from kbnitp_ros.messages.sizes import TIME
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.proposals import Proposals
from kbnitp_ros.nodes.robots_out import RobotsOut
from kbnitp_ros.nodes.shell import Shell
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

# Of any of the services: each has success and message.
Response = Any


class Operator:
    """
    Takes what the operator decides, one decision after another.

    A decision is published on `operator`. With the parameter `recorded` it holds, and its service
    answers, when the recorder has it on disk: what an operator was told is so after any crash.

    Parameters
    ----------
    node : Shell
        The planner.
    grid : Grid
        The field.
    out : RobotsOut
        The robots that can be given up.
    proposals : Proposals
        The plans that can be approved or refused.
    act : callable
        Called with each decision when it holds.

    Attributes
    ----------
    decisions : Decisions
        Those that hold.

    """

    def __init__(
        self,
        node: Shell,
        grid: Grid,
        out: RobotsOut,
        proposals: Proposals,
        act: Callable[[Decision], None],
    ) -> None:
        self.decisions = Decisions()
        self._node = node
        self._grid = grid
        self._out = out
        self._proposals = proposals
        self._act = act
        self._pending: tuple[Decision, Response, Future] | None = None
        self._publisher = node.create_publisher(OperatorAction, 'operator', qos.EVIDENCE)
        node.create_service(SetBool, 'pause', self._on_pause)
        node.create_service(SetBool, 'approve', self._on_approve)
        node.create_service(GiveUp, 'give_up', self._on_give_up)
        node.create_service(Trigger, 'end_mission', self._on_end)
        if node.values['recorded']:
            node.hear(Time, 'operator/recorded', self._on_recorded, qos.EVIDENCE, TIME)

    def restore(self, decision: Decision, data: bytes) -> None:
        """Take a decision on record, and publish it again for those who join late."""
        if self.decisions.take(decision):
            self._publisher.publish(data)

    @property
    def awaited(self) -> str:
        """Return what a decision waits for; empty when none does."""
        if self._pending is None:
            return ''
        topic = self._node.resolve_topic_name('operator/recorded')
        return (
            f'waiting for the recorder to tell on {topic} that it is on disk that the operator '
            f'{self._pending[0]} (parameter recorded)'
        )

    def _on_pause(self, request: SetBool.Request, response: Response) -> Response | Future:
        if request.data == self.decisions.is_paused:
            state = 'is paused' if request.data else 'is not paused'
            return answered(response, not self.decisions.is_ended, f'the mission {state} already')
        return self._decide(response, Action.PAUSE if request.data else Action.RESUME)

    def _on_approve(self, request: SetBool.Request, response: Response) -> Response | Future:
        paths = self._proposals.paths
        if not paths:
            why = '' if self._node.values['approval'] else ': the parameter approval is false'
            if self.decisions.is_paused:
                why = ': the mission is paused'
            return answered(response, False, f'nothing is proposed{why}')
        return self._decide(response, Action.APPROVE if request.data else Action.REFUSE, paths)

    def _on_give_up(self, request: GiveUp.Request, response: Response) -> Response | Future:
        out = {key: robot.path for key, robot in self._out.items() if key.agent == request.agent}
        if not out:
            names = ', '.join(sorted(self._out.agents)) or 'none'
            told = f'no robot of {request.agent!r} is out: {names} is'
            return answered(response, False, told)
        key = min(out)
        if self._node.values['recorded'] and not self._out.is_recorded(key):
            told = f'{key} has not left: its path is not on disk yet'
            return answered(response, False, told)
        try:
            Observation(out[key], False, steps_survived=request.steps_survived)
        except ValueError as error:
            return answered(response, False, str(error))
        return self._decide(response, Action.GIVE_UP, {key: out[key]}, request.steps_survived)

    def _on_end(self, _: Trigger.Request, response: Response) -> Response | Future:
        return self._decide(response, Action.END)

    def _decide(
        self, response: Response, action: Action, paths: Paths | None = None, steps: int = 0
    ) -> Response | Future:
        """Take a decision, unless it cannot be taken now; return the answer, or its future."""
        if self.decisions.is_ended and action != Action.GIVE_UP:
            return answered(response, False, 'the mission has been ended already')
        if self._pending:
            return answered(response, False, f'{self.awaited}: ask again when it is')
        stamp = next_name(self._node.now(), *self.decisions.taken)
        decision = Decision(stamp, action, self._out.left, dict(paths or {}), steps)
        self._publisher.publish(decision_message(self._grid, decision))
        if not self._node.values['recorded']:
            return self._take(decision, response)
        self._pending = decision, response, Future()
        return self._pending[2]

    def _on_recorded(self, message: Time) -> None:
        try:
            stamp = read_name('stamp', message)
        except ValueError as error:
            self._node.diagnostics.refuse('operator/recorded', error)
            return
        if self._pending and self._pending[0].stamp == stamp:
            decision, response, future = self._pending
            self._pending = None
            future.set_result(self._take(decision, response))

    def _take(self, decision: Decision, response: Response) -> Response:
        """Have a decision hold from now on."""
        self.decisions.take(decision)
        self._node.get_logger().info(f'the operator {decision}')
        self._act(decision)
        return answered(response, True, f'the operator {decision}')


def answered(response: Response, success: bool, message: str) -> Response:
    """Return the answer of a service."""
    response.success, response.message = success, message
    return response
