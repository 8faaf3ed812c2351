# SPDX-License-Identifier: Apache-2.0
"""The planner: sends the robots of its agents where the most is to be learnt."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
import sys

from builtin_interfaces.msg import Time
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import (
    deployment_order,
    DeploymentKey,
    Observation,
    observation_of,
    ORDINARY,
)
from kbnitp_ros.log.decisions import read_decisions
from kbnitp_ros.log.deployments import read_deployments, read_mission, read_newest_round
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.decisions import Action, Decision
from kbnitp_ros.messages.deployments import path_message, read_report, report_message
from kbnitp_ros.messages.headers import LAST_COUNTED_ON, next_name, read_name
from kbnitp_ros.messages.sizes import largest_belief, largest_report, TIME
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.field import FieldNode
from kbnitp_ros.nodes.operator_services import Operator
from kbnitp_ros.nodes.parameters import (
    agents_of,
    check_search,
    kinds_of,
    most_steps,
    parameter_of,
    value_for,
)
from kbnitp_ros.nodes.peers import Peers
from kbnitp_ros.nodes.proposals import Proposals
from kbnitp_ros.nodes.reach import cut_off_note, reach_note
from kbnitp_ros.nodes.robots_out import RobotsOut
from kbnitp_ros.nodes.rounds import in_words, Plans, Rounds
from kbnitp_ros.nodes.shell import run, some
from kbnitp_ros.nodes.succession import Succession
from nav_msgs.msg import Path
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription

# A field of which paths reach less than this part is worth a warning.
MOST = 0.5

# How the state begins of a mission that is over.
DONE = 'done'

# Why an estimator may never hold all deployments.
NOT_HEARD_AGAIN = (
    f', and only the last {qos.DEPTH} of each agent are heard again: restart the '
    'estimator with the parameter resume, which names the log'
)


class PlannerNode(FieldNode):
    """Publish paths, planned on the belief given all reports, for agents whose robots are home."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._agents = agents_of(self.values, self.grid)
        check_search(self.values, self.grid)
        self._say_what_is_out_of_reach()
        self._paths = {
            agent: self.create_publisher(Path, f'{agent}/path', qos.EVIDENCE)
            for agent in self._agents
        }
        self._losses = {
            agent: self.create_publisher(DeploymentReport, f'{agent}/report', qos.EVIDENCE)
            for agent in self._agents
        }
        self._succession = Succession()
        self._rounds = Rounds(self.grid, self.values, self.get_logger())
        self._peers = Peers(self, self._agents)
        self._out = RobotsOut(self.values)
        self._proposals = Proposals(self, self.grid, self._agents)
        self._operator = Operator(self, self.grid, self._out, self._proposals, self._act)
        # How many robots that have left only the belief knows of.
        self._left_unknown = 0
        # How many deployments the belief heard last holds, and whether it was told that an
        # estimator will never hold them all.
        self._held = 0
        self._is_incomplete_told = False
        self._last_stamp = 0
        self._is_heard = False
        if self.values['resume']:
            self._restore(self.values['resume'])
            if refusal := self._too_few(self.values['robots']):
                raise ValueError(refusal)
        self.add_on_set_parameters_callback(self._check_changes)
        self._beliefs = self._hear_beliefs()
        for agent in self._agents:
            self.hear(
                DeploymentReport,
                f'{agent}/report',
                partial(self._on_report, agent),
                qos.EVIDENCE,
                largest_report(value_for(self.values, 'max_steps', agent)),
            )
            if self.values['recorded']:
                self.hear(
                    Time,
                    f'{agent}/recorded',
                    partial(self._on_recorded, agent),
                    qos.EVIDENCE,
                    TIME,
                )
        self.create_poll(self._look)

    def _restore(self, log: str) -> None:
        """Publish the paths on record again: those sent before are known to nobody else now."""
        deployments = read_deployments(
            log, self.grid, self.values['max_steps'], kinds_of(self.values)
        )
        for decision, message in read_decisions(log, self.grid):
            self._operator.restore(decision, message)
        given_up = self._operator.decisions.given_up
        for key, recorded in deployments.items():
            if key.agent not in self._paths:
                raise ValueError(
                    f'{log} has deployments of {key.agent}: the parameter agents names only '
                    f'{", ".join(self._agents)}'
                )
            self._paths[key.agent].publish(recorded.message)
            self._out.leave(key, recorded.path)
            self._rounds.note_path(recorded.path)
            self._out.record(key)
            if recorded.observation is not None:
                self._out.end(key)
                is_own = self.values['silent_loss'] or key in given_up
                if is_own and not recorded.observation.survived:
                    # Said by the planner before this one.
                    again = report_message(key, recorded.observation, recorded.reported)
                    self._losses[key.agent].publish(again)
            if key.stamp <= LAST_COUNTED_ON:
                self._last_stamp = key.stamp
        for key, steps_survived in given_up.items():
            if key in self._out:
                self._give_up(key, steps_survived)
        self._succession.mission = read_mission(log)
        # Of one robot, or where each leaves by itself, no part can be missing.
        if len(self._agents) == 1 or self.values['rolling']:
            return
        if self._operator.decisions.is_paused or self._operator.decisions.is_ended:
            return
        if newest_round := read_newest_round(log, deployments):
            planned_on, keys = newest_round
            recorded_paths = {key: deployments[key].path for key in keys}
            refused = self._operator.decisions.refused(planned_on.deployments)
            missing = self._rounds.missing(planned_on, self._agents, recorded_paths, refused)
            self._send(missing, planned_on.mission)

    def _say_what_is_out_of_reach(self) -> None:
        """Say what no path comes to; a warning if that is most of the field."""
        log, max_steps = self.get_logger(), most_steps(self.values)
        if note := reach_note(self.grid, max_steps):
            (log.warning if reach_note(self.grid, max_steps, MOST) else log.info)(note)
        if note := cut_off_note(self.grid):
            log.info(note)

    def _too_few(self, robots: int) -> str:
        """Return why there must be more robots than these; empty when enough."""
        if robots >= self._left:
            return ''
        return (
            f'parameter robots is {robots}: {self._left} robots have left, and it must be at '
            f'least that; {self._left} ends the mission'
        )

    def _check_changes(self, changes: Sequence[Parameter]) -> SetParametersResult:
        """Refuse fewer robots than have left, and searches that take too much memory."""
        known = {each.name: parameter_of('planner', each.name) for each in changes}
        try:
            given = {
                each.name: parameter.check(each.value)
                for each in changes
                if (parameter := known[each.name])
            }
            check_search(self.values | given, self.grid)
            refusal = self._too_few(given['robots']) if 'robots' in given else ''
        except ValueError as error:
            refusal = str(error)
        return SetParametersResult(successful=not refusal, reason=refusal)

    def _hear_beliefs(self) -> Subscription:
        largest = largest_belief(self.grid.cells)
        return self.hear(BeliefMaps, 'belief', self._on_belief, qos.LATCHED, largest)

    def _look(self) -> None:
        self._peers.look_for_agents()
        if self._peers.look_for_estimators():
            self._hear_beliefs_anew()
        self._peers.look_for_unknown_agents()
        self._give_up_overdue()
        self._deploy()

    def _on_belief(self, message: BeliefMaps) -> None:
        try:
            snapshot = read_belief_maps(message)
            self._check_rules(snapshot)
            self._succession.check(snapshot, self._peers.estimators, self._left)
        except ValueError as error:
            self.diagnostics.refuse('belief', error)
            return
        self.diagnostics.accept()
        unknown = snapshot.deployments - self._out.left
        if unknown > self._left_unknown:
            self.get_logger().warning(
                f'the belief holds {unknown} deployments more than are '
                'known here: their paths died with the planner before this one, and a restarted '
                'estimator will lack them, unless the parameter resume names the log'
            )
            self._left_unknown = unknown
        self._notice_incomplete(snapshot.deployments)
        if self._succession.take(snapshot):
            self._deploy()

    @property
    def _left(self) -> int:
        """How many robots have left, those that only the belief knows of included."""
        return self._out.left + self._left_unknown

    def _notice_incomplete(self, held: int) -> None:
        """Say if an estimator was restarted that will never hear of all deployments."""
        self._held = held
        # One that has the log publishes its prior, and then a belief in all that is on record.
        if 0 < held < self._out.forgotten and not self._is_incomplete_told:
            self._is_incomplete_told = True
            self.diagnostics.refuse('belief', f'it holds {held} deployments{NOT_HEARD_AGAIN}')

    def _check_rules(self, snapshot: Snapshot) -> None:
        if snapshot.grid != self.grid:
            raise ValueError(f'it is on {snapshot.grid}: the parameters say {self.grid}')
        for agent in self._agents:
            own = value_for(self.values, 'max_steps', agent)
            theirs = snapshot.kinds.get(agent, ORDINARY).max_steps or snapshot.max_steps
            if theirs < own:
                raise ValueError(
                    f'max_steps is {theirs} for {agent}: the parameter max_steps is {own}, and '
                    'the estimator would refuse such paths'
                )

    def _on_report(self, agent: str, message: DeploymentReport) -> None:
        try:
            key, report = read_report(message, agent)
            if key in self._out:
                # The estimator would refuse it too, and the robot is still out.
                path = self._out[key].path
                max_steps = value_for(self.values, 'max_steps', agent)
                observation_of(report, key, path, self.grid, max_steps)
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/report', error)
            return
        self._out.end(key)
        self._deploy()

    def _on_recorded(self, agent: str, message: Time) -> None:
        try:
            self._out.record(DeploymentKey(agent, read_name('stamp', message)))
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/recorded', error)

    def _hear_beliefs_anew(self) -> None:
        """
        Ask for the belief of the estimators that stay when one of several has left.

        It may have been refused for that of the other, or held to be older.
        """
        self._succession.newest = None
        self._left_unknown = 0
        self.destroy_subscription(self._beliefs)
        self._beliefs = self._hear_beliefs()

    def _give_up_overdue(self) -> None:
        """Report robots lost that should have been back for long."""
        if not self.values['silent_loss']:
            return
        for key in self._out.overdue(self.now()):
            self._give_up(key)

    def _give_up(self, key: DeploymentKey, steps_survived: int = 0) -> None:
        """Report a robot lost that is out."""
        lost = Observation(self._out[key].path, False, steps_survived=steps_survived)
        self._losses[key.agent].publish(report_message(key, lost, self.now()))
        self._out.end(key)

    def _act(self, decision: Decision) -> None:
        """Do what the operator has decided."""
        if decision.action == Action.GIVE_UP:
            for key in decision.paths:
                if key in self._out:
                    self._give_up(key, decision.steps_survived)
        self._deploy()

    def _deploy(self) -> None:
        """Send the next robots, unless something must come first."""
        newest = self._succession.newest
        if decision := self._operator.awaited:
            self.diagnostics.state = decision
            return
        if reason_to_wait := self._reason_to_wait(newest.deployments if newest else None):
            self.diagnostics.state = reason_to_wait
            self._proposals.withdraw()
            if reason_to_wait.startswith(DONE) and not self.values['keep_running']:
                self.end()
            return
        assert newest is not None
        plans = self._next_plans(newest)
        if self.values['approval'] and not self._are_approved(plans):
            self.diagnostics.state = self._waiting_for_approval()
            return
        self._proposals.withdraw()
        self._send(plans, newest.mission)

    def _next_plans(self, newest: Snapshot) -> Plans:
        """Return the plans of the robots to leave next; those that are proposed if they are it."""
        agents = self._free_agents()[: self._robots - self._left]
        refused = self._operator.decisions.refused(self._out.left)
        situation = newest.stamp, newest.deployments, agents, len(refused)
        if self._proposals.are_for(situation):
            return self._proposals.plans
        stamp = self._next_stamp(newest)
        plans = self._rounds.plan(newest, agents, self._out.paths, stamp, refused)
        if self.values['approval'] and not self._are_approved(plans):
            self._proposals.show(plans, situation)
        return plans

    def _are_approved(self, plans: Plans) -> bool:
        paths = {key: plan.path for key, plan in plans.items()}
        return self._operator.decisions.is_approved(self._out.left, paths)

    @property
    def _robots(self) -> int:
        """How many robots are to be deployed."""
        return self._left if self._operator.decisions.is_ended else self.values['robots']

    def _send(self, plans: Plans, mission: int) -> None:
        """Publish the paths of robots that leave now; the first ones begin a mission."""
        mission = self._succession.begin(mission)
        for key, plan in plans.items():
            self._out.leave(key, plan.path)
            self._rounds.note_path(plan.path)
            message = path_message(self.grid, plan.path, key.stamp, mission)
            self._paths[key.agent].publish(message)
            self.tell_deployment(f'{key} leaves {in_words(self.grid, plan)}')
            self._last_stamp = max(self._last_stamp, key.stamp)

    def _free_agents(self) -> list[str]:
        """Return the agents that somebody answers for and whose robots are home."""
        busy = self._out.agents
        return [
            agent for agent in self._agents if self._peers.is_present(agent) and agent not in busy
        ]

    def _next_stamp(self, newest: Snapshot) -> int:
        """
        Return the stamp that names the first deployment to be planned on a belief.

        It is the belief's own, so that a planner which was restarted, and no longer knows what it
        sent, sends the very same message again, which changes nothing. None is used twice, even
        if the clock jumps back, and none is the time that names the mission.
        """
        held = -1 if newest.newest is None else newest.newest.stamp
        return next_name(newest.stamp, newest.mission, held, self._last_stamp)

    def _reason_to_wait(self, held: int | None) -> str:
        """
        Return what must come before the next deployment; empty when nothing.

        Parameters
        ----------
        held : int or None
            How many deployments the newest belief holds; None if there is none.

        """
        if held is None and (self._left or not self._operator.decisions.is_ended):
            return self._waiting_for_belief()
        held = held or 0
        # An agent that has left the graph does not keep the others from their next round.
        awaited = [key for key in self._out if self._peers.is_present(key.agent)]
        if awaited and not self.values['rolling']:
            return self._waiting_for_report(min(awaited, key=deployment_order))
        reported = self._left - len(self._out)
        if held < reported:
            wait = f'waiting for a belief that holds {reported} deployments'
            if self._held < reported and self._out.forgotten:
                return f'{wait}; the last one holds {self._held}{NOT_HEARD_AGAIN}'
            return f'{wait} on {self._of_whom("belief", self._peers.estimators)}'
        if held >= self._robots:
            by_operator = ', ended by the operator' * self._operator.decisions.is_ended
            return f'{DONE}: {held} of {self.values["robots"]} robots deployed{by_operator}'
        if not self._is_heard and (waiting := self.waiting_for(self._paths.values())):
            return waiting
        self._is_heard = True
        if self._left >= self._robots:
            out = some(self._out)
            return f'waiting for robots that are out: {out}; no more leave (parameter robots)'
        if self._operator.decisions.is_paused:
            pause = self.resolve_service_name('pause')
            return f'waiting for the operator to end the pause by the service {pause}'
        return '' if self._free_agents() else self._waiting_for_agent()

    def _of_whom(self, topic: str, publishers: int) -> str:
        """Return the full name of a topic, and whether it is told by anybody."""
        name = self.resolve_topic_name(topic)
        return name if publishers else f'{name}, which nobody publishes'

    def _waiting_for_belief(self) -> str:
        wait = f'waiting for the belief on {self._of_whom("belief", self._peers.estimators)}'
        if not self._peers.estimators:
            return f'{wait}: start an estimator'
        return f'{wait}: its estimator waits for those that its parameter await_nodes names'

    def _waiting_for_approval(self) -> str:
        topics = [
            self.resolve_topic_name(f'{key.agent}/proposal') for key in self._proposals.plans
        ]
        return (
            f'waiting for the operator to approve of {some(topics)} by the service '
            f'{self.resolve_service_name("approve")} (parameter approval)'
        )

    def _waiting_for_report(self, key: DeploymentKey) -> str:
        """Return that a robot which is out is waited for, and what ends that."""
        agent = self.resolve_topic_name(key.agent)
        wait = f'waiting for {key} to be reported on {agent}/report'
        if self.values['recorded'] and not self._out.is_recorded(key):
            return (
                f'{wait}: it leaves when the recorder tells on {agent}/recorded that its path is '
                'on disk (parameter recorded)'
            )
        if self.values['silent_loss']:
            deadline = self.values['return_deadline']
            return (
                f'{wait}, at most until {deadline} s after it is due (parameter return_deadline)'
            )
        return f'{wait}, however long that takes (parameter silent_loss is false)'

    def _waiting_for_agent(self) -> str:
        """Return that an agent is waited for, and why each of the team is not free."""
        absent = [
            self.resolve_topic_name(f'{agent}/report')
            for agent in self._agents
            if not self._peers.is_present(agent)
        ]
        reasons = [
            f'nobody publishes {some(absent)}' if absent else '',
            f'{some(self._out)} are out' if self._out else '',
        ]
        why = '; '.join(filter(None, reasons))
        return f'waiting for an agent whose robot is home: {why} (parameter agents)'


def main(args: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run('planner', PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
