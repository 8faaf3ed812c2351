# SPDX-License-Identifier: Apache-2.0
"""What a planner that is started again takes from the log of its mission."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.base.deployments_in_flight import DeploymentsInFlight
from kbnitp_ros.base.rounds import Plans, Rounds
from kbnitp_ros.configuration import robot_types_of
from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.log.deployments import MissionRecord, read_newest_round
from kbnitp_ros.log.operator_state import OperatorState
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.deployments import report_message, Source
from kbnitp_ros.messages.headers import LAST_COUNTED_ON


class Resumption:
    """The mission of a log, to go on with."""

    def __init__(
        self, log: MissionLog, grid: Grid, values: Mapping[str, Any], agents: Collection[str]
    ) -> None:
        self._log = log
        self._values = values
        self._agents = agents
        robot_types = robot_types_of(values, grid)
        self.record = MissionRecord(log, grid, values['max_steps'], robot_types)
        # In the order they were made.
        self.deployments = self.record.deployments
        for key in self.deployments:
            if key.agent not in agents:
                raise ValueError(
                    f'{log.path} has deployments of {key.agent}: the parameter agents names only '
                    f'{", ".join(agents)}'
                )
        # What holds by them.
        self.operator = OperatorState()
        for action, _ in self.record.actions:
            self.operator.apply(action)

    @property
    def last_stamp(self) -> int:
        """Return the stamp of the last deployment after which others can be counted on."""
        stamps = (key.stamp for key in self.deployments if key.stamp <= LAST_COUNTED_ON)
        return max(stamps, default=0)

    def note(self, in_flight: DeploymentsInFlight, rounds: Rounds) -> None:
        """Take note of all robots that were sent, and of what became of them."""
        for key, recorded in self.deployments.items():
            in_flight.send(key, recorded.path, recorded.content)
            in_flight.record(key, recorded.content)
            if recorded.status is not None:
                in_flight.restore(key, recorded.status)
            if recorded.is_refused:
                continue
            rounds.note_path(recorded.path)
            if (observation := recorded.observation) is not None:
                in_flight.end(key, recorded.reported if observation.survived else None)

    def losses(self) -> Iterator[tuple[DeploymentKey, DeploymentReport]]:
        """Yield the losses that the planner before this one reported."""
        given_up = self.operator.given_up
        for key, recorded in self.deployments.items():
            is_own = self._values['silent_loss'] or key in given_up
            observation = recorded.observation
            if is_own and observation is not None and not observation.survived:
                source = Source.OPERATOR if key in given_up else Source.SILENCE
                yield key, report_message(key, observation, recorded.reported, source)

    def missing(self, rounds: Rounds) -> tuple[Plans, int] | None:
        """Return the plans of the newest round that are not on record, and its mission."""
        # Of one robot, or where each leaves by itself, no part can be missing.
        if len(self._agents) == 1 or self._values['rolling']:
            return None
        if self.operator.is_paused or self.operator.is_ended:
            return None
        newest_round = read_newest_round(self._log, self.deployments)
        if newest_round is None:
            return None
        planned_on, keys = newest_round
        recorded = {key: self.deployments[key].path for key in keys}
        refused = self.operator.refused(planned_on.deployments)
        at_base = {key for key in keys if self.deployments[key].is_refused}
        plans = rounds.missing(planned_on, list(self._agents), recorded, refused, at_base)
        return plans, planned_on.mission
