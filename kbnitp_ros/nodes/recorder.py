# SPDX-License-Identifier: Apache-2.0
"""The recorder: writes every message of the mission to a log, byte for byte."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, defaultdict, deque, OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
import heapq
from itertools import chain
from math import inf
from pathlib import Path
import time
from typing import Any

from kbnitp_msgs.msg import Recorded
from kbnitp_ros.base.mission_tracker import MissionTracker
from kbnitp_ros.base.state import remember
from kbnitp_ros.configuration.known import TOPICS
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.core.inference.record import OrderState
from kbnitp_ros.files import waiting_for
from kbnitp_ros.log.configuration import parameters_record, run_record
from kbnitp_ros.log.files import make_folder, new_log
from kbnitp_ros.log.read import LoggedMessage, PARAMETERS, RUN
from kbnitp_ros.log.record import mission_start
from kbnitp_ros.log.roles import read_content, RECORD, resumed_log, Role
from kbnitp_ros.log.schema import qos_profiles_yaml
from kbnitp_ros.log.write import check_size, LogWriter
from kbnitp_ros.messages.deployments import Acknowledged, AgentStatus, STATUS_KINDS
from kbnitp_ros.messages.headers import (
    check_mission,
    check_texts,
    content_hash,
    NO_MISSION,
    to_stamp,
)
from kbnitp_ros.messages.health import Health
from kbnitp_ros.messages.remarks import Remark
from kbnitp_ros.messages.topics import BELIEF, REMARKS
from kbnitp_ros.nodes.presence import check_author, LOG, OPERATORS, Recorders
from kbnitp_ros.nodes.recorded_topics import (
    message_class,
    ParameterWatch,
    RecordedTopic,
    time_received,
)
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import PERIOD
from kbnitp_ros.nodes.runtime.diagnostics import TOPIC as DIAGNOSTICS
from kbnitp_ros.nodes.runtime.graph import full_name
from kbnitp_ros.nodes.runtime.node import MissionNode
from kbnitp_ros.nodes.runtime.process import run
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier

# Topics recorded although they are outside the mission's namespace, and topics left out within it.
SHARED = ('/clock', DIAGNOSTICS, '/tf', '/tf_static')
LEFT_OUT = ('/parameter_events', '/rosout')

# Roles that nodes act on: messages are synced at once, statuses if an acknowledgement is due.
ACTED_ON = ('path', 'report', 'status', 'operator', *REMARKS)

# Kinds of the messages that are acknowledged, by role; those of statuses differ.
KINDS = {
    'path': Acknowledged.PATH,
    'operator': Acknowledged.ACTION,
    'report': Acknowledged.REPORT,
    **dict.fromkeys(REMARKS, Acknowledged.REMARK),
}

# Roles whose authors repeat a message while anybody waits: only changes are recorded.
REPEATED = ('state', 'mission', 'decision', 'standings', 'hold')

# Nodes that a mission needs, by the role that they publish.
AWAITED = {'path': 'a planner to publish AGENT/path', 'belief': 'an estimator to publish belief'}

# Roles subscribed to only after the parameters of their publishers are recorded, so that a mission
# begins with all parameters on record.
AFTER_CONFIGURATION = (*ACTED_ON, 'belief')

# Seconds between two syncs of messages other than evidence.
SYNC_PERIOD = 0.5

# Minimum seconds between two records of the health of a robot.
HEALTH_PERIOD = 10.0

# Maximum number of foreign topics to inspect per graph scan: with thousands of topics in the graph
# each query takes half a millisecond.
LOOKED_AT_ONCE = 500


class RecorderNode(MissionNode):
    """Record all topics of this namespace, each as soon as it is published."""

    def __init__(self) -> None:
        super().__init__('recorder')
        resume = self.values['resume']
        recorded = resumed_log(resume, self.roles) if resume else None
        path = resume or self.values['file']
        if not path:
            path = new_log()
        elif not resume:
            make_folder(Path(path).parent)
        self._log = LogWriter(path, resume=bool(resume))
        self.get_logger().info(f'recording to {self._log.path}')
        if self._log.shares_folder:
            self.get_logger().warning(
                f'{self._log.path.parent}/metadata.yaml describes another log: open this log by '
                f'its first file, {self._log.path}, or use a folder for each log'
            )
        self.diagnostics.values[LOG] = str(self._log.path)
        self._recorders = Recorders(self, self._log.path)
        self._alive = self.resolve_topic_name('recorders')
        self._why_silent = self._recorders.why_silent
        # Publisher of `operator/recorded`, by which other nodes find recorders in the graph.
        self._operators = self.create_publisher(Recorded, OPERATORS, qos.EVIDENCE)
        self._log.add_metadata(RECORD, self.roles.record)
        self._log.add_metadata(RUN, run_record(get_rmw_implementation_identifier()))
        self._unsynced = True
        self._shown_at = time.monotonic()
        self._tracker = MissionTracker()
        # Missions and names of the evidence of the last beliefs that were recorded.
        self._believed: OrderedDict[tuple[int, int, int], None] = OrderedDict()
        # By topic, stamp and mission: content hash of the first path or action.
        self._first: dict[tuple[str, int, int], int] = {}
        self._paths: Counter[int] = Counter()
        # Deployments with a path on record, of any mission.
        self._ordered: set[DeploymentKey] = set()
        # Whether a message that was just written is awaited.
        self._is_awaited = False
        # Epoch and rules of the estimator whose standings are recorded.
        self._estimator = 0, 0
        # Hash of the first departure of each deployment.
        self._departed: dict[DeploymentKey, int] = {}
        # By agent ('' for the operator) and role: publishers of acknowledgements; and messages on
        # record, also of before this start, that are not acknowledged yet: stamp in nanoseconds,
        # hash of the content, start of the mission in nanoseconds, and kind.
        self._recorded = {('', name): self._operators for name in ('operator', *REMARKS)}
        self._unacknowledged: dict[tuple[str, str], deque[tuple[int, int, int, int]]] = (
            defaultdict(deque)
        )
        # By topic: what was recorded last of the health of a robot, and when, seconds.
        self._health: dict[str, tuple[object, float]] = {}
        # Hash of the last message of each role that is repeated, without its header, by topic.
        self._repeated: dict[str, int] = {}
        # By node: first difference between the topics that it states and the topics of this node.
        self._differing: dict[str, str] = {}
        if recorded is not None:
            self._tracker.mission = mission_start(recorded)
            for role, logged in recorded.read(*ACTED_ON, 'standings'):
                if role.name == 'standings':
                    self._estimator = logged.said.epoch, logged.said.rules
                else:
                    self._restore(role, logged)
        self._configuration: dict[str, Mapping[str, Any]] = {}
        self._namespace = self.get_namespace().rstrip('/') + '/'
        self._topics: dict[str, RecordedTopic] = {}
        # Topics with subscriptions for all publishers, and topics that cannot be recorded.
        self._settled: dict[str, None] = {}
        self._last_looked = ''
        self._refused: set[tuple[str, str]] = set()
        self._watch = ParameterWatch(
            self, self._namespace, self._on_parameters, self.diagnostics.refuse
        )
        self.diagnostics.state = self._state()
        self._on_parameters(self.get_fully_qualified_name(), self.values)
        self.create_poll(self._check_log)
        self.create_look(self._discover)
        self.create_poll(self._sync_all, SYNC_PERIOD)

    def _restore(self, role: Role, logged: LoggedMessage) -> None:
        """Note a message on record, to acknowledge it again to those who missed it."""
        stamp, mission, content = logged.said, NO_MISSION, content_hash(logged.message)
        if role.name == 'status':
            key, status = logged.said
            stamp, kind = key.stamp, STATUS_KINDS[status.state]
            is_departure = status.state is OrderState.DEPARTED
            if is_departure and self._departed.setdefault(key, content) != content:
                return
        else:
            kind = KINDS[role.name]
        if role.name == 'path':
            (_, stamp), mission = logged.said
            if self._note(logged.topic, role, stamp, mission, content) != content:
                return
        elif role.name == 'report':
            (_, stamp), _ = logged.said
        elif isinstance(stamp, Remark):
            stamp = stamp.stamp
        restored = self._unacknowledged[role.agent, role.name]
        restored.append((stamp, content, mission, kind))
        if len(restored) > qos.DEPTH:
            restored.popleft()

    def finish(self) -> None:
        """Record the messages that have arrived."""
        self._write_arrived_on(self._topics.values())
        self.get_logger().info(f'the log of the mission is {self._log.path}')

    def _write_arrived_on(self, topics: Iterable[RecordedTopic]) -> None:
        """Write the messages that have arrived on some topics, in the order of arrival."""
        arrived = [topic.arrived() for topic in topics]
        for message in heapq.merge(*chain(*arrived), key=time_received):
            self._write(*message)
            # Publish diagnostics during a backlog, or another recorder may take over.
            if time.monotonic() > self._shown_at + PERIOD:
                self._shown_at = time.monotonic()
                self.diagnostics.publish()

    def close(self) -> None:
        """Finish the file."""
        try:
            self._log.close()
        finally:
            super().close()

    def _check_log(self) -> None:
        """Check that the log is in place; send pending acknowledgements once they count."""
        self._log.check_in_place()
        if (why := self._recorders.why_silent) != self._why_silent:
            self._why_silent = why
            self._acknowledge_pending()

    def _discover(self) -> None:
        """Subscribe to new topics and publishers."""
        # The estimator publishes once `belief` has its subscribers, so this node subscribes to the
        # estimator's maps first: in reverse order of names `belief` comes last. The estimator
        # creates the publisher of `belief` last. Two equal scans of the graph show, with each
        # publisher, all publishers that were created before it.
        found: dict[str, Any] = {}
        others: list[str] = []
        # A publisher that returns may offer another profile: one settled topic is looked at again.
        self._settled.pop(next(iter(self._settled), ''), None)
        looked = True
        while looked:
            before = found.keys()
            own, others = self._new_topics()
            found = self._published(own)
            looked = found.keys() != before
        self._watch.look()
        if gone := [node for node in self._differing if node not in self._watch.present]:
            for node in gone:
                del self._differing[node]
            self._acknowledge_pending()
        found |= self._published(self._next_topics(others))
        for topic in sorted(found, reverse=True):
            self._subscribe_to(topic, found[topic])

    def _new_topics(self) -> tuple[list[str], list[str]]:
        """Return topics that may have new publishers: with and without a role in the mission."""
        own: list[str] = []
        others: list[str] = []
        for topic, types in self.get_topic_names_and_types():
            known = self._topics[topic].type_name if topic in self._settled else None
            if all(each == known or (topic, each) in self._refused for each in types):
                continue
            if topic in self.roles.by_topic:
                own.append(topic)
            elif topic == self._alive:
                # Other recorders are found by it, and nobody else reads it.
                continue
            elif topic in SHARED or (topic.startswith(self._namespace) and topic not in LEFT_OUT):
                others.append(topic)
        return own, others

    def _published(self, topics: Iterable[str]) -> dict[str, Any]:
        """Return the publishers of each topic that has publishers."""
        publishers = {topic: self.get_publishers_info_by_topic(topic) for topic in topics}
        return {topic: known for topic, known in publishers.items() if known}

    def _next_topics(self, topics: list[str]) -> list[str]:
        """Return the next topics in turn, at most `LOOKED_AT_ONCE`."""
        ordered = sorted(topics)
        start = bisect_right(ordered, self._last_looked)
        taken = (ordered[start:] + ordered[:start])[:LOOKED_AT_ONCE]
        self._last_looked = taken[-1] if taken else ''
        return taken

    def _subscribe_to(self, name: str, publishers: Sequence[Any]) -> None:
        """Subscribe to a topic, once for each profile of its publishers."""
        for publisher in publishers:
            type_name = publisher.topic_type
            if (name, type_name) in self._refused:
                continue
            node = full_name(publisher.node_namespace, publisher.node_name)
            profile = qos.unread_kept(publisher.qos_profile)
            role = self.roles.by_topic.get(name)
            if role is not None and role.name in AFTER_CONFIGURATION:
                # All nodes subscribe with this profile, so that all receive the same evidence.
                profile = qos.unread_kept(qos.EVIDENCE)
                if not self._watch.is_over(node):
                    return
                if lacking := qos.lacking(publisher.qos_profile):
                    self.refuse_once(
                        name,
                        f'node {node} publishes it {lacking}, so other nodes may miss its '
                        'messages: its QoS must be reliable and transient local',
                    )
            try:
                topic = self._topic(name, type_name, publishers)
            except LookupError as error:
                self._refused.add((name, type_name))
                self.diagnostics.refuse(name, error)
                continue
            kind = profile.reliability, profile.durability
            if kind not in topic.subscriptions:
                if topic.subscriptions:
                    self._log.add_topic(name, type_name, offered_by(publishers, type_name))
                topic.subscriptions[kind] = self._subscribe(topic, profile)
            self._settled[name] = None

    def _topic(self, name: str, type_name: str, publishers: Sequence[Any]) -> RecordedTopic:
        """Return a topic, adding it to the log if it is new."""
        if name in self._topics:
            topic = self._topics[name]
            if type_name != topic.type_name:
                raise LookupError(f'type is {type_name}: it is on record as {topic.type_name}')
            return topic
        role = self.roles.by_topic.get(name)
        if role is not None and type_name != role.type_name:
            raise LookupError(f'type is {type_name}: on this topic it must be {role.type_name}')
        message_class(type_name)
        self._log.add_topic(name, type_name, offered_by(publishers, type_name))
        topic = self._topics[name] = RecordedTopic(name, type_name, role)
        if role is not None and role.name in ACTED_ON:
            self._add_acknowledgements(role.agent)
        self.diagnostics.state = self._state()
        return topic

    def _add_acknowledgements(self, agent: str) -> None:
        """Add the publishers of the acknowledgements of an agent, unless they are known."""
        # Each agent and role has its own publisher, since DDS limits the depth of a history. A
        # robot has to know of a departure as soon as of its path, so that paths come last.
        for name in ('status', 'report', 'path'):
            if agent and (agent, name) not in self._recorded:
                self._recorded[agent, name] = self.create_publisher(
                    Recorded, f'{agent}/recorded', qos.EVIDENCE
                )

    def _state(self) -> str:
        """Describe the topics recorded and the nodes awaited."""
        recording = f'recording {len(self._topics)} topics'
        if self._differing:
            node, differs = next(iter(self._differing.items()))
            return waiting_for(
                f'{node} to use the same topics as this node: its {differs}; until then no robot '
                'leaves (remapped topics and the parameter agents must be the same in all nodes)'
            )
        if self._why_silent:
            return waiting_for(f'{self._why_silent}; {recording}')
        known = {topic.role.name for topic in self._topics.values() if topic.role}
        absent = [who for kind, who in AWAITED.items() if kind not in known]
        if not absent:
            return recording
        return waiting_for(
            f'{" and ".join(absent)} in namespace {self.get_namespace()}; {recording}'
        )

    def _subscribe(self, topic: RecordedTopic, profile: QoSProfile) -> Subscription:
        return self.create_subscription(
            message_class(topic.type_name),
            topic.name,
            partial(self._on_message, topic),
            profile,
            raw=True,
        )

    def _on_message(self, topic: RecordedTopic, data: bytes, info: Any) -> None:
        role = topic.role.name if topic.role else ''
        if role in ('belief', 'standings', 'status'):
            # Write paths first, so that they come first in the log.
            self._write_arrived_on(
                each for each in self._topics.values() if each.role and each.role.name == 'path'
            )
        self._is_awaited = False
        self._write(topic, data, info)
        if self._is_awaited:
            # One sync for all messages that have arrived, such as the paths of a round, so that
            # all messages published before an acknowledgement are on disk.
            self._write_arrived_on(self._topics.values())
            self._sync()
            self._acknowledge_all()

    def _write(self, topic: RecordedTopic, data: bytes, info: Any) -> None:
        """Write a valid message, unless another subscription has delivered it."""
        if not topic.is_new(info['source_timestamp'], data):
            return
        try:
            check_size(data)
            if not self._is_of_this_mission(topic, data) or not self._check(topic, data):
                return
        except (ValueError, RuntimeError) as error:
            self.diagnostics.refuse(topic.name, error)
            return
        self._log.write(topic.name, data, info['received_timestamp'], info['source_timestamp'])
        self._unsynced = True
        self.diagnostics.accepted += 1

    def _is_of_this_mission(self, topic: RecordedTopic, data: bytes) -> bool:
        """Return whether a message is from this namespace: all missions share /diagnostics."""
        if topic.name != DIAGNOSTICS or self._namespace == '/':
            return True
        status = deserialize_message(data, message_class(topic.type_name)).status
        return any(each.name.startswith(self._namespace) for each in status)

    def _check(self, topic: RecordedTopic, data: bytes) -> bool:
        """Check a message, and note it for acknowledgement; return False for a repeated one."""
        role = topic.role
        if role is None:
            return True
        message = deserialize_message(data, message_class(topic.type_name))
        check_texts(message)
        said = read_content(role, message)
        if role.name == 'standings':
            epoch, rules = self._estimator
            check_author(self, said, epoch, rules)
            self._estimator = max(epoch, said.epoch), said.rules
        if role.name == 'health':
            return self._is_news(topic, said)
        if role.name in REPEATED:
            return not self._is_repeated(topic, message)
        if role.name == 'status':
            self._check_status(topic, *said)
        elif role.name == 'report':
            key, report = said
            self._await_acknowledgement(topic, key.stamp, report.content, kind=Acknowledged.REPORT)
        elif role.name in ACTED_ON:
            stamp, mission = said.stamp if isinstance(said, Remark) else said, NO_MISSION
            if role.name == 'path':
                (_, stamp), mission = said
                check_mission(mission, self._tracker.mission)
            content = content_hash(message)
            first = self._note(topic.name, role, stamp, mission, content)
            self._await_acknowledgement(topic, stamp, first, mission, kind=KINDS[role.name])
            if first != content:
                raise ValueError(
                    f'another message with stamp {stamp} was recorded first and counts (do two '
                    'nodes publish this topic?)'
                )
        elif role.name == 'belief':
            named = said.mission, *said.evidence
            if named in self._believed:
                raise ValueError('a belief of the same evidence was recorded first, and counts')
            self._tracker.check_belief(said, self.count_authors(topic.name, BELIEF))
            self._tracker.accept_belief(said)
            remember(self._believed, named, None)
        return True

    def _is_news(self, topic: RecordedTopic, health: Health) -> bool:
        """Return whether health is recorded: what matters has changed, and not just now."""
        last, written_at = self._health.get(topic.name, (None, -inf))
        now = time.monotonic()
        if health.recorded == last or now < written_at + HEALTH_PERIOD:
            return False
        self._health[topic.name] = health.recorded, now
        return True

    def _is_repeated(self, topic: RecordedTopic, message: Any) -> bool:
        """Return whether a message says the same as the last one on its topic."""
        if hasattr(message, 'header'):
            message.header.stamp = to_stamp(0)
        content = content_hash(message)
        is_repeated = self._repeated.get(topic.name) == content
        self._repeated[topic.name] = content
        return is_repeated

    def _await_acknowledgement(
        self,
        topic: RecordedTopic,
        stamp: int,
        content: int,
        mission: int = NO_MISSION,
        *,
        kind: int,
        is_urgent: bool = True,
    ) -> None:
        """Acknowledge a message once it is on disk, which is at once if it is urgent."""
        self._is_awaited |= is_urgent
        assert topic.role is not None
        waiting = self._unacknowledged[topic.role.agent, topic.role.name]
        waiting.append((stamp, content, mission, kind))
        if len(waiting) > qos.DEPTH:
            self.diagnostics.refuse(
                topic.name,
                f'more than {qos.DEPTH} messages wait for their mission or their paths: the '
                'oldest one will not be acknowledged',
            )
            waiting.popleft()

    def _check_status(self, topic: RecordedTopic, key: DeploymentKey, status: AgentStatus) -> None:
        """Acknowledge a status once it is on disk."""
        if status.state is OrderState.DEPARTED:
            # If two robots with the same name report a departure, only the first is acknowledged.
            first = self._departed.setdefault(key, status.content)
            if first != status.content:
                raise ValueError(
                    f'another departure of deployment {key} was recorded first and counts (do two '
                    f'robots have the name {key.agent}?)'
                )
        self._await_acknowledgement(
            topic,
            key.stamp,
            status.content,
            kind=STATUS_KINDS[status.state],
            # Most orders are departures a moment later.
            is_urgent=status.state is not OrderState.ACCEPTED,
        )

    def _note(self, name: str, role: Role, stamp: int, mission: int, content: int) -> int:
        """Note a path or action; return the hash of the first with this stamp and mission."""
        key = name, stamp, mission
        if key not in self._first and role.name == 'path':
            self._paths[mission] += 1
            self._ordered.add(DeploymentKey(role.agent, stamp))
        return self._first.setdefault(key, content)

    def _acknowledge_all(self) -> None:
        """Acknowledge all messages on disk, if this recorder's acknowledgements count."""
        if self._differing or self._why_silent:
            return
        for (agent, role), publisher in self._recorded.items():
            waiting = self._unacknowledged[agent, role]
            self._unacknowledged[agent, role] = deque(
                each for each in waiting if not self._acknowledge(publisher, agent, *each)
            )

    def _acknowledge(
        self, publisher: Publisher, agent: str, stamp: int, content: int, mission: int, kind: int
    ) -> bool:
        """Acknowledge a message on disk; return False if its mission is not known yet."""
        order = DeploymentKey(agent, stamp)
        if kind == Acknowledged.DEPARTURE and order not in self._ordered:
            # A departure may arrive before the path of its deployment.
            return False
        if kind == Acknowledged.PATH:
            try:
                self._tracker.check_path(mission)
            except ValueError as error:
                # A path may arrive before the belief that it was planned on.
                if self._tracker.mission is None:
                    return False
                self.diagnostics.refuse(self.resolve_topic_name(f'{agent}/path'), error)
                return True
            self._tracker.begin(mission)
        publisher.publish(
            Recorded(
                stamp=to_stamp(stamp),
                content=content,
                mission=to_stamp(mission),
                agent=agent,
                kind=kind,
            )
        )
        return True

    def _sync(self) -> None:
        if self._unsynced:
            self._log.sync()
            self._unsynced = False

    def _sync_all(self) -> None:
        """Sync now and then, and acknowledge what was not urgent."""
        self._sync()
        self._acknowledge_all()

    def _on_parameters(self, node: str, values: Mapping[str, Any]) -> None:
        """Record all parameters of a node, or those that changed."""
        known = self._configuration.get(node, {})
        if known != (values := {**known, **values}):
            self._configuration[node] = values
            self._compare_roles(node, values.get(TOPICS, ()))
            self._log.add_metadata(f'{PARAMETERS}{node}', parameters_record(values))
            self._unsynced = True

    def _compare_roles(self, node: str, stated: Sequence[str]) -> None:
        """Refuse a node that states other topics for the roles of the mission."""
        names = dict(each.partition('=')[::2] for each in stated)
        differs = self.roles.difference(self.roles.meant_by(node, names))
        if differs and differs != self._differing.get(node):
            self.diagnostics.refuse(f'{node}', f'its {differs}: no robot leaves')
        self._differing.pop(node, None)
        if differs:
            self._differing[node] = differs
        self._acknowledge_pending()

    def _acknowledge_pending(self) -> None:
        """Sync, and send pending acknowledgements if they count."""
        self.diagnostics.state = self._state()
        self._sync()
        self._acknowledge_all()


def offered_by(publishers: Sequence[Any], type_name: str) -> str:
    """Return the QoS of a topic's publishers of this type, in the format of a log."""
    return qos_profiles_yaml(
        each.qos_profile for each in publishers if each.topic_type == type_name
    )


main = partial(run, 'recorder', RecorderNode, linger=0.6)
