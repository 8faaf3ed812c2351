# SPDX-License-Identifier: Apache-2.0
"""A deployment under way: the goals of Nav2, the walk, and the evidence of its steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import hypot
import time
from typing import Any, Protocol

from kbnitp_ros.core import Grid
from kbnitp_ros.files import waiting_for
from kbnitp_ros.messages.headers import SECOND
from kbnitp_ros.robot.journal import JournaledDeployment, Step
from kbnitp_ros.robot.track import Track
from kbnitp_ros.robot.way import Itinerary, MARGIN, shortest_way, Walk, without_loops
from kbnitp_ros.robot.whereabouts import NO_STEP, Place, Whereabouts

# Maximum number of detections kept until the place of the robot at their time is known.
MAX_UNREAD = 1000

# Seconds by which positions may be ahead of the clock by which detections are dated.
MAX_LEAD = 0.2

# Speed of a robot whose maximum speed is unknown, in cells per second.
USUAL_SPEED = 2.0


def distance_home(home: Sequence[float], place: Place) -> float:
    """Return the distance of a place from the home of a robot, in metres."""
    return hypot(place.x - home[0], place.y - home[1])


class Drive(Protocol):
    """The client of Nav2 that a trip needs; see `nodes/driver.py`."""

    name: str
    is_busy: bool
    failure: str
    was_cancelled: bool

    @property
    def awaited(self) -> str:
        """Describe the missing action server; empty if it is there."""

    def drive(self, start: tuple[float, float], leg: Sequence[int]) -> None:
        """Send the robot from its position along a leg."""

    def cancel(self) -> None:
        """Stop the robot where it is."""


class Trip:
    """A deployment under way."""

    def __init__(
        self,
        grid: Grid,
        home: Sequence[float],
        deployment: JournaledDeployment,
        path: Sequence[int],
        values: Mapping[str, Any],
        driver: Drive,
        record: Callable[[JournaledDeployment, int], object],
        warn: Callable[[str], object],
        max_speed: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.deployment = deployment
        # Whether the robot is back at its base, and whether a goal was sent.
        self.is_home = self.has_driven = False
        # Why the last goal failed; empty if it succeeded, or a cell was entered since.
        self.failure = ''
        self._grid = grid
        self._home = home
        self._values = values
        self._driver = driver
        # Records a step by its number.
        self._record = record
        self._warn = warn
        self._clock = clock
        kept: float = values['tf_timeout']
        self._walk = Walk(grid, deployment.cells[-1], kept)
        # Within this time the robot cannot leave its cell and return unnoticed.
        gap = min(kept, 2 * MARGIN * grid.resolution / max_speed) if max_speed else kept
        self._whereabouts = Whereabouts(round(kept * SECOND), round(gap * SECOND))
        speed = max_speed or USUAL_SPEED * grid.resolution
        rule = values['detections.needed'], values['detections.of']
        self._track = Track(grid, speed, len(deployment.steps), *rule)
        # Least time that a robot takes for a cell, nanoseconds.
        self._in_cell = round(grid.resolution / speed * SECOND)
        # Detections not assigned to a step yet: first and last possible time, and the result.
        self._unread: list[tuple[int, int, bool]] = []
        self._itinerary = Itinerary(grid, path, values['attempts'])
        # Whether a goal runs, or has ended and its end is not handled.
        self._is_driving = False
        # Time at which the end of the last goal was noticed, nanoseconds; 0 before.
        self._ended_at = 0
        self._stays_until: int | None = None
        self._try_again_at = 0.0
        # Time of the last pose, and how far it was ahead of the clock, nanoseconds.
        self._placed_at = self._ahead = 0

    @property
    def cell(self) -> int:
        """Return the cell of the robot."""
        return self._walk.cell

    def locate(self, place: Place, now: int) -> None:
        """Take a pose; raise ValueError if the robot cannot be there."""
        age = self._placed_at - place.odometry
        if 0 <= age < self._values['tf_timeout'] * SECOND:
            # No new pose. An older one is new only where the clock was set back.
            return
        self._placed_at, self._ahead = place.odometry, place.odometry - now
        self._track.add(place)
        try:
            entered = self._walk.follow(place.x, place.y, place.odometry / SECOND)
        except ValueError:
            self.lose(place.odometry)
            raise
        self._enter(entered, now)
        is_well_in = self._walk.sees_its_cell(place.x, place.y)
        step = len(self.deployment.steps) if is_well_in else NO_STEP
        self._whereabouts.note(place.odometry, step)
        self._count_readings()

    def lose(self, time_lost: int) -> None:
        """Note that the place of the robot is unknown: no detection counts."""
        self._whereabouts.note(time_lost, NO_STEP)

    def detect(self, since: int, until: int, seen: bool, *, is_stamped: bool) -> None:
        """Keep a detection until the place at its time is known; ValueError if it cannot be."""
        if not is_stamped and self._ahead > MAX_LEAD * SECOND:
            raise ValueError(
                f'the position is dated {self._ahead / SECOND:.1f} s ahead of this clock, so a '
                'detection without a stamp is of no known cell: set the clocks alike'
            )
        if not is_stamped:
            # The poses may arrive late, or their clock may be behind: the robot has to be in the
            # cell either way.
            since -= (lag := max(0, -self._ahead))
            if lag > self._in_cell:
                raise ValueError(
                    f'the position is dated {lag / SECOND:.1f} s behind this clock, longer than '
                    f'the robot may be in a cell ({self._in_cell / SECOND:.1f} s by max_speed): a '
                    'detection without a stamp is of no known cell: set the clocks alike, give '
                    'poses sooner, or stamp the detections'
                )
        self._unread = [*self._unread[-MAX_UNREAD:], (since, until, seen)]
        self._count_readings()

    def _count_readings(self) -> None:
        """Assign detections to the steps during which they were made."""
        unread, self._unread = self._unread, []
        for since, until, seen in unread:
            number = self._whereabouts.step_within(since, until)
            if number is None:
                self._unread.append((since, until, seen))
            elif number != NO_STEP:
                self._track.detect(number, since, until, seen)

    def _enter(self, cells: Sequence[int], now: int) -> None:
        """Make the steps into these cells; poses show the last one only."""
        # Poses lag behind the end of a goal; cells entered much later are no cells of it.
        is_own = self._is_driving and not 0 < self._ended_at < self._placed_at - SECOND
        for number, cell in enumerate(cells, 1):
            self._step(cell, now, is_own=is_own and number == len(cells))
            self._itinerary.enter(cell)
            self.failure = ''

    def _step(self, cell: int, now: int, *, is_own: bool) -> None:
        self.deployment.steps.append(Step(cell, now))
        self._track.enter(is_own=is_own)
        self._record(self.deployment, len(self.deployment.steps))

    def advance(self, place: Place | None, now: int, unplaced: str = '') -> str:
        """Take the next action; return the robot's state; `unplaced`: why it has no place."""
        itinerary = self._itinerary
        if not itinerary.heads_home and self._is_short_of_time(now):
            self._warn(
                f'going home, since the rest of {self._values["time_budget"]} s (parameter '
                'time_budget) is needed for the way back'
            )
            self._driver.cancel()
            self._end_goal(is_home=False)
            itinerary.go_home()
        goal = 'home' if itinerary.heads_home else f'to cell {itinerary.destination}'
        if self._driver.is_busy:
            return f'driving {goal}'
        if self._is_driving:
            self._ended_at = self._ended_at or now
        if place is None:
            if self._is_driving:
                # The robot may be carried until poses return.
                self._track.end_goal(is_home=False)
            return waiting_for(unplaced)
        if self._is_driving:
            # The position may lag behind the controller.
            is_behind = place.stamp < self._ended_at
            if is_behind and now < self._ended_at + self._values['tf_timeout'] * SECOND:
                return waiting_for(f'the position of the robot after driving {goal}')
            self._end_leg(place, now)
        self.is_home |= itinerary.heads_home and self._is_at_base(place)
        if self.is_home:
            return 'home'
        if itinerary.is_stay and self._walk.cell == itinerary.destination:
            return self._stay(now)
        if self._clock() < self._try_again_at:
            return waiting_for(f'the next try {goal} (parameter retry_delay)')
        if awaited := self._driver.awaited:
            return waiting_for(awaited)
        start = place.x, place.y
        self._driver.drive(start, itinerary.next_leg(self.deployment.cells))
        self._is_driving = self.has_driven = True
        return f'driving {goal}'

    def _is_short_of_time(self, now: int) -> bool:
        """Return whether the rest of the time budget is needed for the way back."""
        budget: float = self._values['time_budget']
        deployment = self.deployment
        spent = (now - deployment.departed) / SECOND
        steps_back = len(without_loops(reversed(deployment.cells))) - 1
        # Estimated from the pace of the steps so far.
        return 0 < budget <= spent + steps_back * spent / max(len(deployment.steps), 1)

    def _end_goal(self, *, is_home: bool) -> None:
        if self._is_driving:
            self._is_driving, self._ended_at = False, 0
            self._track.end_goal(is_home=is_home)

    def _end_leg(self, place: Place, now: int) -> None:
        """Handle the end of a goal of Nav2: start the next leg, a retry, or the way home."""
        itinerary = self._itinerary
        self.failure = self._driver.failure
        if not self.failure:
            try:
                self._arrive(place, now)
            except ValueError as error:
                self.failure = str(error)
        self._end_goal(is_home=not self.failure and self._is_at_base(place))
        was_homebound = itinerary.heads_home
        if not self.failure:
            itinerary.succeed()
            self.is_home = was_homebound
            return
        if self._driver.was_cancelled and not was_homebound:
            # Another client stopped the drive on purpose.
            itinerary.go_home()
        else:
            itinerary.fail()
        self._try_again_at = self._clock() + self._values['retry_delay']
        then = 'trying again' if itinerary.heads_home == was_homebound else 'going home'
        self._warn(f'{self.failure}; {then}')

    def _arrive(self, place: Place, now: int) -> None:
        """Settle at the end of a leg; raise ValueError if the robot is not there."""
        itinerary, name = self._itinerary, self._driver.name
        try:
            cell = self._walk.cell_at(place.x, place.y)
        except ValueError as error:
            raise ValueError(f'{name} reports that the goal is reached, but {error}') from error
        if cell != itinerary.destination:
            raise ValueError(
                f'{name} reports cell {itinerary.destination} as reached, but the robot is in '
                f'cell {cell}, at ({place.x:.2f}, {place.y:.2f}): set xy_goal_tolerance of Nav2 '
                'below half the side of a cell'
            )
        if itinerary.heads_home and not self._is_at_base(place):
            beside = (
                f'{name} reports home as reached, but the robot is '
                f'{distance_home(self._home, place):.2f} m away from it: set xy_goal_tolerance of '
                'Nav2 at most to the parameter arrival_tolerance'
            )
            if not itinerary.is_last_try:
                raise ValueError(beside)
            # A robot in the cell of its base has returned, and must not count as lost.
            self._warn(f'{beside}; reporting the return')
        self._enter(self._walk.settle(place.x, place.y), now)

    def _stay(self, now: int) -> str:
        """Stay in the cell for the parameter stay_time; return the state of the robot."""
        if self._stays_until is None:
            self._stays_until = now + int(self._values['stay_time'] * SECOND)
            self._step(self._walk.cell, now, is_own=True)
        elif now >= self._stays_until:
            self._stays_until = None
            self._itinerary.succeed()
        return f'staying in cell {self._walk.cell}'

    def _is_at_base(self, place: Place) -> bool:
        tolerance: float = self._values['arrival_tolerance']
        return distance_home(self._home, place) <= tolerance

    def come_home(self, now: int) -> str:
        """End the walk at the base; return why no step is vouched for, or an empty text."""
        for cell in shortest_way(self._grid, self._walk.cell, self._grid.base)[1:]:
            self._step(cell, now, is_own=False)
        self._track.judge(self.deployment.steps)
        return self._track.doubt
