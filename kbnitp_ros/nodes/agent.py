# SPDX-License-Identifier: Apache-2.0
"""The node of simulated agents, whose robots traverse a hidden world."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import time

from kbnitp_msgs.msg import AgentHealth, AgentStatus, DeploymentReport
from kbnitp_ros.configuration import agent_names, value_for
from kbnitp_ros.configuration.agents import (
    make_execution,
    make_robot_types,
    make_sensor_model,
    own_base,
    true_dynamics,
)
from kbnitp_ros.configuration.field import read_world
from kbnitp_ros.core import DeploymentKey, Observation, World
from kbnitp_ros.core.field.world import Traverse
from kbnitp_ros.core.inference.record import deployment_order, OrderState
from kbnitp_ros.files import waiting_for
from kbnitp_ros.log.record import read_resumed, RecordedMission
from kbnitp_ros.log.roles import resumed_log
from kbnitp_ros.messages.deployments import report_message, status_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import check_mission, content_hash, mission_of_path
from kbnitp_ros.messages.health import Health, health_message
from kbnitp_ros.messages.markers import pose_message, readings_marker
from kbnitp_ros.messages.states import Readiness
from kbnitp_ros.nodes.presence import (
    AGAIN,
    BaseField,
    HoldSubscription,
    INSTALLED,
    OperatorSubscription,
    StatePublisher,
)
from kbnitp_ros.nodes.recorded_paths import RecordedPaths
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.runtime.process import run
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

# Maximum seconds that a robot waits for the paths of earlier deployments: long enough to request
# missing acknowledgements twice, after 1 s and another 2 s.
PATIENCE = 5.0


# A deployment, the cells of its path, and the start of its mission.
SentPath = tuple[DeploymentKey, NDArray[np.intp], int]


class Simulation:
    """The hidden world of a team; simulates robots in deployment order like `run_mission`."""

    # If hazards change, the field depends on the paths of all earlier deployments, so a robot
    # waits until these paths have arrived. In rounds of all agents, robot n (from 0) of an agent
    # waits for n + 1 paths of each agent earlier in the list of agents, and for n paths of each
    # later agent. It does not wait for agents with a robot in flight or waiting: their next paths
    # are later. Other agents may never get a path (end of the mission, `rolling`): see `PATIENCE`.

    def __init__(self, node: FieldNode, record: RecordedMission) -> None:
        self.node = node
        self.grid = node.grid
        self.base_field = BaseField(node, node.grid)
        values = node.values
        common = make_sensor_model(values)
        robot_types = make_robot_types(values, self.grid)
        self._models = {agent: each.model(common) for agent, each in robot_types.items()}
        self.agents = agent_names(values, self.grid)
        self.operator = OperatorSubscription(node, self.agents, record.operator)
        self._dynamics, self._target_dynamics = true_dynamics(values)
        effects = {self._dynamics.effect, self._target_dynamics.effect}
        self.is_static = effects == {'static'}
        self._execution = make_execution(values)
        self._seeds = np.random.SeedSequence(values['seed'])
        # The current world.
        self._world = self._first_world()
        # The accepted paths, and the mission of each agent's paths.
        self.paths: dict[DeploymentKey, NDArray[np.intp]] = {}
        self._missions = dict.fromkeys(self.agents, record.mission)
        # By agent: number of paths received, and of robots that left. By deployment: waiting
        # paths.
        self._known = dict.fromkeys(self.agents, 0)
        self._left = dict.fromkeys(self.agents, 0)
        self._waiting: dict[DeploymentKey, NDArray[np.intp]] = {}
        # Start of the wait of each waiting path, seconds.
        self._since: dict[DeploymentKey, float] = {}
        # Agents with a robot in flight.
        self.out: set[str] = set()
        self._truth = {
            name: node.create_publisher(OccupancyGrid, f'truth/{name}', qos.LATCHED)
            for name in ('hazard', 'target')
            if values['publish_truth']
        }
        # Outcomes computed before their robots left, and departures that wait for their outcome.
        self._outcomes: dict[DeploymentKey, Traverse] = {}
        self._moving: set[DeploymentKey] = set()
        for key in record.orders:
            self._restore(key, record)
        self._publish_truth()
        # By agent that this node simulates: the callback for its outcomes.
        self.leave: dict[str, Callable[[DeploymentKey, Traverse], None]] = {}
        if not self.is_static:
            node.create_poll(self._leave_all)

    def _first_world(self) -> World:
        """Return the world before the first deployment, from a file or drawn."""
        values = self.node.values
        if file := values['world.file']:
            world = read_world(file, self.grid)
        else:
            world = World.random(
                self.grid,
                np.random.default_rng(self._seeds),
                values['world.hazard_density'],
                values['world.kappa'],
                values['world.target_background'],
            )
        duds = values['sensor.duds']
        return world.with_duds(duds, values['seed']) if duds else world

    def _publish_truth(self) -> None:
        for name, publisher in self._truth.items():
            truth = getattr(self._world, name)
            publisher.publish(occupancy_grid(self.grid, truth, self.node.now()))

    @property
    def awaited(self) -> str:
        """Return the agent whose path the next robot waits for; empty if there is none."""
        if not self._waiting or self.is_static:
            return ''
        first = min(self._waiting, key=deployment_order)
        if time.monotonic() > self._since[first] + PATIENCE:
            return ''
        place, robot = self.agents.index(first.agent), self._left[first.agent]
        settled = {*self.out, *(key.agent for key in self._waiting)}
        for number, other in enumerate(self.agents):
            if self._known[other] < robot + (number < place) and other not in settled:
                return other
        return ''

    def read_path(self, agent: str, message: Path) -> SentPath | None:
        """Return the deployment, cells and mission of a path; None if the path is known."""
        key, path = self.node.read_path(agent, message)
        mission = mission_of_path(message)
        check_mission(mission, self._missions[agent])
        known = self.paths.get(key)
        if known is not None and not np.array_equal(known, path):
            raise ValueError(f'deployment {key} already has another path: the first path counts')
        if known is not None:
            return None
        self.node.diagnostics.accepted += 1
        return key, path, mission

    def accept(self, sent: SentPath) -> DeploymentKey:
        """Accept a path that is durably recorded."""
        key, path, mission = sent
        check_mission(mission, self._missions[key.agent])
        self._missions[key.agent] = mission
        self.paths[key] = path
        return key

    def take(self, key: DeploymentKey) -> None:
        """Let a robot leave after all earlier robots that can change the field."""
        self._moving.add(key)
        if key not in self._outcomes:
            self._add_path(key, self.paths[key])
        self._leave_all()

    def _add_path(self, key: DeploymentKey, path: NDArray[np.intp]) -> None:
        if key not in self._waiting:
            self._known[key.agent] += 1
            self._waiting[key] = path
            self._since[key] = time.monotonic()

    def _leave_all(self) -> None:
        before = self._world
        self._traverse_all()
        if not np.array_equal(before.hazard, self._world.hazard):
            self._publish_truth()
        for key in sorted(self._moving & self._outcomes.keys(), key=deployment_order):
            self._moving.remove(key)
            made = self._outcomes.pop(key)
            if key.agent in self.leave:
                self.leave[key.agent](key, made)

    def _traverse_all(self) -> None:
        """Compute the outcomes of all robots that need not wait."""
        while self._waiting and not self.awaited:
            key = min(self._waiting, key=deployment_order)
            is_first = not any(self._left.values())
            path = self._waiting.pop(key)
            del self._since[key]
            # Number of the robot in deployment order, from 0.
            child = self._left[key.agent] * len(self.agents) + self.agents.index(key.agent)
            seeds = np.random.SeedSequence(self._seeds.entropy, spawn_key=(child,))
            made = self._execution.traverse(
                self._world,
                self.grid.at(int(path[0])),
                path,
                self._models[key.agent],
                np.random.default_rng(seeds),
                self._dynamics,
                changing=None if is_first else self.grid.may_be_hazardous,
                target_dynamics=self._target_dynamics,
            )
            self._left[key.agent] += 1
            self._world = made.world
            self._outcomes[key] = made

    def _restore(self, key: DeploymentKey, record: RecordedMission) -> None:
        """Restore a deployment that departed; with changing hazards, any that may depart."""
        # With `silent_loss` a robot that the planner gave up may still be on its way home.
        is_over = bool(record.said_by_agent.get(key))
        may_stay = self.is_static or key in record.operator.taken_back
        is_at_home = may_stay and not (is_over or record.has_departed(key))
        if record.is_refused(key) or is_at_home:
            return
        if self.is_static and is_over:
            self._known[key.agent] += 1
            self._left[key.agent] += 1
            return
        self._add_path(key, record.paths[key])
        self._traverse_all()


class SimulatedAgent(RecordedPaths[SentPath]):
    """An agent that simulates a robot for each of its paths, and reports the outcome."""

    def __init__(
        self,
        simulation: Simulation,
        name: str,
        record: RecordedMission,
    ) -> None:
        super().__init__(
            simulation.node, name, partial(simulation.read_path, name), self._take_path
        )
        self._simulation = simulation
        simulation.leave[name] = self._leave
        self.reports = self._publisher(DeploymentReport, 'report', qos.EVIDENCE)
        self._statuses = self._publisher(AgentStatus, 'status', qos.EVIDENCE)
        self._readings = self._publisher(Marker, 'readings', qos.LATCHED)
        self._healths = self._publisher(AgentHealth, 'health', qos.READINGS)
        self._node.create_poll(self._publish_health, AGAIN)
        own_grid = simulation.grid.at(own_base(self._node.values, name, simulation.grid))
        self._states = StatePublisher(self._node, own_grid, name)
        # Accepted deployments whose robots have not departed.
        self._at_home: list[DeploymentKey] = []
        # Whether the last robot has departed, and has not returned.
        self._is_away = False
        # Deployments with a departure on record.
        self._departed = {key for key in record.orders if record.has_departed(key)}
        self._hold = HoldSubscription(self._node, self._depart_all)
        self._node.create_poll(self._depart_all)
        if self._node.values['publish_pose']:
            self._poses = self._node.create_publisher(TFMessage, '/tf', qos.POSES)
        for key in record.orders:
            if key.agent == name and (said := record.said_by_agent.get(key)):
                # Do not start the robot a second time. What is said again is the same bytes.
                simulation.paths[key] = record.paths[key]
                self._publish_status(key, OrderState.DEPARTED)
                for data in said.values():
                    self.reports.publish(data)

    def _publisher(self, message_type: type, topic: str, profile: QoSProfile) -> Publisher:
        name = f'{self._node.above}/{self.agent}/{topic}'
        return self._node.create_publisher(message_type, name, profile)

    @property
    def pending(self) -> int:
        """Return the number of robots that have not departed."""
        return super().pending + len(self._at_home)

    @property
    def awaited(self) -> str:
        """Describe the condition that blocks departures; empty if there is none."""
        return self._why_held or super().awaited

    @property
    def _why_held(self) -> str:
        return (self._simulation.base_field.awaited or self._hold.awaited) if self._at_home else ''

    def publish_state(self, awaited: str) -> None:
        """Publish the state of the agent, and what a robot at its base waits for."""
        if self._is_away:
            self._states.publish(Readiness.OUT)
        elif awaited:
            self._states.publish(Readiness.WAITING, awaited, is_at_base=True)
        else:
            self._states.publish(Readiness.READY, is_at_base=True)

    def _publish_health(self) -> None:
        health = Health(self._node.now(), INSTALLED)
        self._healths.publish(health_message(self.agent, health))

    def _take_path(self, sent: SentPath) -> None:
        """Accept a path; start its robot unless new departures are held."""
        key = self._simulation.accept(sent)
        self._at_home.append(key)
        self._is_away = False
        self._publish_status(key, OrderState.ACCEPTED)
        if self._node.values['recorded']:
            departure = status_message(key, OrderState.DEPARTED, key.stamp)
            self.when_recorded(key.stamp, content_hash(departure), partial(self._move, key))
        self._depart_all()

    def _depart_all(self) -> None:
        """Refuse orders taken back; start robots, if held only those with a recorded departure."""
        for key in [key for key in self._at_home if key not in self._departed]:
            if reason := self._simulation.operator.refusal(key):
                self._at_home.remove(key)
                self._publish_status(key, OrderState.REFUSED, reason)
        is_held = bool(self._why_held)
        for key in [key for key in self._at_home if not is_held or key in self._departed]:
            self._depart(key)
            if not self._node.values['recorded']:
                self._move(key)

    def _depart(self, key: DeploymentKey) -> None:
        self._at_home.remove(key)
        self._is_away = True
        self._publish_status(key, OrderState.DEPARTED)

    def _move(self, key: DeploymentKey) -> None:
        if key in self._at_home:
            # The departure was recorded before this node restarted.
            self._depart(key)
        self._simulation.take(key)

    def _publish_status(self, key: DeploymentKey, state: OrderState, reason: str = '') -> None:
        """Publish the status of an order; after a restart the message is identical."""
        self._statuses.publish(status_message(key, state, key.stamp, reason))

    def _leave(self, key: DeploymentKey, made: Traverse) -> None:
        self._simulation.out.add(self.agent)
        period = value_for(self._node.values, 'step_period', self.agent)
        if period == 0.0:
            self._return(key, made.observation)
            return
        is_shown = self._node.values['publish_pose']
        walk = made.walk[: made.steps_made + 1].tolist() if is_shown else []
        shown = [partial(self._show, cell) for cell in walk]
        events = iter([*shown, partial(self._return, key, made.observation)])
        # rclpy passes over the timer after one that is destroyed as it fires, so that timers due
        # together run out of order: each takes the next event.
        for step in (*range(len(walk)), len(made.walk) - 1):
            self._after(period * step, lambda: next(events)())

    def _after(self, seconds: float, callback: Callable[[], None]) -> None:
        """Call back once after a delay, on the simulated clock if there is one."""

        def once() -> None:
            self._node.destroy_timer(timer)
            callback()

        is_simulated = self._node.get_parameter('use_sim_time').value
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        clock = self._node.get_clock() if is_simulated else steady
        timer = self._node.create_timer(seconds, once, clock=clock)

    def _show(self, cell: int) -> None:
        pose = pose_message(self._simulation.grid, self.agent, cell, self._node.now())
        self._poses.publish(pose)

    def _return(self, key: DeploymentKey, observation: Observation) -> None:
        """Report the outcome of a robot, except a loss with `silent_loss`."""
        self._simulation.out.discard(self.agent)
        if not observation.survived and self._node.values['silent_loss']:
            return
        stamp = self._node.now()
        self._is_away = False
        field_id = self._simulation.grid.id
        self.reports.publish(report_message(key, observation, stamp, field_id=field_id))
        if observation.survived:
            self._readings.publish(readings_marker(self._simulation.grid, observation, stamp))


class AgentNode(FieldNode):
    """Send a simulated robot along each path of one agent or all agents; report outcomes."""

    def __init__(self) -> None:
        super().__init__('agent')
        resume = self.values['resume']
        log = resumed_log(resume, self.roles) if resume else None
        rules = self.grid, self.values['max_steps'], make_robot_types(self.values, self.grid)
        record = read_resumed(log, *rules) if log else RecordedMission(*rules)
        self._simulation = simulation = Simulation(self, record)
        name, team = self.values['agent'], simulation.agents
        if name and name not in team:
            raise ValueError(
                f'parameter agent is {name}: it must be one of {", ".join(team)} (parameter '
                'agents), or empty for all of them'
            )
        played = [name] if name else team
        self._agents = [SimulatedAgent(simulation, name, record) for name in played]
        # Robots of other nodes change the field as well, unless hazards are static.
        others = () if simulation.is_static else set(team).difference(played)
        self._others = [
            RecordedPaths(
                self,
                other,
                partial(simulation.read_path, other),
                lambda sent: simulation.take(simulation.accept(sent)),
            )
            for other in sorted(others)
        ]
        self.create_poll(self._look)

    def _look(self) -> None:
        """Subscribe to paths once the reports have subscribers; publishers keep earlier paths."""
        if not self._agents[0].is_listening:
            missing = self.missing_listeners([agent.reports for agent in self._agents])
            if missing is not None:
                self.diagnostics.state = waiting_for(missing)
                for agent in self._agents:
                    agent.publish_state(missing)
                return
            for paths in (*self._agents, *self._others):
                paths.listen()
        differs = self._simulation.base_field.awaited
        agents = differs, *(agent.awaited for agent in (*self._agents, *self._others))
        awaited = [each for each in agents if each]
        if agent_awaited := self._simulation.awaited:
            awaited.append(
                f'the path of {agent_awaited} in the same round, for at most {PATIENCE} s: robots '
                'change the field in the order of their agents (parameters hazards.dynamics and '
                'targets.dynamics)'
            )
        for agent in self._agents:
            agent.publish_state(agent.awaited or differs)
        names = ', '.join(each.agent for each in self._agents)
        self.diagnostics.waiting = sum(agent.pending for agent in self._agents)
        self.diagnostics.state = waiting_for(awaited[0]) if awaited else f'taking paths of {names}'


main = partial(run, 'agent', AgentNode, linger=0.15)
