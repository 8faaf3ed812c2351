# SPDX-License-Identifier: Apache-2.0
"""The planner: sends robot after robot where the most is to be learnt."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import DeploymentKey, plan
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.deployments import path_message, read_report
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import agents_of, grid_of, sensor_model_of
from kbnitp_ros.nodes.shell import run, Shell
from nav_msgs.msg import Path


class PlannerNode(Shell):
    """Publish one path after another, each planned on the belief given all before it."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._grid = grid_of(self.values)
        self._model = sensor_model_of(self.values)
        self._paths = {
            agent: self.create_publisher(Path, f'{agent}/path', qos.EVIDENCE)
            for agent in agents_of(self.values)
        }
        self._newest: Snapshot | None = None
        self._out: DeploymentKey | None = None
        self._out_is_reported = False
        self._held_before = 0
        self._last_stamp = 0
        self.diagnostics.state = 'waiting for the belief'
        self.create_subscription(BeliefMaps, 'belief', self._on_belief, qos.LATCHED)
        for agent in self._paths:
            self.create_subscription(
                DeploymentReport, f'{agent}/report', self._on_report, qos.EVIDENCE
            )
        self.create_poll(self._deploy)

    def _on_belief(self, message: BeliefMaps) -> None:
        try:
            snapshot = read_belief_maps(message)
            self._check_rules(snapshot)
        except ValueError as error:
            self.diagnostics.refuse('belief', error)
            return
        self.diagnostics.accept()
        # A restarted estimator goes through its earlier beliefs once more.
        if self._newest is None or snapshot.deployments >= self._newest.deployments:
            self._newest = snapshot
            self._deploy()

    def _check_rules(self, snapshot: Snapshot) -> None:
        if snapshot.grid != self._grid:
            raise ValueError(f'it is on {snapshot.grid}: the parameters say {self._grid}')
        if snapshot.max_steps < self.values['max_steps']:
            raise ValueError(
                f'max_steps is {snapshot.max_steps}: the parameter max_steps is '
                f'{self.values["max_steps"]}, and the estimator would refuse such paths'
            )

    def _on_report(self, message: DeploymentReport) -> None:
        try:
            key, _ = read_report(message)
        except ValueError as error:
            self.diagnostics.refuse('report', error)
            return
        if key == self._out:
            self._out_is_reported = True
            self._deploy()

    def _deploy(self) -> None:
        """Send the next robot, unless something must come first."""
        newest = self._newest
        if newest is None:
            return
        reason_to_wait = self._reason_to_wait(newest.deployments)
        if reason_to_wait:
            self.diagnostics.state = reason_to_wait
            return
        planned = plan(
            self._grid,
            newest.belief,
            self._model,
            self.values['max_steps'],
            self.values['planner'],
            width=self.values['beam_width'],
            max_visits=self.values['max_visits'],
        )
        # A stamp names a deployment, so none is used twice, even if the clock jumps back.
        self._last_stamp = max(self.now(), self._last_stamp + 1)
        agent = list(self._paths)[newest.deployments % len(self._paths)]
        self._out = DeploymentKey(agent, self._last_stamp)
        self._out_is_reported = False
        self._held_before = newest.deployments
        self._paths[agent].publish(path_message(self._grid, planned.path, self._last_stamp))

    def _reason_to_wait(self, held: int) -> str:
        """Return what must come before the next deployment; empty when nothing."""
        if self._out is not None and not (self._out_is_reported and held > self._held_before):
            return f'waiting for {self._out} to be reported and believed'
        robots = self.values['robots']
        if held >= robots:
            return f'done: {held} of {robots} robots deployed'
        if self._out is None and (waiting := self.waiting_for(self._paths.values())):
            return waiting
        return '' if self.now() > 0 else 'waiting for the clock'


def main(args: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run('planner', PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
