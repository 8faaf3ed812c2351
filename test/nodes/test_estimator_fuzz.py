# SPDX-License-Identifier: Apache-2.0
"""
Whatever is sent to the estimator, it counts each message once and believes the sound ones alone.

With KBNITP_TESTS=full in the environment it is sent 20,000 messages, else 1,000.
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from copy import deepcopy
from itertools import pairwise
import json
import math
import time

from extent import FULL
from hypothesis import given, HealthCheck, Phase, settings
from hypothesis import strategies as st
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, TargetReading
from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.core import Belief, DeploymentKey, Estimator, Grid, Observation, SensorModel
from kbnitp_ros.messages.deployments import path_message, report_message
from kbnitp_ros.nodes.estimator import EstimatorNode
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions

MESSAGES = 50  # sent to one node
NODES = (20_000 if FULL else 1_000) // MESSAGES
SECOND = 10**9
GRID = Grid(4, 3, blocked=[5], resolution=0.5)
AGENTS = ('scout_1', 'scout_2')
MAX_STEPS = 6
SOURCES = range(3)
PATHS = ([0, 1, 2, 1, 0], [0, 4, 8, 4, 0], [0, 0], [0, 5, 0], [0, 2, 0], [0, 1, 2, 3, 2, 1, 1, 0])

EDGES = {
    'boolean': st.booleans(),
    'double': st.one_of(
        st.floats(), st.sampled_from([-0.0, 2.0, 1.999, 1e308, -1e308, 5e-324]), st.floats(0, 2)
    ),
    'int32': st.one_of(st.integers(-(2**31), 2**31 - 1), st.integers(0, 3)),
    'uint32': st.one_of(
        st.integers(0, 2**32 - 1), st.integers(0, 13), st.integers(10**9 - 1, 10**9 + 1)
    ),
    'uint8': st.one_of(st.integers(0, 255), st.integers(0, 3)),
    'sequence<double>': st.lists(st.floats(), max_size=4),
    'string': st.one_of(st.sampled_from(['', 'map', '/map', *AGENTS]), st.text(max_size=8)),
}


@st.composite
def sound(draw):
    """Draw a message that may be taken in, with its agent."""
    agent = draw(st.sampled_from(AGENTS))
    key = DeploymentKey(agent, draw(st.integers(0, 3)) * SECOND)
    # Mostly the path that belongs to the deployment, so that reports fit.
    cells = draw(st.sampled_from([PATHS[key.stamp // SECOND % 2]] * 4 + list(PATHS)))
    if draw(st.booleans()):
        mission = draw(st.sampled_from([0, 0, 0, 7])) * SECOND
        return agent, path_message(GRID, cells, key.stamp, mission)
    steps = len(cells) - 1
    if draw(st.booleans()):
        read = st.sampled_from([True, True, True, False, False, False, -1])
        readings = draw(st.lists(read, min_size=steps, max_size=steps))
        observation = Observation(cells, True, readings)
    else:
        known = draw(st.integers(0, steps - 1))
        weights = draw(
            st.lists(st.sampled_from([0.0, 0.5, 1.0, 3.0]), min_size=steps, max_size=steps)
        )
        lost_at = weights if any(weights[known:]) and draw(st.booleans()) else None
        observation = Observation(cells, False, None, known, lost_at)
    return agent, report_message(key, observation, draw(st.integers(0, 10**18)))


def located(steps, known, lost_at):
    """Return the first steps survived, how closely, and where a robot was lost; None if none."""
    if not lost_at:
        return known, -math.inf, []
    if len(lost_at) != steps or not all(0.0 <= each < math.inf for each in lost_at):
        return None
    fit = [0.0] * known + lost_at[known:]
    if not any(fit):
        return None
    fit = [each / max(fit) for each in fit]
    first = next(step for step, each in enumerate(fit) if each > 0.0)
    if all(each == 1.0 for each in fit[first:]):
        return first, -math.inf, []
    return first, -sum(fit), fit


def leaves(message, place=()):
    """Yield (place, type) for every field of a message, those of its parts included."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind in EDGES:
            yield (*place, name), kind
        elif isinstance(value, list):
            yield (*place, name), 'sequence'
            for index, part in enumerate(value):
                yield from leaves(part, (*place, name, index))
        else:
            yield from leaves(value, (*place, name))


def get(message, place):
    """Return the part of a message at a place."""
    for step in place:
        message = message[step] if isinstance(step, int) else getattr(message, step)
    return message


@st.composite
def spoiled(draw):
    """Draw a message with one to three fields changed to anything their types allow."""
    agent, message = draw(sound())
    message = deepcopy(message)
    for _ in range(draw(st.integers(1, 3))):
        place, kind = draw(st.sampled_from(list(leaves(message))))
        *parents, name = place
        if kind == 'sequence':
            parts = get(message, place)
            kept = draw(st.lists(st.sampled_from(parts), max_size=8)) if parts else []
            if isinstance(message, DeploymentReport) and draw(st.booleans()):
                kept.append(TargetReading(cell=draw(EDGES['uint32'])))
            setattr(get(message, parents), name, [deepcopy(part) for part in kept])
        else:
            setattr(get(message, parents), name, draw(EDGES[kind]))
    return agent, message


@st.composite
def scrambled(draw):
    """Draw bytes that come close to a message, or not."""
    agent, message = draw(sound())
    data = bytearray(serialize_message(message))
    for _ in range(draw(st.integers(0, 4))):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    end = draw(st.integers(0, len(data))) if draw(st.booleans()) else len(data)
    scrambled = draw(st.one_of(st.just(bytes(data[:end])), st.binary(max_size=200)))
    return agent, type(message), scrambled


class Sender:
    """The real node, and the test in place of DDS where messages come in."""

    def __init__(self):
        self.node = EstimatorNode()
        self.callbacks = {each.topic_name: each.callback for each in self.node.subscriptions}
        self.beliefs = []
        self.listener = rclpy.create_node('listener')
        self.listen()
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.listener)
        self.until(lambda: self.beliefs)

    def listen(self):
        """Subscribe to the beliefs, of which the last comes again."""
        self.listener.create_subscription(BeliefMaps, 'belief', self.beliefs.append, qos.LATCHED)

    def until(self, condition):
        """Let the node do its own things until something holds."""
        deadline = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=0.1)

    def send(self, agent, kind, data):
        """Have the node take the bytes of a message, which it must count once."""
        counts = self.node.diagnostics
        before = counts.accepted + counts.refused
        what = 'path' if kind is Path else 'report'
        self.callbacks[f'/{agent}/{what}'](data)
        assert counts.accepted + counts.refused == before + 1

    def belief(self, deployments):
        """Return the bits of the newest belief, which holds so many deployments."""
        self.beliefs.clear()
        self.listen()
        self.until(lambda: self.beliefs and self.beliefs[-1].deployments == deployments)
        return self.beliefs[-1].joint.tobytes()

    def close(self):
        """Take the node down."""
        self.executor.shutdown()
        self.listener.destroy_node()
        self.node.destroy_node()


class Evidence:
    """What is sound of all that was sent, found without the package's own reading of it."""

    def __init__(self):
        self.paths = {}
        self.reports = defaultdict(list)
        self.mission = None

    def take(self, agent, message):
        """Keep a message if it is sound by itself."""
        stamps = [message.header.stamp]
        if isinstance(message, Path):
            cells = self.cells(message)
            if cells is not None and is_time(stamps[0], hours=1) and self.is_ours(message):
                self.paths.setdefault((seconds(stamps[0]), agent), cells)
            return
        stamps.append(message.deployment)
        if (
            message.header.frame_id == 'map'
            and message.agent == agent
            and is_time(stamps[0], hours=3)
            and is_time(stamps[1], hours=1)
            and message.source in SOURCES
        ):
            self.reports[seconds(stamps[1]), agent].append(deepcopy(message))

    def is_ours(self, message):
        """Say whether a path is of the mission that the first was of."""
        told = message.poses[0].header.stamp
        mission = seconds(told)
        if told == message.header.stamp:
            mission = 0, 0
        elif not is_time(told, hours=3):
            return False
        self.mission = self.mission or mission
        return mission == self.mission

    def cells(self, message):
        """Return the cells of a path that a robot can take; None of any other."""
        cells = []
        for each in (message, *message.poses):
            if each.header.frame_id != 'map':
                return None
        for pose in message.poses:
            x, y = pose.pose.position.x, pose.pose.position.y
            if not (0.0 <= x < 2.0 and 0.0 <= y < 1.5):
                return None
            cells.append(int(2.0 * y) * 4 + int(2.0 * x))
        return cells if len(cells) <= MAX_STEPS + 1 and is_walk(cells) else None

    def observation(self, key):
        """Return what the reports of a deployment say together; None if none of them fits."""
        path, returns, contacts = self.paths[key], [], []
        for report in self.reports[key]:
            walk = [0, *(reading.cell for reading in report.readings)]
            known = report.steps_survived
            if any(reading.detected and reading.not_looked for reading in report.readings):
                continue
            if report.survived:
                if (
                    is_walk(walk)
                    and len(walk) <= 10 * MAX_STEPS + 1
                    and not (known or report.lost_at)
                ):
                    read = [-1 if each.not_looked else each.detected for each in report.readings]
                    returns.append((sum(each >= 0 for each in read), read, walk))
            elif walk == [0] and known < len(path) - 1:
                told = located(len(path) - 1, known, list(report.lost_at))
                contacts += [] if told is None else [told]
        if returns:
            # Of several that differ, that with more readings counts.
            _, read, walk = max(returns)
            return Observation(walk, True, read)
        if not contacts:
            return None
        known, _, lost_at = max(contacts)
        return Observation(path, False, None, known, lost_at or None)

    def joint(self):
        """Return the belief's bits."""
        estimator = Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), SensorModel(0.5))
        held = 0
        for key in sorted(self.paths):
            observation = self.observation(key)
            if observation is not None:
                estimator.assimilate(observation)
                held += 1
        return held, estimator.belief.joint.tobytes()


def is_walk(cells):
    """Say whether a robot can go that way, from the base back to it."""
    inside = all(0 <= cell < 12 and cell != 5 for cell in cells)
    steps = pairwise(cells)
    near = all(abs(a % 4 - b % 4) <= 1 and abs(a // 4 - b // 4) <= 1 for a, b in steps)
    return len(cells) >= 2 and cells[0] == cells[-1] == 0 and inside and near


def is_time(stamp, hours):
    """Say whether a stamp is a time that leaves as many hours for those after it."""
    return stamp.nanosec < SECOND and (0, 0) <= seconds(stamp) <= (2**31 - 3600 * hours, 0)


def seconds(stamp):
    """Return a stamp as a pair that sorts."""
    return stamp.sec, stamp.nanosec


@pytest.fixture(scope='module')
def context(tmp_path_factory):
    """Provide ROS in this process, on a domain of its own."""
    parameters = {
        'grid.width': 4,
        'grid.height': 3,
        'grid.blocked': [5],
        'grid.resolution': 0.5,
        'max_steps': MAX_STEPS,
        'agents': list(AGENTS),
        'await_nodes': ['listener'],
    }
    args = ['--ros-args', '--log-level', 'fatal']
    for name, value in parameters.items():
        args += ['--param', f'{name}:={json.dumps(value)}']
    with free_domain() as domain, pytest.MonkeyPatch.context() as patch:
        for name, value in environment(domain).items():
            patch.setenv(name, value)
        patch.setenv('ROS_LOG_DIR', str(tmp_path_factory.mktemp('ros_log')))
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        yield
        rclpy.try_shutdown()


@pytest.mark.slow
@pytest.mark.filterwarnings('error::RuntimeWarning')
@given(st.lists(st.one_of(sound(), spoiled(), scrambled()), min_size=MESSAGES, max_size=MESSAGES))
@settings(
    max_examples=NODES,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    # Making so many messages smaller takes longer than reading them.
    phases=[Phase.generate],
)
def test_only_what_is_sound_is_believed(context, sent):
    node, evidence = Sender(), Evidence()
    for agent, *message in sent:
        if len(message) == 2:
            kind, data = message
        else:
            kind, data = type(*message), serialize_message(*message)
        node.send(agent, kind, data)
        # What cannot be decoded is nothing.
        with suppress(RuntimeError):
            evidence.take(agent, deserialize_message(data, kind))
    held, joint = evidence.joint()
    assert node.belief(held) == joint
    node.close()
