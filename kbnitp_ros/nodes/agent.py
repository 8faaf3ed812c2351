# SPDX-License-Identifier: Apache-2.0
"""The simulated agent: its robots go into a hidden world, and some come back."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from builtin_interfaces.msg import Time
from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.core import DeploymentKey, World
from kbnitp_ros.log.deployments import read_deployments
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.markers import readings_marker
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import grid_of, sensor_model_of
from kbnitp_ros.nodes.shell import run, Shell
from kbnitp_ros.nodes.world_file import read_world
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import Marker


class AgentNode(Shell):
    """Send a simulated robot along each path it is given, and report how that ended."""

    def __init__(self) -> None:
        super().__init__('agent')
        self._name = self.values['agent']
        self._grid = grid_of(self.values)
        self._model = sensor_model_of(self.values)
        self._rng = np.random.default_rng(self.values['seed'])
        self._world = self._hidden_world()
        self._known: dict[DeploymentKey, NDArray[np.intp]] = {}
        self._waiting: list[DeploymentKey] = []
        self._recorded: set[int] = set()
        self._reports = self.create_publisher(
            DeploymentReport, f'{self._name}/report', qos.EVIDENCE
        )
        self._readings = self.create_publisher(Marker, f'{self._name}/readings', qos.LATCHED)
        if self.values['publish_truth']:
            self._publish_truth()
        if self.values['resume']:
            self._restore(self.values['resume'])
        self._awaiting = self.create_poll(self._listen)

    def _hidden_world(self) -> World:
        if self.values['world.file']:
            return read_world(self.values['world.file'], self._grid)
        return World.random(
            self._grid,
            self._rng,
            self.values['world.hazard_density'],
            self.values['world.kappa'],
            self.values['world.target_background'],
        )

    def _publish_truth(self) -> None:
        for name in ('hazard', 'target'):
            truth = occupancy_grid(self._grid, getattr(self._world, name), self.now())
            self.create_publisher(OccupancyGrid, f'truth/{name}', qos.LATCHED).publish(truth)

    def _restore(self, log: str) -> None:
        """Publish the reports on record again, and do not make those deployments once more."""
        for key, recorded in read_deployments(log).items():
            if key.agent == self._name and recorded.report is not None:
                _, path = read_path(self._grid, self._name, recorded.path.message)
                self._known[key] = path
                self._rng.spawn(1)
                self._reports.publish(recorded.report.data)

    def _listen(self) -> None:
        """Take paths, which are kept until then, as soon as somebody takes the reports."""
        self.diagnostics.state = self.waiting_for([self._reports])
        if not self.diagnostics.state:
            self._awaiting.cancel()
            self.diagnostics.state = f'taking paths of {self._name}'
            self.create_subscription(Path, f'{self._name}/path', self._on_path, qos.EVIDENCE)
            if self.values['recorded']:
                self.create_subscription(
                    Time, f'{self._name}/recorded', self._on_recorded, qos.EVIDENCE
                )

    def _on_path(self, message: Path) -> None:
        try:
            key, cells = read_path(self._grid, self._name, message)
            path = self._grid.check_path(cells, self.values['max_steps'])
            if self._is_known(key, path):
                return
        except ValueError as error:
            self.diagnostics.refuse(f'{self._name}/path', error)
            return
        self.diagnostics.accept()
        self._known[key] = path
        self._waiting.append(key)
        self._send_out()

    def _is_known(self, key: DeploymentKey, path: NDArray[np.intp]) -> bool:
        known = self._known.get(key)
        if known is not None and not np.array_equal(known, path):
            raise ValueError(f'deployment {key} is known along another path: the first holds')
        return known is not None

    def _on_recorded(self, message: Time) -> None:
        self._recorded.add(from_stamp(message))
        self._send_out()

    def _send_out(self) -> None:
        """Have the robots leave whose paths no crash can take from the base any more."""
        for key in self._waiting.copy():
            if not self.values['recorded'] or key.stamp in self._recorded:
                self._waiting.remove(key)
                self._traverse(key)
        self.diagnostics.waiting = len(self._waiting)

    def _traverse(self, key: DeploymentKey) -> None:
        # The k-th robot leaves with the k-th child of the seed, as in core's run_mission.
        observation = self._world.traverse(self._known[key], self._model, self._rng.spawn(1)[0])
        stamp = self.now()
        self._reports.publish(report_message(key, observation, stamp))
        if observation.survived:
            self._readings.publish(readings_marker(self._grid, observation, stamp))


def main(args: Sequence[str] | None = None) -> int:
    """Run the agent; return the exit code."""
    return run('agent', AgentNode, args, linger=0.15)


if __name__ == '__main__':
    sys.exit(main())
