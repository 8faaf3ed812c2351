# SPDX-License-Identifier: Apache-2.0
"""Somebody on the network of a mission who sends what no node of it would."""

from copy import deepcopy
import os
import time

from bare_dds import BareParticipant, HOSTILE
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.configuration import grid_of
from kbnitp_ros.core import Observation
from kbnitp_ros.messages.deployments import path_message, report_message
from kbnitp_ros.messages.headers import from_stamp, to_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import OccupancyGrid, Path
from onlooker import AGENT
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
import rclpy
from rclpy.serialization import serialize_message
from schedule import NODES
from unbroken import with_defaults
from visualization_msgs.msg import Marker

# The time that ends all times.
END = Time(sec=2**31 - 1, nanosec=999_999_999)

# How long the missions are flooded with bad paths, in seconds.
FLOOD = 20.0

# The topics that bytes are sent on.
TOPICS = {
    f'{AGENT}/path': (Path, qos.EVIDENCE), f'{AGENT}/report': (DeploymentReport, qos.EVIDENCE),
    f'{AGENT}/recorded': (Recorded, qos.EVIDENCE), f'{AGENT}/readings': (Marker, qos.LATCHED),
    'belief': (BeliefMaps, qos.LATCHED), 'belief/hazard': (OccupancyGrid, qos.LATCHED),
    'belief/target': (OccupancyGrid, qos.LATCHED), 'belief/kappa': (OccupancyGrid, qos.LATCHED),
    '/diagnostics': (DiagnosticArray, qos.DIAGNOSTICS),
}  # fmt: skip

# The methods that are kinds of forgery.
FORGERIES = (
    'late',
    'parameters',
    'flood',
    'at_once',
    'garbage',
    'bag',
    'random',
    'topics',
)


class Forger:
    """Sends forged messages of many kinds."""

    def __init__(self, mission, namespace, parameters, rng):
        self._mission = mission
        self._node = mission.node
        self._namespace = namespace
        self._parameters = parameters
        self._robots = parameters['robots']
        self._grid = grid_of(with_defaults(parameters))
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
        """Publish as soon as the publisher is made, which stays."""
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
        """Return the newest deployment on disk, which is none of the forged, and its cells."""
        onlooker = self._mission.onlooker
        key = max(onlooker.recorded & onlooker.evidence.paths.keys())
        # Of a scrambled message with fewer poses the longest is the true one.
        positions = max(onlooker.evidence.paths[key], key=len)
        return key, self._grid.cells_at(positions)

    def late(self, scale):
        """Send times that no others can follow."""
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
        """Send 12,000 bad paths in 20 s."""
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
        """Send with each publisher as soon as it is made, before anybody counts it."""
        belief = deepcopy(self._mission.onlooker.belief)
        mission = from_stamp(belief.mission)
        belief.deployments = self._robots
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
        """Send 100 messages of bytes drawn at random on each topic, at once."""
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
        # Of very many it looks at some after others.
        return {'recorder': min(len(types), 1000)}

    def parameters(self, scale):
        """Send what no parameter is, and what no node is called."""
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
        """Be a node of the mission that gives its parameters a type of which there is none."""

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
        """Send 1,000 messages on each topic: bytes drawn at random, and true ones changed."""
        publishers = [self._publisher(kind, name, how) for name, (kind, how) in TOPICS.items()]
        count = round(1000 * scale)
        for _ in range(count):
            for publisher, (kind, _) in zip(publishers, TOPICS.values()):
                publisher.publish(self._scrambled(kind))
            self._mission.wait(0.001)
        return {'agent': count, 'estimator': 2 * count, 'planner': count, 'recorder': 2 * count}

    def _scrambled(self, kind):
        """Return bytes that are drawn at random, or those of a message with some changed."""
        if self._rng.random() < 0.5:
            return self._rng.bytes(self._rng.integers(4, 200))
        key, cells = self._newest()
        message = kind()
        if kind is Path:
            message = path_message(self._grid, cells, key.stamp)
        elif kind is DeploymentReport:
            # Whatever it is about, a robot that came back has readings.
            message = report_message(*self._lost())
            message.survived = True
        elif kind is BeliefMaps:
            message = deepcopy(self._mission.onlooker.belief)
            message.lethality = 2.0
        data = bytearray(serialize_message(message))
        # In what says whose it is: no true message is left, which anybody could send.
        for place in self._rng.integers(4, min(len(data), 24), size=4):
            data[place] = self._rng.integers(256)
        return bytes(data)
