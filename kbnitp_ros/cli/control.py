# SPDX-License-Identifier: Apache-2.0
"""The node of `watch --control`: it subscribes to a mission and calls its services."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from concurrent import futures
from contextlib import contextmanager, suppress
from functools import partial
from http import HTTPStatus
from importlib import import_module
import json
from math import isfinite
from queue import Full, Queue
import re
from threading import Event, Lock, Thread
import time
from typing import Any, NamedTuple

from kbnitp_msgs.msg import (
    AgentHealth,
    AgentState,
    AgentStatus,
    Annotation,
    BeliefMaps,
    Decision,
    DeploymentReport,
    Finding,
    MissionStatus,
    OperatorAction,
    Progress,
    Revocation,
    Standings,
)
from kbnitp_msgs.srv import AddFinding
from kbnitp_ros.base.board import Board, Preview, Proposal, Sign
from kbnitp_ros.base.preflight import Check, Heard, Light, robot_checks
from kbnitp_ros.base.state import BaseState, LackingError, MissingError
from kbnitp_ros.configuration import find_parameter, value_for
from kbnitp_ros.configuration.places import said_cells
from kbnitp_ros.core import DeploymentKey, ORDINARY
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.files import installed, nearest
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.deployments import hear_report, read_path, read_status
from kbnitp_ros.messages.headers import content_hash, from_stamp, SECOND
from kbnitp_ros.messages.health import read_health
from kbnitp_ros.messages.operator_actions import read_operator_action
from kbnitp_ros.messages.orders import CLEARED, NAME, Order, ORDERS, PARAMETERS, SET
from kbnitp_ros.messages.progress import read_decision, read_mission_status
from kbnitp_ros.messages.remarks import read_remark, Told
from kbnitp_ros.messages.standings import read_standings
from kbnitp_ros.messages.states import AgentState as State
from kbnitp_ros.messages.states import read_state
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
from rcl_interfaces.srv import GetParameters, SetParameters
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions

# Seconds between two looks at the board for its streams, between two spins, until a silent stream
# says that it is there, and to wait for a planner or a service and for the answer to an order.
PERIOD, SPIN, ALIVE, START, ANSWER = 0.25, 0.05, 5.0, 10.0, 30.0

# Maximum number of orders that wait for the node, of answers that are kept, and of previews shown.
MAX_ORDERS, MAX_ANSWERS, MAX_PREVIEWS = 16, 10_000, 8

# Bits of the whole numbers of messages, negative where they have a sign.
BITS = {
    f'{sign}int{bits}': bits if sign else -bits for sign in ('u', '') for bits in (8, 16, 32, 64)
}

# Parameters of the planner by which robots are overdue.
TIMES = 'agents', 'step_period', 'return_deadline'

# Parameters of the planner by which robots are checked.
CHECKED = 'min_battery', 'preflight_skip'

Answer = tuple[HTTPStatus, dict[str, Any]]


class Given(NamedTuple):
    """An order of a person: its request as a message, and the future of its answer."""

    nonce: str
    order: Order | None
    arguments: Mapping[str, Any]
    request: Any
    # What the person typed for an irreversible order.
    confirm: Any
    answer: futures.Future[Answer]


class Operator(Node):
    """A node that hears a mission, and calls its services for people."""

    def __init__(self, name: str, namespace: str, context: Context) -> None:
        super().__init__(NAME, namespace=namespace, context=context)
        self.board = Board(name)
        self.orders: Queue[Given] = Queue(MAX_ORDERS)
        # Orders whose service is not found yet, and until when it is sought.
        self._seeking: list[tuple[float, Given]] = []
        # Messages that could not be read.
        self.refused = 0
        # Parameters of planner and estimator, by role.
        self.values: dict[str, dict[str, Any]] = {'planner': {}, 'estimator': {}}
        self._belief: Snapshot | None = None
        # The state and version of the base: the robots must have its field and its version.
        self._base: State | None = None
        self._version = installed().split()[1]
        self._callers: dict[str, Any] = {
            each.service: self.create_client(service_type(each.type_name), each.service)
            for each in ORDERS.values()
        }
        self._standings: Any = None
        for kind, topic, profile, take in (
            (BeliefMaps, 'belief', qos.LATCHED, self._on_belief),
            (MissionStatus, 'mission', qos.LATCHED, self._on_mission),
            (AgentState, 'state', qos.LATCHED, self._on_base),
            (Progress, 'progress', qos.LATCHED, self._on_progress),
        ):
            self._hear(kind, topic, profile, take)

    def _hear(self, kind: type, topic: str, profile: QoSProfile, take: Callable[..., None]) -> Any:
        """Subscribe to a topic; a message that cannot be read changes nothing."""

        def read(data: Any, info: Any) -> None:
            try:
                message = deserialize_message(data, kind)
                take(message, info['source_timestamp'])
            except (ValueError, RuntimeError):
                self.refused += 1

        callback: Any = read
        return self.create_subscription(kind, topic, callback, qos.unread_kept(profile), raw=True)

    def _on_base(self, message: AgentState, _: int) -> None:
        self._base = read_state(message, '')

    def _on_mission(self, message: MissionStatus, _: int) -> None:
        self.board.status = read_mission_status(message)
        self.board.heard = time.monotonic()
        self._ask('planner', message.author, (*PARAMETERS, *TIMES, *CHECKED))
        for agent in self.board.signs:
            # A node that lacks one of the parameters states none.
            for name in ('step_period', 'min_battery'):
                self._ask('planner', message.author, (f'team.{agent}.{name}',))
        service = f'{message.author}/set_parameters'
        if service not in self._callers:
            self._callers[service] = self.create_client(SetParameters, service)

    def _on_progress(self, message: Progress, _: int) -> None:
        self.board.deployments = message.deployments

    def _on_decision(self, message: Decision, _: int) -> None:
        assert self.board.state
        self.board.decision = read_decision(self.board.state.grid, message)

    def _on_belief(self, message: BeliefMaps, _: int) -> None:
        is_first = self._belief is None
        belief = read_belief_maps(message)
        if self.board.state and belief.grid != self.board.state.grid:
            raise ValueError(f'grid is {belief.grid}: it was {self.board.state.grid}')
        self._belief = belief
        self._ask('estimator', belief.author, ('datum',))
        if is_first:
            grid, types = belief.grid, belief.robot_types
            self.board.state = BaseState(grid, belief.max_steps, types)
            self._follow()
            self._hear(OperatorAction, 'operator', qos.EVIDENCE, self._on_operator)
            for kind, topic in (
                (Finding, 'findings'),
                (Annotation, 'annotations'),
                (Revocation, 'revocations'),
            ):
                self._hear(kind, topic, qos.EVIDENCE, partial(self._on_remark, topic))
            self._hear(Decision, 'decision', qos.LATCHED, self._on_decision)

    def _follow(self) -> None:
        """Subscribe to standings, and so receive all of them."""
        if self._standings:
            self.destroy_subscription(self._standings)
        self._standings = self._hear(Standings, 'standings', qos.STANDINGS, self._on_standings)

    def _on_standings(self, message: Standings, _: int) -> None:
        assert self.board.state
        try:
            self.board.state.follow(read_standings(message))
        except LackingError:
            # The planner says so, too.
            self.refused += 1
        except MissingError:
            self._follow()

    def _on_operator(self, message: OperatorAction, _: int) -> None:
        assert self.board.state
        self.board.state.take_action(read_operator_action(self.board.state.grid, message))

    def _on_remark(self, topic: str, message: Any, _: int) -> None:
        assert self.board.state
        remark = read_remark(topic, message)
        self.board.remarks[remark.content] = remark
        if isinstance(remark.said, tuple):
            self.board.state.annotations[remark.content] = remark.said

    def _ask(self, role: str, author: str, names: tuple[str, ...]) -> None:
        """Ask the node of a role for parameters, again with each of its messages."""
        service = f'{author}/get_parameters'
        if service not in self._callers:
            self._callers[service] = self.create_client(GetParameters, service)
        if not self._callers[service].service_is_ready():
            return

        def keep(answer: Any) -> None:
            read = zip(names, map(parameter_value_to_python, answer.result().values))
            values = self.values[role]
            values |= {name: value for name, value in read if value is not None}
            if role == 'planner':
                self.board.parameters = {name: values.get(name) for name in PARAMETERS}
                if self.board.state:
                    for agent in values.get('agents') or ():
                        self._hear_agent(agent)

        call = self._callers[service].call_async(GetParameters.Request(names=names))
        call.add_done_callback(keep)

    def _hear_agent(self, agent: str) -> None:
        """Subscribe to the topics of an agent, once."""
        if agent in self.board.signs:
            return
        self.board.signs[agent] = Sign()
        for kind, name, profile, take in (
            (Path, 'path', qos.EVIDENCE, self._on_path),
            (Path, 'proposal', qos.LATCHED, self._on_proposal),
            (DeploymentReport, 'report', qos.EVIDENCE, self._on_report),
            (AgentStatus, 'status', qos.EVIDENCE, self._on_status),
            (AgentState, 'state', qos.LATCHED, self._on_state),
            (AgentHealth, 'health', qos.READINGS, self._on_health),
        ):
            self._hear(kind, f'{agent}/{name}', profile, partial(take, agent))

    def _on_path(self, agent: str, message: Path, sent_at: int) -> None:
        assert self.board.state
        key, cells = read_path(self.board.state.grid, agent, message)
        self.board.state.take_path(key, cells, content_hash(message), sent_at)

    def _on_proposal(self, agent: str, message: Path, _: int) -> None:
        self.board.proposals.pop(agent, None)
        if message.poses and self.board.state and self._belief:
            key, cells = read_path(self.board.state.grid, agent, message)
            own = self._belief.robot_types.get(agent, ORDINARY).model(self._belief.model)
            returns = Objective.of(self._belief.belief, own).survival(cells)
            self.board.proposals[agent] = Proposal(key, cells, returns)

    def _on_report(self, agent: str, message: DeploymentReport, _: int) -> None:
        assert self.board.state
        self.board.state.record_report(*hear_report(message, agent))

    def _on_status(self, agent: str, message: AgentStatus, _: int) -> None:
        assert self.board.state
        self.board.state.take_status(*read_status(message, agent))

    def _on_state(self, agent: str, message: AgentState, _: int) -> None:
        self.board.signs[agent].take(read_state(message, agent))
        self.board.signs[agent].heard = time.monotonic()

    def _on_health(self, agent: str, message: AgentHealth, _: int) -> None:
        sign, now = self.board.signs[agent], self.get_clock().now().nanoseconds
        sign.health = health = read_health(message, agent)
        sign.heard, sign.offset = time.monotonic(), (health.stamp - now) / SECOND

    def facts(self) -> str:
        """Return the board in JSON."""
        now = self.get_clock().now().nanoseconds
        self.board.checks = [] if self.board.status.ordered else [*self._checks()]
        facts = self.board.facts(now, time.monotonic(), self._longest)
        return json.dumps(facts, allow_nan=False)

    def _checks(self) -> Iterator[Check]:
        """Yield the checks of the robots before the first departure that are judged."""
        values = self.values['planner']
        if self._base is None or 'min_battery' not in values:
            return
        skipped = values.get('preflight_skip', ())
        for agent, sign in self.board.signs.items():
            heard = Heard(sign.state, sign.health, sign.offset)
            needed = value_for(values, 'min_battery', agent)
            for check in robot_checks(agent, heard, self._base, self._version, needed):
                if check.light is not Light.INFO and check.name not in skipped:
                    yield check._replace(name=f'{agent} {check.name}')

    def _longest(self, key: DeploymentKey) -> float:
        """Return the seconds after its departure at which a robot is overdue."""
        assert self.board.state
        values, steps = self.values['planner'], self.board.state.paths[key].size - 1
        period: float = value_for(values, 'step_period', key.agent)
        return steps * period + float(values['return_deadline'])

    def give(self) -> None:
        """Call the services of the orders that wait, each once it is found."""
        while not self.orders.empty():
            self._seeking.append((time.monotonic() + START, self.orders.get()))
        seeking, self._seeking = self._seeking, []
        for until, given in seeking:
            own = f'{self.board.status.author}/set_parameters'
            name = given.order.service if given.order else own
            if self._callers[name].service_is_ready():
                call = self._callers[name].call_async(given.request)
                call.add_done_callback(partial(self._answered, given))
            elif time.monotonic() < until:
                self._seeking.append((until, given))
            else:
                why = f'nobody offers the service {name}: is its node running?'
                given.answer.set_result((HTTPStatus.SERVICE_UNAVAILABLE, {'error': why}))

    def _answered(self, given: Given, call: Any) -> None:
        answer = call.result()
        if given.order is None:
            (result,) = answer.results
            fields = {'success': result.successful, 'message': result.reason}
        else:
            fields = json_fields(answer)
            if given.order.name == 'add_finding':
                fields['cells'] = self.count_cells(given.request)
            if not answer.success:
                # Nothing was foreseen: its effect is zeros.
                fields.pop('effect', None)
            self._note_preview(given, answer)
            if answer.success and (content := getattr(answer, 'content', 0)):
                self.board.effects[content] = answer.effect
        given.answer.set_result((HTTPStatus.OK, fields))

    def count_cells(self, request: AddFinding.Request) -> int:
        """Return the number of cells of a finding; 0 if its places cannot be read."""
        if len(request.x) and self.board.state:
            with suppress(ValueError):
                return said_cells(self.board.state.grid, self.values['estimator'], request).size
            return 0
        return len(request.finding.cells)

    def _note_preview(self, given: Given, answer: Any) -> None:
        """Show a preview until an order of the same kind is obeyed."""
        assert given.order
        previews = self.board.previews
        if not answer.success:
            return
        name = given.order.name
        if not getattr(given.request, 'preview', False):
            for nonce in [nonce for nonce, each in previews.items() if each.order == name]:
                del previews[nonce]
            return
        effect = getattr(answer, 'effect', None)
        evidence = (from_stamp(effect.epoch), effect.events) if effect else None
        made = name, given.arguments, answer.message, evidence, time.monotonic()
        previews[given.nonce] = Preview(*made)
        while len(previews) > MAX_PREVIEWS:
            del previews[next(iter(previews))]


class Control:
    """The board and the orders of people, for the threads of a server."""

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        # Answers by nonce.
        self._answers: OrderedDict[str, futures.Future[Answer]] = OrderedDict()
        self._lock = Lock()
        self.is_over = Event()
        # The board in JSON, and the number of its changes.
        self.facts = ''
        # An error that ended the node.
        self.broken: Exception | None = None

    def spin(self) -> None:
        """Hear the mission, and call services, until the server ends."""
        executor = SingleThreadedExecutor(context=self._operator.context)
        executor.add_node(self._operator)
        due = 0.0
        try:
            while not self.is_over.is_set():
                executor.spin_once(timeout_sec=SPIN)
                self._operator.give()
                if time.monotonic() > due:
                    due = time.monotonic() + PERIOD
                    self.facts = self._operator.facts()
        except Exception as error:
            self.broken = error
        finally:
            self.is_over.set()
            executor.shutdown()

    def stream(self, role: str) -> Iterator[str]:
        """Yield the board as server-sent events, when it changes."""
        streams, shown, said = self._operator.board.streams, '', 0.0
        with self._lock:
            streams[role] += 1
        try:
            while not self.is_over.is_set():
                if (facts := self.facts) != shown:
                    shown, said = facts, time.monotonic()
                    yield f'data: {facts}\n\n'
                elif time.monotonic() > said + ALIVE:
                    # A comment, by which a write fails once the browser has left.
                    said = time.monotonic()
                    yield ':\n\n'
                self.is_over.wait(PERIOD)
        finally:
            with self._lock:
                streams[role] -= 1

    def act(self, body: bytes) -> tuple[HTTPStatus, str]:
        """Obey the order in the body of a request once, and return its answer."""
        try:
            status, fields = self._act(body)
        except (ValueError, RecursionError) as error:
            status, fields = HTTPStatus.BAD_REQUEST, {'error': str(error)}
        return status, json.dumps(fields, allow_nan=False)

    def _act(self, body: bytes) -> Answer:
        given = read_order(body)
        with self._lock:
            if given.nonce in self._answers:
                answer = self._answers[given.nonce]
            else:
                if why := self._unconfirmed(given):
                    return HTTPStatus.CONFLICT, {'error': why}
                try:
                    self._operator.orders.put_nowait(given)
                except Full:
                    why = f'{MAX_ORDERS} orders wait already: order again later'
                    return HTTPStatus.SERVICE_UNAVAILABLE, {'error': why}
                answer = self._answers[given.nonce] = given.answer
                while len(self._answers) > MAX_ANSWERS:
                    self._answers.popitem(last=False)
        try:
            return answer.result(ANSWER)
        except futures.TimeoutError:
            if getattr(given.request, 'preview', False):
                # It changes nothing, so that it is called anew if it is asked for again.
                with self._lock:
                    self._answers.pop(given.nonce, None)
            why = (
                f'no answer after {ANSWER:g} s, and the order may have been obeyed: look at the '
                'board, or ask again with the same nonce'
            )
            return HTTPStatus.GATEWAY_TIMEOUT, {'error': why}

    def _unconfirmed(self, given: Given) -> str:
        """Explain the confirmation that an irreversible order lacks; empty if it needs none."""
        if given.order is None:
            return ''
        if given.order.name == 'end_mission':
            wanted: Any = self._operator.board.name
            what = f'the name of the mission, {wanted!r}'
        elif given.order.name == 'add_finding' and clears(given.request):
            wanted = self._operator.count_cells(given.request)
            what = f'the number of cells, {wanted}'
        elif given.order.service == 'approve' and given.confirm is not None:
            proposals = {**self._operator.board.proposals}
            wanted = {agent: each.path.tolist() for agent, each in proposals.items()}
            what = 'the paths that wait for approval by now'
        else:
            return ''
        is_same = type(given.confirm) is type(wanted) and given.confirm == wanted
        return '' if is_same else f'confirm is {given.confirm!r}: it must be {what}'


def clears(request: AddFinding.Request) -> bool:
    """Return whether a finding opens cells to people."""
    said = request.finding
    return said.hazard == Told.ABSENT and said.confidence > CLEARED and not request.preview


def read_order(body: bytes) -> Given:
    """Read an order from JSON; raise ValueError with the name that is wrong."""
    asked = json.loads(body, parse_constant=refuse_constant)
    check_names('the request', asked, ('nonce', 'order', 'arguments', 'confirm'))
    nonce, name, arguments = asked.get('nonce'), asked.get('order'), asked.get('arguments', {})
    if not isinstance(nonce, str) or not re.fullmatch('[ -~]{8,64}', nonce):
        raise ValueError('nonce must be a text of 8 to 64 characters, another one for each order')
    confirm, answer = asked.get('confirm'), futures.Future[Answer]()
    if name == SET:
        check_names(SET, arguments, ('name', 'value'))
        request: Any = SetParameters.Request(parameters=[read_parameter(**arguments)])
        return Given(nonce, None, arguments, request, confirm, answer)
    if not isinstance(name, str) or name not in ORDERS:
        known = (*ORDERS, SET)
        meant = nearest(name, known) if isinstance(name, str) else ''
        raise ValueError(f'order is {name!r}: {meant}it must be one of {", ".join(known)}')
    order = ORDERS[name]
    if order.fixed and arguments:
        raise ValueError(f'arguments has {len(arguments)} values: {name} has none')
    request = service_type(order.type_name).Request()
    fill(request, {**arguments, **order.fixed} if isinstance(arguments, dict) else arguments, name)
    return Given(nonce, order, arguments, request, confirm, answer)


def service_type(type_name: str) -> Any:
    """Return the class of a service of the table of orders."""
    package, _, name = type_name.split('/')
    return getattr(import_module(f'{package}.srv'), name)


def refuse_constant(text: str) -> None:
    """Refuse a number that JSON does not have."""
    raise ValueError(f'{text} is no number of JSON')


def check_names(where: str, values: Any, known: tuple[str, ...]) -> None:
    """Check that values are an object whose names are known."""
    if not isinstance(values, dict):
        raise ValueError(f'{where} must be an object')
    for name in values:
        if name not in known:
            raise ValueError(
                f'{where} has no {name!r}: {nearest(name, known)}it may have {", ".join(known)}'
            )


def read_parameter(name: Any = None, value: Any = None) -> Any:
    """Return the message of a parameter of the planner that may be set."""
    if name not in PARAMETERS:
        meant = nearest(name, PARAMETERS) if isinstance(name, str) else ''
        raise ValueError(f'name is {name!r}: {meant}it must be one of {", ".join(PARAMETERS)}')
    parameter = find_parameter('planner', name)
    assert parameter is not None
    return Parameter(name, value=parameter.check(value)).to_parameter_msg()


def fill(message: Any, values: Any, where: str) -> None:
    """Set the fields of a message from JSON, each checked by its type."""
    types = message.get_fields_and_field_types()
    check_names(where, values, tuple(types))
    for name, value in values.items():
        field = f'{where}.{name}'
        if '/' in types[name]:
            fill(getattr(message, name), value, field)
        elif listed := re.fullmatch(r'sequence<(\w+)>', types[name]):
            if not isinstance(value, list):
                raise ValueError(f'{field} must be a list')
            setattr(message, name, [read_value(field, listed[1], each) for each in value])
        else:
            setattr(message, name, read_value(field, types[name], value))


def read_value(field: str, kind: str, value: Any) -> Any:
    """Return a value of JSON as the type of a field; 64 bits may be a text of digits."""
    if kind in BITS:
        bits = BITS[kind]
        low, high = (0, 2**bits) if bits > 0 else (-(2 ** (-bits - 1)), 2 ** (-bits - 1))
        if abs(bits) == 64 and isinstance(value, str) and re.fullmatch('-?[0-9]{1,20}', value):
            value = int(value)
        if type(value) is int and low <= value < high:
            return value
        raise ValueError(f'{field} must be a whole number from {low} to {high - 1}')
    if kind == 'boolean' and isinstance(value, bool):
        return value
    if kind == 'double' and type(value) in (int, float) and isfinite(value):
        return float(value)
    if kind == 'string' and isinstance(value, str) and '\0' not in value:
        # Half of a pair of surrogates is no text.
        value.encode()
        return value
    raise ValueError(f'{field} must be of type {kind}')


def json_fields(message: Any) -> Any:
    """Return a message as values of JSON: numbers of 64 bits as texts, None for NaN."""
    if not hasattr(message, 'get_fields_and_field_types'):
        return message
    fields: dict[str, Any] = {}
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind in ('int64', 'uint64'):
            fields[name] = str(value)
        elif kind == 'double':
            fields[name] = value if isfinite(value) else None
        elif kind.startswith('double'):
            fields[name] = [each if isfinite(each) else None for each in map(float, value)]
        elif kind.startswith(('sequence', 'uint32[')):
            fields[name] = [each if isinstance(each, str) else int(each) for each in value]
        else:
            fields[name] = json_fields(value)
    return fields


@contextmanager
def operating(name: str, namespace: str) -> Iterator[Control]:
    """Yield the control of a mission in a namespace; ValueError if no planner answers."""
    context = Context()
    enclave = f'{namespace.rstrip("/")}/{NAME}'
    rclpy.init(
        args=['--ros-args', '--enclave', enclave],
        context=context,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        operator = Operator(name, namespace, context)
        control = Control(operator)
        thread = Thread(target=control.spin, daemon=True)
        thread.start()
        try:
            end = time.monotonic() + START
            while not operator.board.heard:
                if time.monotonic() > end:
                    topic = operator.resolve_topic_name('mission')
                    raise ValueError(
                        f'--control: no planner is heard on {topic}: start the base, name '
                        'another --namespace, or set ROS_DOMAIN_ID to the number that the base '
                        'was started with'
                    )
                time.sleep(SPIN)
            yield control
        finally:
            control.is_over.set()
            thread.join()
    finally:
        context.try_shutdown()
