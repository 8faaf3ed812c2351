# SPDX-License-Identifier: Apache-2.0
"""Somebody on the network of a mission who sends what no node of it would."""

from __future__ import annotations

from copy import deepcopy
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, TargetReading
from kbnitp_ros.core import Observation
from kbnitp_ros.messages.deployments import path_message, report_message
from kbnitp_ros.messages.headers import to_stamp
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import grid_of
from nav_msgs.msg import OccupancyGrid, Path
from onlooker import AGENT
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
import rclpy
from rclpy.serialization import serialize_message
from schedule import NODES
from unbroken import with_defaults
from visualization_msgs.msg import Marker

# How many characters a large text has, and the time that ends all times.
LARGE = 50_000_000
END = Time(sec=2**31 - 1, nanosec=999_999_999)

# How long the missions are flooded with bad paths, in seconds.
FLOOD = 20.0

# The methods that are kinds of forgery.
FORGERIES = ('late', 'unfitting', 'beliefs', 'parameters', 'large', 'flood', 'bag', 'random')


class Forger:
    """
    Sends forged messages of many kinds.

    A method that is a kind of forgery sends it, `scale` times as many as it is named for, and
    returns how many messages each of the nodes must refuse at least.

    Parameters
    ----------
    mission : Mission
        Whose it is; under way.
    namespace : str
        Of its topics.
    parameters : dict
        Of all nodes.
    rng : numpy.random.Generator
        Of what is drawn.

    """

    def __init__(self, mission, namespace, parameters, rng):
        self._mission = mission
        self._node = mission.node
        self._namespace = namespace
        self._grid = grid_of(with_defaults(parameters))
        self._rng = rng
        self._publishers = {}

    def _publisher(self, kind, topic, profile=qos.EVIDENCE):
        if topic not in self._publishers:
            name = topic if topic.startswith('/') else f'{self._namespace}/{topic}'
            publisher = self._node.create_publisher(kind, name, profile)
            self._publishers[topic] = publisher
            self._mission.wait(1.0)
        return self._publishers[topic]

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
        return {'team': 1, 'recorder': 1, 'estimator': 3, 'planner': 2}

    def _lost(self):
        key, cells = self._newest()
        return key, Observation(cells, False), 1

    def unfitting(self, scale):
        """Send reports on the robot that is out which do not fit its path."""
        _, reports, _ = self._evidence()
        for _ in range(3):
            key, cells = self._newest()
            report = report_message(key, Observation(cells, True, [False] * (len(cells) - 1)), 1)
            report.readings[0] = TargetReading(cell=self._grid.cells - 1)
            reports.publish(report)
            empty = report_message(key, Observation(cells, True, [False] * (len(cells) - 1)), 1)
            empty.readings = []
            reports.publish(empty)
            self._mission.wait(0.2)
        return {'estimator': 6}

    def beliefs(self, scale):
        """Send beliefs that do not follow from those before."""
        *_, beliefs = self._evidence()
        true = deepcopy(self._mission.onlooker.belief)
        forged = [BeliefMaps(), BeliefMaps(), *(deepcopy(true) for _ in range(3))]
        forged[2].deployments = 4_000_000_000
        forged[3].method = 'guess'
        forged[4].lethality = 0.125
        for each in forged:
            beliefs.publish(each)
            self._mission.wait(0.05)
        return {'planner': len(forged), 'recorder': len(forged) - 1}

    def large(self, scale):
        """Send texts of 50 MB."""
        _, reports, _ = self._evidence()
        for field in ('agent', 'frame_id', 'agent'):
            report = report_message(*self._lost())
            if field == 'agent':
                report.agent = 'x' * LARGE
            else:
                report.header.frame_id = 'x' * LARGE
            reports.publish(report)
            self._mission.wait(2.0)
        return {'estimator': 3, 'planner': 3, 'recorder': 3}

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
        return {'team': count, 'estimator': count}

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
        return {'team': 1, 'recorder': 3, 'estimator': 1, 'planner': 1}

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
            belief.info.map_load_time = to_stamp(begun)
            belief.deployments, belief.deployment = number, to_stamp(stamp)
            beliefs.publish(belief)
            self._mission.wait(0.02)
        count = len(numbers)
        return {'team': count, 'estimator': count, 'planner': 1, 'recorder': count + 1}

    def random(self, scale):
        """Send 1,000 messages on each topic: bytes drawn at random, and true ones changed."""
        topics = {
            f'{AGENT}/path': (Path, qos.EVIDENCE),
            f'{AGENT}/report': (DeploymentReport, qos.EVIDENCE),
            f'{AGENT}/recorded': (Time, qos.EVIDENCE),
            f'{AGENT}/readings': (Marker, qos.LATCHED),
            'belief': (BeliefMaps, qos.LATCHED),
            'belief/hazard': (OccupancyGrid, qos.LATCHED),
            'belief/target': (OccupancyGrid, qos.LATCHED),
            'belief/kappa': (OccupancyGrid, qos.LATCHED),
            '/diagnostics': (DiagnosticArray, qos.DIAGNOSTICS),
        }
        publishers = [self._publisher(kind, name, how) for name, (kind, how) in topics.items()]
        count = round(1000 * scale)
        for _ in range(count):
            for publisher, (kind, _) in zip(publishers, topics.values()):
                publisher.publish(self._scrambled(kind))
            self._mission.wait(0.001)
        return {'team': count, 'estimator': 2 * count, 'planner': count, 'recorder': 2 * count}

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
