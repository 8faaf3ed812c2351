# SPDX-License-Identifier: Apache-2.0
"""The recorder: writes every message of the mission to a log, as it came off the wire."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
import heapq
from itertools import chain
from pathlib import Path
import sys
import time
from typing import Any

from kbnitp_msgs.msg import Recorded
from kbnitp_ros.bag import check_readable, LogWriter, MAX_MESSAGE, qos_profiles_yaml
from kbnitp_ros.base.mission_tracker import MissionTracker, PathsUnknownError
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.configuration import PARAMETERS, parameters_record, RUN, run_record
from kbnitp_ros.log.departures import Departures, read_departures, STATUS
from kbnitp_ros.log.deployments import read_mission, read_paths
from kbnitp_ros.log.evidence import BELIEF, GRID, MODEL, PATH, PROGRESS, REPORT
from kbnitp_ros.log.log_path import make_folder, new_log
from kbnitp_ros.log.operator_state import OPERATOR
from kbnitp_ros.log.replayed_views import VIEWS
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.deployments import agent_of, read_path_name, read_report
from kbnitp_ros.messages.headers import to_stamp
from kbnitp_ros.messages.missions import check_mission, mission_of_path, NO_MISSION
from kbnitp_ros.messages.operator_action import read_action_name
from kbnitp_ros.messages.status import OrderState, read_status
from kbnitp_ros.nodes.parameter_watch import ParameterWatch
from kbnitp_ros.nodes.recorders import Precedence
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import NodeState, PERIOD, waiting_for, working
from kbnitp_ros.nodes.runtime.diagnostics import TOPIC as DIAGNOSTICS
from kbnitp_ros.nodes.runtime.graph import full_name
from kbnitp_ros.nodes.runtime.node import MissionNode
from kbnitp_ros.nodes.runtime.process import run
from kbnitp_ros.nodes.topic import HeardTopic, Message, message_class, time_received
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier

# Recorded from outside the mission's namespace, and left out inside it.
SHARED = ('/clock', DIAGNOSTICS, '/tf', '/tf_static')
LEFT_OUT = ('/parameter_events', '/rosout')

EVIDENCE = (PATH, REPORT, STATUS, OPERATOR)

# Without whom there is no mission.
AWAITED = {PATH: 'a planner to publish AGENT/path', BELIEF: 'an estimator to publish belief'}

# No mission begins before these are heard, and they are when their nodes' configuration is known.
AFTER_CONFIGURATION = (*EVIDENCE, BELIEF)

# Of the topics of a mission, and of those under the name of an agent: nobody who was first to
# publish something else there keeps them from being recorded.
TYPES = {
    'belief': BELIEF,
    'model': MODEL,
    'operator': OPERATOR,
    'progress': PROGRESS,
    'decision': 'kbnitp_msgs/msg/Decision',
    'decision/lane': PATH,
    **{f'belief/{name}': GRID for name in VIEWS},
}
AGENT_TYPES = {
    'path': PATH,
    'proposal': PATH,
    'report': REPORT,
    'status': STATUS,
    'recorded': 'kbnitp_msgs/msg/Recorded',
}

# What a log is read for.
READ = {PATH, REPORT, STATUS, BELIEF, GRID, MODEL, PROGRESS, OPERATOR}

# How often what is no evidence is put onto the disk, in seconds.
SYNC_PERIOD = 0.5

# Of how many topics that are none of the mission's it is asked at a look who publishes them: with
# thousands of them in the graph each answer takes half a millisecond.
LOOKED_AT_ONCE = 500

# How long a belief waits for the paths of its deployments, in seconds, and how many do.
PATIENCE = 2.0
MOST_EARLY = 20


class RecorderNode(MissionNode):
    """Record all topics of this namespace, each as soon as it is published."""

    # EventsExecutor raises SystemError for raw subscriptions with event callbacks.
    make_executor = SingleThreadedExecutor

    def __init__(self) -> None:
        super().__init__('recorder')
        self._precedence = Precedence(self)
        self._precedence.wait()
        resume = self.values['resume']
        path = resume or self.values['file']
        if not path:
            path = new_log()
        elif not resume:
            make_folder(Path(path).parent)
        self._log = LogWriter(
            path,
            resume=bool(resume),
            compression=self.values['compression'],
            max_file_size=self.values['max_file_size'],
            max_file_duration=self.values['max_file_duration'],
        )
        self.get_logger().info(f'recording to {self._log.path}')
        if self._log.shares_folder:
            self.get_logger().warning(
                f'folder {self._log.path.parent} is the bag of another log and stays it: ros2 bag '
                f'finds this one by the names of its files, such as {self._log.path}; a folder '
                'for each log avoids that'
            )
        self._precedence.begin(self._log.path)
        self._log.add_metadata(RUN, run_record(get_rmw_implementation_identifier()))
        self._unsynced = True
        self._shown_at = time.monotonic()
        self._tracker = MissionTracker()
        # Of each path and operator's action on record, by topic, stamp and mission: the hash of
        # the first, which counts.
        self._first: dict[tuple[str, int, int], int] = {}
        self._paths: Counter[int] = Counter()
        # Which paths are on record, whatever their mission.
        self._ordered: set[DeploymentKey] = set()
        self._departures = Departures()
        if resume:
            self._tracker.mission = read_mission(resume)
            for name, stamp, mission, content in read_paths(resume):
                self._note(name, stamp, mission, content)
            self._departures = read_departures(resume)
        self._configuration: dict[str, Mapping[str, Any]] = {}
        self._namespace = self.get_namespace().rstrip('/') + '/'
        self._topics: dict[str, HeardTopic] = {}
        # Topics whose publishers are all heard, and what cannot be recorded.
        self._settled: set[str] = set()
        self._last_looked = ''
        self._refused: set[tuple[str, str]] = set()
        # Beliefs that came before the paths of their deployments, and until when they wait.
        self._early: list[tuple[Message, float]] = []
        self._watch = ParameterWatch(
            self, self._namespace, self._on_parameters, self.diagnostics.refuse
        )
        self.diagnostics.state = self._state()
        self._on_parameters(self.get_fully_qualified_name(), self.values)
        self.create_poll(self._check_log)
        self.create_look(self._discover)
        self.create_poll(self._sync, SYNC_PERIOD)

    def finish(self) -> None:
        """Record what has arrived."""
        self._write_arrived()
        for message, _ in self._early:
            self._write_checked(message, 0.0)
        self.get_logger().info(f'the log of the mission is {self._log.path}')

    def _write_arrived(self) -> None:
        """Write what has arrived, in the order it came."""
        self._write_arrived_on(self._topics.values())

    def _write_arrived_on(self, topics: Iterable[HeardTopic]) -> None:
        arrived = [topic.arrived() for topic in topics]
        for message in heapq.merge(*chain(*arrived), key=time_received):
            self._write(*message)
            self._show_life()

    def _show_life(self) -> None:
        """Be heard however much waits to be written: another recorder may replace a silent one."""
        now = time.monotonic()
        if now > self._shown_at + PERIOD:
            self._shown_at = now
            self._precedence.check()
            self.diagnostics.publish()

    def close(self) -> None:
        """Finish the file."""
        try:
            self._log.close()
        finally:
            super().close()

    def _check_log(self) -> None:
        """See that the log is where it was and no other recorder's; write what waited for it."""
        self._log.check_in_place()
        self._precedence.check()
        self._write_early()

    def _discover(self) -> None:
        """Subscribe to what is published and not heard yet."""
        # The estimator publishes as soon as belief has its readers, so the maps, which it created
        # before, must be known and subscribed to before belief is: two looks that agree show all
        # that was created before anything they show, and belief comes last backwards.
        found: dict[str, Any] = {}
        others: list[str] = []
        looked = True
        while looked:
            before = found.keys()
            own, others = self._unheard()
            found = self._published(own)
            looked = found.keys() != before
        self._watch.look()
        found |= self._published(self._next_of(others))
        for topic in sorted(found, reverse=True):
            self._hear(topic, found[topic])

    def _unheard(self) -> tuple[list[str], list[str]]:
        """Return the topics of which publishers may not be heard: the mission's, and others."""
        own: list[str] = []
        others: list[str] = []
        for topic, types in self.get_topic_names_and_types():
            if self._is_ours(topic) and not self._is_settled(topic, types):
                (own if self._type_of(topic) else others).append(topic)
        return own, others

    def _is_settled(self, topic: str, types: Sequence[str]) -> bool:
        heard = self._topics[topic].type_name if topic in self._settled else None
        return all(each == heard or (topic, each) in self._refused for each in types)

    def _published(self, topics: Iterable[str]) -> dict[str, Any]:
        """Return the publishers of those topics that have any."""
        publishers = {topic: self.get_publishers_info_by_topic(topic) for topic in topics}
        return {topic: known for topic, known in publishers.items() if known}

    def _next_of(self, topics: list[str]) -> list[str]:
        """Return the topics, or, of very many, those that come after the last ones returned."""
        ordered = sorted(topics)
        start = bisect_right(ordered, self._last_looked)
        taken = (ordered[start:] + ordered[:start])[:LOOKED_AT_ONCE]
        self._last_looked = taken[-1] if taken else ''
        return taken

    def _is_ours(self, topic: str) -> bool:
        return topic in SHARED or (topic.startswith(self._namespace) and topic not in LEFT_OUT)

    def _hear(self, name: str, publishers: Sequence[Any]) -> None:
        """Subscribe to a topic as often as its publishers need."""
        for publisher in publishers:
            type_name = publisher.topic_type
            if (name, type_name) in self._refused:
                continue
            node = full_name(publisher.node_namespace, publisher.node_name)
            profile = qos.unread_kept(publisher.qos_profile)
            if type_name in AFTER_CONFIGURATION:
                # No node of the mission hears less, and what it does not hear is no evidence.
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
            self._settled.add(name)

    def _topic(self, name: str, type_name: str, publishers: Sequence[Any]) -> HeardTopic:
        """Return a topic, on record from now on."""
        if name in self._topics:
            topic = self._topics[name]
            if type_name != topic.type_name:
                raise LookupError(f'type is {type_name}: it is on record as {topic.type_name}')
            return topic
        wanted = self._type_of(name) or type_name
        if type_name != wanted:
            raise LookupError(f'type is {type_name}: on this topic it must be {wanted}')
        message_class(type_name)
        self._log.add_topic(name, type_name, offered_by(publishers, type_name))
        topic = self._topics[name] = HeardTopic(name, type_name)
        topic.recorded = self._acknowledging(name, type_name)
        self.diagnostics.state = self._state()
        return topic

    def _acknowledging(self, name: str, type_name: str) -> Publisher | None:
        """Return what tells which messages of a topic are on the disk, if anything does."""
        agent, _, last = name.rpartition('/')
        if (last, type_name) in (('path', PATH), ('status', STATUS)):
            # Each with a history of its own, which is as deep as DDS has it.
            return self.create_publisher(Recorded, f'{agent}/recorded', qos.EVIDENCE)
        is_operator = type_name == OPERATOR and name == self.resolve_topic_name('operator')
        return self._precedence.publisher if is_operator else None

    def _state(self) -> NodeState:
        """Return what is recorded, and whom it waits for."""
        recording = f'recording {len(self._topics)} topics'
        heard = {topic.type_name for topic in self._topics.values()}
        absent = [who for kind, who in AWAITED.items() if kind not in heard]
        if not absent:
            return working(recording)
        return waiting_for(
            f'{" and ".join(absent)} in namespace {self.get_namespace()}; {recording}'
        )

    def _type_of(self, name: str) -> str | None:
        """Return the type of a topic that is one of the mission's; None if it is another."""
        relative = name.removeprefix(self._namespace)
        agent, _, last = relative.rpartition('/')
        return TYPES.get(relative) or (AGENT_TYPES.get(last) if agent else None)

    def _subscribe(self, topic: HeardTopic, profile: QoSProfile) -> Subscription:
        def look_again(_: Any) -> None:
            self._settled.discard(topic.name)

        return self.create_subscription(
            message_class(topic.type_name),
            topic.name,
            partial(self._on_message, topic),
            profile,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                matched=look_again, incompatible_qos=look_again, use_default_callbacks=False
            ),
        )

    def _on_message(self, topic: HeardTopic, data: bytes, info: Any) -> None:
        if topic.type_name in (BELIEF, STATUS):
            # They are judged by the paths that are known, and callbacks come in any order.
            self._write_arrived_on(
                each for each in self._topics.values() if each.type_name == PATH
            )
        self._write(topic, data, info)
        if topic.type_name == PATH:
            self._write_early()
        # Of these many keep nobody waiting; but the paths that were read with them do.
        is_seldom_awaited = topic.type_name in (BELIEF, STATUS)
        is_evidence = topic.type_name in EVIDENCE and not is_seldom_awaited
        is_any_unacknowledged = any(each.unacknowledged for each in self._topics.values())
        if is_evidence or (is_seldom_awaited and is_any_unacknowledged):
            # One sync serves all that waits: the paths of a round come together, and so does a
            # whole history. What was published before this is then on the disk before it counts.
            self._write_arrived()
            self._sync()
            self._tell_recorded()

    def _write(self, topic: HeardTopic, data: bytes, info: Any) -> None:
        """Write a message, unless it is on record."""
        if topic.is_new(info['source_timestamp'], data):
            self._write_checked((topic, data, info), time.monotonic() + PATIENCE)

    def _write_checked(self, message: Message, deadline: float) -> None:
        """Write a message that is sound; keep a belief until a time that is ahead of its paths."""
        topic, data, info = message
        try:
            if len(data) > MAX_MESSAGE:
                raise ValueError(f'it has {len(data)} bytes: at most {MAX_MESSAGE} are recorded')
            if not self._is_of_this_mission(topic, data):
                return
            self._check(topic, data)
        except (ValueError, RuntimeError) as error:
            # DDS keeps the order of what one node publishes, not of what two do.
            is_early = isinstance(error, PathsUnknownError) and time.monotonic() < deadline
            if is_early and len(self._early) < MOST_EARLY:
                self._early.append((message, deadline))
            else:
                self.diagnostics.refuse(topic.name, error)
            return
        self._log.write(topic.name, data, info['received_timestamp'], info['source_timestamp'])
        self._unsynced = True
        self.diagnostics.accept()

    def _write_early(self) -> None:
        """Write the beliefs that were ahead of their paths, or refuse those that waited long."""
        early, self._early = self._early, []
        for message, deadline in early:
            self._write_checked(message, deadline)

    def _is_of_this_mission(self, topic: HeardTopic, data: bytes) -> bool:
        """Return whether diagnostics, which all missions tell on one topic, are of this one."""
        if topic.name != DIAGNOSTICS or self._namespace == '/':
            return True
        status = deserialize_message(data, message_class(topic.type_name)).status
        return any(each.name.startswith(self._namespace) for each in status)

    def _check(self, topic: HeardTopic, data: bytes) -> None:
        """Check that what others act on, also when they read the log, can be of this mission."""
        if topic.type_name not in READ:
            return
        message = deserialize_message(data, message_class(topic.type_name))
        check_readable(topic.type_name, data)
        if topic.type_name == STATUS:
            self._check_status(topic, message)
        elif topic.recorded:
            stamp, mission = self._name(topic, message)
            content = content_hash(message)
            first = self._note(topic.name, stamp, mission, content)
            topic.unacknowledged.append((stamp, first, mission))
            if len(topic.unacknowledged) > qos.DEPTH:
                self.diagnostics.refuse(
                    topic.name,
                    f'{qos.DEPTH} paths wait for the first belief of their mission: the oldest is '
                    'not acknowledged any more',
                )
                del topic.unacknowledged[0]
            if first != content:
                raise ValueError(
                    f'another message with stamp {stamp} was recorded first, and counts (do two '
                    'nodes publish this topic?)'
                )
        elif topic.type_name == REPORT:
            # No robot is taken for back by it: only those who have its path see whether it fits.
            read_report(message, agent_of(topic.name))
        elif topic.name == self.resolve_topic_name('belief'):
            snapshot = read_belief_maps(message)
            known = self._paths[snapshot.mission]
            self._tracker.check_belief(snapshot, self.count_authors(topic.name, BELIEF), known)
            self._tracker.accept_belief(snapshot, known)

    def _check_status(self, topic: HeardTopic, message: Any) -> None:
        """Check what an agent says of an order, and have a departure told to be on the disk."""
        # Of two departures of one deployment, by two robots of one name, only the first is told.
        key, status = read_status(message, agent_of(topic.name))
        if key not in self._ordered:
            raise PathsUnknownError(
                f'deployment {key} is {status.state.name}, and its path is not on record'
            )
        self._departures.take(key, status)
        if status.state is OrderState.DEPARTED:
            topic.unacknowledged.append((key.stamp, status.content, NO_MISSION))

    def _name(self, topic: HeardTopic, message: Any) -> tuple[int, int]:
        """Return the stamp of a path or an operator's action, and when its mission began."""
        if topic.type_name == OPERATOR:
            return read_action_name(message), NO_MISSION
        stamp, mission = read_path_name(message), mission_of_path(message)
        check_mission(mission, self._tracker.mission)
        return stamp, mission

    def _note(self, name: str, stamp: int, mission: int, content: int) -> int:
        """Return the hash of the first path or action of this name that is on record."""
        key = name, stamp, mission
        if key not in self._first and name.endswith('/path'):
            self._paths[mission] += 1
            self._ordered.add(DeploymentKey(agent_of(name), stamp))
        return self._first.setdefault(key, content)

    def _tell_recorded(self) -> None:
        """Tell the agents which of their paths are on the disk."""
        for topic in self._topics.values():
            if topic.recorded is not None:
                topic.unacknowledged = [
                    each for each in topic.unacknowledged if not self._tell(topic, *each)
                ]

    def _tell(self, topic: HeardTopic, stamp: int, content: int, mission: int) -> bool:
        """Say that a path or action is on the disk; return False if that must wait."""
        if topic.type_name == PATH:
            try:
                self._tracker.check_path(mission)
            except ValueError as error:
                # A path may come before the belief that it was planned on.
                if self._tracker.mission is None:
                    return False
                self.diagnostics.refuse(topic.name, error)
                return True
            self._tracker.begin(mission)
        assert topic.recorded is not None
        topic.recorded.publish(
            Recorded(stamp=to_stamp(stamp), content=content, mission=to_stamp(mission))
        )
        return True

    def _sync(self) -> None:
        if self._unsynced:
            self._log.sync()
            self._unsynced = False

    def _on_parameters(self, node: str, values: Mapping[str, Any]) -> None:
        if values != self._configuration.get(node):
            self._configuration[node] = values
            self._log.add_metadata(f'{PARAMETERS}{node}', parameters_record(values))
            self._unsynced = True


def offered_by(publishers: Sequence[Any], type_name: str) -> str:
    """Return the QoS of a topic's publishers of this type, as a log keeps it."""
    return qos_profiles_yaml(
        each.qos_profile for each in publishers if each.topic_type == type_name
    )


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder; return the exit code."""
    return run('recorder', RecorderNode, args, linger=0.6)


if __name__ == '__main__':
    sys.exit(main())
