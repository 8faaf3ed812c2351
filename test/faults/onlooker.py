# SPDX-License-Identifier: Apache-2.0
"""A node outside the mission that keeps what it receives."""

from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.core import DeploymentKey, Report
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path

AGENT = 'scout_1'


@dataclass
class Evidence:
    """Paths and reports of deployments, each with repetitions."""

    paths: dict[DeploymentKey, set[tuple[tuple[float, float], ...]]] = field(default_factory=dict)
    reports: dict[DeploymentKey, set[Report]] = field(default_factory=dict)

    def take_path(self, key, message):
        """Keep the positions of a nav_msgs/Path, received or decoded from a log."""
        positions = (pose.pose.position for pose in message.poses)
        self.paths.setdefault(key, set()).add(tuple((each.x, each.y) for each in positions))

    def take_report(self, message):
        key, report = read_report(message)
        self.reports.setdefault(key, set()).add(report)


class Onlooker:
    """A node that subscribes to everything and publishes nothing."""

    def __init__(self, node, namespace, agents):
        self.node = node
        self.evidence = Evidence()
        self.belief = None
        self.recorded = set()
        self.states = {}
        self.refused = {}
        for agent in agents:
            for kind, topic, callback in (
                (Path, 'path', partial(self._on_path, agent)),
                (DeploymentReport, 'report', self._on_report),
                (Recorded, 'recorded', partial(self._on_recorded, agent)),
            ):
                node.create_subscription(
                    kind, f'{namespace}/{agent}/{topic}', callback, qos.EVIDENCE
                )
        for kind, topic, callback, profile in (
            (BeliefMaps, 'belief', self._on_belief, qos.LATCHED),
            (DiagnosticArray, '/diagnostics', self._on_diagnostics, qos.DIAGNOSTICS),
        ):
            name = topic if topic.startswith('/') else f'{namespace}/{topic}'
            node.create_subscription(kind, name, callback, profile)

    def _on_path(self, agent, message):
        self.evidence.take_path(DeploymentKey(agent, from_stamp(message.header.stamp)), message)

    def _on_report(self, message):
        # Strangers may publish messages that no node would.
        with suppress(ValueError):
            self.evidence.take_report(message)

    def _on_recorded(self, agent, message):
        self.recorded.add(DeploymentKey(agent, from_stamp(message.stamp)))

    def _on_belief(self, message):
        self.belief = message

    def _on_diagnostics(self, array):
        for status in array.status:
            values = {value.key: value.value for value in status.values}
            self.states[status.name] = values['state']
            self.refused[status.name] = int(values['refused'])

    def forget(self, name):
        """Forget the state of a node that is restarted."""
        self.states.pop(name, None)
        if name.endswith('/estimator'):
            self.belief = None

    @property
    def held(self):
        return -1 if self.belief is None else self.belief.deployments
