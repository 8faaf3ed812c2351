# SPDX-License-Identifier: Apache-2.0
"""Other recorders, planners, estimators and agents in the graph, and the hold on departures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
import time
from uuid import uuid4

from kbnitp_msgs.msg import AgentState
from kbnitp_ros.base.obstacles import VERSION
from kbnitp_ros.core import Grid
from kbnitp_ros.log.roles import BELIEF, PATH, REPORT, STATUS
from kbnitp_ros.log.schema import describe
from kbnitp_ros.messages.states import read_state, Readiness, state_message
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.graph import full_name, PUBLISHED
from kbnitp_ros.nodes.runtime.node import MissionNode
from std_msgs.msg import Bool

INSTANCE = 'instance'

# Topic that every recorder, and no other node, publishes from start to end. A recorder is alive if
# it publishes this topic and diagnostics: DDS lists publishers of killed processes, and any node
# can publish diagnostics.
OPERATORS = 'operator/recorded'

# Keys in the diagnostics of a recorder: its log, and the start of the recording in nanoseconds.
LOG = 'log'
BEGUN = 'begun'

# Maximum numbers of characters of the values of LOG and BEGUN.
MAX_PATH = 4096
MAX_TIME = 20

# Seconds that a recorder searches for other recorders before its acknowledgements count.
LOOK = 1.5

# Seconds without diagnostics after which a recorder counts as dead: DDS lists a killed node for
# much longer, and a live recorder publishes every second.
SILENT = 3.0

# Maximum number of other recorders remembered: the latest to publish diagnostics.
MAX_RECORDERS = 10


class Recorders:
    """The recorders of a namespace; this process is one of them."""

    def __init__(self, node: MissionNode, log: object) -> None:
        self._node = node
        self._topic = node.resolve_topic_name(OPERATORS)
        self._above = node.get_namespace().rstrip('/')
        # The diagnostics that announce this process.
        self._own = {INSTANCE: uuid4().hex, LOG: str(log), BEGUN: str(time.time_ns())}
        node.diagnostics.values |= self._own
        self._looks_until = time.monotonic() + LOOK
        # Other recorders by identifier: node, last diagnostics, and their time in seconds.
        self._others: dict[str, tuple[str, Mapping[str, str], float]] = {}
        node.subscribe_to_diagnostics(self._on_diagnostics)

    def _on_diagnostics(self, name: str, values: Mapping[str, str]) -> None:
        begun = values.get(BEGUN, '')
        is_time = begun.isdecimal() and len(begun) <= MAX_TIME
        is_here = name.rpartition('/')[0] == self._above
        instance = values.get(INSTANCE, self._own[INSTANCE])
        is_own = instance == self._own[INSTANCE]
        if is_own or not (is_here and is_time and len(values.get(LOG, '')) <= MAX_PATH):
            return
        self._others.pop(instance, None)
        self._others[instance] = name, values, time.monotonic()
        if len(self._others) > MAX_RECORDERS:
            del self._others[next(iter(self._others))]

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
            return 'diagnostics of other recorders, if there are any'
        alive = [each for each in self._others.values() if each[2] >= now - SILENT]
        publishers = self._publishers() if alive else Counter()
        earlier = []
        for name, values, _ in alive:
            # Recorders may share a node name: at most as many are alive as publishers exist.
            if publishers[name]:
                publishers[name] -= 1
                if rank(values) < rank(self._own):
                    earlier.append(f'node {name} records to {values.get(LOG)}')
        if not earlier:
            return ''
        return (
            'the end of an earlier recorder, whose acknowledgements count: '
            f'{" and ".join(earlier)}'
        )


def rank(values: Mapping[str, str]) -> tuple[int, str]:
    """Return the start of a recorder, with its identifier to break ties."""
    return int(values[BEGUN]), values[INSTANCE]


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
BOOL = 'std_msgs/msg/Bool'


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


class StatePublisher:
    """The publisher of the state of an agent, or of the base, on change."""

    def __init__(self, node: MissionNode, grid: Grid, agent: str = '') -> None:
        self._node = node
        self._grid = grid
        self._agent = agent
        self._said: tuple[Readiness, str, bool] | None = None
        topic = f'{node.above}/{agent}/state' if agent else f'{node.above}/state'
        self._publisher = node.create_publisher(AgentState, topic, qos.LATCHED)

    def publish(self, readiness: Readiness, reason: str = '', is_at_base: bool = False) -> None:
        """Publish a state if it differs from the last one."""
        if self._said != (said := (readiness, reason, is_at_base)):
            self._said = said
            now = self._node.now()
            self._publisher.publish(state_message(self._grid, self._agent, *said, now))


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
