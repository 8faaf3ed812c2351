# SPDX-License-Identifier: Apache-2.0
"""A robot whose true place is known, with odometry, localization and Nav2, on a fake clock."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace as Message
from typing import Any

from kbnitp_ros.core import Grid
from kbnitp_ros.messages.headers import SECOND
from kbnitp_ros.robot.journal import JournaledDeployment
from kbnitp_ros.robot.trip import Trip
from kbnitp_ros.robot.way import shortest_way
from kbnitp_ros.robot.whereabouts import Transforms
import numpy as np

# Seconds of a poll of the robot node, which is the step of the simulation; between updates of the
# localization; and between detections.
TICK, UPDATE, DETECTION = 0.05, 1.0, 0.1

# Distance from a point at which Nav2 goes on to the next, by driver, and from the last, in cells.
NEAR = {'follow_waypoints': 0.2, 'navigate_through_poses': 0.3, 'follow_path': 0.05}
GOAL = 0.2

VALUES = {
    'tf_timeout': 2.0,
    'arrival_tolerance': 0.5,
    'stay_time': 1.0,
    'attempts': 3,
    'time_budget': 0.0,
    'retry_delay': 2.0,
    'detections.needed': 1,
    'detections.of': 1,
}

# A deployment ends after this time, if the robot is not back.
PATIENCE = 400.0


@dataclass(frozen=True)
class Scenario:
    """Faults of a deployment; lengths in cells, times in seconds from the departure."""

    odometry: bool = True
    # Maximum speed that the robot is told, as a multiple of its speed; 0 for none.
    told_speed: float = 1.2
    rate: float = 5.0
    speed: float = 1.0
    # Size of corrections, at each update of the localization.
    correction: float = 0.02
    # Jumps of the localization: size, and time until it is back (never if None).
    jumps: tuple[tuple[float, float | None], ...] = ()
    # Jumps of odometry, which the localization repeats: size, and seconds until it is back by
    # itself (never if None), and until the localization corrects it (never if None).
    slips: tuple[tuple[float, float | None, float | None], ...] = ()
    # Share of poses that are off by some cells, alone.
    outliers: float = 0.0
    # Error of the localization at the departure, put right once.
    wrong: float = 0.0
    # Error that grows by this each second.
    drift: float = 0.0
    # Turn of the localization at its first jump, in radians.
    turn: float = 0.0
    # Seconds without transforms; at the departure if `is_early`.
    silence: float = 0.0
    is_early: bool = False
    # Whether the robot is carried home: poses go on, stop, or go on while its wheels turn.
    carried: str = ''
    # Seconds for which the node of the robot is gone.
    killed: float = 0.0
    # What Nav2 does with a goal: reject, abort, cancel, die, lie, or preempt.
    nav2: str = ''
    # Seconds by which the clock of the transforms is ahead.
    ahead: float = 0.0
    # White noise of each pose.
    noise: float = 0.0
    driver: str = ''
    robots: int = 1


class Nav2:
    """The client and server of Nav2: it drives where the localization says."""

    def __init__(self, robot: Robot, driver: str) -> None:
        self.name = f'/{driver}'
        self.is_busy = False
        self.failure = ''
        self.was_cancelled = False
        self.awaited = ''
        self.points: list[complex] = []
        # A failure of the next goals, and the number of goals that fail.
        self.wrong, self.times = '', 0
        self._robot = robot
        self._near = NEAR[driver]
        # Points of another client.
        self.others: list[complex] = []

    def drive(self, start: tuple[float, float], leg: Any) -> None:
        row, col = np.divmod(np.asarray(leg[1:] or leg), self._robot.grid.width)
        self.points = [complex(x, y) for x, y in zip(col + 0.5, row + 0.5)]
        self.is_busy, self.failure, self.was_cancelled = True, '', False
        if self.times:
            if self.wrong == 'reject':
                self._fail('rejected the goal')
            elif self.wrong == 'lie':
                self.times -= 1
                self.cancel()

    def cancel(self) -> None:
        self.points, self.is_busy = [], False

    def spoil(self) -> None:
        """Fail with the goal that is driven."""
        if self.is_busy and self.times and self.wrong in ('abort', 'cancel', 'die', 'preempt'):
            self.was_cancelled = self.wrong == 'cancel'
            if self.wrong == 'preempt':
                at = self._robot.seen
                self.others = [at + complex(*self._robot.rng.uniform(-2, 2, 2))]
            self._fail(f'the goal was {self.wrong}ed')

    def _fail(self, how: str) -> None:
        self.times -= 1
        self.points, self.is_busy, self.failure = [], False, f'the action server {how}'

    def steer(self, at: complex, reach: float) -> complex:
        """Return the move towards the next point from where the robot seems to be."""
        points = self.points or self.others
        while points and abs(points[0] - at) < (self._near if len(points) > 1 else GOAL):
            points.pop(0)
        if not points:
            if self.is_busy:
                self.is_busy = False
            return 0j
        way = points[0] - at
        return way * min(1.0, reach / abs(way))


def transform(parent: str, child: str, at: complex, turn: complex, stamp: int) -> Message:
    """Return a geometry_msgs/TransformStamped, from complex numbers in metres."""
    half = turn**0.5
    return Message(
        child_frame_id=child,
        header=Message(
            frame_id=parent,
            stamp=Message(sec=stamp // SECOND, nanosec=stamp % SECOND),
        ),
        transform=Message(
            translation=Message(x=at.real, y=at.imag, z=0.0),
            rotation=Message(x=0.0, y=0.0, z=half.imag, w=half.real),
        ),
    )


@dataclass
class Result:
    """Outcome of a deployment, beside the truth."""

    # The deployment, if the robot is back.
    deployment: JournaledDeployment | None = None
    # Whether the robot truly was in the cell of each step, between the entries around it.
    is_true: list[bool] = field(default_factory=list)
    is_ever: list[bool] = field(default_factory=list)
    # Whether the reading of each step is of its cell.
    is_read: list[bool] = field(default_factory=list)
    # Cells that the robot truly entered.
    entered: int = 0
    troubles: set[str] = field(default_factory=set)


class Robot:
    """A robot on one deployment."""

    def __init__(self, scenario: Scenario, seed: int, name: str = 'base_link') -> None:
        self.rng = rng = np.random.default_rng([seed, sum(map(ord, name))])
        self.scenario, self.name = scenario, name
        resolution = float(rng.choice([0.5, 1.0, 2.0]))
        self.grid = Grid(
            16, 16, base=int(rng.integers(5, 11) * 16 + rng.integers(5, 11)),
            resolution=resolution, origin=tuple(rng.uniform(-20, 20, 2)),
            yaw=rng.uniform(-np.pi, np.pi), connectivity=int(rng.choice([4, 8])),
        )  # fmt: skip
        self.targets = (np.arange(256) // 16 + np.arange(256) % 16) % 2 == 1
        self.deployment = JournaledDeployment(1, 1, self._path(), departed=1)
        self.nav2 = Nav2(self, scenario.driver or str(rng.choice(list(NEAR))))
        self.values = {**VALUES, 'arrival_tolerance': 0.5 * resolution}
        self.transforms = Transforms('map', name)
        self.result = Result()
        self.time = 1000.0
        row, col = divmod(self.grid.base, 16)
        home = complex(col + 0.5, row + 0.5)
        # True position; error of the localization; position by odometry, and the true pose of
        # its frame; the pose that the localization gives to it. In cells.
        self.home = home
        self.error = scenario.wrong * self._direction()
        self.at = home - self.error
        self.odometry = 0j
        self.frame_turn = np.exp(1j * rng.uniform(-np.pi, np.pi))
        self.turned = 1 + 0j
        self.seen = home
        self._update()
        self.events = self._plan()
        self.is_silent = self.is_dead = self.is_carried = False
        self.trip: Trip | None = None
        self.truth: list[tuple[float, int]] = []
        # Times of entries.
        self.entries: list[float] = []
        self._next_pose = self.time + rng.uniform(0, 1 / scenario.rate)
        self._next_update = self.time + rng.uniform(0, UPDATE)
        self._next_detection = self.time
        self._place = None
        self._begin()

    def _path(self) -> tuple[int, ...]:
        """Return a path of 12 to 18 steps from the base to the base."""
        rng, grid = self.rng, self.grid
        steps, path = int(rng.integers(12, 19)), [grid.base]
        heading = int(rng.integers(1, 8))
        while len(path) + len(shortest_way(grid, path[-1], grid.base)) - 1 < steps:
            # A robot seldom turns, and seldom stays.
            ways = [cell for cell in grid.neighbors(path[-1]).tolist() if cell != path[-1]]
            if rng.random() < 0.4 or path[-1] + heading not in ways:
                heading = int(rng.choice(ways)) - path[-1]
            path.append(path[-1] + heading)
        if rng.random() < 0.2:
            path.append(path[-1])
        return (*path, *shortest_way(grid, path[-1], grid.base)[1:])

    def _direction(self) -> complex:
        return complex(np.exp(2j * np.pi * self.rng.random()))

    def _plan(self) -> list[tuple[float, Any]]:
        """Return events with their times."""
        scenario, rng = self.scenario, self.rng
        length = len(self.deployment.path) / scenario.speed
        events: list[tuple[float, Any]] = []

        def at(share: float, *doing: Any) -> None:
            events.append((self.time + share * length, doing))

        for number, (size, back) in enumerate(scenario.jumps):
            begin = rng.uniform(0.1, 0.8) if len(scenario.jumps) == 1 else (
                rng.uniform(0.1, 0.35) + 0.35 * number
            )  # fmt: skip
            jump = size * self._direction()
            at(begin, 'jump', jump, scenario.turn)
            if back is not None:
                at(begin + back / length, 'jump', -jump, -scenario.turn)
        for size, back, corrected in scenario.slips:
            begin, slip = rng.uniform(0.1, 0.8), size * self._direction()
            at(begin, 'slip', slip)
            if back is not None:
                at(begin + back / length, 'slip', -slip)
            if corrected is not None:
                at(begin + corrected / length, 'jump', -slip, 0.0)
        if scenario.wrong:
            at(rng.uniform(0.2, 0.8), 'jump', -self.error, 0.0)
        if scenario.silence:
            begin = 0.02 if scenario.is_early else rng.uniform(0.1, 0.7)
            at(begin, 'silent', True)
            at(begin + scenario.silence / length, 'silent', False)
        if scenario.carried:
            at(rng.uniform(0.2, 0.6), 'carry')
        if scenario.killed:
            begin = rng.uniform(0.1, 0.7)
            at(begin, 'kill')
            at(begin + scenario.killed / length, 'restart')
        if scenario.nav2:
            self.nav2.wrong = scenario.nav2
            times = int(rng.integers(1, 6))
            for _ in range(3):
                at(rng.uniform(0.0, 0.9), 'spoil', times)
        return sorted(events, key=lambda event: event[0])

    def _do(self, what: str, *told: Any) -> None:
        if what == 'jump':
            self.error += told[0]
            self.turned *= np.exp(1j * told[1])
            self._update()
        elif what == 'slip':
            # In the map; the localization adds the move of odometry to its place.
            self.odometry += told[0] / self.map_turn
            self.error += told[0]
        elif what == 'silent':
            self.is_silent = told[0]
        elif what == 'carry':
            self.is_carried = True
            self.is_silent = self.scenario.carried == 'silent'
            if self.scenario.carried != 'wheels':
                self.nav2.wrong, self.nav2.times = 'cancel', 1
                self.nav2.spoil()
                self.nav2.wrong, self.nav2.times = 'reject', 10**6
        elif what == 'kill':
            self.trip = None
            if self.rng.random() < 0.5:
                self.nav2.cancel()
        elif what == 'restart':
            self.nav2.others, self.nav2.points = self.nav2.points, []
            self.nav2.is_busy = False
            self._begin(())
        else:
            self.nav2.times = told[0]
            self.nav2.spoil()

    def _begin(self, path: tuple[int, ...] | None = None) -> None:
        """Start the trip, as the node does."""
        scenario = self.scenario
        speed = scenario.told_speed * scenario.speed * self.grid.resolution
        self.trip = Trip(
            self.grid, self.grid.centers([self.grid.base])[0], self.deployment,
            self.deployment.path if path is None else path, self.values, self.nav2,
            lambda *_: None, lambda *_: None, speed, lambda: self.time,
        )  # fmt: skip

    @property
    def now(self) -> int:
        return round(self.time * SECOND)

    def _update(self) -> None:
        """Correct odometry by the localization."""
        noise = self.scenario.correction / 2 * complex(*self.rng.normal(size=2))
        self.map_turn = self.frame_turn * self.turned
        self.map_shift = self.at + self.error + noise - self.map_turn * self.odometry

    def tick(self) -> None:
        """Go on by a tick."""
        scenario, rng = self.scenario, self.rng
        self.time += TICK
        while self.events and self.events[0][0] <= self.time:
            self._do(*self.events.pop(0)[1])
        reach = scenario.speed * TICK
        move = self.nav2.steer(self.seen, reach)
        # Odometry turns, and errs by a hundredth.
        self.odometry += move / self.map_turn * (1 + 0.01 * rng.normal())
        self.frame_turn *= np.exp(0.01j * rng.normal() * abs(move))
        if self.is_carried:
            way = self.home - self.at
            self.at += way * min(1.0, reach / max(abs(way), 1e-9))
            if abs(way) < 0.1:
                self.is_carried = self.is_silent = False
                self.nav2.times = 0
        else:
            self.at += move / self.map_turn * self.frame_turn
        self.error += scenario.drift * TICK * np.exp(1j * self.time / 50)
        if self.time >= self._next_update:
            self._next_update += UPDATE
            self._update()
        self.seen = self.map_shift + self.map_turn * self.odometry
        col, row = int(np.floor(self.at.real)), int(np.floor(self.at.imag))
        self.cell = row * 16 + col if 0 <= row < 16 and 0 <= col < 16 else -1
        if not self.truth or self.truth[-1][1] != self.cell:
            self.truth.append((self.time, self.cell))

    def poses(self) -> list[Message]:
        """Return the transforms of this tick."""
        scenario, grid = self.scenario, self.grid
        if self.time < self._next_pose or self.is_silent:
            self._next_pose = max(self._next_pose, self.time - 1)
            return []
        self._next_pose += 1 / scenario.rate
        stamp = self.now + round(scenario.ahead * SECOND)
        noise = scenario.noise * complex(*self.rng.normal(size=2))
        slip = 0j
        if scenario.outliers and self.rng.random() < scenario.outliers:
            slip = self.rng.uniform(1.0, 4.0) * self._direction()

        def in_map(at: complex) -> complex:
            return complex(*grid.in_metres([at.real, at.imag]))

        if not scenario.odometry:
            return [transform('map', self.name, in_map(self.seen + noise + slip), 1 + 0j, stamp)]
        turn, odom = self.map_turn * np.exp(1j * grid.yaw), f'{self.name}/odom'
        at = (self.odometry + slip / self.map_turn) * grid.resolution
        return [
            transform('map', odom, in_map(self.map_shift + noise), turn, stamp),
            transform(odom, self.name, at, 1 + 0j, stamp),
        ]

    def look(self) -> None:
        """Do what the robot node does at a poll."""
        trip = self.trip
        if trip is None or self.result.deployment:
            return
        now = self.now
        try:
            place = self._place = self.transforms.place(now, self.values['tf_timeout'])
        except ValueError as error:
            self._place = None
            trip.lose(now)
            self.result.troubles.add(str(error))
        else:
            try:
                trip.locate(place, now)
            except ValueError as error:
                self.result.troubles.add(str(error))
        if self.time >= self._next_detection:
            self._next_detection = self.time + DETECTION
            seen = self.cell >= 0 and bool(self.targets[self.cell])
            try:
                trip.detect(now, now, seen, is_stamped=False)
            except ValueError as error:
                self.result.troubles.add(str(error))
        trip.advance(self._place, now, 'the position')
        new = len(self.deployment.steps) - len(self.entries)
        self.entries += [self.time] * new
        if trip.is_home:
            if doubt := trip.come_home(now):
                self.result.troubles.add(doubt)
            self.entries += [self.time] * (len(self.deployment.steps) - len(self.entries))
            self._judge()

    def _judge(self) -> None:
        """Compare the evidence with the truth."""
        result, steps, entries = self.result, self.deployment.steps, np.array(self.entries)
        result.deployment = self.deployment
        result.entered = len(self.truth) - 1
        begins = np.array([begin for begin, _ in self.truth])
        ends = np.append(begins[1:], self.time)
        cells = np.array([cell for _, cell in self.truth])
        # Poses arrive a moment late.
        late = 2 * TICK
        for step, time in zip(steps, self.entries):
            before, after = entries[entries < time], entries[entries > time]
            since = before[-1] - late if before.size else 0.0
            until = after[0] if after.size else self.time
            is_there = (cells == step.cell) & (begins <= until) & (ends >= since)
            result.is_true.append(bool(is_there.any()))
            result.is_ever.append(step.cell in cells)
            result.is_read.append(step.reading in (-1, self.targets[step.cell]))


def run(scenario: Scenario, seed: int) -> list[Result]:
    """Return the results of a deployment of each robot."""
    names = [f'base_{number}' for number in range(scenario.robots)]
    robots = [Robot(replace(scenario), seed, name) for name in names]
    end = robots[0].time + PATIENCE
    while robots[0].time < end and not all(robot.result.deployment for robot in robots):
        for robot in robots:
            robot.tick()
        message = Message(transforms=[pose for robot in robots for pose in robot.poses()])
        for robot in robots:
            robot.transforms.take(message, static=False)
            robot.look()
    return [robot.result for robot in robots]
