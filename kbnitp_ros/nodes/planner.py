# SPDX-License-Identifier: Apache-2.0
"""The planner: sends robots along the paths that gain most information or serve the goal best."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
import time
from typing import Any

from kbnitp_msgs.msg import MissionStatus
from kbnitp_ros.base.obstacles import describe_obstacle
from kbnitp_ros.base.protocol import PlannerState
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.configuration import agent_names, find_parameter
from kbnitp_ros.configuration.agents import make_robot_types
from kbnitp_ros.configuration.checks import (
    check_changes,
    check_parking,
    check_periods,
    check_reach,
    check_robots,
    cut_off_note,
    reach_note,
)
from kbnitp_ros.configuration.mission import check_search, settled_goal
from kbnitp_ros.core import Grid, NoPathError
from kbnitp_ros.files import some, waiting_for
from kbnitp_ros.log.record import read_newest_round, read_resumed, RecordedMission
from kbnitp_ros.log.roles import MissionLog, resumed_log
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.deployments import Source
from kbnitp_ros.messages.headers import next_name
from kbnitp_ros.messages.operator_actions import Action, OperatorAction
from kbnitp_ros.messages.progress import mission_status_message, NOT_KNOWN, Obstacle
from kbnitp_ros.messages.progress import MissionStatus as Status
from kbnitp_ros.messages.states import Readiness
from kbnitp_ros.nodes.dispatch import Dispatch
from kbnitp_ros.nodes.goal import GoalState
from kbnitp_ros.nodes.newest_belief import NewestBelief
from kbnitp_ros.nodes.operator_services import Operator
from kbnitp_ros.nodes.presence import AGAIN, Peers, Repeated, StatePublisher
from kbnitp_ros.nodes.rounds import Plans, Rounds, Search
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.runtime.process import run
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

# Parameters that say which goal is reached.
GOAL = ('goal.kind', 'goal.cells', 'stop.confidence')


class PlannerNode(FieldNode):
    """Plan paths on the newest belief, and send robots of free agents along them."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._agents = agent_names(self.values, self.grid)
        # The file of a mask is read once: it may change or go.
        self.values |= settled_goal(self.values, self.grid)
        check_search(self.values, self.grid, {})
        check_periods(self.values, self._agents)
        check_parking(self.grid, self.values)
        check_reach(self.grid, self.values)
        self._log_reachability()
        resume = self.values['resume']
        log = self._log = resumed_log(resume, self.roles) if resume else None
        record = read_planner_record(log, self.values, self.grid) if log else None
        types = make_robot_types(self.values, self.grid)
        self._state = record or BaseState(self.grid, self.values['max_steps'], types, self.values)
        self._goal = GoalState(self, self._state, self._deploy)
        self._rounds = Rounds(self.grid, self.values, self.get_logger().warning)
        self._dispatch = Dispatch(self, self._agents, self._rounds, self._state, self._deploy)
        self._beliefs = NewestBelief(
            self, self._agents, self._state, self._goal.take, self._on_standings
        )
        self._peers = Peers(self, self._agents)
        # The search for the next round, kept with its result while robots cannot leave.
        self._search: Search | None = None
        # Whether the values of this start are on record.
        self._is_begun = False
        # Number of parameter changes.
        self._changes = 0
        # The last search that found no path worth a robot, and the reason.
        self._worthless_for: Search | None = None
        self._why_worthless = ''
        self._operator = Operator(self, self._agents, self._state, self._act)
        self._has_subscribers = False
        self._end_logged = ''
        # How the mission stands, as it was published last, and the time, seconds.
        self._status, self._said_at = NOT_KNOWN, -inf
        self._statuses = Repeated(self, MissionStatus, 'mission', qos.LATCHED)
        # Values of parameters that may change, as they were given at this start.
        self._given = {name: as_plain(self.values[name]) for name in changeable(self.values)}
        if log and record:
            self._restore(log, record)
            check_robots(self.values['robots'], self._counted)
        self._operator.hold(self._state.operator.is_holding)
        StatePublisher(self, self.grid).publish(Readiness.READY)
        self.add_on_set_parameters_callback(self._check_changes)
        self._restore_settings()
        self.add_post_set_parameters_callback(self._note_change)
        # Subscribe to paths before beliefs, since beliefs are checked against the paths received.
        self._dispatch.listen()
        self._beliefs.subscribe()
        self.create_look(self._look_at_graph)
        self.create_poll(self._go_on)

    def _restore(self, log: MissionLog, record: RecordedMission) -> None:
        """Publish again what a recorded mission had published, and send the rest of its round."""
        for stamp in record.operator.actions:
            self._operator.restore(record.messages[stamp])
        self._dispatch.restore(record)
        self._beliefs.tracker.mission = record.mission
        # With one agent, or with `rolling`, no paths of a round can be missing.
        has_rounds = len(self._agents) > 1 and not self.values['rolling']
        if has_rounds and (missing := missing_plans(log, record, self._agents, self._rounds)):
            plans, mission = missing
            self._dispatch.send(plans, self._beliefs.tracker.begin(mission))

    def _restore_settings(self) -> None:
        """Take the values that the operator set, unless another value is given at this start."""
        operator = self._state.operator
        for name, value in operator.settings.items():
            if self._given.get(name, value) == value:
                continue
            before, given = operator.given.get(name), self._given[name]
            if given != before:
                self.get_logger().warning(
                    f'parameter {name} is {given}, as given at this start, and not {value}, which '
                    f'the operator had set: at the last start it was {before}'
                )
                continue
            answer = self.set_parameters([Parameter(name, value=value)])[0]
            if answer.successful:
                self.get_logger().info(f'parameter {name} is {value}, as the operator had set')
            else:
                self.get_logger().warning(
                    f'parameter {name} stays {given}, and not {value}, which the operator had '
                    f'set: {answer.reason}'
                )

    def _log_reachability(self) -> None:
        """Log the cells of a map, and the part of the field that no path reaches."""
        grid, mapped = self.grid, self.values['map'] or self.values['map_topic']
        cells = f'{grid.width} x {grid.height} cells of {grid.resolution:g} m'
        from_map = f'map {mapped}: {cells} (grid.resolution), {(~grid.free).sum()} of them blocked'
        for note in (from_map * bool(mapped), reach_note(grid, self.values), cut_off_note(grid)):
            if note:
                self.get_logger().info(note)

    def _check_changes(self, changes: Sequence[Parameter]) -> SetParametersResult:
        """Refuse parameter values that are invalid in the running mission."""
        new = {each.name: each.value for each in changes}
        newest = self._beliefs.newest
        believed = newest.robot_types if newest else {}
        try:
            check_changes(new, self.values, self.grid, believed, self._counted)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _note_change(self, changes: Sequence[Parameter]) -> None:
        """Discard plans made with other parameters, and put the changes on record."""
        self._changes += 1
        self._goal.not_worth = None
        if values := {each.name: each.value for each in changes if each.name in self._given}:
            plain = {name: as_plain(value) for name, value in values.items()}
            self._operator.record(Action.SET, plain)

    def _look_at_graph(self) -> None:
        if self._peers.look():
            self._beliefs.subscribe()

    def _on_standings(self) -> None:
        self._follow()
        self._deploy()

    def _follow(self) -> None:
        # A pending action may be the reason for a refusal; nobody leaves before it is on record.
        if self._operator.awaited is None:
            self._dispatch.follow()

    def _go_on(self) -> None:
        if not self._is_begun and self.now() > 0:
            self._is_begun = True
            if self._given != self._state.operator.given:
                self._operator.record(Action.START, self._given)
        if self._log and isinstance(self._state, RecordedMission):
            self._dispatch.read_again(self._log, self._state)
        self._dispatch.log_departures()
        self._dispatch.log_reasons()
        self._dispatch.give_up_overdue()
        self._deploy()

    @property
    def _counted(self) -> int:
        """Return the number of robots sent, without those that came back without a step."""
        return self._state.robots_left - len(self._state.unmoved)

    def _act(self, action: OperatorAction) -> None:
        """Apply an action of the operator."""
        self._follow()
        if action.action == Action.GIVE_UP:
            for key in action.paths:
                if key in self._state.in_flight:
                    steps, settled = action.steps_survived, action.settled
                    self._dispatch.give_up(key, Source.OPERATOR, steps, settled)
        elif action.cells:
            # Plans through other cells are discarded.
            self._changes += 1
            self._goal.not_worth = None
        self._deploy()

    def _planner_state(self) -> PlannerState:
        """Return the state that decides whether robots leave."""
        return PlannerState(
            agents=self._agents,
            base=self._state,
            states=self._dispatch.states,
            unrecorded_action=self._operator.awaited,
            newest=self._beliefs.evidence,
            why_unfollowed=self._beliefs.why_unfollowed,
            estimators=self._peers.estimators,
            is_decided=self._goal.is_decided,
            why_over=self._goal.why_over,
            missing_listeners=self._missing_listeners,
            topic=self.resolve_topic_name,
            service=self.resolve_service_name,
            searched=self._search.agents if self._search else (),
            why_worthless=self._why_worthless,
            proposed=tuple(self._operator.proposed),
            absent=self._peers.absent,
            silent=self._peers.silent,
            outdated=self._peers.outdated,
            left_alone=self._dispatch.left_alone,
            waiting=self._dispatch.waiting,
        )

    def _missing_listeners(self) -> str | None:
        """Describe the missing subscribers; None once all have subscribed."""
        if self._has_subscribers:
            return None
        gone = self._state.gone_agents
        paths = [each for name, each in self._dispatch.paths.items() if name not in gone]
        missing = self.missing_listeners(paths)
        if missing is None and 'agent' in self.values['await_nodes']:
            # Subscribers alone do not prove that an agent has a node: with changing hazards, nodes
            # of simulated agents subscribe to the paths of all agents.
            absent = [each for each in self._peers.absent if each not in gone]
            # Otherwise the first robots would leave without the agents whose states come later.
            states, others = self._dispatch.states.unstated, {*self._peers.outdated, *gone}
            unstated = [each for each in states if each not in others]
            if absent:
                missing = f'a node of agent {some(absent)} (parameter await_nodes)'
            elif unstated:
                missing = f'the field of agent {some(unstated)} (parameter await_nodes)'
        self._has_subscribers = missing is None
        return missing

    def _record_goal(self) -> None:
        """Put on record that the goal is reached, or that it no longer is."""
        operator, is_reached = self._state.operator, self._goal.is_reached
        if is_reached is None or operator.is_ended or self._operator.awaited is not None:
            return
        goal = {name: as_plain(self.values[name]) for name in GOAL}
        if is_reached and operator.reached != goal:
            self._operator.record(Action.REACHED, goal)
        elif not is_reached and operator.reached == goal:
            self.get_logger().warning('the goal was reached and no longer holds: no robot leaves')
            self._operator.record(Action.GOAL_LOST)

    def _deploy(self) -> None:
        """Send the next robots, unless a condition blocks them."""
        self._record_goal()
        now = self._planner_state()
        if obstacle := now.obstacle:
            self._publish_obstacle(now, obstacle)
            if obstacle is not Obstacle.ACTION_UNRECORDED:
                self._operator.withdraw()
            is_over = obstacle.is_end and not self.values['keep_running']
            if is_over and not self._dispatch.late:
                self.end()
            return
        newest = self._beliefs.newest
        assert newest is not None
        try:
            leaving = self._dispatch.leaving(now.free_agents)
            plans = self._next_plans(newest, leaving[: now.robots - now.sent])
        except NoPathError as error:
            self._goal.not_worth = str(error)
        if self._goal.why_over() is not None:
            self._deploy()
            return
        if not plans:
            obstacle = Obstacle.SEARCHING if self._search else Obstacle.WORTHLESS
            if self._goal.awaits_draws:
                obstacle = Obstacle.DECIDING
            self._publish_obstacle(self._planner_state(), obstacle)
            return
        if self.values['approval'] and not self._are_approved(plans):
            self._publish_obstacle(self._planner_state(), Obstacle.UNAPPROVED)
            return
        self._operator.withdraw()
        self._dispatch.send(plans, self._beliefs.tracker.begin(newest.mission))

    def _publish_obstacle(self, now: PlannerState, obstacle: Obstacle) -> None:
        """Publish the condition that blocks departures: on change, and each second of a wait."""
        what = describe_obstacle(now, obstacle)
        self.diagnostics.state = f'done: {what}' if obstacle.is_end else waiting_for(what)
        state = self._state
        status = Status(
            author=self.get_fully_qualified_name(),
            state=now.mission_state(obstacle),
            obstacle=obstacle,
            ends_by=now.ends_by(obstacle),
            hold=self._operator.is_held,
            ordered=state.robots_left,
            out=len(state.in_flight.keys() - {*state.undeparted, *state.held}),
            lost=state.lost,
            held=len(state.held),
            confidence=self.values['stop.confidence'],
            waiting={agent: each.what for agent, each in now.waiting.items()},
            no_go=state.operator.no_go,
            reason='' if now.is_plain(obstacle) else self.diagnostics.state,
        )
        time_now = time.monotonic()
        if status != self._status or time_now > self._said_at + AGAIN:
            self._status, self._said_at = status, time_now
            self._statuses.publish(mission_status_message(replace(status, stamp=self.now())))
        if obstacle.is_end:
            self._log_end(self.diagnostics.state)

    def _log_end(self, how: str) -> None:
        """Log once how the mission ended, and how long the base still runs."""
        if how == self._end_logged:
            return
        self._end_logged = how
        self.get_logger().info(f'the mission is over: {how}')
        if not self.values['keep_running'] and (late := self._dispatch.late):
            self.get_logger().info(
                f'the planner keeps running for up to {max(late.values()):.0f} s, since robots '
                f'that were given up may return: {some(late)}'
            )

    def _next_plans(self, newest: Snapshot, agents: list[str]) -> Plans:
        """Return the next round's plans, or its proposals if they still apply; {} until found."""
        refused = self._state.operator.refused(self._state.robots_left)
        now = Search(newest.evidence, agents, len(refused), self._changes)
        if self._operator.proposed and self._operator.proposed_by == now:
            return self._operator.proposed
        search = self._search
        if self._worthless_for == now or (search and search.is_running):
            return {}
        if search and not search.lasts(now, self.values['rolling']):
            self.get_logger().info(
                f'discarding the plan for {some(search.agents)}: the belief, the team, a '
                'parameter or a refusal of the operator changed during the search'
            )
            search = None
        if search is None:
            if self._goal.awaits_draws:
                self._goal.ask_for_draws()
                return {}
            self._operator.withdraw()
            # The stamp is not taken from the clock, so that a restarted planner sends the same
            # message again.
            held = -1 if newest.newest is None else newest.newest.stamp
            last = self._dispatch.last_stamp
            stamp = next_name(newest.stamp, newest.mission, held, last)
            paths = self._state.paths_in_flight
            draws = self._goal.draws
            no_go = self._state.operator.no_go
            find = self._rounds.search(
                newest, agents, paths, stamp, refused, draws=draws, no_go=no_go
            )
            found = self.compute(find, self._on_search_over)
            self._search = replace(now, found=found)
            return {}
        self._search = None
        assert search.found is not None
        planned = search.found.result()
        self._rounds.warn_if_slow(planned)
        self._goal.not_worth = planned.why_not_worth or None
        if planned.why_worthless:
            self._worthless_for = search
            self._why_worthless = planned.why_worthless
            return {}
        if self.values['approval'] and not self._are_approved(planned.plans):
            self._operator.propose(planned.plans, search)
        return planned.plans

    def _on_search_over(self, _: object) -> None:
        self._deploy()
        if self._search and not self._search.is_running:
            self.get_logger().info(
                f'the plan for {some(self._search.agents)} is ready, but robots cannot leave '
                f'yet: {self.diagnostics.state}'
            )

    def _are_approved(self, plans: Plans) -> bool:
        paths = {key: plan.path for key, plan in plans.items()}
        return self._state.operator.is_approved(self._state.robots_left, paths)


def changeable(values: Mapping[str, Any]) -> list[str]:
    """Return the names of the planner's parameters that can change while it runs."""
    known = ((name, find_parameter('planner', name)) for name in values)
    return [name for name, parameter in known if parameter and not parameter.read_only]


def as_plain(value: Any) -> Any:
    """Return the value of a parameter without arrays of rclpy."""
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value


def read_planner_record(log: MissionLog, values: Mapping[str, Any], grid: Grid) -> RecordedMission:
    """Read the record of a mission to resume; check that its agents are in the team."""
    types, agents = make_robot_types(values, grid), values['agents']
    record = read_resumed(log, grid, values['max_steps'], types, values)
    for key in record.orders:
        if key.agent not in agents:
            raise ValueError(
                f'{log.path} has deployments of {key.agent}: the parameter agents names only '
                f'{", ".join(agents)}'
            )
    return record


def missing_plans(
    log: MissionLog, record: RecordedMission, agents: Collection[str], rounds: Rounds
) -> tuple[Plans, int] | None:
    """Return the plans without a recorded path in the newest round, and the mission."""
    operator = record.operator
    newest_round = None if operator.is_holding else read_newest_round(log, record)
    if newest_round is None:
        return None
    planned_on, keys = newest_round
    recorded = {key: record.paths[key] for key in keys}
    refused = operator.refused(planned_on.deployments)
    at_base = {key for key in keys if record.is_refused(key)}
    no_go = operator.no_go
    plans = rounds.missing(planned_on, list(agents), recorded, refused, at_base, no_go)
    return plans, planned_on.mission


main = partial(run, 'planner', PlannerNode)
