# SPDX-License-Identifier: Apache-2.0
"""A hidden world and the agents that send simulated robots into it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.configuration import (
    agents_of,
    execution_of,
    robot_types_of,
    sensor_model_of,
    value_for,
)
from kbnitp_ros.configuration.world_file import read_world
from kbnitp_ros.core import DeploymentKey, Observation, World
from kbnitp_ros.log.deployments import RecordedDeployment
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.markers import readings_marker
from kbnitp_ros.messages.missions import check_mission, mission_of_path
from kbnitp_ros.messages.poses import pose_message
from kbnitp_ros.nodes.recorded_paths import RecordedPaths
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker


class Simulation:
    """The field as it really is, the same for all agents of a team."""

    def __init__(self, node: FieldNode) -> None:
        self.node = node
        self.grid = node.grid
        common = sensor_model_of(node.values)
        robot_types = robot_types_of(node.values)
        self.models = {
            agent: robot_type.model(common) for agent, robot_type in robot_types.items()
        }
        self.execution = execution_of(node.values)
        self.agents = agents_of(node.values, self.grid)
        self._seeds = np.random.SeedSequence(node.values['seed'])
        self.world = self._hidden_world()
        if node.values['publish_truth']:
            self._publish_truth()

    def _hidden_world(self) -> World:
        values = self.node.values
        if values['world.file']:
            return read_world(values['world.file'], self.grid)
        return World.random(
            self.grid,
            np.random.default_rng(self._seeds),
            values['world.hazard_density'],
            values['world.kappa'],
            values['world.target_background'],
        )

    def _publish_truth(self) -> None:
        for name in ('hazard', 'target'):
            truth = occupancy_grid(self.grid, getattr(self.world, name), self.node.now())
            publisher = self.node.create_publisher(OccupancyGrid, f'truth/{name}', qos.LATCHED)
            publisher.publish(truth)

    def generator(self, agent: str, robot: int) -> np.random.Generator:
        """
        Return the randomness of an agent's robot, counted from 0.

        Robots leave in rounds, the agents in their order, and the n-th of all robots has the n-th
        child of the seed, as in core's run_mission.
        """
        child = robot * len(self.agents) + self.agents.index(agent)
        return np.random.default_rng(
            np.random.SeedSequence(self._seeds.entropy, spawn_key=(child,))
        )


class SimulatedAgent:
    """
    Sends a simulated robot along each path that one agent is given, and reports how it ended.

    Parameters
    ----------
    simulation : Simulation
        Where the robots go.
    name : str
        The agent's.
    prefix : str
        What the names of its topics begin with.
    recorded : dict
        The deployments on record of the mission that is gone on with.
    mission : int or None
        When that began, in nanoseconds; None as long as no robot has left.

    """

    def __init__(
        self,
        simulation: Simulation,
        name: str,
        prefix: str,
        recorded: dict[DeploymentKey, RecordedDeployment],
        mission: int | None,
    ) -> None:
        self._simulation = simulation
        self._node = simulation.node
        self.name = name
        self._prefix = prefix
        self._mission = mission
        self._max_steps = value_for(self._node.values, 'max_steps', name)
        self._known: dict[DeploymentKey, NDArray[np.intp]] = {}
        # Which of its robots takes a deployment, counted from 0.
        self._robots: dict[DeploymentKey, int] = {}
        self._sent = RecordedPaths(self._node, name, prefix, self._read_path, self._take_path)
        self.reports = self._publisher(DeploymentReport, 'report', qos.EVIDENCE)
        self._readings = self._publisher(Marker, 'readings', qos.LATCHED)
        if self._node.values['publish_pose']:
            self._poses = self._node.create_publisher(TFMessage, '/tf', qos.POSES)
        for key, deployment in recorded.items():
            if key.agent == name:
                self._restore(key, deployment)

    def _publisher(self, message_type: type, topic: str, profile: QoSProfile) -> Publisher:
        return self._node.create_publisher(message_type, self._prefix + topic, profile)

    def _restore(self, key: DeploymentKey, deployment: RecordedDeployment) -> None:
        """Publish a report on record again, and do not make that deployment once more."""
        self._robots[key] = len(self._robots)
        observation = deployment.observation
        # A silent robot was only given up: it may be on its way home.
        if observation and (observation.survived or not self._node.values['silent_loss']):
            self._known[key] = deployment.path
            self.reports.publish(report_message(key, observation, deployment.reported))

    def listen(self) -> None:
        """Take paths from now on."""
        self._sent.listen()

    @property
    def pending(self) -> int:
        """How many of its robots have not left yet."""
        return self._sent.pending

    @property
    def awaited(self) -> str:
        """Return what its robots wait for; empty when none does."""
        return self._sent.awaited

    def _read_path(self, message: Path) -> tuple[DeploymentKey, NDArray[np.intp], int] | None:
        grid = self._simulation.grid
        key, cells = read_path(grid, self.name, message)
        path = grid.check_path(cells, self._max_steps)
        mission = mission_of_path(message)
        check_mission(mission, self._mission)
        known = self._known.get(key)
        if known is not None and not np.array_equal(known, path):
            raise ValueError(f'deployment {key} is known with another path: the first path counts')
        if known is not None:
            return None
        self._node.diagnostics.accept()
        return key, path, mission

    def _take_path(self, sent: tuple[DeploymentKey, NDArray[np.intp], int]) -> None:
        """Have a robot leave whose path no crash can take from the base any more."""
        key, path, mission = sent
        check_mission(mission, self._mission)
        self._mission = mission
        self._known[key] = path
        self._leave(key)

    def _leave(self, key: DeploymentKey) -> None:
        simulation, path = self._simulation, self._known[key]
        robot = self._robots.setdefault(key, len(self._robots))
        rng = simulation.generator(self.name, robot)
        made = simulation.execution.traverse(
            simulation.world, simulation.grid, path, simulation.models[self.name], rng
        )
        period = value_for(self._node.values, 'step_period', self.name)
        if period == 0.0:
            self._return(key, made.observation)
            return
        self._after(period * (len(made.walk) - 1), partial(self._return, key, made.observation))
        if self._node.values['publish_pose']:
            for step, cell in enumerate(made.walk[: made.steps_made + 1].tolist()):
                self._after(period * step, partial(self._show, cell))

    def _after(self, seconds: float, callback: Callable[[], None]) -> None:
        """Call back once, after a time on the simulated clock, or else on one that nobody sets."""

        def once() -> None:
            self._node.destroy_timer(timer)
            callback()

        is_simulated = self._node.get_parameter('use_sim_time').value
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        clock = self._node.get_clock() if is_simulated else steady
        timer = self._node.create_timer(seconds, once, clock=clock)

    def _show(self, cell: int) -> None:
        pose = pose_message(self._simulation.grid, self.name, cell, self._node.now())
        self._poses.publish(pose)

    def _return(self, key: DeploymentKey, observation: Observation) -> None:
        """Report what came of a robot, now that it is back or would have been."""
        if not observation.survived and self._node.values['silent_loss']:
            return
        stamp = self._node.now()
        self.reports.publish(report_message(key, observation, stamp))
        if observation.survived:
            self._readings.publish(readings_marker(self._simulation.grid, observation, stamp))
