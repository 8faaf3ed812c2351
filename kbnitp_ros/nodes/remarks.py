# SPDX-License-Identifier: Apache-2.0
"""The services by which people say what they know: findings, annotations and revocations."""

from __future__ import annotations

from collections.abc import Callable
from concurrent import futures
from functools import partial
from math import nan
import time
from typing import Any, NamedTuple

from kbnitp_msgs.msg import Annotation, Effect, Finding, Recorded, Revocation
from kbnitp_msgs.srv import AddFinding, Annotate, Revoke
from kbnitp_ros.configuration import make_goal
from kbnitp_ros.configuration.places import said_cells
from kbnitp_ros.core import DeploymentKey, Ledger
from kbnitp_ros.core import Finding as CoreFinding
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.core.inference.record import OPEN
from kbnitp_ros.messages.deployments import Acknowledged
from kbnitp_ros.messages.headers import from_stamp, next_name, read_name, to_stamp
from kbnitp_ros.messages.remarks import read_remark, Remark, stamped
from kbnitp_ros.nodes.decisions import Decisions
from kbnitp_ros.nodes.operator_services import answered
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
import numpy as np
from rclpy.task import Future

# Maximum number of remarks of a mission, so that endless calls fill neither memory nor disk.
MAX_REMARKS = 1000

# Seconds to judge a mission again from which on the answer says so.
LONG = 2.0


class Evidence(NamedTuple):
    """The evidence of which a preview is: the start of the estimator, and its events."""

    epoch: int
    events: int


class Trial(NamedTuple):
    """A copy of the ledger, and the number of messages that the ledger had taken by then."""

    ledger: Ledger
    taken: int


class Pending(NamedTuple):
    """A remark that is not on record yet, and the call that it answers."""

    remark: Remark
    # The ledger with the remark.
    trial: Trial
    response: Any
    answer: Future


class Remarks:
    """The services `add_finding`, `annotate` and `revoke`, one call at a time."""

    def __init__(
        self,
        node: FieldNode,
        known: Callable[[], tuple[Evidence, Trial]],
        take: Callable[[Remark, Trial], None],
        decisions: Decisions,
    ) -> None:
        self._node = node
        # The evidence judged now and its ledger; ValueError before the first belief.
        self._known = known
        # Called with a remark on record, and the ledger with it.
        self._take = take
        # Previews lead through no closed cells either.
        self._decisions = decisions
        self._is_busy = False
        self._pending: Pending | None = None
        self._publishers = {
            name: node.create_publisher(kind, name, qos.EVIDENCE)
            for name, kind in (
                ('findings', Finding),
                ('annotations', Annotation),
                ('revocations', Revocation),
            )
        }
        self._last = 0
        node.create_service(AddFinding, 'add_finding', self._on_add_finding)
        node.create_service(Annotate, 'annotate', self._on_annotate)
        node.create_service(Revoke, 'revoke', self._on_revoke)
        if node.values['recorded']:
            node.subscribe(Recorded, 'operator/recorded', self._on_recorded, qos.EVIDENCE)

    def _on_add_finding(self, request: AddFinding.Request, response: Any) -> Any:
        def fill(stamp: int, _: Ledger) -> Finding:
            if len(request.x) or len(request.y):
                if len(request.finding.cells):
                    raise ValueError('finding.cells and x are given: give one of them')
                grid, values = self._node.grid, self._node.values
                request.finding.cells = said_cells(grid, values, request).astype(np.uint32)
            if not from_stamp(request.finding.since):
                request.finding.since = to_stamp(stamp)
            return request.finding

        return self._on('add_finding', 'findings', fill, request, response)

    def _on_annotate(self, request: Annotate.Request, response: Any) -> Any:
        def fill(_: int, ledger: Ledger) -> Annotation:
            said = request.annotation
            key = DeploymentKey(said.agent, read_name('deployment', said.deployment))
            if (path := ledger.paths.get(key)) is None:
                raise ValueError(f'deployment {key} is not known')
            if request.cell >= 0:
                steps = np.flatnonzero(path[1:] == request.cell) + 1
                if not steps.size or len(said.steps):
                    raise ValueError(
                        f'cell is {request.cell}: it must be one of the path, and no steps given'
                    )
                said.steps = steps.astype(np.uint32)
            if not said.report:
                standing = ledger.standings.get(key, OPEN)
                first = [each.content for each in standing.refusals]
                said.report = standing.report or next(iter(first), 0)
            return said

        return self._on('annotate', 'annotations', fill, request, response)

    def _on_revoke(self, request: Revoke.Request, response: Any) -> Any:
        return self._on('revoke', 'revocations', lambda *_: request.revocation, request, response)

    def _on(
        self,
        service: str,
        topic: str,
        fill: Callable[[int, Ledger], Any],
        request: Any,
        response: Any,
    ) -> Any:
        """Try a remark on a copy of the ledger; put it on record unless only asked for."""
        try:
            evidence, (ledger, taken) = self._known()
            if self._is_busy:
                raise ValueError(
                    'another remark is being judged, or waits for the recorder: call again later'
                )
            given = Evidence(from_stamp(request.epoch), request.events)
            if not request.preview and given != evidence:
                raise ValueError(
                    f'epoch and events are {given.epoch} and {given.events}, and the evidence is '
                    f'{evidence.epoch} and {evidence.events}: ask for the preview again'
                )
            if len(ledger.remarks) >= MAX_REMARKS:
                raise ValueError(f'{MAX_REMARKS} remarks are on record, and no more are taken')
            stamp = next_name(self._node.now(), self._last)
            message = stamped(fill(stamp, ledger), stamp)
            remark = read_remark(topic, message)
        except (ValueError, TypeError) as error:
            return self._refused(service, response, error)
        self._is_busy = True
        answer = Future()

        def reply(found: futures.Future[Effect]) -> None:
            self._is_busy = False
            try:
                response.effect = found.result()
                response.effect.epoch = to_stamp(evidence.epoch)
                response.effect.events = evidence.events
                if not request.preview and self._known()[0] != evidence:
                    raise ValueError('new evidence arrived meanwhile: ask for the preview again')
            except ValueError as error:
                answer.set_result(self._refused(service, response, error))
                return
            if request.preview:
                answer.set_result(answered(response, True, describe_effect(response.effect)))
                return
            self._last, self._is_busy = stamp, True
            self._pending = Pending(remark, Trial(trial, taken), response, answer)
            self._publishers[topic].publish(message)
            if not self._node.values['recorded']:
                self._finish()

        # The estimator judges on meanwhile, in another thread.
        before, trial = ledger.copy(), ledger.copy()
        self._node.compute(partial(self._tried, before, trial, remark), reply)
        return answer

    def _refused(self, service: str, response: Any, error: Exception) -> Any:
        self._node.diagnostics.refuse(service, error)
        return answered(response, False, str(error))

    def _tried(self, ledger: Ledger, trial: Ledger, remark: Remark) -> Effect:
        """Return what a remark changes, which is recorded in a copy of the ledger."""
        began = time.monotonic()
        remark.record(trial)
        seconds = time.monotonic() - began
        goal, values = make_goal(self._node.values, self._node.grid), self._node.values
        p_free, grid = [nan, nan], self._decisions.open_grid
        if goal is not None:
            for place, each in enumerate((ledger, trial)):
                hazards = joint_hazards(each.estimator, len(each.deployments))
                model = each.estimator.model
                decision = goal.decide(grid, hazards, model, values['max_steps'])
                p_free[place] = decision.p_free
        out = []
        if isinstance(remark.said, CoreFinding) and remark.said.changed:
            out = [
                str(key)
                for key, path in trial.paths.items()
                if key not in trial.standings
                and key.stamp < (remark.said.since or 0)
                and np.isin(path, remark.said.cells).any()
            ]
        return Effect(
            p_free=p_free,
            hazards=[float(each.belief.hazard.sum()) for each in (ledger, trial)],
            lost=np.array([ledger.lost, trial.lost], dtype=np.uint32),
            held=[str(key) for key in trial.held if key not in ledger.held],
            out=out,
            seconds=seconds,
        )

    def _on_recorded(self, message: Recorded) -> None:
        waiting = self._pending
        is_remark = message.kind == Acknowledged.REMARK
        if waiting and is_remark and message.content == waiting.remark.content:
            self._finish()

    def _finish(self) -> None:
        """Judge the remark that is on record, and answer the call."""
        assert self._pending is not None
        remark, trial, response, answer = self._pending
        self._pending, self._is_busy = None, False
        try:
            self._take(remark, trial)
        except ValueError as error:
            answer.set_result(self._refused('remarks', response, error))
            return
        response.content = remark.content
        answer.set_result(answered(response, True, describe_effect(response.effect)))


def describe_effect(effect: Effect) -> str:
    """Return a sentence on what a remark changes."""
    words = [f'expected hazards {effect.hazards[0]:.2f} -> {effect.hazards[1]:.2f}']
    if not np.isnan(effect.p_free[0]):
        words.append(f'free with {effect.p_free[0]:.3f} -> {effect.p_free[1]:.3f}')
    if effect.lost[0] != effect.lost[1]:
        words.append(f'lost robots {effect.lost[0]} -> {effect.lost[1]}')
    if effect.held:
        words.append(f'held until BEFORE or AFTER is said of each: {", ".join(effect.held)}')
    if effect.out:
        words.append(f'out meanwhile: {", ".join(effect.out)}')
    if effect.seconds > LONG:
        words.append(f'{effect.seconds:.1f} s to judge the mission again')
    return '; '.join(words)
