# SPDX-License-Identifier: Apache-2.0
"""The estimator: computes the belief from paths and reports, and publishes it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial

from kbnitp_msgs.msg import AgentStatus, BeliefMaps, DeploymentReport
from kbnitp_ros.base.state import Departures, MissingError
from kbnitp_ros.configuration import agent_names, make_estimator
from kbnitp_ros.configuration.agents import own_robot_types
from kbnitp_ros.configuration.checks import density_note, failure_note
from kbnitp_ros.configuration.field import make_datum
from kbnitp_ros.configuration.mission import checked_goal, settled_goal
from kbnitp_ros.configuration.table import MAX_AGENTS
from kbnitp_ros.core import DeploymentKey, Ledger
from kbnitp_ros.files import counted
from kbnitp_ros.log.record import check_same_field, is_of_mission, read_mission, record
from kbnitp_ros.log.roles import MissionLog, resumed_log
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import read_path, read_report, read_status
from kbnitp_ros.messages.headers import check_mission, content_hash, from_stamp, mission_of_path
from kbnitp_ros.messages.progress import Checked
from kbnitp_ros.nodes.decisions import Decisions
from kbnitp_ros.nodes.models import Models
from kbnitp_ros.nodes.recorded_paths import RecordedPaths
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import HELD, waiting_for
from kbnitp_ros.nodes.runtime.node import FieldNode, PendingMessages
from kbnitp_ros.nodes.runtime.process import run
from kbnitp_ros.nodes.views import NewEvidence, Views
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo

# A deployment, the cells of its path, the hash of its message, and the start of its mission.
SentPath = tuple[DeploymentKey, NDArray[np.intp], int, int]

CLOCK = 'the clock to start on /clock (parameter use_sim_time)'


class EstimatorNode(FieldNode):
    """Compute the belief from the reports of all deployments, and publish it after each report."""

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
        self.get_logger().info(failure_note(self.values))
        if estimator.parameters:
            self.get_logger().info(
                f'learning {", ".join(estimator.parameters)}, whatever value is given for them '
                '(parameter learn.numbers; [] takes the given values as known)'
            )
        # The mission of the paths in the ledger; None without paths.
        self._mission: int | None = None
        self._departures = Departures()
        if self.values['resume']:
            log = resumed_log(self.values['resume'], self.roles)
            check_same_field(log, self.grid, robot_types)
            self._take_in(log)
        agents = agent_names(self.values, self.grid)
        # Create the views first: nodes that discover `belief` then know the views already.
        self._views = Views(self, agents)
        if self.values['filter.type'] >= 0:
            values = (self.values[f'filter.{name}'] for name in ('type', 'base', 'multiplier'))
            self._views.announce_mask(*values)
        has_model = estimator.parameters or estimator.check.alternatives
        self._models = Models(self, self._warn_of_doubt) if has_model else None
        self._decisions = Decisions(self)
        self._doubt = ''
        self._new = NewEvidence()
        self._belief = self.create_publisher(
            BeliefMaps,
            'belief',
            qos.LATCHED,
            event_callbacks=PublisherEventCallbacks(matched=self.guarded(self._on_matched)),
        )
        for agent in agents:
            sent = RecordedPaths(self, agent, partial(self._read_path, agent), self._take_path)
            sent.listen()
            self.subscribe_to_agent(DeploymentReport, agent, partial(self._on_report, agent))
            self.subscribe_to_agent(AgentStatus, agent, partial(self._on_status, agent))
        # Losses reported before the departures of their robots.
        self._early = PendingMessages(self, self._on_report)
        self._started = 0
        self._unconverged = ''
        self._weak_density = ''
        self._awaiting = self.create_poll(self._publish_first)

    def _take_in(self, log: MissionLog) -> None:
        """Apply the recorded paths, reports and statuses; duplicates change nothing."""
        if self._mission is None:
            self._mission = read_mission(log)
        evidence = log.read('path', 'report', 'status')
        for role, logged in self.log_progress(evidence, f'reading {log.path}'):
            # Evidence that was refused before the restart is refused again.
            with suppress(ValueError):
                if role.name == 'status':
                    self._departures.take(*logged.said)
                elif is_of_mission(role, logged, self._mission):
                    record(self._ledger, role, logged)
        for key in self._ledger.deployments:
            self._departures.end(key, None)

    def _publish_first(self) -> None:
        missing, now = self.missing_listeners([self._belief]), self.now()
        if missing or now <= 0:
            self.diagnostics.state = waiting_for(missing or CLOCK)
        else:
            if log := self.values['resume']:
                # The recorder may have written messages since the log was read.
                self._take_in(resumed_log(log, self.roles))
            self._started = now
            self._awaiting.cancel()
            # A replay of the log starts from the prior.
            self._publish(self._prior)
            if self._ledger.deployments:
                self._publish(self._ledger)
            self._update_state()

    def _on_matched(self, status: QoSPublisherMatchedInfo) -> None:
        if status.current_count_change > 0:
            # The new subscriber has not received the earlier beliefs.
            self._new.name_all()

    def _read_path(self, agent: str, message: Path) -> SentPath | None:
        key, cells = read_path(self._ledger.grid, agent, message)
        self._ledger.check_path(key, cells)
        mission = mission_of_path(message)
        if not self._is_begun_by(mission):
            # The recorder acknowledges no paths of other missions.
            check_mission(mission, self._mission)
        if mission == self._mission and key in self._ledger.paths:
            self._accept(key, self._ledger.record_path(key, cells))
            return None
        return key, cells, content_hash(message), mission

    def _take_path(self, sent: SentPath) -> None:
        key, cells, content, mission = sent
        self._join(mission)
        try:
            changed = self._ledger.record_path(key, cells, content)
        finally:
            # Recording a path drops pending reports that do not match the path.
            self._update_warning()
        self._accept(key, changed)

    def _on_report(
        self, agent: str, message: DeploymentReport, deadline: float | None = None
    ) -> None:
        try:
            key, report = read_report(message, agent)
            if not report.survived:
                self._departures.check_loss(key)
            named = replace(report, content=content_hash(message))
            changed = self._ledger.record_report(key, named)
        except MissingError as error:
            if not self._early.keep(deadline, agent, message):
                self._refuse(f'{agent}/report', error)
        except ValueError as error:
            self._refuse(f'{agent}/report', error)
        else:
            self._departures.end(key, report.stamp if report.survived else None)
            read = [step for step, (_, reading) in enumerate(report.readings, 1) if reading >= 0]
            last, steps = max(read, default=0), len(report.readings)
            # The last step leads into the base, where no reading is needed.
            if changed and steps - last > 1:
                self.get_logger().warning(
                    f'{key} has no readings after step {last} of {steps}: the detector failed, or '
                    'the position of the robot was uncertain'
                )
            self._accept(key, changed)

    def _on_status(self, agent: str, message: AgentStatus) -> None:
        """Record an agent's status, which does not affect the belief."""
        try:
            is_new = self._departures.take(*read_status(message, agent))
        except ValueError as error:
            self.diagnostics.refuse(f'{agent}/status', error)
            return
        self.diagnostics.accepted += 1
        if is_new:
            self._count_out()
            if self._awaiting.is_canceled():
                self._views.show_out(self._ledger)

    def _count_out(self) -> None:
        """Count the robots in flight; a departure may arrive before its path."""
        self._views.out = sum(key in self._ledger.paths for key in self._departures.out)

    def _is_begun_by(self, mission: int) -> bool:
        """Return whether a path that states `mission` makes it the current mission."""
        # Before the first belief, paths of several missions may arrive, as from an old bag: the
        # newest mission counts.
        is_newer = self._mission is not None and mission > self._mission
        return (is_newer and not self._started) or 0 < mission == self._started != self._mission

    def _join(self, mission: int) -> None:
        """Begin a mission, or check that it is the current mission."""
        if self._is_begun_by(mission):
            ledger = self._prior.copy()
            ledger.copy_pending(self._ledger)
            self._ledger = ledger
            self._new.name_all()
        else:
            check_mission(mission, self._mission)
        self._mission = mission

    def _refuse(self, topic: str, error: ValueError) -> None:
        # The ledger may have dropped pending reports.
        self._update_warning()
        self.diagnostics.refuse(topic, error)

    def _accept(self, key: DeploymentKey, changed: bool) -> None:
        self._update_warning()
        self._count_out()
        if self._awaiting.is_canceled():
            if changed:
                self._new.add(key)
                self._publish(self._ledger)
                self._log_outcome(key)
            else:
                self._views.show_out(self._ledger)
            self._update_state()
        if changed and key in self._ledger.contradicted:
            # The new report replaces another return, which is refused.
            self.diagnostics.refuse(f'{key.agent}/report', self._ledger.contradicted[key])
        else:
            self.diagnostics.accepted += 1

    def _log_outcome(self, key: DeploymentKey) -> None:
        """Log the outcome of a deployment, and the new entropy."""
        ledger = self._ledger
        outcome = ledger.outcomes[key]
        steps = outcome.steps_survived
        contact = f', last contact after step {steps}' if steps else ''
        ended = 'came back' if outcome.survived else f'was lost{contact}'
        held, lost = len(ledger.deployments), ledger.lost
        self.deployment_logger.info(
            f'{key} {ended}: entropy {ledger.belief.entropy():.2f} nats after '
            f'{counted(held, "deployment")}, {counted(lost, "robot")} lost'
        )

    def _publish(self, ledger: Ledger) -> None:
        mission = self._started if self._mission is None else self._mission
        message = belief_maps(ledger, self._started, mission, *self._new.take(ledger))
        self._belief.publish(message)
        stamp = from_stamp(message.header.stamp)
        if self._models is not None:
            self._models.publish(ledger, stamp)
        self._decisions.publish(ledger, stamp, mission)
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
        """Publish held deployments and reports without a path; warn of more than `MAX_AGENTS`."""
        values = self.diagnostics.values
        for name in [name for name in values if name.startswith(HELD)]:
            del values[name]
        values |= {f'{HELD}{key}': why for key, why in self._ledger.held.items()}
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
