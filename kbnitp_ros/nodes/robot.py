# SPDX-License-Identifier: Apache-2.0
"""The node of a real robot: drives it by Nav2, and reports from its journal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import hypot
import os
from pathlib import Path
import time
from typing import Any

from kbnitp_msgs.msg import AgentStatus, DeploymentReport
from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.agents import own_base
from kbnitp_ros.configuration.field import make_datum
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.core.inference.record import MAX_WALK
from kbnitp_ros.files import in_words
from kbnitp_ros.messages.deployments import OrderState, report_message, status_message
from kbnitp_ros.messages.headers import FRAME, SECOND
from kbnitp_ros.messages.markers import readings_marker
from kbnitp_ros.nodes.driver import addresses, detection_class, Driver, read_detection
from kbnitp_ros.nodes.presence import HoldSubscription
from kbnitp_ros.nodes.recorded_paths import PendingPaths
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import waiting_for
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.runtime.process import run
from kbnitp_ros.robot.journal import Deployment, Journal, Step
from kbnitp_ros.robot.way import Itinerary, MARGIN, shortest_way, Walk, without_loops
from kbnitp_ros.robot.whereabouts import Fixes, NO_STEP, Place, Transforms, Whereabouts
from sensor_msgs.msg import NavSatFix
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

# Maximum number of detections kept until the place of the robot at their time is known.
MAX_UNREAD = 1000

# Exit code of a node that must be restarted, since DDS does not use new network links.
NEW_LINKS = os.EX_TEMPFAIL


class RobotNode(FieldNode):
    """Send one real robot along each path of its agent, by Nav2, and report the outcome."""

    @property
    def grid(self) -> Grid:
        """Return the field, with the base of this robot."""
        field = super().grid
        return field.at(own_base(self.values, self.values['agent'], field))

    def __init__(self) -> None:
        # Network addresses at the start: DDS ignores later ones. A node that starts without a link
        # stays unreachable when a link comes up, and a node whose address changes is not found at
        # the new address.
        self._addresses = addresses()
        super().__init__('robot')
        values = self.values
        self._agent: str = values['agent']
        prefix = f'{self.above}/{self._agent}/'
        detections = detection_class(values['detection_type'])
        home = Path(os.environ.get('ROS_HOME', '~/.ros'), 'kbnitp_ros')
        journal = values['journal'] or home / f'{self._agent}.journal'
        self._journal = Journal(journal, self._agent, self.grid)
        self._reports = self.create_publisher(DeploymentReport, f'{prefix}report', qos.EVIDENCE)
        self._statuses = self.create_publisher(AgentStatus, f'{prefix}status', qos.EVIDENCE)
        self._readings = self.create_publisher(Marker, f'{prefix}readings', qos.LATCHED)
        self._hold = HoldSubscription(self)
        self._pending = PendingPaths(self, self._agent, self._journal, self._accept, self._refuse)
        self._driver = Driver(
            self, values['driver'], values['nav_namespace'], self.grid, values['server_timeout']
        )
        # The topic of the robot's pose, and its reader.
        self._source = {'tf': '/tf', 'fix': 'fix'}[values['position']]
        self._whereis: Transforms | Fixes
        datum, frame = make_datum(values), values['base_frame']
        if values['position'] == 'tf':
            self._whereis = Transforms(FRAME, frame)
        elif datum is not None:
            self._whereis = Fixes(datum.in_map, frame, self.grid.resolution / 2)
        else:
            raise ValueError(
                "parameter position is 'fix', and datum is empty: set datum to the geographic "
                'origin and heading of the frame map'
            )
        # Current place of the robot; None if it is unknown.
        self._place: Place | None = None
        # Current problems by subject; empty texts for solved ones.
        self._troubles = {self._source: 'nothing was received yet'}
        self._is_driving = False
        # Whether the robot waits for its reported departure to be on record.
        self._is_at_gate = False
        # Time at which the end of the last goal was noticed, nanoseconds; 0 before.
        self._ended_at = 0
        self._stays_until: int | None = None
        self._try_again_at = 0.0
        # Time of the last poll by the system clock and by ROS, nanoseconds.
        self._looked = 0, 0
        self._resume()
        if not self._addresses:
            self.get_logger().warning(
                'this computer has no network link but lo, so no other computer can reach this '
                f'robot. Once there is a link, this node ends with exit code {NEW_LINKS} and must '
                'be started again'
            )
        self._subscribe_to_places()
        self.subscribe(
            detections,
            'detections',
            self._on_detection,
            qos.READINGS,
            is_timed=True,
            keeps_all=False,
        )
        self.create_poll(self._look)

    def _subscribe_to_places(self) -> None:
        if isinstance(self._whereis, Fixes):
            take = partial(self._take_place, self._whereis.take)
            self.subscribe(NavSatFix, 'fix', take, qos.READINGS, keeps_all=False)
            return
        for topic, profile, is_static in (
            ('/tf', qos.POSES, False),
            ('/tf_static', qos.LATCHED_POSES, True),
        ):
            take = partial(self._take_place, partial(self._whereis.take, static=is_static))
            self.subscribe(TFMessage, topic, take, profile, keeps_all=False)

    def _resume(self) -> None:
        """Resume from the journal: publish its statuses and reports, and send the robot home."""
        if self._journal.corruption:
            self.get_logger().warning(self._journal.corruption)
            self.diagnostics.values['journal'] = self._journal.corruption
        for stamp, (time_refused, reason) in self._journal.refusals.items():
            self._publish_status(stamp, OrderState.REFUSED, time_refused, reason)
        for deployment in self._journal.deployments:
            self._publish_status(deployment.stamp, OrderState.DEPARTED, deployment.departed)
            if deployment.is_home:
                self._report(deployment)
        self._deployment: Deployment | None = None
        if under_way := self._journal.under_way:
            self._set_out(under_way, ())
            self.get_logger().warning(
                f'deployment {self._key(under_way)} was interrupted when the robot was switched '
                f'off in cell {self._walk.cell}: it goes home'
            )

    def _set_out(self, deployment: Deployment, path: Sequence[int]) -> None:
        self._deployment = deployment
        self._walk = Walk(
            self.grid, deployment.cells[-1], self.values['tf_timeout'], self.values['max_speed']
        )
        kept, speed = self.values['tf_timeout'], self.values['max_speed']
        # Within this time the robot cannot leave its cell and return unnoticed.
        gap = min(kept, 2 * MARGIN * self.grid.resolution / speed) if speed else kept
        self._whereabouts = Whereabouts(round(kept * SECOND), round(gap * SECOND))
        # Detections not assigned to a step yet: first and last possible time, and the result.
        self._unread: list[tuple[int, int, bool]] = []
        self._itinerary = Itinerary(self.grid, path, self.values['attempts'])
        self._is_driving, self._ended_at = False, 0
        self._stays_until, self._try_again_at = None, 0.0

    def _key(self, deployment: Deployment) -> DeploymentKey:
        return DeploymentKey(self._agent, deployment.stamp)

    def _publish_status(
        self, stamp: int, state: OrderState, time_said: int, reason: str = ''
    ) -> None:
        """Publish the status of an order."""
        key = DeploymentKey(self._agent, stamp)
        self._statuses.publish(status_message(key, state, time_said, reason))

    def _accept(self, deployment: Deployment) -> None:
        self._publish_status(deployment.stamp, OrderState.ACCEPTED, self.now())

    def _take_place(self, take: Callable[[Any], None], message: TFMessage | NavSatFix) -> None:
        try:
            take(message)
        except ValueError as error:
            self.diagnostics.refuse(self._source, error)

    def _locate(self) -> None:
        """Localize the robot and, if it is out, record the cells it has entered."""
        try:
            self._place = self._whereis.place(self.now(), self.values['tf_timeout'])
        except ValueError as error:
            self._place = None
            self._lose(self.now(), error)
            return
        entered: list[int] = []
        if self._deployment is not None:
            try:
                entered = self._walk.follow(self._place.x, self._place.y, self.now() / SECOND)
            except ValueError as error:
                self._lose(self._place.odometry, error)
                return
        self._publish_trouble(self._source, '')
        self._enter(entered)
        if self._deployment is not None:
            if self._walk.doubt and not self._deployment.is_doubted:
                self._doubt(self._deployment, self._walk.doubt)
            is_well_in = self._walk.sees_its_cell(self._place.x, self._place.y)
            step = len(self._deployment.steps) if is_well_in else 0
            self._whereabouts.note(self._place.odometry, step)
            self._count_readings(self._deployment)

    def _lose(self, time_lost: int, error: ValueError) -> None:
        """Discard detections while the robot's place is unknown, and publish the reason."""
        if self._deployment is not None:
            self._whereabouts.note(time_lost, NO_STEP)
        self._publish_trouble(self._source, str(error))

    def _enter(self, cells: Sequence[int]) -> None:
        for cell in cells:
            self._step(cell)
            self._itinerary.enter(cell)

    def _step(self, cell: int) -> None:
        """Record a step of the walk, in memory and in the journal."""
        assert self._deployment is not None
        self._deployment.steps.append(Step(cell, self.now()))
        self._keep(partial(self._journal.step, self._deployment, len(self._deployment.steps)))

    def _doubt(self, deployment: Deployment, why: str) -> None:
        """Stop recording readings: the robot's cell is uncertain."""
        warning = (
            f'{self._key(deployment)}: the position of the robot is uncertain, so later readings '
            f'do not count: {why}'
        )
        self.get_logger().warning(warning)
        self.diagnostics.values['doubt'] = warning
        self._keep(partial(self._journal.doubt, deployment, self.now()))

    def _keep(self, write: Callable[[], None]) -> bool:
        """Write to the disk; on failure report it, and keep the record in memory."""
        try:
            write()
        except OSError as error:
            self._publish_trouble(
                'journal', f'{in_words(error)}; further records are kept in memory'
            )
            return False
        self._publish_trouble('journal', '')
        return True

    def _publish_trouble(self, about: str, trouble: str) -> None:
        """Publish a problem; an empty text clears it."""
        if trouble and not self._troubles.get(about):
            self.get_logger().warning(f'{about}: {trouble}')
        elif not trouble and self._troubles.get(about):
            self.get_logger().info(f'{about}: the problem is over')
        self._troubles[about] = trouble
        self.diagnostics.warning = '; '.join(filter(None, self._troubles.values()))

    def _on_detection(self, message: object, published: int) -> None:
        """Keep a detection until the robot's place at its time is known."""
        try:
            seen, stamp = read_detection(message, self.values)
            since, until = self._detection_time(stamp, published)
        except ValueError as error:
            self.diagnostics.refuse('detections', error)
            return
        if self._deployment is not None and not self._deployment.is_doubted:
            self._unread = [*self._unread[-MAX_UNREAD:], (since, until, seen)]
        self._locate()

    def _detection_time(self, stamp: int | None, published: int) -> tuple[int, int]:
        """Return the interval of ROS time in which a detection was made, in nanoseconds."""
        looked_at, looked = self._looked
        if stamp is None and self.get_parameter('use_sim_time').value:
            # Simulated time has no publication time, so the interval starts at the last poll.
            return (looked if published >= looked_at else 0), self.now()
        what = 'it was published' if stamp is None else 'header.stamp is'
        made = published if stamp is None else stamp
        age = (self.now() - made) / SECOND
        if abs(age) > self.values['tf_timeout']:
            raise ValueError(
                f'{what} {age:.1f} s ago: at most {self.values["tf_timeout"]} s are allowed '
                '(parameter tf_timeout)'
            )
        return made, made

    def _count_readings(self, deployment: Deployment) -> None:
        """Assign detections to the steps during which they were made."""
        # Detections that may be of another cell are discarded.
        unread, self._unread = self._unread, []
        for since, until, seen in unread:
            number = self._whereabouts.step_within(since, until)
            if number is None:
                self._unread.append((since, until, seen))
            elif number != NO_STEP and not deployment.is_doubted:
                step = deployment.steps[number - 1]
                # The reading of a step is positive if any of its detections is positive.
                if step.reading < seen:
                    step.reading = int(seen)
                    self._keep(partial(self._journal.step, deployment, number))

    def _look(self) -> None:
        self._looked = time.time_ns(), self.now()
        self._locate()
        self._keep(self._journal.write)
        self._driver.look()
        is_home = self._deployment is None or self._is_at_gate
        if is_home and (new := addresses().items() - self._addresses.items()):
            news = ', '.join(f'{name} has {address}' for name, address in sorted(new))
            self._publish_trouble(
                'links',
                f'{news}, which DDS does not use yet: ending with exit code {NEW_LINKS}, to be '
                'restarted',
            )
            self.end(NEW_LINKS)
            return
        self.diagnostics.waiting = self._pending.pending
        self.diagnostics.state = (
            self._wait() if self._deployment is None else self._go_on(self._deployment)
        )

    def _wait(self) -> str:
        """Start the next deployment unless a condition blocks it; return the robot's state."""
        if not self._pending.is_listening:
            if missing := self.missing_listeners([self._reports]):
                return waiting_for(missing)
            self._pending.listen()
        if awaited := self._pending.awaited:
            return waiting_for(awaited)
        if (deployment := self._pending.newest) is None:
            return f'taking paths of {self._agent}'
        if not self._keep(partial(self._journal.begin, deployment.mission)):
            return self._no_room
        for superseded in self._pending.superseded():
            if not self._refuse(
                superseded, f'the newer path {self._key(deployment)} came before the robot left'
            ):
                return self._no_room
            self._pending.close(superseded)
        if awaited := self._hold.awaited or self._not_ready():
            return waiting_for(awaited)
        if not self._depart(deployment):
            return self._no_room
        return self._go_on(deployment)

    def _refuse(self, deployment: Deployment, reason: str) -> bool:
        """Refuse a path for good; return whether the refusal is in the journal."""
        stamp, now = deployment.stamp, self.now()
        if not self._keep(partial(self._journal.refuse, stamp, now, reason)):
            return False
        self._publish_status(stamp, OrderState.REFUSED, now, reason)
        self.get_logger().warning(f'deployment {self._key(deployment)} is refused: {reason}')
        return True

    def _depart(self, deployment: Deployment) -> bool:
        """Record the departure in the journal and report it; return False if recording fails."""
        deployment.departed = self.now()
        if not self._keep(partial(self._journal.depart, deployment)):
            return False
        self._pending.close(deployment)
        self._set_out(deployment, deployment.path)
        self._is_at_gate = True
        departure = status_message(self._key(deployment), OrderState.DEPARTED, deployment.departed)
        self._pending.when_recorded(departure, partial(self._leave, deployment))
        self._statuses.publish(departure)
        return True

    def _leave(self, deployment: Deployment) -> None:
        """Start the drive, unless a pause has ended the deployment."""
        if self._deployment is deployment:
            self._is_at_gate = False
            steps = len(deployment.path) - 1
            self.get_logger().info(f'leaving on {self._key(deployment)}: {steps} steps')

    @property
    def _no_room(self) -> str:
        return waiting_for(f'room on the disk: {self._troubles["journal"]}')

    @property
    def _unplaced(self) -> str:
        """Return the reason why the robot's place is unknown."""
        name = 'TF' if self._source == '/tf' else 'a fix'
        return f'{name}: {self._troubles[self._source]}'

    def _not_ready(self) -> str:
        """Describe the condition that blocks the departure; empty if there is none."""
        if self.now() <= 0:
            return 'the clock to start'
        if self._place is None:
            return self._unplaced
        away, tolerance = self._distance(self._place), self.values['arrival_tolerance']
        if away > tolerance:
            return (
                f'the robot to be at its base, cell {self.grid.base}: it is {away:.1f} m from the '
                f'middle, at most {tolerance} m are allowed (parameter arrival_tolerance)'
            )
        return self._driver.not_ready((self._place.x, self._place.y), self.now())

    def _go_on(self, deployment: Deployment) -> str:
        """Take the next action of the deployment; return the robot's state."""
        if self._is_at_gate:
            return self._wait_at_gate(deployment)
        itinerary = self._itinerary
        budget: float = self.values['time_budget']
        spent = (self.now() - deployment.departed) / SECOND
        steps_back = len(without_loops(reversed(deployment.cells))) - 1
        # Estimated from the pace of the steps so far.
        way_back = steps_back * spent / max(len(deployment.steps), 1)
        if not itinerary.heads_home and 0 < budget <= spent + way_back:
            self.get_logger().warning(
                f'{self._key(deployment)}: going home, since the rest of {budget} s (parameter '
                'time_budget) is needed for the way back'
            )
            self._driver.cancel()
            self._is_driving = False
            itinerary.go_home()
        goal = 'home' if itinerary.heads_home else f'to cell {itinerary.destination}'
        if self._driver.is_busy:
            return f'driving {goal}'
        if self._place is None:
            return waiting_for(self._unplaced)
        if self._is_driving:
            # The position may lag behind the controller.
            self._ended_at = self._ended_at or self.now()
            is_behind = self._place.stamp < self._ended_at
            if is_behind and self.now() < self._ended_at + self.values['tf_timeout'] * SECOND:
                return waiting_for(f'the position of the robot after driving {goal}')
            self._is_driving, self._ended_at = False, 0
            self._end_leg(self._place)
        tolerance = self.values['arrival_tolerance']
        if itinerary.heads_home and self._distance(self._place) <= tolerance:
            self._come_home(deployment)
            return f'home from {self._key(deployment)}'
        if itinerary.is_stay and self._walk.cell == itinerary.destination:
            return self._stay()
        if time.monotonic() < self._try_again_at:
            return waiting_for(f'the next try {goal} (parameter retry_delay)')
        if awaited := self._driver.awaited:
            return waiting_for(awaited)
        start = self._place.x, self._place.y
        self._driver.drive(start, itinerary.next_leg(deployment.cells), self.now())
        self._is_driving = True
        return f'driving {goal}'

    def _wait_at_gate(self, deployment: Deployment) -> str:
        """Wait until the departure is on record; a pause ends the deployment."""
        if self._hold.is_held:
            self.get_logger().warning(
                f'{self._key(deployment)}: the operator paused the mission before its departure '
                'was on disk; it stays at the base'
            )
            self._is_at_gate = False
            self._come_home(deployment)
            return f'home from {self._key(deployment)}'
        return waiting_for(
            f'the recorder to acknowledge the departure of {self._key(deployment)} on '
            f'{self._agent}/recorded (parameter recorded)'
        )

    def _end_leg(self, place: Place) -> None:
        """Handle the end of a goal of Nav2: start the next leg, a retry, or the way home."""
        itinerary, failure = self._itinerary, self._driver.failure
        if not failure:
            try:
                cell = self._walk.cell_at(place.x, place.y)
            except ValueError as error:
                failure = f'{self._driver.name} reports that the goal is reached, but {error}'
            else:
                is_there = cell == itinerary.destination
                if itinerary.heads_home:
                    is_there &= self._distance(place) <= self.values['arrival_tolerance']
                if is_there:
                    self._enter(self._walk.settle(place.x, place.y))
                else:
                    failure = (
                        f'{self._driver.name} reports cell {itinerary.destination} as reached, '
                        f'but the robot is in cell {cell}, at ({place.x:.2f}, {place.y:.2f}): '
                        'set the goal tolerance of Nav2 below half the side of a cell, and at '
                        'most to the parameter arrival_tolerance'
                    )
        if not failure:
            itinerary.succeed()
            return
        was_homebound = itinerary.heads_home
        if self._driver.was_cancelled and not was_homebound:
            # Another client stopped the drive on purpose.
            itinerary.go_home()
        else:
            itinerary.fail()
        self._try_again_at = time.monotonic() + self.values['retry_delay']
        then = 'trying again' if itinerary.heads_home == was_homebound else 'going home'
        self.get_logger().warning(f'{failure}; {then}')

    def _distance(self, place: Place) -> float:
        """Return the distance of a place from the middle of the base, in metres."""
        ((x, y),) = self.grid.centers([self.grid.base]).tolist()
        return hypot(place.x - x, place.y - y)

    def _stay(self) -> str:
        """Stay in the cell for the parameter stay_time; return the state of the robot."""
        now = self.now()
        if self._stays_until is None:
            self._stays_until = now + int(self.values['stay_time'] * SECOND)
            self._step(self._walk.cell)
        elif now >= self._stays_until:
            self._stays_until = None
            self._itinerary.succeed()
        return f'staying in cell {self._walk.cell}'

    def _come_home(self, deployment: Deployment) -> None:
        """End a walk at the base."""
        for cell in shortest_way(self.grid, self._walk.cell, self.grid.base)[1:]:
            self._step(cell)
        self._deployment = None
        self._keep(partial(self._journal.arrive, deployment, self.now()))
        self._report(deployment)
        self.get_logger().info(
            f'home from {self._key(deployment)} after {len(deployment.steps)} steps'
        )

    def _report(self, deployment: Deployment) -> None:
        most = MAX_WALK * value_for(self.values, 'max_steps', self._agent)
        observation, now = deployment.observation(most), self.now()
        if len(deployment.steps) > most:
            warning = (
                f'{self._key(deployment)} has {len(deployment.steps)} steps, more than a report '
                f'may have ({MAX_WALK} * max_steps = {most}): {observation.path.size - 1} steps '
                'are reported, without loops; the journal has all steps'
            )
            self.get_logger().warning(warning)
            self.diagnostics.values['long walk'] = warning
        self._reports.publish(report_message(self._key(deployment), observation, now))
        self._readings.publish(readings_marker(self.grid, observation, now))

    def finish(self) -> None:
        """Stop the robot, since no node would track it any more."""
        self._driver.cancel()

    def close(self) -> None:
        """Write pending records of the journal, and close it."""
        self._keep(self._journal.write)
        self._journal.close()
        super().close()


main = partial(run, 'robot', RobotNode, linger=0.15)
