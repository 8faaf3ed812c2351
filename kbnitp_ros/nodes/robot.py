# SPDX-License-Identifier: Apache-2.0
"""The node of a real robot: drives it by Nav2, and reports from its journal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import inf, nan
import os
from pathlib import Path
import time
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from kbnitp_msgs.msg import AgentHealth, AgentStatus, DeploymentReport
from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.agents import own_base
from kbnitp_ros.configuration.field import make_datum, parking_place
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.core.inference.record import MAX_WALK, OrderState
from kbnitp_ros.files import in_words, Waiting, waiting_for
from kbnitp_ros.messages.deployments import report_message, status_message
from kbnitp_ros.messages.headers import content_hash, FRAME, SECOND
from kbnitp_ros.messages.health import Health, health_message
from kbnitp_ros.messages.markers import readings_marker
from kbnitp_ros.messages.operator_actions import OperatorState
from kbnitp_ros.messages.states import Readiness
from kbnitp_ros.nodes.driver import addresses, detection_class, Driver, read_detection
from kbnitp_ros.nodes.presence import (
    AGAIN,
    BaseField,
    HoldSubscription,
    INSTALLED,
    OperatorSubscription,
    StatePublisher,
)
from kbnitp_ros.nodes.recorded_paths import PendingPaths
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.runtime.process import run
from kbnitp_ros.robot.journal import Journal, JournaledDeployment, Step
from kbnitp_ros.robot.track import BY_ODOMETRY, BY_POSES
from kbnitp_ros.robot.trip import distance_home, Trip, USUAL_SPEED
from kbnitp_ros.robot.whereabouts import Fixes, Place, Transforms
import numpy as np
from sensor_msgs.msg import BatteryState, NavSatFix
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

# Seconds after which the charge of a battery is not known any more.
BATTERY_TIMEOUT = 60.0

# Distance that rounding may cause, metres.
NEGLIGIBLE = 1e-6

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
        self._home = parking_place(values, self._agent, self.grid)
        detections = detection_class(values['detection_type'])
        home = Path(os.environ.get('ROS_HOME', '~/.ros'), 'kbnitp_ros')
        journal = values['journal'] or home / f'{self._agent}.journal'
        self._journal = Journal(journal, self._agent, self.grid)
        self._reports = self.create_publisher(DeploymentReport, f'{prefix}report', qos.EVIDENCE)
        self._statuses = self.create_publisher(AgentStatus, f'{prefix}status', qos.EVIDENCE)
        self._readings = self.create_publisher(Marker, f'{prefix}readings', qos.LATCHED)
        self._healths = self.create_publisher(AgentHealth, f'{prefix}health', qos.READINGS)
        self._states = StatePublisher(self, self.grid, self._agent)
        self._base_field = BaseField(self, self.grid)
        self._hold = HoldSubscription(self)
        self._operator = OperatorSubscription(self, [self._agent], OperatorState())
        self._pending = PendingPaths(self, self._agent, self._journal, self._refuse)
        self._driver = Driver(
            self,
            values['driver'],
            values['nav_namespace'],
            self.grid,
            self._home,
            values['server_timeout'],
        )
        # The topic of the robot's pose, and its reader.
        self._source = {'tf': '/tf', 'fix': 'fix'}[values['position']]
        self._whereis: Transforms | Fixes
        datum, frame = make_datum(values), values['base_frame']
        if values['position'] == 'tf':
            # A deviation that is to be stated is unknown until then.
            self._whereis = Transforms(FRAME, frame, inf if values['pose_topic'] else 0.0)
        elif datum is not None:
            self._whereis = Fixes(datum.in_map, frame, self.grid.resolution / 2)
        else:
            raise ValueError(
                "parameter position is 'fix', and datum is empty: set datum to the geographic "
                'origin and heading of the frame map'
            )
        # Current place of the robot; None if it is unknown.
        self._place: Place | None = None
        # Charge of the battery, and the time of its message, seconds.
        self._battery = nan, -inf
        # Current problems by subject; empty texts for solved ones.
        self._troubles = {self._source: 'nothing was received yet'}
        # The deployment in flight; None at home.
        self._trip: Trip | None = None
        # Whether the robot waits for its reported departure to be on record.
        self._is_at_gate = False
        # Stamp of the newest order that was accepted.
        self._accepted = 0
        # Why the last deployment came back without a step; empty if it did not.
        self._why_unmoved = ''
        # Maximum speed and source of positions that were logged.
        self._logged: tuple[float, bool] | None = None
        # Time of the last poll by the system clock and by ROS, nanoseconds.
        self._looked = 0, 0
        self._resume()
        if not self._addresses:
            self.get_logger().warning(
                'this computer has no network link but lo, so no other computer can reach this '
                f'robot. Once there is a link, this node ends with exit code {NEW_LINKS} and must '
                'be started again'
            )
        # Distance from home to the next cell, cell sides.
        edge = 0.5 - np.abs(self.grid.in_cells(self._home[:2]) % 1.0 - 0.5).max()
        if values['arrival_tolerance'] > edge * self.grid.resolution + NEGLIGIBLE:
            self.get_logger().warning(
                f'parameter arrival_tolerance is {values["arrival_tolerance"]} m, and the next '
                f'cell {edge * self.grid.resolution:.3g} m from home: a robot in another cell '
                'counts as home'
            )
        if values['detections.needed'] > values['detections.of']:
            raise ValueError(
                f'parameter detections.needed is {values["detections.needed"]}: it must be at '
                f'most detections.of, which is {values["detections.of"]}'
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
        if topic := values['battery_topic']:
            self.subscribe(BatteryState, topic, self._on_battery, qos.READINGS, keeps_all=False)
        self.create_poll(self._look)
        self.create_poll(self._publish_health, AGAIN)

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
        if topic := self.values['pose_topic']:
            take = partial(self._take_place, self._whereis.take_deviation)
            if (nav := self.values['nav_namespace']) and not topic.startswith('/'):
                topic = f'{nav.rstrip("/")}/{topic}'
            # AMCL publishes it reliable and transient local.
            self.subscribe(PoseWithCovarianceStamped, topic, take, qos.LATCHED, keeps_all=False)

    def _resume(self) -> None:
        """Resume from the journal: publish its statuses and reports, and send the robot home."""
        if self._journal.corruption:
            self.get_logger().warning(self._journal.corruption)
            self.diagnostics.values['journal'] = self._journal.corruption
        for stamp, (time_refused, reason) in self._journal.refusals.items():
            self._publish_status(stamp, OrderState.REFUSED, time_refused, reason)
        for deployment in self._journal.deployments:
            # What was said of a departure that the journal lost is not known.
            if deployment.departed:
                self._publish_status(deployment.stamp, OrderState.DEPARTED, deployment.departed)
            if deployment.is_home:
                self._report(deployment)
        if under_way := self._journal.under_way:
            self._trip = self._set_out(under_way, ())
            self._trip.has_driven = True
            self.get_logger().warning(
                f'deployment {self._key(under_way)} was interrupted when the robot was switched '
                f'off in cell {self._trip.cell}: it goes home'
            )

    def _set_out(self, deployment: JournaledDeployment, path: Sequence[int]) -> Trip:
        """Return the trip of a deployment along a path, or home if the path is empty."""
        key, warn = self._key(deployment), self.get_logger().warning
        return Trip(
            self.grid,
            self._home,
            deployment,
            path,
            self.values,
            self._driver,
            lambda *step: self._keep(partial(self._journal.step, *step)),
            lambda text: warn(f'{key}: {text}'),
            self._max_speed,
        )

    @property
    def _max_speed(self) -> float:
        """Return the maximum speed of the robot, in m/s; 0 while it is unknown."""
        given: float = self.values['max_speed']
        return given or self._driver.max_speed

    def _key(self, deployment: JournaledDeployment) -> DeploymentKey:
        return DeploymentKey(self._agent, deployment.stamp)

    def _publish_status(
        self, stamp: int, state: OrderState, time_said: int, reason: str = ''
    ) -> None:
        """Publish the status of an order."""
        key = DeploymentKey(self._agent, stamp)
        self._statuses.publish(status_message(key, state, time_said, reason))

    def _take_place(self, take: Callable[[Any], None], message: TFMessage | NavSatFix) -> None:
        try:
            take(message)
        except ValueError as error:
            self.diagnostics.refuse(self._source, error)

    def _locate(self) -> None:
        """Localize the robot and, if it is out, record the cells it has entered."""
        now = self.now()
        self._place = None
        try:
            self._place = self._whereis.place(now, self.values['tf_timeout'])
            if self._trip is not None:
                self._trip.locate(self._place, now)
        except ValueError as error:
            if self._trip is not None and self._place is None:
                self._trip.lose(now)
            self._publish_trouble(self._source, str(error))
        else:
            self._publish_trouble(self._source, '')

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
            self._locate()
            if self._trip is not None:
                self._trip.detect(since, until, seen, is_stamped=stamp is not None)
        except ValueError as error:
            self.diagnostics.refuse('detections', error)

    def _on_battery(self, message: BatteryState) -> None:
        is_known = 0.0 <= message.percentage <= 1.0
        self._battery = message.percentage if is_known else nan, time.monotonic()

    def _publish_health(self) -> None:
        charge, heard = self._battery
        now, place, at = self.now(), self._place, {}
        if place is not None:
            at = {'x': place.x, 'y': place.y, 'pose_age': max(now - place.stamp, 0) / SECOND}
            # Positions by odometry state no deviation, and others none before the first message.
            at['deviation'] = place.sigma if 0.0 < place.sigma < inf else nan
        health = Health(
            now,
            INSTALLED,
            battery=charge if time.monotonic() < heard + BATTERY_TIMEOUT else nan,
            journal=self._journal.is_written,
            server=not self._driver.is_down,
            **at,
        )
        self._healths.publish(health_message(self._agent, health))

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

    def _look(self) -> None:
        self._looked = time.time_ns(), self.now()
        self._locate()
        self._keep(self._journal.write)
        self._driver.look()
        is_home = self._trip is None or self._is_at_gate
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
        state = self._wait() if self._trip is None else self._go_on(self._trip)
        self.diagnostics.state = state
        self._publish_state(state)

    def _publish_state(self, state: str) -> None:
        """Publish whether the robot can leave, and what stops it."""
        trip, place = self._trip, self._place
        tolerance = self.values['arrival_tolerance']
        is_at_base = place is not None and distance_home(self._home, place) <= tolerance
        awaited = state.what if isinstance(state, Waiting) else ''
        publish = partial(self._states.publish, journal=self._journal.id)
        if trip is not None:
            # A robot without a step is still at its base if it was not sent, or is seen there.
            is_at_base = not trip.deployment.steps and (not trip.has_driven or is_at_base)
            publish(Readiness.OUT, trip.failure or awaited, is_at_base)
            return
        forgotten = self._pending.orders.forgotten
        if forgotten and not is_at_base:
            publish(
                Readiness.NO_JOURNAL,
                f'journal {self._journal.path} does not know the departure of '
                f'{self._key(forgotten)}: bring the robot to its base',
            )
            return
        if self._why_unmoved and self._driver.is_down:
            self._why_unmoved = ''
        awaited = awaited or self._base_field.awaited or self._why_away() or self._driver.awaited
        if awaited:
            publish(Readiness.WAITING, awaited, is_at_base)
        else:
            publish(Readiness.READY, self._why_unmoved, is_at_base)

    def _wait(self) -> str:
        """Start the next deployment unless a condition blocks it; return the robot's state."""
        if not self._pending.is_listening:
            if (missing := self.missing_listeners([self._reports])) is not None:
                return waiting_for(missing)
            self._pending.listen()
        # A base with another field sends no path.
        if awaited := self._pending.awaited or self._base_field.awaited:
            return waiting_for(awaited)
        forgotten = self._pending.orders.forgotten
        if forgotten and self._journal.may_lack(forgotten) and not self._why_away():
            self._report_forgotten(forgotten)
        if (deployment := self._pending.newest) is None:
            return f'taking paths of {self._agent}'
        if not self._keep(partial(self._journal.begin, deployment.mission)):
            return self._no_room
        newer = f'the newer path {self._key(deployment)} came before the robot left'
        refusals = [(each, newer) for each in self._pending.orders.superseded]
        if taken_back := self._operator.refusal(self._key(deployment)):
            refusals.append((deployment, taken_back))
        for refused, reason in refusals:
            if not self._refuse(refused, reason):
                return self._no_room
            self._pending.orders.close(refused)
        if taken_back:
            return f'taking paths of {self._agent}'
        if self._accepted != deployment.stamp:
            self._accepted = deployment.stamp
            self._publish_status(deployment.stamp, OrderState.ACCEPTED, self.now())
        if awaited := self._hold.awaited or self._not_ready():
            return waiting_for(awaited)
        if not self._depart(deployment):
            return self._no_room
        return (
            f'leaving on {self._key(deployment)}'
            if self._trip is None
            else self._go_on(self._trip)
        )

    def _report_forgotten(self, deployment: JournaledDeployment) -> None:
        """Report a return from a deployment that the journal lost, and vouch for no step."""
        if not self._keep(partial(self._journal.depart, deployment)):
            return
        self._pending.orders.close(deployment)
        now = self.now()
        deployment.steps = [Step(cell, now, is_entered=False) for cell in deployment.path[1:]]
        for number in range(1, len(deployment.path)):
            self._keep(partial(self._journal.step, deployment, number))
        self._keep(partial(self._journal.arrive, deployment, now))
        self._report(deployment)
        self.get_logger().warning(
            f'home from {self._key(deployment)}, which the journal lost: no step is vouched for'
        )

    def _refuse(self, deployment: JournaledDeployment, reason: str) -> bool:
        """Refuse a path for good; return whether the refusal is in the journal."""
        stamp, now = deployment.stamp, self.now()
        if not self._keep(partial(self._journal.refuse, stamp, now, reason)):
            return False
        self._publish_status(stamp, OrderState.REFUSED, now, reason)
        self.get_logger().warning(f'deployment {self._key(deployment)} is refused: {reason}')
        return True

    def _depart(self, deployment: JournaledDeployment) -> bool:
        """Record the departure in the journal and report it; return False if recording fails."""
        deployment.departed = self.now()
        if not self._keep(partial(self._journal.depart, deployment)):
            return False
        self._pending.orders.close(deployment)
        self._log_limits()
        self._trip = trip = self._set_out(deployment, deployment.path)
        self._is_at_gate = True
        departure = status_message(self._key(deployment), OrderState.DEPARTED, deployment.departed)
        content = content_hash(departure)
        self._pending.when_recorded(deployment.stamp, content, partial(self._leave, trip))
        self._statuses.publish(departure)
        return True

    def _log_limits(self) -> None:
        """Log once by which positions and which speed the robot vouches for its steps."""
        speed = self._max_speed
        has_odometry = self._place is not None and self._place.correction is not None
        if self._logged == (speed, has_odometry):
            return
        self._logged = speed, has_odometry
        log, cell = self.get_logger(), self.grid.resolution
        wanted = min(self.values['arrival_tolerance'], cell / 2)
        if (tolerance := self._driver.goal_tolerance) > wanted + NEGLIGIBLE:
            log.warning(
                f'xy_goal_tolerance of Nav2 is {tolerance:g} m: set it to at most {wanted:g} m '
                '(half a cell and arrival_tolerance), or goals end where the robot has not arrived'
            )
        if not speed:
            speed = USUAL_SPEED * cell
            log.warning(
                f'max_speed is 0, and Nav2 states no maximum speed: {speed:g} m/s is assumed'
            )
        reach = (BY_ODOMETRY if has_odometry else BY_POSES).stretch * cell
        source = 'positions with odometry'
        if not has_odometry:
            source = 'positions without odometry (with it, frames map, odom and base, far better)'
        log.info(
            f'{source}: at {speed:g} m/s the robot vouches for its steps with poses at least '
            f'every {reach / speed:.2g} s'
        )

    def _leave(self, trip: Trip) -> None:
        """Start the drive, unless a pause has ended the deployment."""
        if self._trip is trip:
            self._is_at_gate = False
            steps = len(trip.deployment.path) - 1
            self.get_logger().info(f'leaving on {self._key(trip.deployment)}: {steps} steps')

    @property
    def _no_room(self) -> str:
        return waiting_for(f'room on the disk: {self._troubles["journal"]}')

    @property
    def _unplaced(self) -> str:
        """Return the reason why the robot's place is unknown."""
        name = 'TF' if self._source == '/tf' else 'a fix'
        return f'{name}: {self._troubles[self._source]}'

    def _why_away(self) -> str:
        """Describe why the robot is not known to be at its base; empty if it is."""
        if self.now() <= 0:
            return 'the clock to start'
        if self._place is None:
            return self._unplaced
        away, tolerance = distance_home(self._home, self._place), self.values['arrival_tolerance']
        if away > tolerance:
            return (
                f'the robot to be at its base, cell {self.grid.base}: it is {away:.1f} m from its '
                f'home, at most {tolerance} m are allowed (parameter arrival_tolerance)'
            )
        return ''

    def _not_ready(self) -> str:
        """Describe the condition that blocks the departure; empty if there is none."""
        if awaited := self._why_away():
            return awaited
        assert self._place is not None
        return self._driver.not_ready((self._place.x, self._place.y))

    def _go_on(self, trip: Trip) -> str:
        """Take the next action of the deployment; return the robot's state."""
        if self._is_at_gate:
            return self._wait_at_gate(trip)
        state = trip.advance(self._place, self.now(), self._unplaced)
        return self._come_home(trip) if trip.is_home else state

    def _wait_at_gate(self, trip: Trip) -> str:
        """Wait until the departure is on record; a pause ends the deployment."""
        key = self._key(trip.deployment)
        if self._hold.is_held:
            self.get_logger().warning(
                f'{key}: the operator paused the mission before its departure was on disk; it '
                'stays at the base'
            )
            self._is_at_gate = False
            trip.failure = 'the operator paused the mission'
            return self._come_home(trip)
        return waiting_for(
            f'the recorder to acknowledge the departure of {key} on {self._agent}/recorded '
            '(parameter recorded)'
        )

    def _come_home(self, trip: Trip) -> str:
        """End a walk at the base, and report it; return the robot's state."""
        deployment, now = trip.deployment, self.now()
        key = self._key(deployment)
        if doubt := trip.come_home(now):
            self.get_logger().warning(f'{key}: no step is vouched for: {doubt}')
        self._trip = None
        self._why_unmoved = '' if deployment.steps else trip.failure or 'the robot made no step'
        self._keep(partial(self._journal.arrive, deployment, now))
        self._report(deployment)
        made = len(deployment.steps)
        unsure = sum(not step.is_entered for step in deployment.steps)
        self.get_logger().info(
            f'home from {key} after {made} steps'
            + (f', {unsure} not vouched for' if unsure else '')
        )
        return f'home from {key}'

    def _report(self, deployment: JournaledDeployment) -> None:
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
        field_id = self.grid.id
        self._reports.publish(
            report_message(self._key(deployment), observation, now, field_id=field_id)
        )
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
