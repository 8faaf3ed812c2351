# SPDX-License-Identifier: Apache-2.0
"""The planner: sends the robots of its agents where the most is to be learnt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import auto, Enum
from functools import partial
import sys

from kbnitp_msgs.msg import AgentStatus, BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.base.deployments_in_flight import check_periods, DeploymentsInFlight
from kbnitp_ros.base.late_returns import LateReturns
from kbnitp_ros.base.mission_tracker import MissionTracker
from kbnitp_ros.base.reachability import cut_off_note, reach_note
from kbnitp_ros.base.refusals import Refusals
from kbnitp_ros.base.resumption import Resumption
from kbnitp_ros.base.rounds import describe_plan, Plans, Rounds
from kbnitp_ros.configuration import (
    agents_of,
    check_search,
    most_steps,
    parameter_of,
    value_for,
)
from kbnitp_ros.core import (
    deployment_order,
    DeploymentKey,
    lost_after_contact,
    NoPathError,
    observation_of,
    ORDINARY,
    Report,
)
from kbnitp_ros.log.evidence import BELIEF
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.deployments import (
    path_message,
    read_path,
    read_report,
    report_message,
    Source,
)
from kbnitp_ros.messages.headers import next_name, read_name
from kbnitp_ros.messages.missions import mission_of_path
from kbnitp_ros.messages.operator_action import Action, OperatorAction
from kbnitp_ros.messages.progress import MissionState
from kbnitp_ros.messages.sizes import (
    largest_belief,
    largest_path,
    largest_report,
    RECORDED,
    STATUS_SIZE,
)
from kbnitp_ros.messages.status import read_status
from kbnitp_ros.messages.status import State as AgentState
from kbnitp_ros.nodes.bounded_progress import BoundedProgress
from kbnitp_ros.nodes.decisions import Decisions
from kbnitp_ros.nodes.hold import Holding
from kbnitp_ros.nodes.operator_services import Operator, Proposals
from kbnitp_ros.nodes.peers import Peers
from kbnitp_ros.nodes.recorders import records
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import (
    done,
    MISSION_REASON,
    MISSION_STATE,
    State,
    waiting_for,
)
from kbnitp_ros.nodes.runtime.executor import OneByOne
from kbnitp_ros.nodes.runtime.node import FieldNode, some
from kbnitp_ros.nodes.runtime.process import run
from kbnitp_ros.nodes.search import Search, Situation
from nav_msgs.msg import Path
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription

# A field of which paths reach less than this part is worth a warning.
MOST = 0.5

# Why an estimator may never hold all deployments.
NOT_HEARD_AGAIN = (
    f', and only the last {qos.DEPTH} of each agent are heard again: restart the '
    'estimator with the parameter resume, which names the log'
)


class Obstacle(Enum):
    """What keeps robots from leaving."""

    ACTION_UNRECORDED = auto()
    NO_BELIEF = auto()
    UNREPORTED = auto()
    BELIEF_BEHIND = auto()
    ALL_DEPLOYED = auto()
    UNDECIDED = auto()
    OVER = auto()
    SEVERAL_RECORDERS = auto()
    NOT_HEARD = auto()
    ALL_LEFT = auto()
    PAUSED = auto()
    NO_FREE_AGENT = auto()
    UNAPPROVED = auto()
    SEARCHING = auto()
    WORTHLESS = auto()


# What keeps robots from leaving for a while in every mission.
PLAIN = {
    Obstacle.UNREPORTED,
    Obstacle.BELIEF_BEHIND,
    Obstacle.ALL_LEFT,
    Obstacle.SEARCHING,
}


class PlannerNode(FieldNode):
    """Publish paths, planned on the belief given all reports, for agents whose robots are home."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._agents = agents_of(self.values, self.grid)
        check_search(self.values, self.grid, {})
        check_periods(self.values, self._agents)
        self._log_reachability()
        self._paths = {
            agent: self.create_publisher(Path, f'{agent}/path', qos.EVIDENCE)
            for agent in self._agents
        }
        self._losses = {
            agent: self.create_publisher(DeploymentReport, f'{agent}/report', qos.EVIDENCE)
            for agent in self._agents
        }
        self._tracker = MissionTracker()
        self._decisions = Decisions(self, self.grid)
        self._rounds = Rounds(
            self.grid, self.values, self.get_logger().warning, self._decisions.knowledge
        )
        self._bounds = BoundedProgress(self) if self.values['bound'] else None
        self._peers = Peers(self, self._agents)
        self._in_flight = DeploymentsInFlight(self.values, qos.DEPTH)
        self._late = LateReturns(self.values)
        self._proposals = Proposals(self, self.grid, self._agents)
        self._refusals = Refusals()
        # That for the paths of the next round; those that were found are kept while robots may
        # not leave.
        self._search: Search | None = None
        # How often parameters were changed.
        self._changes = 0
        # For what nothing was found that is worth a robot, and why.
        self._worthless_for: Situation | None = None
        self._why_worthless = ''
        # Where robots go that were sent and are not known to have departed, in words.
        self._goals: dict[DeploymentKey, str] = {}
        self._holding = Holding(self)
        self._operator = Operator(
            self, self.grid, self._in_flight, self._proposals, self._holding.tell, self._act
        )
        # How many robots that were sent only the belief knows of.
        self._sent_unknown = 0
        # How many deployments the belief heard last holds, and whether it was told that an
        # estimator will never hold them all.
        self._held = 0
        self._is_incomplete_told = False
        self._last_stamp = 0
        self._is_heard = False
        self._end_told = ''
        if self.values['resume']:
            self._restore(self.values['resume'])
            self._decisions.restore(self.values['resume'])
            if refusal := self._too_few(self.values['robots']):
                raise ValueError(refusal)
        self._holding.tell(self._operator.state.is_holding)
        self.add_on_set_parameters_callback(self._check_changes)
        self.add_post_set_parameters_callback(lambda _: self._note_change())
        # Before the beliefs: none holds a path that was not heard.
        self._sent_paths = {agent: self._hear_paths(agent) for agent in self._agents}
        self._beliefs = self._hear_beliefs()
        for agent in self._agents:
            self.hear(
                DeploymentReport,
                f'{agent}/report',
                partial(self._on_report, agent),
                qos.EVIDENCE,
                largest_report(value_for(self.values, 'max_steps', agent)),
            )
            self.hear(
                AgentStatus,
                f'{agent}/status',
                partial(self._on_status, agent),
                qos.EVIDENCE,
                STATUS_SIZE,
            )
            if self.values['recorded']:
                self.hear(
                    Recorded,
                    f'{agent}/recorded',
                    partial(self._on_recorded, agent),
                    qos.EVIDENCE,
                    RECORDED,
                )
        self.create_look(self._look_at_graph)
        self.create_poll(self._go_on)

    def _restore(self, log: str) -> None:
        """Publish the paths on record again: those sent before are known to nobody else now."""
        resumed = Resumption(log, self.grid, self.values, self._agents)
        for action, message in resumed.actions:
            self._operator.restore(action, message)
        for key, recorded in resumed.deployments.items():
            if not recorded.is_refused:
                self._paths[key.agent].publish(recorded.message)
        resumed.note(self._in_flight, self._rounds)
        for key, report in resumed.losses():
            self._losses[key.agent].publish(report)
            self._late.expect(key, resumed.deployments[key].path)
        self._last_stamp = resumed.last_stamp
        for key, steps_survived in resumed.operator.given_up.items():
            if key in self._in_flight:
                self._give_up(key, Source.OPERATOR, steps_survived)
        self._tracker.mission = resumed.mission
        if missing := resumed.missing(self._rounds):
            self._send(*missing)

    def _log_reachability(self) -> None:
        """Say what no path comes to; a warning if that is most of the field."""
        log, max_steps = self.get_logger(), most_steps(self.values)
        if note := reach_note(self.grid, max_steps):
            (log.warning if reach_note(self.grid, max_steps, MOST) else log.info)(note)
        if note := cut_off_note(self.grid):
            log.info(note)

    def _too_few(self, robots: int) -> str:
        """Return why there must be more robots than these; empty when enough."""
        if robots >= self._sent:
            return ''
        return (
            f'parameter robots is {robots}: {self._sent} robots were sent, and it must be at '
            f'least that; {self._sent} ends the mission'
        )

    def _check_changes(self, changes: Sequence[Parameter]) -> SetParametersResult:
        """Refuse fewer robots than were sent, and searches that take too much memory."""
        known = {each.name: parameter_of('planner', each.name) for each in changes}
        try:
            given = {
                each.name: parameter.check(each.value)
                for each in changes
                if (parameter := known[each.name])
            }
            newest = self._tracker.newest
            check_search(self.values | given, self.grid, newest.robot_types if newest else {})
            refusal = self._too_few(given['robots']) if 'robots' in given else ''
        except ValueError as error:
            refusal = str(error)
        return SetParametersResult(successful=not refusal, reason=refusal)

    def _note_change(self) -> None:
        """Have what was planned by other parameters count no longer."""
        self._changes += 1
        self._decisions.review()

    def _hear_beliefs(self) -> Subscription:
        largest = largest_belief(self.grid.cells)
        return self.hear(BeliefMaps, 'belief', self._on_belief, qos.LATCHED, largest)

    def _hear_paths(self, agent: str) -> Subscription:
        """Take the paths of an agent, which another planner may send."""
        largest = largest_path(value_for(self.values, 'max_steps', agent))
        return self.hear(
            Path, f'{agent}/path', partial(self._on_path, agent), qos.EVIDENCE, largest
        )

    def _look_at_graph(self) -> None:
        self._peers.look_for_agents()
        self._peers.look_for_planners()
        if self._peers.look_for_estimators():
            self._hear_beliefs_anew()
        if self.values['recorded']:
            self._peers.look_for_recorders()
        self._peers.look_for_unknown_agents()

    def _go_on(self) -> None:
        self._tell_departures()
        self._give_up_overdue()
        self._deploy()

    def _on_belief(self, message: BeliefMaps) -> None:
        try:
            snapshot = read_belief_maps(message)
            self._check_rules(snapshot)
            known = self._known(snapshot.mission)
            self._tracker.check_belief(snapshot, self.count_authors('belief', BELIEF), known)
        except ValueError as error:
            self.diagnostics.refuse('belief', error)
            return
        self.diagnostics.accept()
        unknown = snapshot.deployments - self._in_flight.sent
        if unknown > self._sent_unknown:
            self.get_logger().warning(
                f'the belief holds {unknown} deployments more than are '
                'known here: their paths died with the planner before this one, and a restarted '
                'estimator will lack them, unless the parameter resume names the log'
            )
            self._sent_unknown = unknown
        self._notice_incomplete(snapshot.deployments)
        if self._tracker.accept_belief(snapshot, known):
            self._decisions.take(snapshot)
            self._deploy()

    def _known(self, mission: int) -> int:
        """Return how many deployments of a mission may be in a belief, as far as known here."""
        # Each agent may have had a robot out when the planner before this one died.
        out_before = len(self._agents) if self._sent_unknown else 0
        return self._in_flight.known(mission) + out_before

    @property
    def _sent(self) -> int:
        """How many robots were sent, those that only the belief knows of included."""
        return self._in_flight.sent + self._sent_unknown

    def _notice_incomplete(self, held: int) -> None:
        """Say if an estimator was restarted that will never hear of all deployments."""
        self._held = held
        # One that has the log publishes its prior, and then a belief in all that is on record.
        if 0 < held < self._in_flight.forgotten and not self._is_incomplete_told:
            self._is_incomplete_told = True
            self.diagnostics.refuse('belief', f'it holds {held} deployments{NOT_HEARD_AGAIN}')

    def _check_rules(self, snapshot: Snapshot) -> None:
        if snapshot.grid != self.grid:
            raise ValueError(f'it is on {snapshot.grid}: the parameters say {self.grid}')
        check_search(self.values, self.grid, snapshot.robot_types)
        for agent in self._agents:
            own = value_for(self.values, 'max_steps', agent)
            theirs = snapshot.robot_types.get(agent, ORDINARY).max_steps or snapshot.max_steps
            if theirs < own:
                raise ValueError(
                    f'max_steps is {theirs} for {agent}: the parameter max_steps is {own}, and '
                    'the estimator would refuse such paths'
                )

    def _on_report(self, agent: str, message: DeploymentReport) -> None:
        try:
            key, report = read_report(message, agent)
            if key in self._in_flight:
                # The estimator would refuse it too, and the robot is still out.
                path = self._in_flight[key].path
                max_steps = value_for(self.values, 'max_steps', agent)
                observation_of(report, key, path, self.grid, max_steps)
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/report', error)
            return
        self._tell_departure(key)
        self._in_flight.end(key, report.stamp if report.survived else None)
        if report.survived:
            self._late.end(key)
            self._warn_of_stay(key, report)
        self._decisions.knowledge.note_report(key, report)
        self._deploy()

    def _warn_of_stay(self, key: DeploymentKey, report: Report) -> None:
        """Say that a robot has used up an order without leaving the base."""
        if all(cell == self.grid.base for cell, _ in report.readings):
            self.get_logger().warning(
                f'{key} is back without a step, which counts as a deployment: the console of '
                'its robot tells why'
            )

    def _on_status(self, agent: str, message: AgentStatus) -> None:
        """Take note of what an agent does with an order."""
        try:
            key, status = read_status(message, agent)
            robot = self._in_flight.get(key)
            if not self._in_flight.take(key, status):
                return
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/status', error)
            return
        self.diagnostics.accept()
        if status.state is AgentState.REFUSED and robot is not None:
            self._rounds.forget_path(robot.path)
            self._refusals.add(agent)
            self._goals.pop(key, None)
            self.get_logger().warning(
                f'{key} is refused by its agent, and its robot stays at the base: '
                f'{status.reason}; nothing is learnt of it'
            )
        self._tell_departures()

    def _tell_departures(self) -> None:
        """Tell on the console which robots have departed."""
        for key in [key for key in self._goals if self._in_flight.has_departed(key)]:
            self._tell_departure(key)

    def _tell_departure(self, key: DeploymentKey) -> None:
        if goal := self._goals.pop(key, None):
            self._refusals.clear(key.agent)
            self.deployment_logger.info(f'{key} leaves {goal}')

    def _on_path(self, agent: str, message: Path) -> None:
        """Take note of a path: the recorder may have that of another planner on disk."""
        try:
            key, cells = read_path(self.grid, agent, message)
            path = self.grid.check_path(cells, value_for(self.values, 'max_steps', agent))
            mission = mission_of_path(message)
            is_other = self._in_flight.hear(key, path, content_hash(message), mission)
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/path', error)
            return
        if is_other:
            self.diagnostics.refuse(
                f'{agent}/path',
                f'{key} follows the path of another planner, which the recorder wrote first; the '
                'path that this planner sent is not used',
            )

    def _on_recorded(self, agent: str, message: Recorded) -> None:
        try:
            key = DeploymentKey(agent, read_name('stamp', message.stamp))
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/recorded', error)
            return
        if self._in_flight.record(key, message.content):
            # Whoever sent it keeps it for those who ask later.
            self.destroy_subscription(self._sent_paths[agent])
            self._sent_paths[agent] = self._hear_paths(agent)
        self._tell_departures()

    def _hear_beliefs_anew(self) -> None:
        """
        Ask for the belief of the estimators that stay when one of several has left.

        It may have been refused for that of the other, or held to be older.
        """
        self._tracker.newest = None
        self.destroy_subscription(self._beliefs)
        self._beliefs = self._hear_beliefs()

    def _give_up_overdue(self) -> None:
        """Report robots lost that should have been back for long."""
        if not self.values['silent_loss']:
            return
        for key in self._in_flight.overdue(self.now()):
            self._give_up(key, Source.SILENCE)

    def _give_up(self, key: DeploymentKey, source: Source, steps_survived: int = 0) -> None:
        """Report a robot lost that is out."""
        self._tell_departure(key)
        path, contact = self._in_flight[key].path, self.values['contact_probability']
        lost = lost_after_contact(path, steps_survived, contact)
        self._losses[key.agent].publish(report_message(key, lost, self.now(), source))
        self._in_flight.end(key)
        self._late.expect(key, path)

    def _act(self, action: OperatorAction) -> None:
        """Do what follows from an action of the operator."""
        if action.action == Action.GIVE_UP:
            for key in action.paths:
                if key in self._in_flight:
                    self._give_up(key, Source.OPERATOR, action.steps_survived)
        self._deploy()

    def _deploy(self) -> None:
        """Send the next robots, unless something must come first."""
        newest = self._tracker.newest
        if obstacle := self._obstacle(newest.deployments if newest else None):
            self._tell(obstacle)
            if obstacle is not Obstacle.ACTION_UNRECORDED:
                self._proposals.withdraw()
            is_over = obstacle in (Obstacle.ALL_DEPLOYED, Obstacle.OVER)
            if is_over and not self.values['keep_running'] and not self._late.awaited:
                self.end()
            return
        assert newest is not None
        try:
            plans = self._next_plans(newest)
        except NoPathError as error:
            self._decisions.note_not_worth(error)
        if self._decisions.why_over():
            self._deploy()
            return
        if not plans:
            self._tell(Obstacle.SEARCHING if self._search else Obstacle.WORTHLESS)
            return
        if self.values['approval'] and not self._are_approved(plans):
            self._tell(Obstacle.UNAPPROVED)
            return
        self._proposals.withdraw()
        self._send(plans, newest.mission)

    def _tell(self, obstacle: Obstacle) -> None:
        """Tell what keeps robots from leaving, and at once another state of the mission."""
        self.diagnostics.state = self._state_at(obstacle)
        state = MissionState.RUNNING
        if self._operator.state.is_ended:
            state = MissionState.ENDED
        elif obstacle in (Obstacle.ALL_DEPLOYED, Obstacle.OVER):
            state = MissionState.DONE
        elif self._operator.state.is_paused:
            state = MissionState.PAUSED
        before = self.diagnostics.values.get(MISSION_STATE)
        self.diagnostics.values |= {
            MISSION_STATE: state.name,
            MISSION_REASON: '' if obstacle in PLAIN else self.diagnostics.state.sentence,
        }
        if state.name != before:
            self.diagnostics.publish()
        if obstacle in (Obstacle.ALL_DEPLOYED, Obstacle.OVER):
            self._tell_end(self.diagnostics.state.sentence)

    def _tell_end(self, how: str) -> None:
        """Tell once how the mission ended, and until when the base stays."""
        if how == self._end_told:
            return
        self._end_told = how
        self.get_logger().info(f'the mission is over: {how}')
        if not self.values['keep_running'] and (late := self._late.awaited):
            self.get_logger().info(
                f'the base stays for {max(late.values()):.0f} s at the most, in which robots that '
                f'were given up may come home: {some(late)}'
            )

    def _next_plans(self, newest: Snapshot) -> Plans:
        """
        Return the plans of the robots to leave next; those that are proposed if they are it.

        There are none as long as they are searched for.
        """
        agents = self._free_agents()[: self._robots - self._sent]
        refused = self._operator.state.refused(self._in_flight.sent)
        belief = newest.stamp, newest.deployments
        now = Situation(belief, agents, len(refused), self._changes)
        if self._proposals.are_for(now):
            return self._proposals.plans
        search = self._search
        if self._worthless_for == now or (search is not None and not search.is_over):
            return {}
        if search is None or not self._is_wanted(search, now):
            self._proposals.withdraw()
            stamp, paths = self._next_stamp(newest), self._in_flight.paths
            find = self._rounds.search(newest, agents, paths, stamp, refused)
            self._search = Search(find, now, self._wake)
            return {}
        self._search = None
        planned = search.found()
        self._rounds.say_if_slow(planned)
        self._decisions.note_not_worth(planned.why_not_worth)
        if planned.why_worthless:
            self._worthless_for = search.situation
            self._why_worthless = planned.why_worthless
            return {}
        if self.values['approval'] and not self._are_approved(planned.plans):
            self._proposals.show(planned.plans, search.situation)
        for plan in planned.plans.values():
            if self._bounds and plan.upper_bound is not None:
                self._bounds.show(newest.stamp, plan.upper_bound)
        return planned.plans

    def _is_wanted(self, search: Search, now: Situation) -> bool:
        """Return whether robots may leave on what a search has found."""
        is_wanted = search.situation.lasts(now, self.values['rolling'])
        if not is_wanted:
            self.get_logger().info(
                f'the paths found for {some(search.situation.agents)} are dropped: the belief, '
                'the team, a parameter or what the operator refuses has changed since the search '
                'began'
            )
        return is_wanted

    def _wake(self) -> None:
        """Have the thread of all callbacks look at what was found."""
        executor = self.executor
        if isinstance(executor, OneByOne):
            executor.call_next(self._on_search_over)

    def _on_search_over(self) -> None:
        self._deploy()
        if self._search and self._search.is_over:
            self.get_logger().info(
                f'paths were found for {some(self._search.situation.agents)}, and are kept: '
                f'{self.diagnostics.state.sentence}'
            )

    def _are_approved(self, plans: Plans) -> bool:
        paths = {key: plan.path for key, plan in plans.items()}
        return self._operator.state.is_approved(self._in_flight.sent, paths)

    @property
    def _robots(self) -> int:
        """How many robots are to be deployed; after the end those that have departed."""
        if self._operator.state.is_ended:
            return self._sent - len(self._in_flight.undeparted)
        robots: int = self.values['robots']
        return robots

    def _send(self, plans: Plans, mission: int) -> None:
        """Publish the paths of robots that leave now; the first ones begin a mission."""
        mission = self._tracker.begin(mission)
        for key, plan in plans.items():
            message = path_message(self.grid, plan.path, key.stamp, mission)
            self._in_flight.send(key, plan.path, content_hash(message))
            self._rounds.note_path(plan.path)
            self._decisions.knowledge.note_path(key, plan.path, content_hash(message))
            self._paths[key.agent].publish(message)
            self._goals[key] = describe_plan(self.grid, plan)
            self._last_stamp = max(self._last_stamp, key.stamp)

    def _free_agents(self) -> list[str]:
        """Return the agents that somebody answers for and whose robots are home."""
        busy = self._in_flight.agents
        return [
            agent
            for agent in self._agents
            if self._peers.is_present(agent)
            and agent not in busy
            and not self._refusals.is_left_alone(agent)
            and not self._is_mute(agent)
        ]

    def _is_mute(self, agent: str) -> bool:
        """Return whether an agent does not say when it departs, and its silence would count."""
        is_presumed = self.values['presume_departure'] or not self.values['silent_loss']
        return not is_presumed and not self._peers.says_status(agent)

    def _next_stamp(self, newest: Snapshot) -> int:
        """
        Return the stamp that names the first deployment to be planned on a belief.

        It is the belief's own, so that a planner which was restarted, and no longer knows what it
        sent, sends the very same message again, which changes nothing. None is used twice, even
        if the clock jumps back, and none is the time that names the mission.
        """
        held = -1 if newest.newest is None else newest.newest.stamp
        return next_name(newest.stamp, newest.mission, held, self._last_stamp)

    def _obstacle(self, held: int | None) -> Obstacle | None:
        """
        Return what keeps the next robots from leaving; None when nothing.

        Parameters
        ----------
        held : int or None
            How many deployments the newest belief holds; None if there is none.

        """
        if self._operator.awaited:
            return Obstacle.ACTION_UNRECORDED
        if held is None and (self._sent or not self._operator.state.is_ended):
            return Obstacle.NO_BELIEF
        held = held or 0
        if self._unreported and not self.values['rolling']:
            return Obstacle.UNREPORTED
        if held < self._reported:
            return Obstacle.BELIEF_BEHIND
        if held >= self._robots:
            return Obstacle.ALL_DEPLOYED
        if not self._decisions.is_ready():
            return Obstacle.UNDECIDED
        if self._decisions.why_over():
            return Obstacle.UNREPORTED if self._unreported else Obstacle.OVER
        if len(self._peers.recorders) > 1:
            return Obstacle.SEVERAL_RECORDERS
        if not self._is_heard and self._missing_listeners:
            return Obstacle.NOT_HEARD
        self._is_heard = True
        if self._sent >= self._robots:
            return Obstacle.ALL_LEFT
        if self._operator.state.is_paused:
            return Obstacle.PAUSED
        return None if self._free_agents() else Obstacle.NO_FREE_AGENT

    @property
    def _unreported(self) -> list[DeploymentKey]:
        """Return the deployments in flight that the next round waits for."""
        # An agent that has left the graph does not keep the others from their next round, nor do
        # robots that do not depart any more keep a mission from its end.
        left_out = self._in_flight.undeparted if self._operator.state.is_ended else ()
        return [
            key
            for key in self._in_flight
            if self._peers.is_present(key.agent) and key not in left_out
        ]

    @property
    def _reported(self) -> int:
        """How many deployments were reported, so that a belief must hold them."""
        return self._sent - len(self._in_flight)

    @property
    def _missing_listeners(self) -> str:
        missing = self.missing_listeners(self._paths.values())
        if missing or 'agent' not in self.values['await_nodes']:
            return missing
        # In a field that changes every simulating agent listens to the paths of all.
        absent = [agent for agent in self._agents if not self._peers.is_present(agent)]
        return f'agent to answer for {some(absent)} (parameter await_nodes)' if absent else ''

    def _state_at(self, obstacle: Obstacle) -> State:
        """Return what the planner does while an obstacle keeps robots from leaving."""
        if obstacle is Obstacle.ALL_DEPLOYED:
            return done(self._how_it_ended())
        if obstacle is Obstacle.OVER:
            return done(f'{self._how_it_ended()}: {self._decisions.why_over()}')
        awaited: dict[Obstacle, Callable[[], str]] = {
            Obstacle.ACTION_UNRECORDED: lambda: self._operator.awaited,
            Obstacle.NO_BELIEF: self._first_belief,
            Obstacle.UNREPORTED: self._report,
            Obstacle.BELIEF_BEHIND: self._next_belief,
            Obstacle.UNDECIDED: lambda: (
                'all evidence of the belief, for the goal: restart the planner with the parameter '
                'resume, which names the log'
            ),
            Obstacle.SEVERAL_RECORDERS: lambda: (
                f'all but one recorder to end: {records(self._peers.recorders)}'
            ),
            Obstacle.NOT_HEARD: lambda: self._missing_listeners,
            Obstacle.ALL_LEFT: lambda: (
                f'robots that were sent: {some(self._in_flight)}; no more are (parameter robots)'
            ),
            Obstacle.PAUSED: lambda: (
                'the operator to end the pause by the service '
                f'{self.resolve_service_name("pause")}'
            ),
            Obstacle.NO_FREE_AGENT: self._free_agent,
            Obstacle.UNAPPROVED: self._approval,
            Obstacle.SEARCHING: self._searching,
            Obstacle.WORTHLESS: lambda: (
                f'the operator, since nothing is worth a robot: {self._why_worthless}; other '
                'parameters, or the service '
                f'{self.resolve_service_name("end_mission")}, go on'
            ),
        }
        return waiting_for(awaited[obstacle]())

    def _how_it_ended(self) -> str:
        newest = self._tracker.newest
        held = newest.deployments if newest else 0
        by_operator = ', ended by the operator' * self._operator.state.is_ended
        return f'{held} of {self.values["robots"]} robots deployed{by_operator}'

    def _next_belief(self) -> str:
        wait = f'a belief that holds {self._reported} deployments'
        if self._held < self._reported and self._in_flight.forgotten:
            return f'{wait}; the last one holds {self._held}{NOT_HEARD_AGAIN}'
        return f'{wait} on {self._of_whom("belief", self._peers.estimators)}'

    def _of_whom(self, topic: str, publishers: int) -> str:
        """Return the full name of a topic, and whether it is told by anybody."""
        name = self.resolve_topic_name(topic)
        return name if publishers else f'{name}, which nobody publishes'

    def _first_belief(self) -> str:
        wait = f'the belief on {self._of_whom("belief", self._peers.estimators)}'
        if not self._peers.estimators:
            return f'{wait}: start an estimator'
        return f'{wait}: its estimator waits for those that its parameter await_nodes names'

    def _searching(self) -> str:
        assert self._search
        return f'the search for the paths of {some(self._search.situation.agents)} to end'

    def _approval(self) -> str:
        topics = [
            self.resolve_topic_name(f'{key.agent}/proposal') for key in self._proposals.plans
        ]
        return (
            f'the operator to approve of {some(topics)} by the service '
            f'{self.resolve_service_name("approve")} (parameter approval)'
        )

    def _report(self) -> str:
        """Return which report is awaited first, and what ends the wait."""
        key = min(self._unreported, key=deployment_order)
        agent = self.resolve_topic_name(key.agent)
        wait = f'{key} to be reported on {agent}/report'
        if self.values['recorded'] and not self._in_flight[key].is_recorded:
            return (
                f'{wait}: it may leave when the recorder tells on {agent}/recorded that its '
                'path is on disk (parameter recorded)'
            )
        if not self._in_flight.has_departed(key) and self._peers.says_status(key.agent):
            return (
                f'{key} to depart, as its agent tells on {agent}/status; it is not given up before'
            )
        if self.values['silent_loss']:
            deadline = self.values['return_deadline']
            return (
                f'{wait}, at most until {deadline} s after it is due (parameter return_deadline)'
            )
        return f'{wait}, however long that takes (parameter silent_loss is false)'

    def _free_agent(self) -> str:
        """Return that an agent is awaited, and why each of the team is not free."""
        absent = [
            self.resolve_topic_name(f'{agent}/report')
            for agent in self._agents
            if not self._peers.is_present(agent)
        ]
        mute = [
            self.resolve_topic_name(f'{agent}/status')
            for agent in self._agents
            if self._peers.is_present(agent) and self._is_mute(agent)
        ]
        resting = [agent for agent in self._agents if self._refusals.is_left_alone(agent)]
        reasons = [
            f'nobody publishes {some(absent)}' if absent else '',
            f'{some(self._in_flight)} are out' if self._in_flight else '',
            f'{some(resting)} refused the last order' if resting else '',
            f'nobody publishes {some(mute)}, so that the silence of a robot that has not left '
            'would count as its loss (parameter presume_departure)'
            if mute
            else '',
        ]
        why = '; '.join(filter(None, reasons))
        return f'an agent whose robot is home: {why} (parameter agents)'


def main(args: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run('planner', PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
