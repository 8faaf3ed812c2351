# SPDX-License-Identifier: Apache-2.0
"""The services of the operator, the planner's proposals, and its hold on departures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from kbnitp_msgs.msg import OperatorAction as OperatorActionMessage
from kbnitp_msgs.msg import Recorded
from kbnitp_msgs.srv import GiveUp, NoGo, TakeBack
from kbnitp_ros.base.no_go import changed_no_go, open_grid
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.configuration import make_goal
from kbnitp_ros.core import DeploymentKey, Observation
from kbnitp_ros.files import some
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.headers import content_hash, header, next_name, shown
from kbnitp_ros.messages.operator_actions import (
    Action,
    MAX_TIMES,
    operator_action_message,
    OperatorAction,
    Paths,
    REPEATED,
)
from kbnitp_ros.nodes.presence import HOLD, Repeated
from kbnitp_ros.nodes.rounds import describe_plan, Plans, Search
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import MissionNode
from nav_msgs.msg import Path
import numpy as np
from rclpy.task import Future
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

# Maximum number of characters of a reason and of its author.
MAX_TEXT = 200

# What comes of an order that is taken back.
TAKEN_BACK = (
    ': it counts as never sent once its agent has refused it; if its robot has left by then, it '
    'stays out'
)

# Response of a service: success and message.
Response = Any


class Operator:
    """The operator's services (one action at a time), the proposals, and the hold."""

    def __init__(
        self,
        node: MissionNode,
        agents: Sequence[str],
        state: BaseState,
        act: Callable[[OperatorAction], None],
    ) -> None:
        # The plans of the next round that wait for approval, and the search that found them.
        self.proposed: Plans = {}
        self.proposed_by: Search | None = None
        self._node = node
        self._state = state
        self._act = act
        # The published value of `hold`.
        self._is_held: bool | None = None
        # Actions that are not on disk yet, by the hash of the message; the response of a service
        # and its future, if a service was called.
        self._pending: dict[int, tuple[OperatorAction, Response, Future | None]] = {}
        self._publisher = node.create_publisher(OperatorActionMessage, 'operator', qos.EVIDENCE)
        self._proposals = {
            agent: node.create_publisher(Path, f'{agent}/proposal', qos.LATCHED)
            for agent in agents
        }
        # Those of an earlier planner, which was killed, do not wait any more.
        for publisher in self._proposals.values():
            publisher.publish(Path(header=header(node.now())))
        self._holds = Repeated(node, Bool, HOLD, qos.LATCHED)
        node.create_service(SetBool, 'pause', self._on_pause)
        node.create_service(SetBool, 'approve', self._on_approve)
        node.create_service(GiveUp, 'give_up', self._on_give_up)
        node.create_service(NoGo, 'no_go', self._on_no_go)
        node.create_service(TakeBack, 'take_back', self._on_take_back)
        node.create_service(Trigger, 'end_mission', self._on_end)
        if node.values['recorded']:
            node.subscribe(Recorded, 'operator/recorded', self._on_recorded, qos.EVIDENCE)

    def restore(self, data: bytes) -> None:
        """Publish an action on record again, for nodes that join late."""
        self._publisher.publish(data)

    def hold(self, is_held: bool) -> None:
        """Publish whether departures are held, if that has changed."""
        if is_held != self._is_held:
            self._is_held = is_held
            self._holds.publish(Bool(data=is_held))

    @property
    def is_held(self) -> bool:
        """Return whether departures are held."""
        return bool(self._is_held)

    def propose(self, plans: Plans, search: Search) -> None:
        """Publish the plans of a search on AGENT/proposal."""
        self.withdraw()
        self.proposed, self.proposed_by = plans, search
        for key, plan in plans.items():
            self._proposals[key.agent].publish(
                path_message(self._state.grid, plan.path, key.stamp)
            )
            self._node.get_logger().info(
                f'proposed for {key.agent}: {describe_plan(self._state.grid, plan)}'
            )

    def withdraw(self) -> None:
        """Withdraw the proposals."""
        for key in self.proposed:
            self._proposals[key.agent].publish(Path(header=header(key.stamp)))
        self.proposed = {}

    @property
    def awaited(self) -> str | None:
        """Describe the acknowledgement that an action waits for; None if none is pending."""
        if not self._pending:
            return None
        topic = self._node.resolve_topic_name('operator/recorded')
        action, _, _ = next(iter(self._pending.values()))
        return f'the recorder to confirm the action "{action}" on {topic} (parameter recorded)'

    def _on_pause(self, request: SetBool.Request, response: Response) -> Response | Future:
        # A pending action may change the state.
        operator = self._state.operator
        releases = not request.data and (self._state.still_agents or operator.is_goal_lost)
        if not self._pending and request.data == operator.is_paused and not releases:
            state = 'is paused' if request.data else 'is not paused'
            return answered(response, not operator.is_ended, f'the mission {state} already')
        return self._decide(response, Action.PAUSE if request.data else Action.RESUME)

    def _on_approve(self, request: SetBool.Request, response: Response) -> Response | Future:
        paths = {key: plan.path for key, plan in self.proposed.items()}
        if not paths:
            why = '' if self._node.values['approval'] else ': the parameter approval is false'
            if self._state.operator.is_paused:
                why = ': the mission is paused'
            return answered(response, False, f'nothing is proposed{why}')
        return self._decide(response, Action.APPROVE if request.data else Action.REFUSE, paths)

    def _on_give_up(self, request: GiveUp.Request, response: Response) -> Response | Future:
        out = {
            key: path
            for key, path in self._state.paths_in_flight.items()
            if key.agent == request.agent
        }
        if not out:
            names = ', '.join(sorted({key.agent for key in self._state.in_flight})) or 'none'
            why = f'no robot of {shown(request.agent)} is in flight (agents in flight: {names})'
            return answered(response, False, why)
        key = min(out)
        is_open = key not in {*self._state.held, *self._state.unjudged}
        if is_open and self._state.is_at_base(key):
            why = (
                f'{key} has not departed: its agent says on {request.agent}/status that its robot '
                'is at the base'
            )
            return answered(response, False, why)
        try:
            Observation(out[key], False, steps_survived=request.steps_survived)
        except ValueError as error:
            return answered(response, False, str(error))
        return self._decide(
            response,
            Action.GIVE_UP,
            {key: out[key]},
            steps_survived=request.steps_survived,
            settled=self._state.heard_hashes(key),
        )

    def _on_no_go(self, request: NoGo.Request, response: Response) -> Response | Future:
        what = Action.LIFT if request.lift else Action.NO_GO
        cells, values = tuple(sorted({*map(int, request.cells)})), self._node.values
        try:
            said = read_said(request)
            grid, known = self._state.grid, self._state.operator.no_go
            no_go = changed_no_go(grid, known, cells, lift=request.lift)
            open_grid(grid, no_go, make_goal(values, grid), values['max_steps'])
        except ValueError as error:
            return answered(response, False, str(error))
        if request.preview:
            crossing = self._crossing(what, cells)
            response.agents = [key.agent for key in crossing]
            return answered(response, True, f'possible{in_words(crossing)}')
        return self._decide(response, what, cells=cells, **said)

    def _crossing(self, what: Action, cells: Sequence[int]) -> list[DeploymentKey]:
        """Return the robots in flight whose paths cross cells that are closed."""
        if what != Action.NO_GO:
            return []
        paths = self._state.paths_in_flight
        return [key for key, path in paths.items() if np.isin(path, cells).any()]

    def _on_take_back(self, request: TakeBack.Request, response: Response) -> Response | Future:
        try:
            key = self._open_order(request.agent)
            said = read_said(request)
        except ValueError as error:
            return answered(response, False, str(error))
        return self._decide(response, Action.TAKE_BACK, {key: self._state.paths[key]}, **said)

    def _open_order(self, agent: str) -> DeploymentKey:
        """Return the order of an agent on which no robot is known to have departed."""
        state = self._state
        orders = {key.agent: key for key in sorted(state.in_flight) if not state.is_refused(key)}
        left = {key for key in orders.values() if state.is_away(key) or state.has_departed(key)}
        if agent not in orders:
            why = 'agent is empty: name the agent whose order is taken back'
            if agent:
                why = f'no order of {shown(agent)} is open'
            names = ', '.join(str(key) for key in orders.values() if key not in left) or 'none'
            raise ValueError(f'{why} (open orders: {names})')
        key = orders[agent]
        if key in left:
            raise ValueError(f'{key} left: its robot can only be given up or annotated')
        if action := state.operator.taken_back.get(key):
            raise ValueError(f'{key} is {action.refusal}: its agent has not refused it so far')
        return key

    def _on_end(self, _: Trigger.Request, response: Response) -> Response | Future:
        return self._decide(response, Action.END)

    def _decide(
        self,
        response: Response,
        what: Action,
        paths: Paths | None = None,
        **own: Any,
    ) -> Response | Future:
        """Accept or refuse an action with its own fields; return the response, or its future."""
        if self._state.operator.is_ended and what != Action.GIVE_UP:
            return answered(response, False, 'the mission has been ended already')
        if self._pending:
            return answered(response, False, f'waiting for {self.awaited}: call again after that')
        times = sum(each.action == what for each in self._state.operator.actions.values())
        if what in REPEATED and times >= MAX_TIMES:
            why = (
                f'{what.name} was called {times} times, the maximum in a mission: end this '
                'mission by the service end_mission, and begin another one'
            )
            return answered(response, False, why)
        if what in (Action.PAUSE, Action.END):
            self.hold(True)
        action, content = self._publish(what, paths=dict(paths or {}), **own)
        if not self._node.values['recorded']:
            return self._take(action, response)
        future = Future()
        self._pending[content] = action, response, future
        return future

    def _publish(self, what: Action, **own: Any) -> tuple[OperatorAction, int]:
        """Publish an action; return it with the hash of its message."""
        pending = [action.stamp for action, _, _ in self._pending.values()]
        stamp = next_name(self._node.now(), *self._state.operator.actions, *pending)
        action = OperatorAction(stamp, what, self._state.robots_left, **own)
        message = operator_action_message(self._state.grid, action)
        self._publisher.publish(message)
        return action, content_hash(message)

    def record(self, what: Action, values: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Put values of parameters or a change of the goal on record, beyond a restart."""
        action, content = self._publish(what, parameters=dict(values))
        # A start that is not on record changes nothing: the next one is compared with an earlier.
        if self._node.values['recorded'] and what is not Action.START:
            self._pending[content] = action, None, None
        else:
            self._apply(action)

    def _on_recorded(self, message: Recorded) -> None:
        if message.content not in self._pending:
            return
        action, response, future = self._pending.pop(message.content)
        if future is None:
            self._apply(action)
            self._act(action)
        else:
            future.set_result(self._take(action, response))

    def _apply(self, action: OperatorAction) -> None:
        self._state.take_action(action)
        self.hold(self._state.operator.is_holding)

    def _take(self, action: OperatorAction, response: Response) -> Response:
        """Apply an action of a service, and answer."""
        self._apply(action)
        self._node.get_logger().info(str(action))
        pending = ''.join(
            f'; {key} was held, since {why}: it counts as lost from now on'
            for key, why in self._state.held.items()
            if key in action.paths
        )
        if action.cells:
            crossing = self._crossing(action.action, action.cells)
            response.agents = [key.agent for key in crossing]
            pending = in_words(crossing)
        if action.action == Action.TAKE_BACK:
            pending = TAKEN_BACK
        self._act(action)
        state = self._state
        out = [key for key in state.in_flight if key not in {*state.undeparted, *state.held}]
        if action.action == Action.END and out:
            pending = f'; the mission is over once {some(out)} are reported'
        return answered(response, True, f'{action}{pending}')


def in_words(crossing: Sequence[DeploymentKey]) -> str:
    """Return words for the robots that cross closed cells; empty if there are none."""
    if not crossing:
        return ''
    return f'; out, on a path or a way home that may cross them: {some(crossing)}'


def read_said(request: NoGo.Request | TakeBack.Request) -> dict[str, Any]:
    """Return the reason and the author of a request."""
    said = {'reason': request.reason, 'author': request.author}
    for name, text in said.items():
        if len(text) > MAX_TEXT:
            raise ValueError(f'{name} has {len(text)} characters, at most {MAX_TEXT} fit')
    return said


def answered(response: Response, success: bool, message: str) -> Response:
    """Return a response of a service."""
    response.success, response.message = success, message
    return response
