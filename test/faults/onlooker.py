# SPDX-License-Identifier: Apache-2.0
"""What somebody who listens to a mission from outside gets to know of it."""

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

# The agent of a mission whose parameters name none.
AGENT = 'scout_1'


@dataclass
class Evidence:
    """The paths and reports of deployments, each said any number of times."""

    paths: dict[DeploymentKey, set[tuple[tuple[float, float], ...]]] = field(default_factory=dict)
    reports: dict[DeploymentKey, set[Report]] = field(default_factory=dict)

    def take_path(self, key, message):
        """Keep the positions of a nav_msgs/Path, as received or as decoded from a log."""
        positions = (pose.pose.position for pose in message.poses)
        self.paths.setdefault(key, set()).add(tuple((each.x, each.y) for each in positions))

    def take_report(self, message):
        """Keep what a DeploymentReport says, whenever it was said."""
        key, report = read_report(message)
        self.reports.setdefault(key, set()).add(report)


class Onlooker:
    """A node that hears everything and says nothing."""

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
        # Somebody may send what none of the nodes would.
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
        """Forget what a node said that is started again."""
        self.states.pop(name, None)
        if name.endswith('/estimator'):
            self.belief = None

    @property
    def held(self):
        """Return how many deployments the newest belief holds; -1 before the first."""
        return -1 if self.belief is None else self.belief.deployments
