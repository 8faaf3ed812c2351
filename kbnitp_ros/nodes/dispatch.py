# SPDX-License-Identifier: Apache-2.0
"""The planner's orders, and the statuses and reports of the agents."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from math import inf
import re
import time

from kbnitp_msgs.msg import AgentHealth, AgentState, AgentStatus, DeploymentReport, Recorded
from kbnitp_ros.base.agent_states import AgentStates
from kbnitp_ros.base.readiness import Readiness, Waiting
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.agents import own_base
from kbnitp_ros.configuration.field import parking_place
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.core.field.observation import lost_after_contact
from kbnitp_ros.core.inference.record import OPEN, Verdict
from kbnitp_ros.log.record import RecordedMission
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.deployments import (
    hear_report,
    path_message,
    read_report,
    read_status,
    report_message,
    Source,
)
from kbnitp_ros.messages.headers import (
    content_hash,
    LAST_COUNTED_ON,
    mission_of_path,
    read_name,
    SECOND,
)
from kbnitp_ros.messages.health import read_health
from kbnitp_ros.messages.progress import Need
from kbnitp_ros.messages.states import read_state
from kbnitp_ros.nodes.rounds import describe_plan, Plans, Rounds
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode, LOG_FIRST
from nav_msgs.msg import Path
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

# Seconds without orders for an agent after it refused an order, doubled with each further refusal;
# and the maximum pause.
FIRST_PAUSE, MAX_PAUSE = 1.0, 60.0

# Seconds until the path of an order on record must have arrived.
READ_AGAIN = 1.0

# What may change in a reason that is not told again.
NUMBER = re.compile('[0-9.]+')

# Seconds that the nodes of a base may take to process a return.
PROCESSING = 5.0


class Dispatch:
    """The robots of the planner, from their orders to their reports."""

    def __init__(
        self,
        node: FieldNode,
        agents: Sequence[str],
        rounds: Rounds,
        state: BaseState,
        act: Callable[[], None],
    ) -> None:
        self._node = node
        self._values = node.values
        self._agents = agents
        self._rounds = rounds
        self._state = state
        self._act = act
        # The publishers of paths.
        self.paths = {
            agent: node.create_publisher(Path, f'{agent}/path', qos.EVIDENCE) for agent in agents
        }
        self._losses = {
            agent: node.create_publisher(DeploymentReport, f'{agent}/report', qos.EVIDENCE)
            for agent in agents
        }
        bases = {agent: own_base(self._values, agent, node.grid) for agent in agents}
        fields = {agent: node.grid.at(base) for agent, base in bases.items()}
        self.states = AgentStates(fields, self._values)
        # The field of each agent, with its base, and the home of its robot.
        self._fields = fields
        self._homes = {agent: parking_place(self._values, agent, node.grid) for agent in agents}
        self._readiness = Readiness(self._values)
        # Start of each agent's wait for a reason, seconds; infinite once it was logged.
        self._waits: dict[tuple[str, str], float] = {}
        # Reason of each agent, with the time since which it gives it, and the reasons logged.
        self._reasons: dict[str, tuple[str, float]] = {}
        self._told: set[tuple[str, str]] = set()
        # Held deployments, with the reason logged last.
        self._held: dict[DeploymentKey, str] = {}
        # Robots that were given up, and the time until which they may return.
        self._late: dict[DeploymentKey, float] = {}
        # Pauses of agents after refusals: the length in seconds, and the end.
        self._pauses: dict[str, tuple[float, float]] = {}
        # The stamp of the last deployment, in nanoseconds.
        self.last_stamp = 0
        # Paths and reports on record that have not arrived, and the times, seconds.
        self.unknown: dict[tuple[DeploymentKey, int], float] = {}
        # Deployments without a step that were logged.
        self._unmoved: set[DeploymentKey] = set()
        # Descriptions of the plans of robots that have not departed.
        self._goals: dict[DeploymentKey, str] = {}

    def restore(self, record: RecordedMission) -> None:
        """Publish the paths of a recorded mission again, and the losses that its planner saw."""
        for key in record.orders:
            if key.stamp <= LAST_COUNTED_ON:
                self.last_stamp = key.stamp
            # The publisher of the former planner, which kept the path, is gone. The estimator may
            # not have heard of an order that was refused.
            self.paths[key.agent].publish(record.messages[key])
            if not record.is_refused(key):
                self._rounds.count_path(record.paths[key])
        # What is sent again is the same bytes.
        for (key, _), data in record.given_up.items():
            self._losses[key.agent].publish(data)
            if key in record.paths:
                self._await_late(key)
        for key, action in record.unreported_losses.items():
            self.give_up(key, Source.OPERATOR, action.steps_survived, action.settled)

    def read_again(self, log: MissionLog, record: RecordedMission) -> None:
        """Read orders of an earlier planner that were recorded after the log was read."""
        due = time.monotonic() - READ_AGAIN
        if not any(since < due for since in self.unknown.values()):
            return
        self.unknown.clear()
        before = {*record.paths}
        for role, logged in log.read('path', 'report', 'status'):
            with suppress(ValueError):
                record.take(role, logged)
        for key in record.orders:
            if key not in before:
                self.last_stamp = max(self.last_stamp, key.stamp)
                self.paths[key.agent].publish(record.messages[key])
                self._rounds.count_path(record.paths[key])

    def listen(self) -> None:
        """Subscribe to the agents' topics."""
        self._sent_paths = {agent: self._subscribe_to_paths(agent) for agent in self._agents}
        for agent in self._agents:
            self._node.subscribe_to_agent(DeploymentReport, agent, partial(self._on_report, agent))
            self._node.subscribe_to_agent(AgentStatus, agent, partial(self._on_status, agent))
            self._node.subscribe_to_agent(AgentState, agent, partial(self._on_state, agent))
            self._node.subscribe_to_agent(AgentHealth, agent, partial(self._on_health, agent))
            if topic := self._values['ready_topic']:
                take = partial(self._on_ready, agent)
                self._node.subscribe(Bool, f'{agent}/{topic}', take, qos.LATCHED)
            if self._values['recorded']:
                self._node.subscribe_to_agent(Recorded, agent, partial(self._on_recorded, agent))

    def _subscribe_to_paths(self, agent: str) -> Subscription:
        """Subscribe to an agent's paths, since another planner may publish paths, too."""
        return self._node.subscribe_to_agent(Path, agent, partial(self._on_path, agent))

    @property
    def left_alone(self) -> list[str]:
        """Return the agents that get no orders for a while after they refused an order."""
        now = time.monotonic()
        return [agent for agent, (_, until) in self._pauses.items() if now < until]

    @property
    def waiting(self) -> dict[str, Waiting]:
        """Return the conditions that keep robots at their base, by agent."""
        now, out = time.monotonic(), {key.agent for key in self._state.in_flight}
        at_base = [agent for agent in self._agents if agent not in out]
        found = {
            agent: self._readiness.waiting(agent, now) or self._separation(agent)
            for agent in at_base
        }
        return {agent: each for agent, each in found.items() if each is not None}

    def _separation(self, agent: str) -> Waiting | None:
        """Return the wait for a robot that is still near the home of this one."""
        if not (least := self._values['separation']):
            return None
        x, y, *_ = self._homes[agent]
        for key in self._state.in_flight.keys() - self._state.held:
            away = self._readiness.distance(key.agent, x, y)
            if self._fields[key.agent].base != self._fields[agent].base:
                continue
            if not self._state.is_away(key):
                return Waiting(Need.SEPARATION, f'{key.agent} to depart (parameter separation)')
            if away < least:
                why = f'{key.agent} to be {least:g} m away: it was heard {away:.1f} m'
                return Waiting(Need.SEPARATION, f'{why} from its home (parameter separation)')
        return None

    def leaving(self, free: Sequence[str]) -> list[str]:
        """Return the free agents that may leave at once: with a separation, one of each base."""
        if not self._values['separation']:
            return [*free]
        first = {self._fields[agent].base: agent for agent in reversed(free)}
        return [agent for agent in free if agent in first.values()]

    def _longest_absence(self, key: DeploymentKey) -> int:
        """Return the timeout of a silent robot, nanoseconds."""
        steps, period = self._state.paths[key].size - 1, 'step_period'
        away = steps * value_for(self._values, period, key.agent) + self._values['return_deadline']
        nanoseconds: int = round(away * SECOND)
        return nanoseconds

    def _await_late(self, key: DeploymentKey) -> None:
        """Keep the base running until a robot that was given up has had time to return."""
        self._late[key] = time.monotonic() + self._longest_absence(key) / SECOND

    @property
    def late(self) -> dict[DeploymentKey, float]:
        """Return the robots that were given up and may still return, with the seconds left."""
        now = time.monotonic()
        return {key: until - now for key, until in self._late.items() if until > now}

    def send(self, plans: Plans, mission: int) -> None:
        """Publish the paths of a round."""
        for key, plan in plans.items():
            message = path_message(self._node.grid, plan.path, key.stamp, mission)
            content = content_hash(message)
            self._state.take_path(key, plan.path, content, self._node.now())
            self._rounds.count_path(plan.path)
            self.paths[key.agent].publish(message)
            self._goals[key] = describe_plan(self._node.grid, plan)
            self.last_stamp = max(self.last_stamp, key.stamp)

    def give_up(
        self,
        key: DeploymentKey,
        source: Source,
        steps_survived: int = 0,
        settled: Sequence[int] = (),
    ) -> None:
        """Report a robot in flight as lost; `settled`: hashes of reports that do not matter."""
        self._log_departure(key)
        path, contact = self._state.paths[key], self._values['contact_probability']
        lost = lost_after_contact(path, steps_survived, contact)
        message = report_message(key, lost, self._node.now(), source, settled=settled)
        self._losses[key.agent].publish(message)
        # The robot waits for the estimator's judgement, and not for another timeout.
        with suppress(ValueError):
            self._state.record_report(*read_report(message))
        self._await_late(key)

    def give_up_overdue(self) -> None:
        """Report timed-out robots as lost, except robots that were seen not to be."""
        if not self._values['silent_loss']:
            return
        for key in self._state.overdue(self._node.elapsed(), self._longest_absence):
            if why := self._why_not_lost(key):
                is_left = self.states.is_left_to_operator(key.agent)
                self._state.hold(key, why, is_left_to_operator=is_left)
            else:
                self.give_up(key, Source.SILENCE)

    def _why_not_lost(self, key: DeploymentKey) -> str:
        status = self._state.status(key)
        # The time of a presumed departure is not known.
        departed = status.stamp if status else self._state.sent[key]
        return self.states.why_not_lost(key.agent, departed)

    def log_departures(self) -> None:
        """Log the departures."""
        state = self._state
        for key in [*self._goals]:
            if key not in state.void and (key not in state.in_flight or state.is_away(key)):
                self._log_departure(key)

    def log_reasons(self) -> None:
        """Log once why deployments are held, and what agents say or wait for for `LOG_FIRST`."""
        for key, why in self._state.held.items():
            if self._held.get(key) != why:
                self._held[key] = why
                self._log_departure(key)
                give_up = self._node.resolve_service_name('give_up')
                self._node.get_logger().warning(
                    f'{key} is held, and counts for nothing, until the robot reports again or '
                    f'{give_up} is called: {why}'
                )
        # Short waits are normal.
        for agent, (words, since) in self._reasons.items():
            is_new = words and (agent, words) not in self._told
            if is_new and time.monotonic() > since + LOG_FIRST:
                self._told.add((agent, words))
                self._node.get_logger().warning(words)

        waiting, now = self.waiting, time.monotonic()
        # A wait is logged again when its reason changes, but for the numbers in it.
        keys = ((agent, NUMBER.sub('', each.why)) for agent, each in waiting.items())
        self._waits = {key: self._waits.get(key, now) for key in keys}
        for (agent, reason), since in self._waits.items():
            if now > since + LOG_FIRST:
                self._waits[agent, reason] = inf
                self._node.get_logger().warning(f'{agent} waits: {waiting[agent].why}')

    def _log_departure(self, key: DeploymentKey) -> None:
        if goal := self._goals.pop(key, None):
            self._pauses.pop(key.agent, None)
            self._node.deployment_logger.info(f'{key} leaves {goal}')

    def _on_report(self, agent: str, message: DeploymentReport) -> None:
        """Await the judgement of a report."""
        try:
            key, report = hear_report(message, agent)
            self._state.record_report(key, report)
        except ValueError as error:
            self._node.diagnostics.refuse(f'{agent}/report', error)
        self._act()

    def follow(self) -> None:
        """Handle deployments that ended, or that an estimator took back."""
        state = self._state
        for key in [*self._goals]:
            if key in state.void:
                self._take_back(key)
        for key in state.unmoved - self._unmoved:
            reason = self.states.reason(key.agent) or 'see the console of its robot'
            self._node.get_logger().warning(
                f'{key} returned without moving, and does not count as a robot of the mission: '
                f'{reason}'
            )
        self._unmoved = {*state.unmoved}
        for key in [*self._late]:
            if state.standings.get(key, OPEN).verdict in (Verdict.RETURN, Verdict.UNMOVED):
                self._late[key] = min(self._late[key], time.monotonic() + PROCESSING)
        self.log_departures()

    def _take_back(self, key: DeploymentKey) -> None:
        """Forget the path of a refused order; pause an agent that refused by itself."""
        self._rounds.count_path(self._state.paths[key], -1)
        del self._goals[key]
        if action := self._state.operator.taken_back.get(key):
            self._node.get_logger().info(f'{key} is {action.refusal}: its robot stays at the base')
            return
        pause = FIRST_PAUSE
        if key.agent in self._pauses:
            pause = min(2 * self._pauses[key.agent][0], MAX_PAUSE)
        self._pauses[key.agent] = pause, time.monotonic() + pause
        status = self._state.status(key)
        reason = status.reason if status else ''
        self._node.get_logger().warning(
            f'{key} was refused by its agent, so its robot stays at the base: {reason}'
        )

    def _on_state(self, agent: str, message: AgentState) -> None:
        try:
            is_withdrawn = self.states.take(agent, read_state(message, agent))
        except ValueError as error:
            self._node.diagnostics.refuse(f'{agent}/state', error)
            return
        self._node.diagnostics.values[f'agent {agent}'] = self.states.reason(agent)
        words = self.states.words(agent)
        if words != self._reasons.get(agent, ('', 0.0))[0]:
            self._reasons[agent] = words, time.monotonic()
        if is_withdrawn and agent in self._state.still_agents:
            self._state.forgive(agent)
        for key in [key for key in self._state.held if key.agent == agent]:
            if not self._why_not_lost(key):
                self._state.leave(agent)
        self._act()

    def _on_health(self, agent: str, message: AgentHealth) -> None:
        try:
            health = read_health(message, agent)
        except ValueError as error:
            self._node.diagnostics.refuse(f'{agent}/health', error)
            return
        self._readiness.take(agent, health, time.monotonic())

    def _on_ready(self, agent: str, message: Bool) -> None:
        self._readiness.ready[agent] = message.data

    def _on_status(self, agent: str, message: AgentStatus) -> None:
        """Record an agent's status of an order."""
        try:
            self._state.take_status(*read_status(message, agent))
        except ValueError as error:
            self._node.diagnostics.refuse(f'{agent}/status', error)
            return
        self._node.diagnostics.accepted += 1
        self.log_departures()
        self._act()

    def _on_path(self, agent: str, message: Path) -> None:
        """Note another planner's path; use it in place of ours if the recorder acknowledged it."""
        try:
            key, path = self._node.read_path(agent, message)
            mission = mission_of_path(message)
            is_other = self._state.take_other_path(key, path, content_hash(message), mission)
        except ValueError as error:
            self._node.diagnostics.refuse(f'{agent}/path', error)
            return
        if is_other:
            self._node.diagnostics.refuse(
                f'{agent}/path',
                f'{key} follows the path of another planner, which was recorded first, and not '
                'the path of this planner',
            )

    def _is_known(self, key: DeploymentKey, message: Recorded) -> bool:
        """Return whether the message that is on record has arrived."""
        if message.kind == Recorded.REPORT:
            return message.content in self._state.heard_hashes(key)
        return message.kind != Recorded.PATH or key in self._state.paths

    def _on_recorded(self, agent: str, message: Recorded) -> None:
        try:
            key = DeploymentKey(agent, read_name('stamp', message.stamp))
        except ValueError as error:
            self._node.diagnostics.refuse(f'{agent}/recorded', error)
            return
        if not self._is_known(key, message):
            self.unknown.setdefault((key, message.content), time.monotonic())
        if self._state.take_recorded(key, message.content):
            # Subscribe anew to receive the recorded path, which its publisher keeps.
            self._node.destroy_subscription(self._sent_paths[agent])
            self._sent_paths[agent] = self._subscribe_to_paths(agent)
        self.log_departures()
