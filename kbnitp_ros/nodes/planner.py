# SPDX-License-Identifier: Apache-2.0
"""The planner: sends the robots of its agents where the most is to be learnt."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
import sys
import time

from builtin_interfaces.msg import Time
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import (
    deployment_order,
    DeploymentKey,
    Observation,
    observation_of,
    plan_team,
    SensorModel,
)
from kbnitp_ros.log.deployments import read_deployments, read_mission, read_newest_round
from kbnitp_ros.log.evidence import BELIEF, REPORT
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.deployments import (
    agent_of,
    path_message,
    read_report,
    report_message,
)
from kbnitp_ros.messages.headers import LAST_COUNTED_ON, next_name, read_name, SECOND
from kbnitp_ros.messages.sizes import largest_belief, largest_report, TIME
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.field import FieldNode
from kbnitp_ros.nodes.parameters import (
    agents_of,
    check_search,
    parameters_of,
    sensor_model_of,
)
from kbnitp_ros.nodes.recent import Recent
from kbnitp_ros.nodes.shell import run
from kbnitp_ros.nodes.succession import Succession
from kbnitp_ros.study.reach import cut_off_note, reach_note
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription

# A field of which paths reach less than this part is worth a warning.
MOST = 0.5


@dataclass
class Flight:
    """
    A robot that is out.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        Its cells.
    due : int or None
        When it is given up, nanoseconds of ROS time; None until it has left and the clock runs.
    is_overdue : bool
        Whether it should have been given up at the last look.

    """

    path: NDArray[np.intp]
    due: int | None = None
    is_overdue: bool = False


class PlannerNode(FieldNode):
    """Publish paths, planned on the belief given all reports, for agents whose robots are home."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._model = sensor_model_of(self.values)
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
            if self.values['silent_loss']
        }
        self._succession = Succession()
        self._out: dict[DeploymentKey, Flight] = {}
        # Whose paths are on disk, as long as they are not reported.
        self._recorded = Recent(qos.DEPTH)
        # How many robots of each agent have left, as far as known.
        self._sent: Counter[str] = Counter()
        # How many deployments the belief heard last holds, and whether it was told that an
        # estimator will never hold them all.
        self._heard = 0
        self._is_told = False
        # How many robots have left, and how many more only the belief knows of.
        self._left = 0
        self._unknown = 0
        self._last_stamp = 0
        self._time = 0
        self._is_heard = False
        self._is_slow = False
        self._answering: dict[str, int] = {}
        self._strangers: set[str] = set()
        self._estimators = 0
        if self.values['resume']:
            self._restore(self.values['resume'])
            if refusal := self._too_few(self.values['robots']):
                raise ValueError(refusal)
        self.add_on_set_parameters_callback(self._check_changes)
        self.diagnostics.state = 'waiting for the belief'
        self._beliefs = self._hear_beliefs()
        for agent in self._agents:
            self.hear(
                DeploymentReport,
                f'{agent}/report',
                partial(self._on_report, agent),
                qos.EVIDENCE,
                largest_report(self.values['max_steps']),
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
        deployments = read_deployments(log, self.grid, self.values['max_steps'])
        for key, recorded in deployments.items():
            if key.agent not in self._paths:
                raise ValueError(
                    f'{log} has deployments of {key.agent}: the parameter agents names only '
                    f'{", ".join(self._agents)}'
                )
            self._paths[key.agent].publish(recorded.message)
            if recorded.observation is None:
                self._out[key] = Flight(recorded.path)
                self._recorded.add(key)
            elif key.agent in self._losses and not recorded.observation.survived:
                # Said by the planner before this one.
                again = report_message(key, recorded.observation, recorded.reported)
                self._losses[key.agent].publish(again)
            self._left += 1
            self._sent[key.agent] += 1
            if key.stamp <= LAST_COUNTED_ON:
                self._last_stamp = key.stamp
        self._succession.mission = read_mission(log)
        # Of one robot, or where each leaves by itself, no part can be missing.
        if len(self._agents) == 1 or self.values['rolling']:
            return
        if newest_round := read_newest_round(log, deployments):
            planned_on, keys = newest_round
            self._complete_round(planned_on, {key: deployments[key].path for key in keys})

    def _say_what_is_out_of_reach(self) -> None:
        """Say what no path comes to; a warning if that is most of the field."""
        log, max_steps = self.get_logger(), self.values['max_steps']
        if note := reach_note(self.grid, max_steps):
            (log.warning if reach_note(self.grid, max_steps, MOST) else log.info)(note)
        if note := cut_off_note(self.grid):
            log.info(note)

    def _too_few(self, robots: int) -> str:
        """Return why there must be more robots than these; empty when enough."""
        left = self._left + self._unknown
        if robots >= left:
            return ''
        return (
            f'parameter robots is {robots}: {left} robots have left, and it must be at '
            f'least that; {left} ends the mission'
        )

    def _check_changes(self, changes: Sequence[Parameter]) -> SetParametersResult:
        """Refuse fewer robots than have left, and searches that take too much memory."""
        known = parameters_of('planner')
        try:
            given = {
                each.name: known[each.name].check(each.value)
                for each in changes
                if each.name in known
            }
            check_search(self.values | given, self.grid)
            refusal = self._too_few(given['robots']) if 'robots' in given else ''
        except ValueError as error:
            refusal = str(error)
        return SetParametersResult(successful=not refusal, reason=refusal)

    def _complete_round(
        self, planned_on: Snapshot, recorded: dict[DeploymentKey, NDArray[np.intp]]
    ) -> None:
        """
        Send the robots of a round that died with the mission before all its paths were on record.

        Some of the others may have reported, so nobody could plan these paths later.
        """
        agents = self._agents[: max(0, self.values['robots'] - planned_on.deployments)]
        if len(recorded) >= len(agents):
            return
        first = next_name(planned_on.stamp, planned_on.mission)
        planned = self._plan_round(planned_on, agents, [], first)
        # Otherwise it was a round of other agents, or the parameters are others now.
        if all(np.array_equal(path, planned.get(key, ())) for key, path in recorded.items()):
            missing = {key: path for key, path in planned.items() if key not in recorded}
            self._send(missing, planned_on.mission)

    def _hear_beliefs(self) -> Subscription:
        largest = largest_belief(self.grid.cells)
        return self.hear(BeliefMaps, 'belief', self._on_belief, qos.LATCHED, largest)

    def _look(self) -> None:
        self._look_for_agents()
        self._look_for_estimators()
        self._look_for_strangers()
        self._give_up()
        self._deploy()

    def _on_belief(self, message: BeliefMaps) -> None:
        try:
            snapshot = read_belief_maps(message)
            self._check_rules(snapshot)
            self._succession.check(snapshot, self._estimators, self._left + self._unknown)
        except ValueError as error:
            self.diagnostics.refuse('belief', error)
            return
        self.diagnostics.accept()
        unknown = snapshot.deployments - self._left
        if unknown > self._unknown:
            self.get_logger().warning(
                f'the belief holds {unknown} deployments more than are '
                'known here: their paths died with the planner before this one, and a restarted '
                'estimator will lack them, unless the parameter resume names the log'
            )
            self._unknown = unknown
        self._notice_loss(snapshot.deployments)
        if self._succession.take(snapshot):
            self._deploy()

    def _notice_loss(self, held: int) -> None:
        """Say if an estimator was restarted that will never hear of all deployments."""
        self._heard = held
        # One that has the log publishes its prior, and then a belief in all that is on record.
        if 0 < held < self._forgotten and not self._is_told:
            self._is_told = True
            self.diagnostics.refuse('belief', f'it holds {held} deployments{self._in_vain}')

    @property
    def _forgotten(self) -> int:
        """How many deployments their publishers keep no longer."""
        return sum(max(0, sent - qos.DEPTH) for sent in self._sent.values())

    @property
    def _in_vain(self) -> str:
        """Return why an estimator may never hold all deployments."""
        return (
            f', and only the last {qos.DEPTH} of each agent are heard again: restart the '
            'estimator with the parameter resume, which names the log'
        )

    def _check_rules(self, snapshot: Snapshot) -> None:
        if snapshot.grid != self.grid:
            raise ValueError(f'it is on {snapshot.grid}: the parameters say {self.grid}')
        if snapshot.max_steps < self.values['max_steps']:
            raise ValueError(
                f'max_steps is {snapshot.max_steps}: the parameter max_steps is '
                f'{self.values["max_steps"]}, and the estimator would refuse such paths'
            )

    def _on_report(self, agent: str, message: DeploymentReport) -> None:
        try:
            key, report = read_report(message, agent)
            if key in self._out:
                # The estimator would refuse it too, and the robot is still out.
                path, max_steps = self._out[key].path, self.values['max_steps']
                observation_of(report, key, path, self.grid, max_steps)
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/report', error)
            return
        self._out.pop(key, None)
        self._recorded.discard(key)
        self._deploy()

    def _on_recorded(self, agent: str, message: Time) -> None:
        try:
            self._recorded.add(DeploymentKey(agent, read_name('stamp', message)))
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/recorded', error)

    def _look_for_agents(self) -> None:
        """Notice which agents somebody answers for, and who answers for one that is taken."""
        own = int(self.values['silent_loss'])
        for agent in self._agents:
            answering = self.count_authors(f'{agent}/report', REPORT) - own
            before = self._answering.get(agent, 0)
            self._answering[agent] = answering
            if answering > max(before, 1):
                self.diagnostics.refuse(
                    f'{agent}/report',
                    f'{answering} nodes answer for agent {agent}: unless one has just died, '
                    'each needs a name of its own',
                )
            elif before and not answering:
                self.diagnostics.refuse(
                    f'{agent}/path',
                    f'agent {agent} has left the graph: the others carry on, and so does '
                    f'{agent} when it is back',
                )

    def _look_for_estimators(self) -> None:
        """
        Notice when more than one node publishes beliefs.

        When one of them leaves, the belief of those that stay is asked for again: it may have been
        refused for that of the other, or held to be older.
        """
        before, self._estimators = (
            self._estimators,
            self.count_authors('belief', BELIEF),
        )
        if self._estimators > max(before, 1):
            self.diagnostics.refuse(
                'belief',
                f'{self._estimators} nodes publish beliefs: unless one has just died, '
                'end all but one',
            )
        elif 0 < self._estimators < before:
            self._succession.newest = None
            self._unknown = 0
            self.destroy_subscription(self._beliefs)
            self._beliefs = self._hear_beliefs()

    def _look_for_strangers(self) -> None:
        """Notice who reports for an agent that is none of the team."""
        for topic, types in self.get_topic_names_and_types():
            agent = agent_of(topic)
            is_known = not agent or agent in self._agents or agent in self._strangers
            if REPORT not in types or is_known:
                continue
            if topic == self.resolve_topic_name(f'{agent}/report') and self.count_publishers(
                topic
            ):
                self._strangers.add(agent)
                self.diagnostics.refuse(
                    f'{agent}/report',
                    f'agent {agent} is unknown, and nobody hears it: the parameter agents names '
                    f'{", ".join(self._agents)}',
                )

    def _give_up(self) -> None:
        """Report robots lost that should have been back for long."""
        now = self.now()
        jump, self._time = min(0, now - self._time), now
        if not self.values['silent_loss'] or now <= 0:
            return
        for key, flight in list(self._out.items()):
            if self.values['recorded'] and key not in self._recorded:
                continue
            # Robots do not come home sooner because the clock was set back.
            flight.due = self._due(now, flight) if flight.due is None else flight.due + jump
            was_overdue, flight.is_overdue = flight.is_overdue, now > flight.due
            # What came while a plan was made is heard between two looks.
            if was_overdue and flight.is_overdue:
                del self._out[key]
                lost = Observation(flight.path, False)
                self._losses[key.agent].publish(report_message(key, lost, now))

    def _due(self, now: int, flight: Flight) -> int:
        """Return when a robot that leaves now is given up, in nanoseconds."""
        steps = flight.path.size - 1
        wait = steps * self.values['step_period'] + self.values['return_deadline']
        return now + round(wait * SECOND)

    def _deploy(self) -> None:
        """Send the next robots, unless something must come first."""
        newest = self._succession.newest
        if newest is None:
            return
        reason_to_wait = self._reason_to_wait(newest.deployments)
        if reason_to_wait:
            self.diagnostics.state = reason_to_wait
            return
        agents = self._free_agents()[: self.values['robots'] - self._left - self._unknown]
        out = [flight.path for flight in self._out.values()]
        self._send(self._plan_round(newest, agents, out, self._next_stamp(newest)), newest.mission)

    def _plan_round(
        self, known: Snapshot, agents: Sequence[str], out: Sequence[NDArray[np.intp]], stamp: int
    ) -> dict[DeploymentKey, NDArray[np.intp]]:
        """Return the paths of robots that leave together, the first of them named by `stamp`."""
        start = time.monotonic()
        team = plan_team(
            self.grid,
            known.belief,
            self._model_of(known),
            self.values['max_steps'],
            len(agents),
            self.values['allocation'],
            self.values['planner'],
            width=self.values['beam_width'],
            max_visits=self.values['max_visits'],
            loss_cost=self.values['loss_cost'],
            out=out,
        )
        longest = max((len(each.path) - 1 for each in team.plans), default=0)
        self._say_if_slow(time.monotonic() - start, self.values['step_period'] * longest)
        return {
            DeploymentKey(agent, stamp + number): planned.path
            for number, (agent, planned) in enumerate(zip(agents, team.plans))
        }

    def _model_of(self, known: Snapshot) -> SensorModel:
        """Return the sensor model to plan with: its numbers that are learnt are the belief's."""
        learnt = known.unknowns.priors.keys() & vars(self._model).keys()
        return replace(self._model, **{name: getattr(known.model, name) for name in learnt})

    def _say_if_slow(self, planning: float, away: float) -> None:
        """Say once that robots wait longer for their paths than they are away, in seconds."""
        if 0.0 < away < planning and not self._is_slow:
            self._is_slow = True
            self.get_logger().warning(
                f'planning took {planning:.1f} s, and the robots are back after {away:.1f} s: '
                'a lower beam_width, or the planner relaxed, takes less'
            )

    def _send(self, paths: dict[DeploymentKey, NDArray[np.intp]], mission: int) -> None:
        """Publish the paths of robots that leave now; the first ones begin a mission."""
        mission = self._succession.begin(mission)
        for key, path in paths.items():
            self._out[key] = Flight(path)
            self._sent[key.agent] += 1
            message = path_message(self.grid, path, key.stamp, mission)
            self._paths[key.agent].publish(message)
            self._last_stamp = max(self._last_stamp, key.stamp)
        self._left += len(paths)

    def _free_agents(self) -> list[str]:
        """Return the agents that somebody answers for and whose robots are home."""
        busy = {key.agent for key in self._out}
        return [
            agent for agent in self._agents if self._answering.get(agent) and agent not in busy
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

    def _reason_to_wait(self, held: int) -> str:
        """Return what must come before the next deployment; empty when nothing."""
        # An agent that has left the graph does not keep the others from their next round.
        awaited = [key for key in self._out if self._answering.get(key.agent)]
        if awaited and not self.values['rolling']:
            return f'waiting for {min(awaited, key=deployment_order)} to be reported'
        left = self._left + self._unknown
        reported = left - len(self._out)
        if held < reported:
            wait = f'waiting for a belief that holds {reported} deployments'
            if self._heard < reported and self._forgotten:
                wait += f'; the last one holds {self._heard}{self._in_vain}'
            return wait
        robots = self.values['robots']
        if held >= robots:
            return f'done: {held} of {robots} robots deployed'
        if not self._is_heard and (waiting := self.waiting_for(self._paths.values())):
            return waiting
        self._is_heard = True
        if left >= robots:
            return f'waiting for robots that are out: {", ".join(map(str, self._out))}'
        return '' if self._free_agents() else 'waiting for an agent whose robot is home'


def main(args: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run('planner', PlannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
