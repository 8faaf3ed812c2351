# SPDX-License-Identifier: Apache-2.0
"""The planner: sends robot after robot where the most is to be learnt."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import deployment_order, DeploymentKey, plan
from kbnitp_ros.log.deployments import read_deployments
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.deployments import path_message, read_path, read_report
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
        self._out: set[DeploymentKey] = set()
        # How many deployments the belief must hold before the next is planned on it.
        self._made = 0
        self._last_stamp = 0
        self._is_heard = False
        if self.values['resume']:
            self._restore(self.values['resume'])
        self.diagnostics.state = 'waiting for the belief'
        self.create_subscription(BeliefMaps, 'belief', self._on_belief, qos.LATCHED)
        for agent in self._paths:
            self.create_subscription(
                DeploymentReport, f'{agent}/report', self._on_report, qos.EVIDENCE
            )
        self.create_poll(self._deploy)

    def _restore(self, log: str) -> None:
        """Publish the paths on record again: those sent before are known to nobody else now."""
        for key, recorded in read_deployments(log).items():
            if key.agent not in self._paths:
                raise ValueError(
                    f'{log} has deployments of {key.agent}: the parameter agents names only '
                    f'{", ".join(self._paths)}'
                )
            _, cells = read_path(self._grid, key.agent, recorded.path.message)
            self._grid.check_path(cells, self.values['max_steps'])
            self._paths[key.agent].publish(recorded.path.data)
            if recorded.report is None:
                self._out.add(key)
            self._made += 1
            self._last_stamp = key.stamp

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
        self._out.discard(key)
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
        agent = list(self._paths)[newest.deployments % len(self._paths)]
        key = DeploymentKey(agent, self._next_stamp(newest))
        self._out.add(key)
        self._made = newest.deployments + 1
        self._last_stamp = key.stamp
        self._paths[agent].publish(path_message(self._grid, planned.path, key.stamp))

    def _next_stamp(self, newest: Snapshot) -> int:
        """
        Return the stamp that names the deployment to be planned on a belief.

        It is the belief's own, so that a planner which was restarted, and no longer knows what it
        sent, sends the very same message again, which changes nothing. None is used twice, even
        if the clock jumps back.
        """
        held = 0 if newest.newest is None else newest.newest.stamp
        return max(newest.stamp, held + 1, self._last_stamp + 1)

    def _reason_to_wait(self, held: int) -> str:
        """Return what must come before the next deployment; empty when nothing."""
        if self._out:
            return f'waiting for {min(self._out, key=deployment_order)} to be reported'
        if held < self._made:
            return f'waiting for a belief that holds {self._made} deployments'
        robots = self.values['robots']
        if held >= robots:
            return f'done: {held} of {robots} robots deployed'
        if not self._is_heard and (waiting := self.waiting_for(self._paths.values())):
            return waiting
        self._is_heard = True
        return ''


def main(args: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run('planner', PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
