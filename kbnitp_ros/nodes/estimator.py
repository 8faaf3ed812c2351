# SPDX-License-Identifier: Apache-2.0
"""The estimator: judges what counts, computes the belief from it, and publishes both."""

from __future__ import annotations

from functools import partial

from kbnitp_msgs.msg import AgentStatus, BeliefMaps, DeploymentReport, MissionStatus
from kbnitp_msgs.msg import Standings as StandingsMessage
from kbnitp_ros.configuration import agent_names, make_estimator
from kbnitp_ros.configuration.agents import own_robot_types
from kbnitp_ros.configuration.checks import density_note, failure_note, ignored_note
from kbnitp_ros.configuration.field import make_datum
from kbnitp_ros.configuration.mission import checked_goal, settled_goal
from kbnitp_ros.configuration.table import MAX_AGENTS
from kbnitp_ros.core import DeploymentKey, Ledger, Report
from kbnitp_ros.core.inference.record import OPEN, Verdict
from kbnitp_ros.files import counted, waiting_for
from kbnitp_ros.log.record import check_same_field, fold_evidence, mission_start, read_no_go
from kbnitp_ros.log.roles import MissionLog, resumed_log
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import AgentStatus as Status
from kbnitp_ros.messages.deployments import hear_report, read_path, read_status
from kbnitp_ros.messages.headers import check_mission, content_hash, from_stamp, mission_of_path
from kbnitp_ros.messages.progress import Checked, read_mission_status
from kbnitp_ros.messages.remarks import Remark
from kbnitp_ros.messages.standings import standings_fields, standings_message
from kbnitp_ros.messages.topics import REMARKS
from kbnitp_ros.nodes.decisions import Decisions
from kbnitp_ros.nodes.models import Models
from kbnitp_ros.nodes.presence import Repeated
from kbnitp_ros.nodes.recorded_paths import RecordedPaths
from kbnitp_ros.nodes.remarks import Evidence, Remarks, Trial
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.runtime.process import run
from kbnitp_ros.nodes.views import Views
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.parameter import Parameter

# A deployment, the cells of its path, the hash of its message, and the start of its mission.
SentPath = tuple[DeploymentKey, NDArray[np.intp], int, int]

CLOCK = 'the clock to start on /clock (parameter use_sim_time)'

# Seconds between two looks for messages on record that have not arrived.
READ_AGAIN = 1.0

# One in so many standings is complete.
COMPLETE_EVERY = 64

# Words for a deployment that ended, by verdict.
ENDED = {
    Verdict.RETURN: 'came back',
    Verdict.UNMOVED: 'came back without a step',
    Verdict.LOSS: 'was lost',
}


class EstimatorNode(FieldNode):
    """Judge each report that is on record, and publish standings and the belief after it."""

    def __init__(self) -> None:
        super().__init__('estimator')
        # Only check the datum: the page of a mission reads it from the log.
        make_datum(self.values)
        # The file of a mask is read once: it may change or go.
        self.values |= settled_goal(self.values, self.grid)
        estimator = make_estimator(self.values, self.grid)
        checked_goal(self.values, self.grid, estimator=estimator)
        robot_types = own_robot_types(self.values, self.grid)
        self._ledger = Ledger(self.grid, self.values['max_steps'], estimator, robot_types)
        self._prior = self._ledger.copy()
        self._rules = content_hash(belief_maps(self._prior, 0))
        self.get_logger().info(failure_note(self.values))
        if estimator.parameters:
            self.get_logger().info(
                f'learning {", ".join(estimator.parameters)} (parameter learn.numbers; [] takes '
                'the given values as known)'
            )
        if ignored := ignored_note(self.values, estimator.unknowns.priors):
            self.get_logger().warning(ignored)
        # The mission of the paths in the ledger; None without paths.
        self._mission: int | None = None
        # Start of this estimator, later than those of all earlier ones on record, nanoseconds.
        self._epoch = 0
        # Number of messages and logs that the ledger has taken.
        self._taken = 0
        no_go: tuple[int, ...] = ()
        if self.values['resume']:
            log = resumed_log(self.values['resume'], self.roles)
            check_same_field(log, self.grid, robot_types)
            self._take_in(log)
            no_go = read_no_go(log, self.grid)[-1]
        agents = agent_names(self.values, self.grid)
        # Create the views first: nodes that discover `belief` then know the views already.
        self._views = Views(self, agents)
        if self.values['filter.type'] >= 0:
            values = (self.values[f'filter.{name}'] for name in ('type', 'base', 'multiplier'))
            self._views.announce_mask(*values)
        has_model = estimator.parameters or estimator.model_check.alternatives
        self._models = Models(self, self._warn_of_doubt) if has_model else None
        self._decisions = Decisions(self)
        self._decisions.close(no_go)
        self._doubt = ''
        # The last confidence of the planner that is not possible here.
        self._refused_confidence: float | None = None
        # Events and changes in the standings published last, and standings until complete ones.
        self._published = 0, 0
        self._until_complete = 0
        matched = PublisherEventCallbacks(matched=self.guarded(self._on_standings_matched))
        self._standings = Repeated(
            self, StandingsMessage, 'standings', qos.STANDINGS, event_callbacks=matched
        )
        self._belief = self.create_publisher(BeliefMaps, 'belief', qos.LATCHED)
        # The messages of each agent that are on record.
        self._on_record: dict[str, RecordedPaths[SentPath]] = {}
        for agent in agents:
            sent = RecordedPaths(self, agent, partial(self._read_path, agent), self._take_path)
            self._on_record[agent] = sent
            sent.listen()
            self.subscribe_to_agent(DeploymentReport, agent, partial(self._on_report, agent))
            self.subscribe_to_agent(AgentStatus, agent, partial(self._on_status, agent))
        self.subscribe(MissionStatus, 'mission', self._on_mission, qos.LATCHED)
        self._remarks = Remarks(self, self._judged, self._take_remark, self._decisions)
        self._started = 0
        self._unconverged = ''
        self._weak_density = ''
        self._awaiting = self.create_poll(self._publish_first)
        if self.values['resume']:
            self.create_poll(self._read_again, READ_AGAIN)

    def _take_in(self, log: MissionLog) -> None:
        """Judge the recorded paths, reports and statuses; duplicates change nothing."""
        if self._mission is None:
            self._mission = mission_start(log)
        evidence = log.read('path', 'report', 'status', 'standings', *REMARKS)
        messages = self.log_progress(evidence, f'reading {log.path}')
        self._epoch = max(self._epoch, fold_evidence(self._ledger, messages, self._mission))
        self._taken += 1

    def _publish_first(self) -> None:
        missing, now = self.missing_listeners([self._belief]), self.now()
        if missing is not None or now <= 0:
            self.diagnostics.state = waiting_for(missing or CLOCK)
        else:
            if log := self.values['resume']:
                # The recorder may have written messages since the log was read.
                self._take_in(resumed_log(log, self.roles))
            self._started = now
            self._epoch = max(now, self._epoch + 1)
            self._awaiting.cancel()
            self._publish_standings()
            # A replay of the log starts from the prior.
            self._publish(self._prior)
            if self._ledger.changes:
                self._publish(self._ledger)
            self._update_state()

    def _read_again(self) -> None:
        """Read the log again if something is on record that has not arrived."""
        unknown = [each.has_unknown() for each in self._on_record.values()]
        if self._started and any(unknown):
            self._take_in(resumed_log(self.values['resume'], self.roles))
            if self._ledger.deployments:
                self._publish_news(self._ledger.deployments[-1])

    def _publish_standings(self) -> None:
        """Publish the standings that changed; all of them at the start and now and then."""
        changed, since = self._ledger.take_changed(), self._published[0]
        self._until_complete -= 1
        if self._until_complete <= 0:
            since, self._until_complete = 0, COMPLETE_EVERY
        self._published = self._ledger.events, self._ledger.changes
        keys = changed if since else self._ledger.judged
        fields = standings_fields(
            self._ledger,
            keys,
            self.now(),
            self.get_fully_qualified_name(),
            self._epoch,
            self._rules,
            since,
            self._mission or 0,
        )
        self._standings.publish(standings_message(fields))

    def _on_standings_matched(self, status: QoSPublisherMatchedInfo) -> None:
        if status.current_count_change > 0 and self._started:
            # The new subscriber has not received the earlier standings.
            self._until_complete = 0
            self._publish_standings()

    def _read_path(self, agent: str, message: Path) -> SentPath | None:
        key, cells = read_path(self._ledger.grid, agent, message)
        self._ledger.check_path(key, cells)
        mission = mission_of_path(message)
        if not self._is_begun_by(mission):
            # The recorder acknowledges no paths of other missions.
            check_mission(mission, self._mission)
        if mission == self._mission and key in self._ledger.paths:
            self._ledger.record_path(key, cells)
            self.diagnostics.accepted += 1
            return None
        return key, cells, content_hash(message), mission

    def _take_path(self, sent: SentPath) -> None:
        key, cells, content, mission = sent
        self._join(mission)
        try:
            self._ledger.record_path(key, cells, content)
        except ValueError as error:
            # A report that waited for this path is refused.
            self.diagnostics.refuse(f'{key.agent}/report', error)
        else:
            self.diagnostics.accepted += 1
        self._publish_news(key)

    def _on_report(self, agent: str, message: DeploymentReport) -> None:
        """Judge a report once it is on record."""
        try:
            key, report = hear_report(message, agent)
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/report', error)
            return
        judge = partial(self._judge, key, report)
        self._on_record[agent].when_recorded(key.stamp, report.content, judge)

    def _judge(self, key: DeploymentKey, report: Report) -> None:
        try:
            changed = self._ledger.record_report(key, report)
        except ValueError as error:
            self.diagnostics.refuse(f'{key.agent}/report', error)
        else:
            self.diagnostics.accepted += 1
            read = [step for step, (_, reading) in enumerate(report.readings, 1) if reading >= 0]
            last, steps = max(read, default=0), len(report.readings)
            # The last step leads into the base, where no reading is needed.
            if changed and steps - last > 1:
                self.get_logger().warning(
                    f'{key} has no readings after step {last} of {steps}: the detector failed, or '
                    'the position of the robot was uncertain'
                )
        self._publish_news(key)

    def _on_status(self, agent: str, message: AgentStatus) -> None:
        """Take an agent's status once it is on record: it may decide whether a loss counts."""
        try:
            key, status = read_status(message, agent)
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/status', error)
            return
        self.diagnostics.accepted += 1
        take = partial(self._take_status, key, status)
        self._on_record[agent].when_recorded(key.stamp, status.content, take)

    def _take_status(self, key: DeploymentKey, status: Status) -> None:
        """Take the status of an order that is on record."""
        self._ledger.record_status(key, status.state, status.stamp)
        self._publish_news(key)

    def _on_mission(self, message: MissionStatus) -> None:
        """Show how the mission stands; take its planner's confidence and no-go cells."""
        try:
            status = read_mission_status(message)
        except ValueError as error:
            self.diagnostics.refuse('mission', error)
            return
        self._views.show_status(status)
        try:
            self._decisions.close(status.no_go)
        except ValueError as error:
            self.diagnostics.refuse('mission', f'no_go: {error}')
        confidence = status.confidence
        if confidence not in (self.values['stop.confidence'], self._refused_confidence):
            answer = self.set_parameters([Parameter('stop.confidence', value=confidence)])[0]
            if answer.successful:
                self.get_logger().info(f'stop.confidence is {confidence:g}, as for the planner')
            else:
                self._refused_confidence = confidence
                self.diagnostics.refuse('mission', f'confidence: {answer.reason}')

    def _publish_news(self, key: DeploymentKey) -> None:
        """Publish what a message about a deployment has changed."""
        self._taken += 1
        ledger = self._ledger
        self._update_warning()
        events, changes = self._published
        if not self._started or ledger.events == events:
            return
        for other in ledger.changed:
            if other != key or ledger.standings.get(other, OPEN).verdict is Verdict.HELD:
                self._log_standing(other)
        self._publish_standings()
        if ledger.changes != changes:
            self._publish(ledger)
            self._log_outcome(key)
        self._update_state()

    def _judged(self) -> tuple[Evidence, Trial]:
        """Return the evidence that was judged; ValueError before the first belief."""
        if not self._started:
            raise ValueError('no belief has been published yet: call again later')
        return Evidence(self._epoch, self._ledger.events), Trial(self._ledger, self._taken)

    def _take_remark(self, remark: Remark, trial: Trial) -> None:
        """Judge a remark that is on record, and publish what it changes."""
        if trial.taken == self._taken:
            # Judging again may take minutes, which the trial has done beside this thread.
            self._ledger = trial.ledger
        else:
            remark.record(self._ledger)
        self._taken += 1
        who = f' ({remark.author})' if remark.author else ''
        self.get_logger().info(f'{type(remark.said).__name__} of a person{who} counts')
        self._publish_standings()
        self._publish(self._ledger)
        self._update_state()

    def _is_begun_by(self, mission: int) -> bool:
        """Return whether a path that states `mission` makes it the current mission."""
        # Before the first belief, paths of several missions may arrive, as from an old bag: the
        # newest mission counts.
        is_newer = self._mission is not None and mission > self._mission
        return (is_newer and not self._started) or 0 < mission == self._started != self._mission

    def _join(self, mission: int) -> None:
        """Begin a mission, or check that it is the current mission."""
        if self._is_begun_by(mission):
            # Remarks may come before the first path.
            if self._ledger.paths:
                ledger = self._prior.copy()
                ledger.copy_pending(self._ledger)
                self._ledger = ledger
        else:
            check_mission(mission, self._mission)
        self._mission = mission

    def _log_standing(self, key: DeploymentKey) -> None:
        """Log that a deployment is held, or that another one changed what counts of it."""
        standing = self._ledger.standings.get(key, OPEN)
        if standing.verdict is Verdict.HELD:
            self.get_logger().warning(f'{key} is held, and counts for nothing: {standing.why}')
        else:
            words = ENDED.get(standing.verdict, standing.verdict.name)
            self.get_logger().info(f'{key} {words}, since evidence of an earlier robot arrived')

    def _log_outcome(self, key: DeploymentKey) -> None:
        """Log what counts of a deployment, and the new entropy."""
        ledger = self._ledger
        standing = ledger.standings.get(key, OPEN)
        outcome = ledger.outcomes.get(key)
        steps = 0 if outcome is None else outcome.steps_survived
        contact = f', last contact after step {steps}' if steps else ''
        ended = ENDED.get(standing.verdict, 'counts for nothing any more')
        held, lost = len(ledger.deployments), ledger.lost
        self.deployment_logger.info(
            f'{key} {ended}{contact}: entropy {ledger.belief.entropy():.2f} nats after '
            f'{counted(held, "deployment")}, {counted(lost, "robot")} lost'
        )

    def _publish(self, ledger: Ledger) -> None:
        mission = self._started if self._mission is None else self._mission
        author = self.get_fully_qualified_name()
        message = belief_maps(ledger, self._started, mission, author, self._epoch)
        self._belief.publish(message)
        stamp = from_stamp(message.header.stamp)
        if self._models is not None:
            self._models.publish(ledger, stamp)
        self._decisions.publish(ledger, stamp, mission, self._epoch)
        self._views.show(ledger, stamp)
        self._update_sampling(ledger)

    def _warn_of_doubt(self, checked: Checked) -> None:
        """Publish a check of the model on diagnostics, and warn of doubt."""
        check = checked.check
        after = counted(checked.deployments, 'deployment')
        self.diagnostics.values['model_check'] = f'{check.reason} (after {after})'
        if check.is_in_doubt and not self._doubt:
            self.get_logger().warning(check.reason)
        self._doubt = check.reason if check.is_in_doubt else ''
        self._update_warning()

    def _update_sampling(self, ledger: Ledger) -> None:
        """Publish the sampling error, and warn of a bad one or of a weak prior."""
        estimator, was_weak = ledger.estimator, self._weak_density
        self._weak_density = density_note(ledger)
        if self._weak_density and not was_weak:
            self.get_logger().warning(self._weak_density)
        error = f'{estimator.sampling_error:.2g}'
        self.diagnostics.values['sampling_error'] = error
        self._unconverged = (
            ''
            if estimator.is_converged
            else f'the sampling of the belief has not converged: its error is {error} nats'
        )
        self._update_warning()

    def _update_warning(self) -> None:
        """Publish reports without a path; warn of more than `MAX_AGENTS`."""
        pending = self.diagnostics.waiting = self._ledger.pending
        unknown = ''
        if pending > MAX_AGENTS:
            unknown = f'the paths of {pending} reports are unknown'
        self.diagnostics.warning = '; '.join(
            filter(None, (self._unconverged, self._weak_density, self._doubt, unknown))
        )

    def _update_state(self) -> None:
        self.diagnostics.state = (
            f'{counted(len(self._ledger.deployments), "deployment")} in the belief, '
            f'{counted(self._ledger.duplicates, "duplicate message")}'
        )

    def finish(self) -> None:
        """Publish the last views, and the decision on the last belief and its check."""
        self._views.publish()
        self._decisions.finish()
        if self._models is not None:
            self._models.finish()


main = partial(run, 'estimator', EstimatorNode, linger=0.3)
