# SPDX-License-Identifier: Apache-2.0
"""The estimator: folds paths and reports into a belief, and shows it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
import sys

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, ModelBelief
from kbnitp_ros.core import DeploymentKey, Estimator, Ledger
from kbnitp_ros.log.bag import read_log, same_types
from kbnitp_ros.log.deployments import read_mission
from kbnitp_ros.log.evidence import check_same_field, PATH, record, REPORT
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import agent_of, read_path, read_report
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.missions import check_mission, mission_of_path
from kbnitp_ros.messages.models import model_belief
from kbnitp_ros.messages.sizes import largest_path, largest_report
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.field import FieldNode
from kbnitp_ros.nodes.parameters import agents_of, estimator_of, kinds_of, value_for
from kbnitp_ros.nodes.progress import ProgressTeller
from kbnitp_ros.nodes.shell import run
from nav_msgs.msg import OccupancyGrid, Path

WAITING_FOR_CLOCK = 'waiting for the clock to start on /clock (parameter use_sim_time)'


class EstimatorNode(FieldNode):
    """Turn what is known of all deployments into a belief, published after each of them."""

    def __init__(self) -> None:
        super().__init__('estimator')
        estimator = estimator_of(self.values, self.grid)
        kinds = {agent: kind for agent, kind in kinds_of(self.values).items() if kind.own}
        self._ledger = Ledger(self.grid, self.values['max_steps'], estimator, kinds)
        self._prior = self._ledger.copy()
        # That of the paths in the ledger; None as long as there is none.
        self._mission: int | None = None
        if self.values['resume']:
            self._restore(self.values['resume'])
        # In this order whoever knows of belief knows of the maps as well.
        self._maps = {
            name: self.create_publisher(OccupancyGrid, f'belief/{name}', qos.LATCHED)
            for name in ('hazard', 'target', 'kappa')
        }
        self._model = (
            self.create_publisher(ModelBelief, 'model', qos.LATCHED)
            if estimator.unknowns.priors
            else None
        )
        agents = agents_of(self.values, self.grid)
        self._progress = ProgressTeller(self, agents)
        self._belief = self.create_publisher(BeliefMaps, 'belief', qos.LATCHED)
        for agent in agents:
            self.hear(
                Path,
                f'{agent}/path',
                partial(self._on_path, agent),
                qos.EVIDENCE,
                largest_path(value_for(self.values, 'max_steps', agent)),
            )
            self.hear(
                DeploymentReport,
                f'{agent}/report',
                partial(self._on_report, agent),
                qos.EVIDENCE,
                largest_report(value_for(self.values, 'max_steps', agent)),
            )
        self._started = 0
        self._awaiting = self.create_poll(self._publish_first)

    def _restore(self, log: str) -> None:
        """
        Take in what is on record.

        Publishers keep so many messages only, and they may have died with what they said.
        """
        check_same_field(log, self._ledger.grid)
        self._mission = read_mission(log)
        agents = agents_of(self.values, self.grid)
        with same_types(log):
            evidence = read_log(log, (PATH, REPORT))
            for logged in self.tell_progress(evidence, f'taking in {log}'):
                if agent_of(logged.topic) in agents:
                    # What was refused when it came is refused again.
                    with suppress(ValueError):
                        record(self._ledger, logged)

    def _publish_first(self) -> None:
        waiting, now = self.waiting_for([self._belief]), self.now()
        if waiting or now <= 0:
            self.diagnostics.state = waiting or WAITING_FOR_CLOCK
        else:
            self._started = now
            self._awaiting.cancel()
            # From the prior a log can be computed again.
            self._publish(self._prior)
            if self._ledger.deployments:
                self._publish(self._ledger)
            self._say_what_is_held()

    def _on_path(self, agent: str, message: Path) -> None:
        try:
            key, cells = read_path(self._ledger.grid, agent, message)
            self._ledger.grid.check_path(cells, self._ledger.most_steps(key))
            self._join(mission_of_path(message))
            changed = self._ledger.record_path(key, cells)
        except ValueError as error:
            self._refuse(f'{agent}/path', error)
        else:
            self._accept(key, changed)

    def _on_report(self, agent: str, message: DeploymentReport) -> None:
        try:
            key, report = read_report(message, agent)
            changed = self._ledger.record_report(key, report)
        except ValueError as error:
            self._refuse(f'{agent}/report', error)
        else:
            self._accept(key, changed)

    def _join(self, mission: int) -> None:
        """
        Take part in a mission, unless it is another one than that of the paths held.

        Those heard before the first belief is published may be of several, such as of an old bag
        that is played: then the newest counts. Whatever it is, a planner that names the time of
        this estimator's own prior has begun a mission on it.

        Raises
        ------
        ValueError
            If it is another one.

        """
        is_newer = self._mission is not None and mission > self._mission
        if (is_newer and not self._started) or 0 < mission == self._started != self._mission:
            ledger = self._prior.copy()
            ledger.await_paths_of(self._ledger)
            self._ledger = ledger
        else:
            check_mission(mission, self._mission)
        self._mission = mission

    def _refuse(self, topic: str, error: ValueError) -> None:
        # A report that waited in vain for the right path has been dropped.
        self.diagnostics.waiting = self._ledger.waiting
        self.diagnostics.refuse(topic, error)

    def _accept(self, key: DeploymentKey, changed: bool) -> None:
        self.diagnostics.waiting = self._ledger.waiting
        if self._awaiting.is_canceled():
            if changed:
                self._publish(self._ledger)
                self._tell_ending(key)
            else:
                self._progress.tell_out(self._ledger.out)
            self._say_what_is_held()
        if changed and key in self._ledger.contradicted:
            # The return that was held until now counts no longer.
            self.diagnostics.refuse(f'{key.agent}/report', self._ledger.contradicted[key])
        else:
            self.diagnostics.accept()

    def _tell_ending(self, key: DeploymentKey) -> None:
        """Tell on the console how a deployment ended, and what is known now."""
        ledger = self._ledger
        survived, steps = ledger.ending(key)
        contact = f', heard of last after step {steps}' if steps else ''
        ended = 'came back' if survived else f'was lost{contact}'
        self.tell_deployment(
            f'{key} {ended}: entropy {ledger.belief.entropy():.2f} nats after '
            f'{len(ledger.deployments)} deployments, {ledger.lost} robots lost'
        )

    def _publish(self, ledger: Ledger) -> None:
        mission = self._started if self._mission is None else self._mission
        message = belief_maps(ledger, self._started, mission)
        self._belief.publish(message)
        grid, belief = ledger.grid, ledger.belief
        stamp = from_stamp(message.header.stamp)
        for name, publisher in self._maps.items():
            publisher.publish(occupancy_grid(grid, getattr(belief, name), stamp))
        if self._model is not None:
            self._model.publish(model_belief(ledger, stamp))
        self._progress.take(ledger, stamp)
        self._say_how_sure(ledger.estimator)

    def _say_how_sure(self, estimator: Estimator) -> None:
        """Tell how far chance takes the belief, and warn if that is further than aimed at."""
        error = f'{estimator.sampling_error:.2g}'
        self.diagnostics.values['sampling_error'] = error
        self.diagnostics.warning = (
            ''
            if estimator.is_settled
            else f'sampling has not settled: the belief is {error} nats off by chance'
        )

    def _say_what_is_held(self) -> None:
        self.diagnostics.state = (
            f'{len(self._ledger.deployments)} deployments in the belief, '
            f'{self._ledger.duplicates} messages said nothing new'
        )


def main(args: Sequence[str] | None = None) -> int:
    """Run the estimator; return the exit code."""
    return run('estimator', EstimatorNode, args, linger=0.3)


if __name__ == '__main__':
    sys.exit(main())
