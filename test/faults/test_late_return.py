# SPDX-License-Identifier: Apache-2.0
"""A robot given up for lost that comes back after all: the test plays the agent."""

from extent import some
from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.configuration import grid_of
from kbnitp_ros.core import Observation
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import report_message
from kbnitp_ros.nodes.runtime import qos
from mission import NAMESPACE
import numpy as np
from onlooker import AGENT
import pytest
from unbroken import folded, with_defaults

PARAMETERS = {
    'grid.width': 5, 'grid.height': 5, 'max_steps': 10, 'robots': 8, 'planner': 'relaxed',
}  # fmt: skip


class Agent:
    """An agent whose robots fare as the test says."""

    def __init__(self, mission, parameters):
        self._mission = mission
        self._parameters = parameters
        self._rng = np.random.default_rng(1)
        self._publisher = mission.node.create_publisher(
            DeploymentReport, f'{NAMESPACE}/{AGENT}/report', qos.EVIDENCE
        )

    def report(self, number, survived):
        """Report on a deployment, from 0, and wait until the belief is that of all reports."""
        mission, evidence = self._mission, self._mission.onlooker.evidence
        mission.until(lambda: len(evidence.paths) > number, f'path {number}')
        key, (positions,) = sorted(evidence.paths.items())[number]
        cells = grid_of(with_defaults(self._parameters)).cells_at(positions)
        readings = self._rng.random(len(cells) - 1) < 0.3 if survived else None
        now = mission.node.get_clock().now().nanoseconds
        self._publisher.publish(report_message(key, Observation(cells, survived, readings), now))
        mission.until(
            lambda: survived in {report.survived for report in evidence.reports.get(key, ())},
            f'report {number}',
        )
        self.until_believed()

    def until_believed(self):
        """Wait until the belief is that of all that was reported, a return before a loss."""
        onlooker = self._mission.onlooker
        expected = folded(self._parameters, onlooker.evidence).joint.tobytes()
        self._mission.until(
            lambda: onlooker.belief and np.asarray(onlooker.belief.joint).tobytes() == expected,
            'belief of all reports',
        )


@pytest.mark.parametrize('method', some(['kappa_bnitp', 'kappa_bnitp_published'], 2))
def test_a_late_return_beats_the_loss_that_was_assumed(set_out, method):
    parameters = PARAMETERS | {'method': method}
    mission = set_out(parameters, awaited={'planner': ['estimator', 'recorder', 'onlooker']})
    agent = Agent(mission, parameters)
    mission.start('recorder', 'estimator', 'planner')
    for number in range(5):
        agent.report(number, survived=number in (0, 3))
    agent.report(1, survived=True)
    assert mission.onlooker.held == 5
    # Whoever has not heard of the return says again that the robot is lost.
    agent.report(1, survived=False)
    for number in range(5, 8):
        agent.report(number, survived=number == 6)
    agent.report(7, survived=True)

    mission.restart('estimator')
    agent.until_believed()
    mission.restart('planner')
    mission.restart('recorder')
    mission.until_over()
    assert set(mission.processes.stop().values()) == {0}
    assert mission.logged() == mission.onlooker.evidence
    assert replay(mission.log).reproduced
