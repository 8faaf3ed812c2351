# SPDX-License-Identifier: Apache-2.0
"""Other recorders, planners, estimators and agents in the graph, and the hold on departures."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from math import inf
import time
from typing import Any
from uuid import uuid4

from kbnitp_msgs.msg import AgentState, OperatorAction, RecorderState
from kbnitp_ros.base.protocol import VERSION
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.log.schema import describe
from kbnitp_ros.messages.headers import content_hash, from_stamp, to_stamp
from kbnitp_ros.messages.operator_actions import OperatorState, read_operator_action
from kbnitp_ros.messages.standings import Standings
from kbnitp_ros.messages.states import read_state, Readiness, state_message
from kbnitp_ros.messages.topics import BELIEF, BOOL, PATH, REPORT, STANDINGS, STATUS
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.graph import full_name, PUBLISHED
from kbnitp_ros.nodes.runtime.node import FieldNode, MissionNode
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool

# Version of this package, which each agent states.
INSTALLED = version('kbnitp_ros')

# Topic that every recorder, and no other node, publishes from start to end.
OPERATORS = 'operator/recorded'

# Key of a recorder's log in its diagnostics.
LOG = 'log'

# Seconds that a recorder searches for other recorders before its acknowledgements count; seconds
# between two of its messages; and seconds without one after which it counts as dead.
LOOK = 1.5
AGAIN = 1.0
SILENT = 3.0

# Maximum numbers of characters of the name of a log, and of other recorders that are remembered.
MAX_PATH = 4096
MAX_RECORDERS = 10

# First and longest pause before another node's message is corrected, seconds: two estimators would
# correct each other for ever. Maximum number of own messages that are told from those of others,
# and maximum seconds to wait until the graph names the author of a message.
MIN_PAUSE, MAX_PAUSE = 0.1, 1.0
MAX_OWN = 100
MAX_UNNAMED = 30.0


class Repeated:
    """A topic with one author, who repeats its last message when another node contradicts it."""

    def __init__(
        self, node: MissionNode, kind: type, topic: str, profile: QoSProfile, **options: Any
    ) -> None:
        self._node = node
        self._topic = topic
        self.publisher = node.create_publisher(kind, topic, profile, **options)
        self._last: Any = None
        # Hashes of own messages, which are received as well.
        self._own: OrderedDict[int, None] = OrderedDict()
        self._said_at = self._contradicted_at = -inf
        self._is_contradicted = False
        self._pause = MIN_PAUSE
        kind_of = f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'
        self._type_name = kind_of
        self._is_stamped = hasattr(kind(), 'header')
        node.subscribe(kind, topic, self._on_message, profile)
        node.create_poll(self._correct)

    def publish(self, message: Any) -> None:
        """Publish a message, which counts from now on."""
        self._pause = MIN_PAUSE
        self._send(message)

    def _send(self, message: Any) -> None:
        self._last, self._is_contradicted = message, False
        content = content_hash(message)
        self._own.pop(content, None)
        self._own[content] = None
        if len(self._own) > MAX_OWN:
            self._own.popitem(last=False)
        self._said_at = time.monotonic()
        self.publisher.publish(message)

    def _on_message(self, message: Any) -> None:
        # A message without a stamp may be another node's, although this one has said the same.
        if self._last is None:
            return
        content = content_hash(message)
        is_own = content in self._own if self._is_stamped else content == next(reversed(self._own))
        if not is_own:
            self._is_contradicted, self._contradicted_at = True, time.monotonic()
            self._correct()

    def _correct(self) -> None:
        """Repeat the last message if it was contradicted; refuse the other author once named."""
        now = time.monotonic()
        if self._is_contradicted and now > self._said_at + self._pause:
            self._pause = min(2.0 * self._pause, MAX_PAUSE)
            self._send(self._last)
        if now > self._contradicted_at + MAX_UNNAMED:
            return
        others = self._node.named_authors(self.publisher.topic_name, self._type_name)
        # A node that was killed and restarted is named twice for some time.
        if len({*others}) > 1:
            self._contradicted_at = -inf
            self._node.diagnostics.refuse(
                self._topic,
                f'another node contradicts this one, which repeats its message: nodes '
                f'{", ".join(others)} publish it; stop all but one',
            )


def check_author(node: MissionNode, said: Standings, epoch: int, rules: int) -> None:
    """Check that no second estimator takes over while the graph lists the first one."""
    named = node.named_authors('standings', STANDINGS)
    if named and said.author not in named:
        raise ValueError(
            f'author is {said.author}, and only {", ".join(sorted({*named}))} publishes standings'
        )
    # The graph counts a node a moment before it names it.
    count = node.count_authors('standings', STANDINGS)
    is_other = len({*named}) > 1 or (count > 1 and said.rules != rules)
    if epoch and said.epoch > epoch and is_other:
        nodes = f', nodes {", ".join(named)}' if named else ''
        raise ValueError(
            f'{count} estimators publish standings{nodes}: the first one counts; stop all but one'
        )


class Recorders:
    """The recorders of a namespace; this process is one of them."""

    def __init__(self, node: MissionNode, log: object) -> None:
        self._node = node
        self._own = RecorderState(
            author=node.get_fully_qualified_name(),
            instance=uuid4().hex,
            begun=to_stamp(time.time_ns()),
            log=str(log)[:MAX_PATH],
        )
        self._topic = node.resolve_topic_name(OPERATORS)
        self._looks_until = time.monotonic() + LOOK
        # Other recorders by instance, with the time of their last message in seconds.
        self._others: OrderedDict[str, tuple[RecorderState, float]] = OrderedDict()
        self._publisher = node.create_publisher(RecorderState, 'recorders', qos.ALIVE)
        node.subscribe(RecorderState, 'recorders', self._on_state, qos.ALIVE, keeps_all=False)
        node.create_poll(self.publish, AGAIN)
        self.publish()

    def publish(self) -> None:
        """Show that this recorder is alive."""
        self._publisher.publish(self._own)

    def _on_state(self, message: RecorderState) -> None:
        if message.instance == self._own.instance or len(message.log) > MAX_PATH:
            return
        self._others.pop(message.instance, None)
        self._others[message.instance] = message, time.monotonic()
        if len(self._others) > MAX_RECORDERS:
            self._others.popitem(last=False)

    def _publishers(self) -> Counter[str]:
        """Return the number of publishers of `OPERATORS` by node, without this process."""
        own = sum(each.topic_name == self._topic for each in self._node.publishers)
        if self._node.count_publishers(self._topic) <= own:
            return Counter()
        known = self._node.authors(self._topic, PUBLISHED['recorder'])
        return Counter(known) - Counter({self._node.get_fully_qualified_name(): own})

    @property
    def why_silent(self) -> str:
        """Explain why acknowledgements of this recorder do not count; empty if they do."""
        now = time.monotonic()
        if now < self._looks_until:
            return 'other recorders, if there are any, to say that they are here'
        alive = [state for state, heard in self._others.values() if heard >= now - SILENT]
        publishers = self._publishers() if alive else Counter()
        earlier = []
        for state in alive:
            # Recorders may share a node name: at most as many are alive as publishers exist.
            if publishers[state.author]:
                publishers[state.author] -= 1
                if rank(state) < rank(self._own):
                    earlier.append(f'node {state.author} records to {state.log}')
        if not earlier:
            return ''
        return (
            'the end of an earlier recorder, whose acknowledgements count: '
            f'{" and ".join(earlier)}'
        )


def rank(state: RecorderState) -> tuple[int, str]:
    """Return the start of a recorder, with its instance to break ties."""
    return from_stamp(state.begun), state.instance


# Type hash of publishers that state none, as those of earlier distributions of ROS.
UNHASHED = 'INVALID'


class Peers:
    """The other participants of the mission, as last seen in the graph."""

    def __init__(self, node: MissionNode, agents: Sequence[str]) -> None:
        self._node = node
        self._agents = agents
        # Number of other publishers by topic.
        self._others: Counter[str] = Counter()
        # Hashes of the type of reports: of this node, and of the publishers of each agent.
        _, self._own = describe(REPORT)
        self._versions: dict[str, set[str]] = {}
        self._unknown_agents: set[str] = set()
        # Agents whose nodes do not report departures.
        self.silent = [*agents]

    @property
    def estimators(self) -> int:
        """Return the number of nodes that publish beliefs."""
        return self._others['belief']

    @property
    def absent(self) -> list[str]:
        """Return the agents without a node that publishes their reports."""
        return [agent for agent in self._agents if not self._others[f'{agent}/report']]

    @property
    def outdated(self) -> list[str]:
        """Return the agents whose nodes have reports of another version."""
        known = {self._own, UNHASHED}
        return [agent for agent in self._agents if self._versions.get(agent, set()) - known]

    def look(self) -> bool:
        """Check the graph and warn; return whether one of several estimators has left."""
        for agent in self._agents:
            # The planner itself publishes reports, of robots that are given up.
            before, now = self._count(f'{agent}/report', REPORT, own=1)
            if now != before:
                self._look_for_versions(agent)
            if now > max(before, 1):
                self._node.diagnostics.refuse(
                    f'{agent}/report',
                    f'{now} nodes publish reports of agent {agent}: unless one has just died, '
                    'give each its own agent name',
                )
            elif before and not now:
                self._node.diagnostics.refuse(
                    f'{agent}/path',
                    f'agent {agent} has left the graph: the other agents continue, and {agent} '
                    'gets orders again when it is back',
                )
            self._look_for_planners(f'{agent}/path')
        count = self._node.count_authors
        self.silent = [each for each in self._agents if not count(f'{each}/status', STATUS)]
        self._look_for_unknown_agents()
        before, now = self._count('belief', BELIEF)
        if now > max(before, 1):
            self._node.diagnostics.refuse(
                'belief',
                f'{now} nodes publish beliefs: unless one has just died, end all but one',
            )
        return 0 < now < before

    def _count(self, topic: str, type_name: str, own: int = 0) -> tuple[int, int]:
        """Count the other publishers of a topic; return the previous and the present number."""
        before = self._others[topic]
        self._others[topic] = max(self._node.count_authors(topic, type_name) - own, 0)
        return before, self._others[topic]

    def _look_for_versions(self, agent: str) -> None:
        """Refuse nodes of an agent whose reports cannot be read."""
        topic = f'{agent}/report'
        name = self._node.resolve_topic_name(topic)
        known = self._node.get_publishers_info_by_topic(name)
        reports = [node for node in known if node.topic_type == REPORT]
        self._versions[agent] = {str(node.topic_type_hash) for node in reports}
        for node in reports:
            if str(node.topic_type_hash) not in (self._own, UNHASHED):
                self._node.refuse_once(
                    topic,
                    f'node {full_name(node.node_namespace, node.node_name)} has messages of '
                    'another version of kbnitp_msgs: robots and base must both be of version '
                    f'{VERSION} or later',
                )

    def _look_for_planners(self, topic: str) -> None:
        """Warn of other planners that publish paths of an agent, once their names are known."""
        planners = self._node.count_authors(topic, PATH) - 1
        if planners > max(self._others[topic], 0):
            nodes = self._node.named_authors(topic, PATH)
            if not nodes:
                return
            self._node.diagnostics.refuse(
                topic,
                f'{len(nodes)} planners publish it, nodes {", ".join(nodes)}: stop all but '
                'one, unless one has just died; if two paths have the same stamp, the one '
                'recorded first counts',
            )
        self._others[topic] = planners

    def _look_for_unknown_agents(self) -> None:
        """Warn of reports for an agent outside the team."""
        for topic, types in self._node.get_topic_names_and_types():
            agent = topic.removeprefix(f'{self._node.above}/').removesuffix('/report')
            is_known = '/' in agent or agent in self._agents or agent in self._unknown_agents
            if REPORT in types and not is_known and self._node.count_publishers(topic):
                self._unknown_agents.add(agent)
                self._node.diagnostics.refuse(
                    f'{agent}/report',
                    f'agent {agent} is unknown, and its reports are ignored: the parameter agents '
                    f'names {", ".join(self._agents)}',
                )


HOLD = 'hold'


class HoldSubscription:
    """A subscription to `hold`: departures are blocked until its only publisher allows them."""

    def __init__(self, node: MissionNode, act: Callable[[], None] = lambda: None) -> None:
        self._node = node
        self._act = act
        self.is_held: bool | None = None
        self._topic = node.resolve_topic_name(f'{node.above}/{HOLD}')
        node.subscribe(Bool, self._topic, self._on_hold, qos.LATCHED)

    def _on_hold(self, message: Bool) -> None:
        self.is_held = message.data
        self._act()

    @property
    def awaited(self) -> str:
        """Describe the condition that blocks departures; empty if there is none."""
        if self.is_held is None:
            return f'the planner to publish on {self._topic} whether robots may depart'
        if self.is_held:
            return f'the operator to end the pause ({self._topic} is true)'
        # A killed planner stays in the graph beside its restarted node of the same name.
        if self._node.count_authors(self._topic, BOOL) > 1:
            others = sorted({*self._node.authors(self._topic, BOOL)})
            if len(others) > 1:
                return (
                    f'all nodes but one to stop publishing {self._topic}: {", ".join(others)} '
                    'publish it'
                )
        return ''


class OperatorSubscription:
    """A subscription to the operator's actions, for the orders that are taken back."""

    def __init__(self, node: FieldNode, agents: Iterable[str], state: OperatorState) -> None:
        self._node = node
        self._agents = {*agents}
        self._state = state
        topic = f'{node.above}/operator'
        node.subscribe(OperatorAction, topic, self._on_action, qos.EVIDENCE)

    def _on_action(self, message: OperatorAction) -> None:
        # Paths of other agents may start at bases that this node does not know.
        if message.action != OperatorAction.TAKE_BACK or not self._agents >= {*message.agents}:
            return
        try:
            self._state.apply(read_operator_action(self._node.grid, message))
        except ValueError as error:
            self._node.diagnostics.refuse('operator', error)

    def refusal(self, key: DeploymentKey) -> str:
        """Return the reason to refuse an order; empty if it is not taken back."""
        action = self._state.taken_back.get(key)
        return action.refusal if action else ''


class StatePublisher:
    """The publisher of the state of an agent, or of the base: on change, and while it waits."""

    def __init__(self, node: MissionNode, grid: Grid, agent: str = '') -> None:
        self._node = node
        self._grid = grid
        self._agent = agent
        self._said: tuple[Readiness, str, bool, str] | None = None
        self._said_at = -inf
        topic = f'{node.above}/{agent}/state' if agent else f'{node.above}/state'
        self._publisher = Repeated(node, AgentState, topic, qos.LATCHED)

    def publish(
        self, readiness: Readiness, reason: str = '', is_at_base: bool = False, journal: str = ''
    ) -> None:
        """Publish a state if it differs from the last one, and each second of a wait."""
        now = time.monotonic()
        is_due = readiness is not Readiness.READY and now > self._said_at + AGAIN
        if self._said != (said := (readiness, reason, is_at_base, journal)) or is_due:
            self._said, self._said_at = said, now
            self._publisher.publish(
                state_message(
                    self._grid,
                    self._agent,
                    readiness,
                    reason,
                    is_at_base,
                    self._node.now(),
                    journal,
                )
            )


class BaseField:
    """The field of the base, which an agent compares with its own before it takes an order."""

    def __init__(self, node: MissionNode, grid: Grid) -> None:
        # Description of the difference, which blocks departures; empty if there is none.
        self.awaited = ''
        self._node = node
        self._grid = grid
        node.subscribe(AgentState, f'{node.above}/state', self._on_state, qos.LATCHED)

    def _on_state(self, message: AgentState) -> None:
        try:
            differs = read_state(message, '').difference(self._grid)
        except ValueError as error:
            self._node.diagnostics.refuse('state', error)
            return
        self.awaited = f'the same field as the base: {differs}' if differs else ''
