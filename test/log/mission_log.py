# SPDX-License-Identifier: Apache-2.0
"""Messages of a mission, made without running ROS, and logs of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from kbnitp_ros.core import (
    Belief,
    Clustering,
    DeploymentKey,
    Dynamics,
    Estimator,
    Grid,
    Lane,
    Learning,
    Ledger,
    RobotType,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    World,
)
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.core.decision.told import with_told
from kbnitp_ros.core.field.unknowns import STATIC
from kbnitp_ros.core.field.world import AS_ORDERED
from kbnitp_ros.core.planning.regions import without as without_cells
from kbnitp_ros.log.schema import qos_profiles_yaml
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import path_message, read_report, report_message
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import content_hash, from_stamp, NO_MISSION
from kbnitp_ros.messages.progress import Checked, decision_fields, decision_message, model_belief
from kbnitp_ros.messages.standings import standings_fields, standings_message
import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message

GRID = Grid(5, 4, base=2, resolution=0.1, origin=(-1.3, 0.7), blocked=(8, 9))
MODEL = SensorModel(0.6, malfunction=0.02)
MAX_STEPS = 8
KNOWN = Unknowns()

# 2026-11-20, in nanoseconds.
START = 1_795_132_800_000_000_000

QOS = QoSProfile(depth=7, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass
class Sent:
    topic: str
    message: Any
    time: int

    @property
    def type_name(self):
        kind = type(self.message)
        return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'

    @cached_property
    def data(self):
        """Return the serialized bytes; padding differs from call to call."""
        return serialize_message(self.message)


AUTHOR = '/estimator'

# Deployments from one check of the model to the next.
CHECK_EVERY = 2


@dataclass(eq=False)
class Mission:
    """Publishes like the nodes of a mission, into the list `sent`."""

    method: str = 'kappa_bnitp'
    namespace: str = ''
    grid: Grid = GRID
    unknowns: Unknowns = KNOWN
    method_seed: int = 0
    dynamics: Dynamics = STATIC
    clustering: Clustering | None = None
    target_dynamics: Dynamics = STATIC
    hazard: float = 0.3
    robot_types: Mapping[str, RobotType] = field(default_factory=dict)

    def __post_init__(self):
        self.sent = []
        self.prior = Belief.prior(self.grid, self.hazard, 0.4, 0.7)
        self.now = START
        self.start_estimator()

    def start_estimator(self):
        estimator = Estimator(
            self.prior,
            MODEL,
            self.method,
            self.unknowns,
            self.method_seed,
            dynamics=self.dynamics,
            clustering=self.clustering,
            target_dynamics=self.target_dynamics,
        )
        self.ledger = Ledger(self.grid, MAX_STEPS, estimator, self.robot_types)
        self.started = self.epoch = self.now
        self.events = 0
        self.publish_standings()
        self.publish_belief()

    def publish(self, topic, message):
        self.now += 1000
        self.sent.append(Sent(f'{self.namespace}/{topic}', message, self.now))

    def publish_standings(self):
        since, self.events = self.events, self.ledger.events
        changed = self.ledger.take_changed()
        fields = standings_fields(self.ledger, changed, self.now, AUTHOR, self.epoch, 7, since)
        self.publish('standings', standings_message(fields))

    def publish_belief(self):
        belief = belief_maps(self.ledger, self.started, NO_MISSION, AUTHOR, self.epoch)
        self.publish('belief', belief)
        stamp = from_stamp(belief.header.stamp)
        for name in ('hazard', 'target', 'kappa'):
            view = getattr(self.ledger.belief, name)
            self.publish(f'belief/{name}', occupancy_grid(self.grid, view, stamp))
        if self.unknowns.priors:
            held = len(self.ledger.deployments)
            if held % CHECK_EVERY == 0:
                self.checked = Checked(self.ledger.estimator.model_check, held, stamp)
            self.publish('model', model_belief(self.ledger, stamp, self.checked))

    def send_out(self, path, agent='scout_1'):
        """Send a robot on a path; return the deployment's key."""
        key = DeploymentKey(agent, self.now)
        self.publish(f'{agent}/path', path_message(self.grid, path, key.stamp))
        return key

    def come_back(self, key, observation):
        report = report_message(key, observation, self.now)
        self.publish(f'{key.agent}/report', report)
        return read_report(report)

    def assimilate(self, path, key, report):
        self.hear_path(key, path)
        assert self.hear_report(key, report)

    def hear_path(self, key, path):
        content = content_hash(path_message(self.grid, path, key.stamp))
        self.ledger.record_path(key, path, content)

    def hear_report(self, key, report):
        """Judge a report, and publish what changed; return whether the evidence did."""
        try:
            changed = self.ledger.record_report(key, report)
        except ValueError:
            changed = False
        if self.ledger.changed:
            self.publish_standings()
        if changed:
            self.publish_belief()
        return changed

    def deploy(self, observation, agent='scout_1', orders=None):
        """Deploy a robot and assimilate its report; by default its orders are its path."""
        orders = observation.path if orders is None else orders
        key = self.send_out(orders, agent)
        self.assimilate(orders, *self.come_back(key, observation))
        return key


class Deciding(Mission):
    """A mission whose planner decides after each belief."""

    def __init__(self, goal, no_go=(), **options):
        self.goal, self.no_go = goal, no_go
        super().__init__(**options)

    def publish_belief(self):
        super().publish_belief()
        held = len(self.ledger.deployments)
        stamp = from_stamp(on(self.sent, '/belief')[-1].message.header.stamp)
        estimator = self.ledger.estimator
        hazards = joint_hazards(estimator, held)
        grid = without_cells(GRID, self.no_go)
        decision = self.goal.decide(grid, hazards, estimator.model, MAX_STEPS)
        if decision.reached:
            decision = with_told(decision, estimator, held)
        evidence = AUTHOR, self.epoch, self.ledger.changes, self.no_go
        fields = decision_fields(GRID, decision, held, stamp, 0, cells(self.goal), *evidence)
        message = decision_message(fields)
        self.publish('decision', message)
        self.publish('decision/lane', message.path)


def cells(goal):
    return [goal.to] if isinstance(goal, Lane) else goal.cells


def observations(
    robots=8,
    seed=1,
    method='kappa_bnitp',
    grid=GRID,
    unknowns=KNOWN,
    method_seed=0,
    conduct=AS_ORDERED,
    dynamics=STATIC,
    clustering=None,
):
    rng = np.random.default_rng(seed)
    world = World.random(grid, rng, 0.2, 0.7, 0.2)
    return run_mission(
        grid,
        Belief.prior(grid, 0.3, 0.4, 0.7),
        MODEL,
        world,
        robots,
        rng,
        method,
        SearchOptions(max_steps=MAX_STEPS),
        truth=Truth(execution=conduct),
        learning=Learning(unknowns, method_seed, clustering),
        dynamics=dynamics,
    )


def mission(robots=8, seed=1, conduct=AS_ORDERED, **options):
    whole = Mission(**options)
    known = ('method', 'grid', 'unknowns', 'method_seed', 'dynamics', 'clustering')
    chosen = {name: options[name] for name in known if name in options}
    for deployment in observations(robots, seed, conduct=conduct, **chosen):
        whole.deploy(deployment.observation, orders=deployment.plan.path)
        assert whole.ledger.belief.joint.tobytes() == deployment.belief.joint.tobytes()
    return whole


def record(path, sent, qos=QOS):
    """Write messages to a finished log."""
    with LogWriter(path) as log:
        record_to(log, sent, qos)
    return path


def record_to(log, sent, qos=QOS, synced=False):
    """Write messages to a log, adding topics at their first message."""
    known = set()
    for message in sent:
        if message.topic not in known:
            known.add(message.topic)
            log.add_topic(message.topic, message.type_name, qos_profiles_yaml([qos]))
        log.write(message.topic, message.data, message.time + 500, message.time)
        if synced:
            log.sync()


def on(sent, *topics):
    return [message for message in sent if message.topic in topics]


def without(sent, *unwanted):
    return [message for message in sent if not any(message is one for one in unwanted)]


def instead(sent, old, message):
    return [replace(each, message=message) if each is old else each for each in sent]


def same(recorded, original):
    """Return whether a message decoded by some library has the values that were sent."""
    if hasattr(original, 'get_fields_and_field_types'):
        return all(
            same(getattr(recorded, name), getattr(original, name))
            for name in original.get_fields_and_field_types()
        )
    if isinstance(original, (str, bool, int)):
        return recorded == original
    if isinstance(original, bytes):
        return bytes([recorded] if isinstance(recorded, int) else recorded) == original
    if isinstance(original, float):
        return np.float64(recorded).tobytes() == np.float64(original).tobytes()
    if len(recorded) != len(original):
        return False
    if hasattr(original, 'typecode'):
        return np.array(list(recorded), original.typecode).tobytes() == original.tobytes()
    return all(map(same, recorded, original))
