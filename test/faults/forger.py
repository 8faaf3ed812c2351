# SPDX-License-Identifier: Apache-2.0
"""A participant that publishes what no node of the mission would."""

from copy import deepcopy
from dataclasses import dataclass, field
import os
import time

from bare_dds import BareParticipant, HOSTILE
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from kbnitp_ros.configuration import make_grid
from kbnitp_ros.core import Observation
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import path_message, report_message
from kbnitp_ros.messages.headers import from_stamp, to_stamp
from kbnitp_ros.messages.topics import BELIEF
from kbnitp_ros.nodes.runtime import qos
from mission import full_name, Mission, NAMESPACE, StuckError
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
from onlooker import AGENT
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
import rclpy
from rclpy.serialization import serialize_message
from unbroken import core_mission, NODES, with_defaults
from visualization_msgs.msg import Marker

# The latest representable time.
END = Time(sec=2**31 - 1, nanosec=999_999_999)

# Place of the name of a deployment in a serialized report.
DEPLOYMENT = 20

# Seconds of the flood of bad paths.
FLOOD = 20.0

TOPICS = {
    f'{AGENT}/path': (Path, qos.EVIDENCE), f'{AGENT}/report': (DeploymentReport, qos.EVIDENCE),
    f'{AGENT}/recorded': (Recorded, qos.EVIDENCE), f'{AGENT}/readings': (Marker, qos.LATCHED),
    'belief': (BeliefMaps, qos.LATCHED), 'belief/hazard': (OccupancyGrid, qos.LATCHED),
    'belief/target': (OccupancyGrid, qos.LATCHED), 'belief/kappa': (OccupancyGrid, qos.LATCHED),
    '/diagnostics': (DiagnosticArray, qos.DIAGNOSTICS),
}  # fmt: skip

# Methods of `Forger`, each a kind of forgery.
FORGERIES = ('late', 'parameters', 'flood', 'at_once', 'garbage', 'bag', 'random', 'topics')


class Forger:
    """Publishes forged messages of many kinds."""

    def __init__(self, mission, namespace, parameters, rng):
        self._mission = mission
        self._node = mission.node
        self._namespace = namespace
        self._parameters = parameters
        self._robots = parameters['robots']
        self._grid = make_grid(with_defaults(parameters))
        self._rng = rng
        self._publishers = {}
        self._made = []

    def _publisher(self, kind, topic, profile=qos.EVIDENCE):
        if topic not in self._publishers:
            name = topic if topic.startswith('/') else f'{self._namespace}/{topic}'
            publisher = self._node.create_publisher(kind, name, profile)
            self._publishers[topic] = publisher
            self._mission.wait(1.0)
        return self._publishers[topic]

    def _publish_at_once(self, kind, topic, profile, messages):
        """Publish as soon as the publisher exists; it is kept."""
        name = topic if topic.startswith('/') else f'{self._namespace}/{topic}'
        publisher = self._node.create_publisher(kind, name, profile)
        for message in messages:
            publisher.publish(message)
        self._made.append(publisher)

    def _evidence(self):
        """Return the publishers of forged paths, reports and beliefs."""
        return (
            self._publisher(Path, f'{AGENT}/path'),
            self._publisher(DeploymentReport, f'{AGENT}/report'),
            self._publisher(BeliefMaps, 'belief', qos.LATCHED),
        )

    def _newest(self):
        """Return the newest recorded deployment that is not forged, and its cells."""
        onlooker = self._mission.onlooker
        key = max(onlooker.recorded & onlooker.evidence.paths.keys())
        # A scrambled path has fewer poses: the longest is the true one.
        positions = max(onlooker.evidence.paths[key], key=len)
        return key, self._grid.cells_at(positions)

    def late(self, scale):
        """Publish times that no later time can follow."""
        paths, reports, _ = self._evidence()
        path = path_message(self._grid, [0, 1, 0], 1)
        path.header.stamp = END
        paths.publish(path)
        told, named = (report_message(*self._lost()) for _ in range(2))
        told.header.stamp = END
        named.deployment = END
        reports.publish(told)
        reports.publish(named)
        return {'agent': 1, 'recorder': 1, 'estimator': 3, 'planner': 2}

    def _lost(self):
        key, cells = self._newest()
        return key, Observation(cells, False), 1

    def flood(self, scale):
        """Publish 12,000 bad paths in 20 s."""
        paths, *_ = self._evidence()
        bad = path_message(self._grid, [0, self._grid.cells - 1, 0], 1)
        number, begun = 0, time.monotonic()
        count = round(12_000 * scale)
        while number < count:
            bad.header.stamp = to_stamp(number + 1)
            paths.publish(bad)
            number += 1
            ahead = number * FLOOD / 12_000 - (time.monotonic() - begun)
            if ahead > 0:
                self._mission.wait(ahead)
        return {'agent': count, 'estimator': count}

    def at_once(self, scale):
        """Publish with each new publisher before anybody discovers it."""
        belief = deepcopy(self._mission.onlooker.belief)
        mission = from_stamp(belief.mission)
        # More than the paths of the whole mission: it may be over by now.
        belief.deployments = self._robots + 1
        key, _ = self._newest()
        other = path_message(self._grid, [0, 1, 0], key.stamp, mission)
        acknowledgements = (Recorded(stamp=to_stamp(n + 1)) for n in range(round(5200 * scale)))
        made = []
        for kind, topic, profile, messages in (
            (BeliefMaps, 'belief', qos.LATCHED, [belief]),
            (Path, f'{AGENT}/path', qos.EVIDENCE, [other]),
            (Recorded, f'{AGENT}/recorded', qos.EVIDENCE, acknowledgements),
        ):
            made.append(self._node.create_publisher(kind, f'{self._namespace}/{topic}', profile))
            for message in messages:
                made[-1].publish(message)
        self._mission.wait(2.0)
        for publisher in made:
            self._node.destroy_publisher(publisher)
        return {'planner': 1, 'recorder': 2}

    def garbage(self, scale):
        """Publish 100 messages of random bytes on each topic, in one burst."""
        count = round(100 * scale)
        for topic, (kind, profile) in TOPICS.items():
            drawn = [self._rng.bytes(self._rng.integers(4, 200)) for _ in range(count)]
            self._publish_at_once(kind, topic, profile, drawn)
        return {'agent': count, 'estimator': 2 * count, 'planner': count, 'recorder': 2 * count}

    def topics(self, scale):
        """Announce 1,000 topics of a type that is not installed, and some of hostile types."""
        self._stranger = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
        types = [*HOSTILE, *('strangers::msg::dds_::Unknown_',) * round(1000 * scale)]
        for number, type_name in enumerate(types):
            self._stranger.announce(f'rt{self._namespace}/stranger_{number}', type_name)
        # The recorder inspects a large number of topics in turns.
        return {'recorder': min(len(types), 1000)}

    def parameters(self, scale):
        """Publish bad values of parameters and bad names of nodes."""
        events = self._node.create_publisher(ParameterEvent, '/parameter_events', 10)
        self._mission.wait(1.0)
        events.publish(ParameterEvent(node='/bad name!'))
        for name in NODES:
            service = f'{self._namespace}/{name}/set_parameters'
            client = self._node.create_client(SetParameters, service)
            self._mission.until(client.service_is_ready, service)
            request = SetParameters.Request()
            request.parameters = [Parameter(name='robots', value=ParameterValue(type=77))]
            client.call_async(request)
        self._answer_badly()
        return {'agent': 1, 'recorder': 3, 'estimator': 1, 'planner': 1}

    def _answer_badly(self):
        """Run a node of the mission whose parameter service returns an unknown type."""

        def names(_, response):
            response.result.names = ['odd']
            return response

        def values(_, response):
            response.values = [ParameterValue(type=99)]
            self._asked = True
            return response

        self._asked = False
        odd = f'{self._namespace}/odd'
        self._node.create_service(ListParameters, f'{odd}/list_parameters', names)
        self._node.create_service(GetParameters, f'{odd}/get_parameters', values)
        self._odd = rclpy.create_node(
            'odd',
            context=self._node.context,
            namespace=self._namespace,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._mission.until(lambda: self._asked, 'question for parameters')

    def bag(self, scale):
        """Play the paths, reports and beliefs of another mission."""
        paths, reports, beliefs = self._evidence()
        begun = 10**18
        numbers = range(round(50 * scale) or 1)
        for number in numbers:
            key, cells = self._newest()
            stamp = begun + number + 1
            old = key._replace(stamp=stamp)
            paths.publish(path_message(self._grid, cells, stamp, begun))
            reports.publish(report_message(old, Observation(cells, False), stamp))
            belief = deepcopy(self._mission.onlooker.belief)
            belief.mission = to_stamp(begun)
            belief.deployments, belief.deployment = number, to_stamp(stamp)
            beliefs.publish(belief)
            self._mission.wait(0.02)
        count = len(numbers)
        return {'agent': count, 'estimator': count, 'planner': 1, 'recorder': count + 1}

    def random(self, scale):
        """Publish 1,000 messages on each topic: random bytes, and scrambled true messages."""
        publishers = [self._publisher(kind, name, how) for name, (kind, how) in TOPICS.items()]
        count = round(1000 * scale)
        for _ in range(count):
            for publisher, (kind, _) in zip(publishers, TOPICS.values()):
                publisher.publish(self._scrambled(kind))
            self._mission.wait(0.001)
        return {'agent': count, 'estimator': 2 * count, 'planner': count, 'recorder': 2 * count}

    def _scrambled(self, kind):
        """Return random bytes, or a message's bytes with some changed."""
        if self._rng.random() < 0.5:
            return self._rng.bytes(self._rng.integers(4, 200))
        key, cells = self._newest()
        message = kind()
        if kind is Path:
            message = path_message(self._grid, cells, key.stamp)
        elif kind is DeploymentReport:
            # Of any deployment: a returned robot has readings.
            message = report_message(*self._lost())
            message.survived = True
        elif kind is BeliefMaps:
            message = deepcopy(self._mission.onlooker.belief)
            message.lethality = 2.0
        data = bytearray(serialize_message(message))
        # In the fields that identify it: a true message could be sent by anyone.
        for place in self._rng.integers(4, min(len(data), 24), size=4):
            data[place] = self._rng.integers(256)
        if kind is DeploymentReport:
            # A report that names a deployment may hold it, as the report of its robot would.
            data[DEPLOYMENT] ^= self._rng.integers(1, 256)
        return bytes(data)


# A mission that outlasts the forgeries: a robot takes half a second.
PARAMETERS = {
    'grid.width': 5, 'grid.height': 5, 'max_steps': 10, 'robots': 12, 'planner': 'relaxed',
    'step_period': 0.05, 'seed': 5,
}  # fmt: skip

# Megabytes by which a node may grow from the first report on.
GROWTH = 50.0


@dataclass
class Forged:
    kinds: tuple[str, ...]
    findings: list[tuple[str, str]] = field(default_factory=list)
    refused: dict[str, int] = field(default_factory=dict)
    required: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NODES, 0))
    # Megabytes of each node, at the first report and at the end.
    before: dict[str, float] = field(default_factory=dict)
    after: dict[str, float] = field(default_factory=dict)

    def __str__(self):
        found = ''.join(f'\n  {kind}: {words}' for kind, words in self.findings)
        return f'mission with {", ".join(self.kinds) or "nothing"} forged:{found}'


def run_forged(folder, kinds, scale=1.0, seed=1, processes=Processes):
    parameters = PARAMETERS | {'seed': seed}
    outcome = Forged(tuple(kinds))
    with free_domain() as domain:
        os.environ |= environment(domain) | {'ROS_LOG_DIR': str(folder / 'ros_log')}
        with Mission(domain, folder, parameters, processes=processes) as mission:
            mission.start(*NODES)
            try:
                _forge(mission, parameters, outcome, scale)
            except StuckError as error:
                outcome.findings.append(('stuck', f'{error}: {outcome.required} to be refused'))
                return outcome
            codes = mission.processes.stop()
            bad = {name: code for name, code in codes.items() if code}
            outcome.findings += [('exit', f'{name} ended with {bad[name]}') for name in bad]
            said = [mission.said(name) for name in NODES]
            outcome.findings += [('exit', words) for words in said if 'Traceback' in words]
            outcome.findings += wrong_beliefs(mission.log, parameters)
    return outcome


def _forge(mission, parameters, outcome, scale):
    """Send the forgeries; wait until the mission is over and all are refused."""
    onlooker = mission.onlooker
    mission.until(lambda: onlooker.evidence.reports, 'report')
    outcome.before = mission.memory()
    forger = Forger(mission, NAMESPACE, parameters, np.random.default_rng(parameters['seed']))
    for kind in outcome.kinds:
        for node, count in getattr(forger, kind)(scale).items():
            outcome.required[node] += count
    over = f'done: {parameters["robots"]} of {parameters["robots"]} '
    states = onlooker.states
    mission.until(lambda: states.get(full_name('planner'), '').startswith(over), 'end')

    def are_refused():
        outcome.refused = {name: onlooker.refused.get(full_name(name), 0) for name in NODES}
        return all(outcome.refused[name] >= outcome.required[name] for name in NODES)

    mission.until(are_refused, 'refusal of all that was forged')

    def is_recorded():
        *_, last = read_log(mission.log, (BELIEF,))
        return last.message.deployments == parameters['robots']

    mission.until(is_recorded, 'last belief on record')
    outcome.after = mission.memory()
    for name, now in outcome.after.items():
        if now > outcome.before[name] + GROWTH:
            words = f'{name} has {now:.0f} MB, before {outcome.before[name]:.0f} MB'
            outcome.findings.append(('memory', words))


def wrong_beliefs(log, parameters):
    """Yield findings on recorded beliefs; views may also be a stranger's."""
    report = replay(log)
    topic = f'{NAMESPACE}/belief'
    for mismatch in report.mismatches:
        if mismatch.topic == topic:
            yield 'replay', str(mismatch)
    *_, last = read_log(log, (BELIEF,))
    unbroken = core_mission(parameters)[-1].belief.joint.tobytes()
    if np.asarray(last.message.joint).tobytes() != unbroken:
        yield 'belief', 'the belief recorded last is not that of core'
