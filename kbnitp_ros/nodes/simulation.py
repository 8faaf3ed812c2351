# SPDX-License-Identifier: Apache-2.0
"""A hidden world that robots and time may change, and its simulated agents."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import time

from kbnitp_msgs.msg import AgentStatus, DeploymentReport
from kbnitp_ros.configuration import agent_names, value_for
from kbnitp_ros.configuration.agents import (
    make_execution,
    make_robot_types,
    make_sensor_model,
    own_base,
    true_dynamics,
)
from kbnitp_ros.configuration.field import read_world
from kbnitp_ros.core import (
    DeploymentKey,
    Dynamics,
    Execution,
    Grid,
    Observation,
    SensorModel,
    World,
)
from kbnitp_ros.core.field.world import Traverse
from kbnitp_ros.core.inference.record import deployment_order
from kbnitp_ros.log.record import RecordedMission
from kbnitp_ros.messages.deployments import OrderState, read_path, report_message, status_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import check_mission, content_hash, mission_of_path
from kbnitp_ros.messages.markers import pose_message, readings_marker
from kbnitp_ros.nodes.presence import HoldListener
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

# Seconds that a robot waits for paths that may come before its own: missing acknowledgements are
# requested again after 1 s and 2 s.
PATIENCE = 5.0


class HiddenField:
    """Outcomes of robots in a hidden field, as in core's run_mission."""

    # Hazards that change are a fold of all paths in deployment order, so a robot leaves when those
    # before it are known. Where all agents take part in each round in their order, robot n of an
    # agent, from 0, waits for n + 1 paths of each agent before it and n of each after it. An agent
    # whose robot is out or waits gets no earlier path. Of others it may never come, as at the end
    # of a mission or when agents leave one by one, so nobody waits for longer than `PATIENCE`.

    def __init__(
        self,
        grid: Grid,
        world: World,
        dynamics: Dynamics,
        execution: Execution,
        models: Mapping[str, SensorModel],
        agents: Sequence[str],
        generator: Callable[[str, int], np.random.Generator],
    ) -> None:
        # The present field.
        self.world = world
        self._grid = grid
        self._dynamics = dynamics
        self._execution = execution
        self._models = models
        self._agents = agents
        self._generator = generator
        # The known paths, and the number of robots that left, by agent; and waiting paths.
        self._known = dict.fromkeys(agents, 0)
        self._made = dict.fromkeys(agents, 0)
        self._waiting: dict[DeploymentKey, NDArray[np.intp]] = {}
        # When these became known.
        self._since: dict[DeploymentKey, float] = {}
        # Agents whose robots have left and are not back.
        self.out: set[str] = set()

    def take(self, key: DeploymentKey, path: NDArray[np.intp]) -> None:
        """Add a path."""
        if key not in self._waiting:
            self._known[key.agent] += 1
            self._waiting[key] = path
            self._since[key] = time.monotonic()

    def leaving(self) -> list[tuple[DeploymentKey, Traverse]]:
        """Return the robots that leave now, with their outcomes."""
        leaving = []
        while self._waiting and not self.awaited:
            first = min(self._waiting, key=deployment_order)
            leaving.append((first, self._leave(first)))
        return leaving

    def pass_over(self, agent: str) -> None:
        """Count a robot whose outcome is known, where hazards stay."""
        self._known[agent] += 1
        self._made[agent] += 1

    @property
    def is_static(self) -> bool:
        """Return whether hazards stay."""
        return self._dynamics.effect == 'static'

    @property
    def awaited(self) -> str:
        """Return the agent whose path the next robot waits for; empty if there is none."""
        if not self._waiting or self.is_static:
            return ''
        first = min(self._waiting, key=deployment_order)
        if time.monotonic() > self._since[first] + PATIENCE:
            return ''
        place, robot = self._agents.index(first.agent), self._made[first.agent]
        settled = {*self.out, *(key.agent for key in self._waiting)}
        for number, other in enumerate(self._agents):
            if self._known[other] < robot + (number < place) and other not in settled:
                return other
        return ''

    def _leave(self, key: DeploymentKey) -> Traverse:
        robot = self._made[key.agent]
        is_first = not any(self._made.values())
        path = self._waiting.pop(key)
        del self._since[key]
        made = self._execution.traverse(
            self.world,
            self._grid.at(int(path[0])),
            path,
            self._models[key.agent],
            self._generator(key.agent, robot),
            self._dynamics,
            changing=None if is_first else self._grid.may_be_hazardous,
        )
        self._made[key.agent] = robot + 1
        self.world = made.world
        return made


class Simulation:
    """The real field, shared by all agents of a team."""

    def __init__(self, node: FieldNode, record: RecordedMission) -> None:
        self.node = node
        self.grid = node.grid
        common = make_sensor_model(node.values)
        robot_types = make_robot_types(node.values, self.grid)
        self.agents = agent_names(node.values, self.grid)
        dynamics = true_dynamics(node.values)
        self._seeds = np.random.SeedSequence(node.values['seed'])
        if file := node.values['world.file']:
            world = read_world(file, self.grid)
        else:
            world = World.random(
                self.grid,
                np.random.default_rng(self._seeds),
                node.values['world.hazard_density'],
                node.values['world.kappa'],
                node.values['world.target_background'],
            )
        self.field = HiddenField(
            self.grid,
            world,
            dynamics,
            make_execution(node.values),
            {agent: robot_type.model(common) for agent, robot_type in robot_types.items()},
            self.agents,
            self.generator,
        )
        self._truth = {
            name: node.create_publisher(OccupancyGrid, f'truth/{name}', qos.LATCHED)
            for name in ('hazard', 'target')
            if node.values['publish_truth']
        }
        # Outcomes of robots that leave at once, and robots that move once their outcome is known.
        self._out: dict[DeploymentKey, Traverse] = {}
        self._moving: set[DeploymentKey] = set()
        for key in record.orders:
            self._restore(key, record)
        self._publish_truth()
        # Callbacks with the outcomes, by agent; agents of other nodes have none.
        self.leave: dict[str, Callable[[DeploymentKey, Traverse], None]] = {}
        if not self.field.is_static:
            node.create_poll(self._leave_all)

    def _publish_truth(self) -> None:
        for name, publisher in self._truth.items():
            truth = getattr(self.field.world, name)
            publisher.publish(occupancy_grid(self.grid, truth, self.node.now()))

    def take(self, key: DeploymentKey, path: NDArray[np.intp]) -> None:
        """Start a deployment once all earlier ones that can change the field have started."""
        self._moving.add(key)
        if key not in self._out:
            self.field.take(key, path)
        self._leave_all()

    def _leave_all(self) -> None:
        before = self.field.world
        self._out |= self.field.leaving()
        if not np.array_equal(before.hazard, self.field.world.hazard):
            self._publish_truth()
        for key in sorted(self._moving & self._out.keys(), key=deployment_order):
            self._moving.remove(key)
            made = self._out.pop(key)
            if key.agent in self.leave:
                self.leave[key.agent](key, made)

    def is_over(self, observation: Observation | None) -> bool:
        """Return whether a robot on record is done."""
        # A silent robot was only given up, and may be on its way home.
        return observation is not None and (
            observation.survived or not self.node.values['silent_loss']
        )

    def _restore(self, key: DeploymentKey, record: RecordedMission) -> None:
        """Restore a deployment on record, unless its robot is still to depart."""
        is_static = self.field.is_static
        if record.departures.is_refused(key) or (is_static and not record.has_departed(key)):
            return
        if is_static and self.is_over(record.outcome(key)):
            self.field.pass_over(key.agent)
            return
        self.field.take(key, record.paths[key])
        self._out |= self.field.leaving()

    def generator(self, agent: str, robot: int) -> np.random.Generator:
        """Return the generator of an agent's robot, counted from 0 in departure order."""
        child = robot * len(self.agents) + self.agents.index(agent)
        return np.random.default_rng(
            np.random.SeedSequence(self._seeds.entropy, spawn_key=(child,))
        )


class AgentPaths:
    """The paths of one agent, each passed to the simulation."""

    def __init__(self, simulation: Simulation, name: str, mission: int | None) -> None:
        self.name = name
        self._simulation = simulation
        self._node = simulation.node
        self._mission = mission
        self._max_steps = value_for(self._node.values, 'max_steps', name)
        self._base = own_base(self._node.values, name, simulation.grid)
        self._known: dict[DeploymentKey, NDArray[np.intp]] = {}
        self._sent = RecordedPaths(self._node, name, self._read_path, self._take_path)

    def listen(self) -> None:
        """Subscribe to the paths."""
        self._sent.listen()

    @property
    def pending(self) -> int:
        """Return the number of its robots that have not left yet."""
        return self._sent.pending

    @property
    def awaited(self) -> str:
        """Describe the wait of the agent's robots; empty if there is none."""
        return self._sent.awaited

    def _read_path(self, message: Path) -> tuple[DeploymentKey, NDArray[np.intp], int] | None:
        grid = self._simulation.grid
        key, cells = read_path(grid, self.name, message)
        path = grid.at(self._base).check_path(cells, self._max_steps)
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
        """Accept a path that is durably recorded."""
        key, path, mission = sent
        check_mission(mission, self._mission)
        self._mission = mission
        self._known[key] = path
        self._follow(key)

    def _follow(self, key: DeploymentKey) -> None:
        """Add a recorded path to the simulation."""
        self._simulation.take(key, self._known[key])


class SimulatedAgent(AgentPaths):
    """A simulated robot for each path of one agent, and its reports."""

    def __init__(
        self,
        simulation: Simulation,
        name: str,
        record: RecordedMission,
    ) -> None:
        super().__init__(simulation, name, record.mission)
        simulation.leave[name] = self._leave
        self.reports = self._publisher(DeploymentReport, 'report', qos.EVIDENCE)
        self._statuses = self._publisher(AgentStatus, 'status', qos.EVIDENCE)
        self._readings = self._publisher(Marker, 'readings', qos.LATCHED)
        # Paths whose robots may not depart yet.
        self._at_home: list[DeploymentKey] = []
        # Paths whose robots have departed, by the log.
        self._departed = {key for key in record.orders if record.has_departed(key)}
        self._hold = HoldListener(self._node, self._depart_all)
        self._node.create_poll(self._depart_all)
        if self._node.values['publish_pose']:
            self._poses = self._node.create_publisher(TFMessage, '/tf', qos.POSES)
        for key in record.orders:
            outcome = record.outcome(key)
            if key.agent == name and outcome is not None and simulation.is_over(outcome):
                # Its report is published again, and its robot not sent a second time.
                self._known[key] = record.paths[key]
                self._say(key, OrderState.DEPARTED)
                stamp = record.reports[key].stamp
                self.reports.publish(report_message(key, outcome, stamp))

    def _publisher(self, message_type: type, topic: str, profile: QoSProfile) -> Publisher:
        name = f'{self._node.above}/{self.name}/{topic}'
        return self._node.create_publisher(message_type, name, profile)

    @property
    def pending(self) -> int:
        """Return the number of its robots that have not departed yet."""
        return super().pending + len(self._at_home)

    @property
    def awaited(self) -> str:
        """Describe the wait of the agent's robots; empty if there is none."""
        return (self._hold.awaited if self._at_home else '') or super().awaited

    def _follow(self, key: DeploymentKey) -> None:
        """Let a robot depart when it may, or at once if its departure is on record."""
        self._at_home.append(key)
        self._say(key, OrderState.ACCEPTED)
        if self._node.values['recorded']:
            departure = content_hash(status_message(key, OrderState.DEPARTED, key.stamp))
            self._sent.when_recorded(key.stamp, departure, partial(self._move, key))
        self._depart_all()

    def _depart_all(self) -> None:
        """Let the robots at home depart: all if they may, else those that had departed."""
        is_held = bool(self._at_home and self._hold.awaited)
        for key in [key for key in self._at_home if not is_held or key in self._departed]:
            self._depart(key)
            if not self._node.values['recorded']:
                self._move(key)

    def _depart(self, key: DeploymentKey) -> None:
        self._at_home.remove(key)
        self._say(key, OrderState.DEPARTED)

    def _move(self, key: DeploymentKey) -> None:
        if key in self._at_home:
            # The recorder had its departure before this node restarted.
            self._depart(key)
        super()._follow(key)

    def _say(self, key: DeploymentKey, state: OrderState) -> None:
        """Publish the status of an order; a restarted agent publishes the same again."""
        self._statuses.publish(status_message(key, state, key.stamp))

    def _leave(self, key: DeploymentKey, made: Traverse) -> None:
        self._simulation.field.out.add(self.name)
        period = value_for(self._node.values, 'step_period', self.name)
        if period == 0.0:
            self._return(key, made.observation)
            return
        self._after(period * (len(made.walk) - 1), partial(self._return, key, made.observation))
        if self._node.values['publish_pose']:
            for step, cell in enumerate(made.walk[: made.steps_made + 1].tolist()):
                self._after(period * step, partial(self._show, cell))

    def _after(self, seconds: float, callback: Callable[[], None]) -> None:
        """Call back once, after a time on the simulated clock, or else on a steady one."""

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
        """Report the outcome of a robot after its time away."""
        self._simulation.field.out.discard(self.name)
        if not observation.survived and self._node.values['silent_loss']:
            return
        stamp = self._node.now()
        self.reports.publish(report_message(key, observation, stamp))
        if observation.survived:
            self._readings.publish(readings_marker(self._simulation.grid, observation, stamp))
