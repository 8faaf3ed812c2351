# SPDX-License-Identifier: Apache-2.0
"""Other recorders, planners, estimators and agents in the graph, and the hold on departures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
import time
from uuid import uuid4

from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_ros.log.roles import BELIEF, PATH, REPORT, STATUS
from kbnitp_ros.nodes.heard import NAMELESS
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import TOPIC
from kbnitp_ros.nodes.runtime.graph import full_name, PUBLISHED
from kbnitp_ros.nodes.runtime.node import MissionNode
from std_msgs.msg import Bool

INSTANCE = 'instance'

# Seconds without diagnostics after which a node counts as dead: DDS lists a killed node for much
# longer, and a live one publishes every second.
SILENT = 3.0

# Maximum number of other instances remembered, the newest.
MAX_INSTANCES = 10


@dataclass(frozen=True)
class Instance:
    """Another process."""

    # The full name of its node.
    name: str
    # The values of its last diagnostics.
    values: Mapping[str, str]
    # When they came, by `time.monotonic`.
    heard_at: float


class Instances:
    """The diagnostics of other instances than this process."""

    def __init__(
        self, node: MissionNode, is_meant: Callable[[str, Mapping[str, str]], bool]
    ) -> None:
        # The identifier of this process.
        self.own = uuid4().hex
        self._is_meant = is_meant
        self._heard: dict[str, Instance] = {}
        node.hear_newest(DiagnosticArray, TOPIC, self._on_diagnostics, qos.DIAGNOSTICS)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            values = {each.key: each.value for each in status.values}
            instance = values.get(INSTANCE, self.own)
            if instance == self.own or not self._is_meant(status.name, values):
                continue
            self._heard.pop(instance, None)
            self._heard[instance] = Instance(status.name, values, time.monotonic())
            if len(self._heard) > MAX_INSTANCES:
                del self._heard[next(iter(self._heard))]

    @property
    def alive(self) -> list[Instance]:
        """Return the other instances with recent diagnostics."""
        since = time.monotonic() - SILENT
        return [each for each in self._heard.values() if each.heard_at >= since]


# Published by every recorder from start to end, and by no other node. A publisher alone may be of
# a killed process, and diagnostics alone may be of anybody.
OPERATORS = 'operator/recorded'

# Diagnostics of a recorder: its log, and the start of the recording in nanoseconds.
LOG = 'log'
BEGUN = 'begun'

# Maximum numbers of characters of these values.
MAX_PATH = 4096
MAX_TIME = 20

# Seconds that a recorder looks for others before its acknowledgements count.
LOOK = 1.5


class Recorders:
    """The other recorders of a namespace."""

    def __init__(self, node: MissionNode) -> None:
        self._node = node
        self._topic = node.resolve_topic_name(OPERATORS)
        self._namespace = full_name(node.get_namespace(), '')
        self._looks_until = 0.0
        # Diagnostics of the recorders.
        self.instances = Instances(node, self._is_recording)

    def _is_recording(self, name: str, values: Mapping[str, str]) -> bool:
        begun = values.get(BEGUN, '')
        is_time = begun.isdecimal() and len(begun) <= MAX_TIME
        is_here = name.rpartition('/')[0] == self._namespace.rstrip('/')
        return is_here and is_time and len(values.get(LOG, '')) <= MAX_PATH

    @property
    def publishers(self) -> Counter[str]:
        """Return how often each node publishes the recorders' topic, this process left out."""
        own = sum(each.topic_name == self._topic for each in self._node.publishers)
        if self._node.count_publishers(self._topic) <= own:
            return Counter()
        known = self._node.authors(self._topic, PUBLISHED['recorder'])
        return Counter(known) - Counter({self._node.get_fully_qualified_name(): own})

    @property
    def alive(self) -> list[Instance]:
        """Return the active recorders, at most as many of a name as publish."""
        alive = []
        if heard := self.instances.alive:
            publishers = self.publishers
            for recorder in heard:
                if publishers[recorder.name]:
                    publishers[recorder.name] -= 1
                    alive.append(recorder)
        return alive

    def begin(self, log: object) -> None:
        """Announce that this process records."""
        begun = {INSTANCE: self.instances.own, LOG: str(log), BEGUN: str(time.time_ns())}
        self._node.diagnostics.values |= begun
        self._looks_until = time.monotonic() + LOOK

    @property
    def why_silent(self) -> str:
        """Return why acknowledgements of this recorder do not count: the first one's do."""
        if time.monotonic() < self._looks_until:
            return 'diagnostics of another recorder'
        own = rank(self._node.diagnostics.values)
        if earlier := [each for each in self.alive if rank(each.values) < own]:
            return (
                f'the end of an earlier recorder, whose acknowledgements count: {records(earlier)}'
            )
        return ''


def rank(values: Mapping[str, str]) -> tuple[int, str]:
    """Return the start of a recorder, with its identifier to break ties."""
    return int(values[BEGUN]), values[INSTANCE]


def records(recorders: list[Instance]) -> str:
    """Return which recorder writes which log, in words."""
    return ' and '.join(f'node {each.name} records to {each.values[LOG]}' for each in recorders)


# Number of looks for the names of other planners before they are reported.
LOOKS = 20


class Peers:
    """The other participants of the mission, as last seen in the graph."""

    def __init__(self, node: MissionNode, agents: Sequence[str]) -> None:
        # Number of nodes that publish beliefs.
        self.estimators = 0
        self._node = node
        self._agents = agents
        self._answering: dict[str, int] = {}
        self._unknown_agents: set[str] = set()
        self._planners: dict[str, int] = {}
        self._looks: Counter[str] = Counter()

    def is_present(self, agent: str) -> bool:
        """Return whether a node answers for an agent."""
        return self._answering.get(agent, 0) > 0

    def says_status(self, agent: str) -> bool:
        """Return whether a node reports when robots of an agent depart."""
        return self._node.count_authors(f'{agent}/status', STATUS) > 0

    def look(self) -> bool:
        """Look at the graph; return whether one of several estimators left."""
        self._look_for_agents()
        self._look_for_planners()
        self._look_for_unknown_agents()
        before = self.estimators
        self.estimators = self._node.count_authors('belief', BELIEF)
        if self.estimators > max(before, 1):
            self._node.diagnostics.refuse(
                'belief',
                f'{self.estimators} nodes publish beliefs: unless one has just died, '
                'end all but one',
            )
        return 0 < self.estimators < before

    def _look_for_agents(self) -> None:
        """Check which agents have a node, and warn of agents with several."""
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

    def _look_for_planners(self) -> None:
        """Warn of other planners that publish paths of an agent, with their names."""
        for agent in self._agents:
            before = self._planners.get(agent, 1)
            planners = self._node.count_authors(f'{agent}/path', PATH)
            if planners > max(before, 1):
                nodes = self._node.authors(f'{agent}/path', PATH)
                self._looks[agent] += 1
                # DDS knows the publishers of a node a moment before its name.
                if NAMELESS in nodes and self._looks[agent] < LOOKS:
                    continue
                self._node.diagnostics.refuse(
                    f'{agent}/path',
                    f'{len(nodes)} planners publish it, nodes {", ".join(nodes)}: stop all but '
                    'one, unless one has just died; of two paths with the same stamp the one '
                    'recorded first counts',
                )
            self._planners[agent] = planners

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

# Minimum seconds between two answers to others.
MIN_PAUSE = 0.1

# Seconds that the graph may take to name the author of a message.
MAX_UNNAMED = 30.0

# Seconds that an author may be in the graph without a name before it is reported without.
MAX_NAMELESS = 1.0


class HoldListener:
    """The planner's hold on departures: also while it is unknown, or others publish it."""

    def __init__(self, node: MissionNode, act: Callable[[], None] = lambda: None) -> None:
        self._node = node
        self._act = act
        self.is_held: bool | None = None
        self._topic = node.resolve_topic_name(f'{node.above}/{HOLD}')
        node.hear(Bool, self._topic, self._on_hold, qos.LATCHED)

    def _on_hold(self, message: Bool) -> None:
        self.is_held = message.data
        self._act()

    @property
    def awaited(self) -> str:
        """Return the condition that blocks departures; empty if there is none."""
        if self.is_held is None:
            return f'the planner to publish on {self._topic} whether robots may depart'
        if self.is_held:
            return f'the operator to end the pause ({self._topic} is true)'
        # A killed planner stays in the graph beside its successor of the same name.
        if self._node.count_authors(self._topic, BOOL) > 1:
            others = sorted({*self._node.authors(self._topic, BOOL)})
            if len(others) > 1:
                return f'one node alone to publish {self._topic}: {", ".join(others)} do'
        return ''


class HoldPublisher:
    """The planner's publisher of `hold`, which answers other values with its own."""

    def __init__(self, node: MissionNode) -> None:
        self._node = node
        self._is_held: bool | None = None
        self._is_contradicted = False
        self._published_at = self._heard_at = -inf
        self._publisher = node.create_publisher(Bool, HOLD, qos.LATCHED)
        node.hear(Bool, HOLD, self._on_hold, qos.LATCHED)
        node.create_poll(self._answer)

    def tell(self, is_held: bool) -> None:
        """Publish whether departures are held, if that has changed."""
        if is_held != self._is_held:
            self._is_held = is_held
            self._publish()

    def _publish(self) -> None:
        self._is_contradicted = False
        self._published_at = time.monotonic()
        self._publisher.publish(Bool(data=self._is_held))

    def _on_hold(self, message: Bool) -> None:
        if self._is_held is not None and message.data != self._is_held:
            self._is_contradicted = True
            self._heard_at = time.monotonic()
            self._answer()

    def _answer(self) -> None:
        """Publish the own value after another one, and refuse that once its author is known."""
        now = time.monotonic()
        if self._is_contradicted and now > self._published_at + MIN_PAUSE:
            self._publish()
        if now > self._heard_at + MAX_UNNAMED:
            return
        others = self._node.authors(self._publisher.topic_name, BOOL)
        # DDS knows the publishers of a node a moment before its name, if it has one.
        is_named = NAMELESS not in others or now > self._heard_at + MAX_NAMELESS
        # An own value from before the last change arrives as well: then there are no others.
        if len(others) > 1 and is_named:
            self._heard_at = -inf
            self._node.diagnostics.refuse(
                HOLD,
                f'data is {not self._is_held}, but this planner publishes {self._is_held}, which '
                f'counts: nodes {", ".join(others)} publish it',
            )
