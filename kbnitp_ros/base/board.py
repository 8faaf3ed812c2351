# SPDX-License-Identifier: Apache-2.0
"""The board of a mission: a small JSON object for people beside the field."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from kbnitp_ros.base.preflight import Check
from kbnitp_ros.base.said import contradictions, Statement, statements
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.core import Decision, DeploymentKey
from kbnitp_ros.core.inference.record import OrderState
from kbnitp_ros.messages.headers import SECOND, stamp_fields
from kbnitp_ros.messages.health import Health
from kbnitp_ros.messages.progress import Helper, MissionStatus, NOT_KNOWN, Obstacle
from kbnitp_ros.messages.remarks import Remark
from kbnitp_ros.messages.states import AgentState
import numpy as np
from numpy.typing import NDArray

# Seconds without a sign from which on the age of the last sign is shown: signs come each second.
SILENT = 3

# Seconds for which a preview is shown that nobody follows by its order.
PREVIEWED = 300


@dataclass
class Sign:
    """The last signs of an agent: its state, since when it has it, and the health of its robot."""

    state: AgentState | None = None
    # Time of the first state of the same readiness and reason, nanoseconds of the robot's clock.
    since: int = 0
    health: Health | None = None
    # Time by the robot's clock after the base's, when its health arrived, seconds.
    offset: float = 0.0
    # Time of the last sign, seconds of the board's steady clock.
    heard: float = 0.0

    def take(self, state: AgentState) -> None:
        """Take a state."""
        known = self.state
        if not known or (known.readiness, known.reason) != (state.readiness, state.reason):
            self.since = state.stamp
        self.state = state


@dataclass(frozen=True)
class Proposal:
    """A path that waits for approval, and its probability of return."""

    key: DeploymentKey
    path: NDArray[np.intp]
    returns: float


@dataclass
class Preview:
    """A preview that nobody has followed by its order."""

    order: str
    arguments: Mapping[str, Any]
    message: str
    # Epoch and events of the evidence of which it was made; None without evidence.
    evidence: tuple[int, int] | None
    # When it was made, seconds of the board's steady clock.
    made: float


@dataclass
class Board:
    """The last words of a base and its robots."""

    name: str
    status: MissionStatus = NOT_KNOWN
    # Time of the last sign of the planner, seconds of the board's steady clock.
    heard: float = 0.0
    # Deployments in the belief, and the decision on the goal made with it.
    deployments: int = 0
    decision: Decision | None = None
    # The fold of the mission; None before the first belief.
    state: BaseState | None = None
    remarks: dict[int, Remark] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    signs: dict[str, Sign] = field(default_factory=dict)
    proposals: dict[str, Proposal] = field(default_factory=dict)
    previews: dict[str, Preview] = field(default_factory=dict)
    # Checks of the robots before the first departure; empty after it.
    checks: Sequence[Check] = ()
    # What statements of this board changed, as kbnitp_msgs/Effect, by their hashes.
    effects: dict[int, Any] = field(default_factory=dict)
    # Number of open streams of those who may act, and who may look.
    streams: dict[str, int] = field(default_factory=lambda: {'act': 0, 'look': 0})
    # Statements as they were computed last, and the evidence and actions by then.
    _said: tuple[tuple[int, ...], list[Statement]] = ((), [])

    def facts(
        self, now: int, steady: float, longest: Callable[[DeploymentKey], float]
    ) -> dict[str, Any]:
        """
        Return the board at a time, in nanoseconds of ROS time and seconds of the steady clock.

        `longest`: the seconds after its departure at which a robot is overdue.
        """
        said = self._statements()
        facts = {
            'mission': self._mission(steady),
            'goal': self._goal(),
            'parameters': {**self.parameters},
            'needs': [*self._needs(steady)],
            'robots': [self._robot(agent, now, steady, longest) for agent in sorted(self.signs)],
            'preflight': [each._asdict() | {'light': each.light.name} for each in self.checks],
            'said': [statement_facts(each) | self._effect(each) for each in said],
            'contradictions': [
                {'findings': [*map(str, pair)], 'cells': cells}
                for pair, cells in contradictions(said).items()
            ],
            'closed': [*self.status.no_go],
            'open': {**self.streams},
        }
        plain: dict[str, Any] = as_json(facts)
        return plain

    def _statements(self) -> list[Statement]:
        """Return all statements, computed again only if anything was said or judged."""
        if (state := self.state) is None:
            return []
        actions = len(state.operator.actions)
        now = (*state.evidence, state.events, len(self.remarks), actions, len(state.paths))
        if self._said[0] != now:
            self._said = now, statements(state, self.remarks.values())
        return self._said[1]

    def _mission(self, steady: float) -> dict[str, Any]:
        status, state = self.status, self.state
        return {
            'name': self.name,
            'state': status.state.name,
            'obstacle': status.obstacle.name,
            'ends_by': status.ends_by.name,
            'reason': status.reason,
            'hold': status.hold,
            'sent': status.ordered,
            'out': status.out,
            'lost': status.lost,
            'held': status.held,
            'deployments': self.deployments,
            'epoch': stamp(state.evidence.epoch if state else 0),
            'events': state.events if state else 0,
            'age': age(steady, self.heard),
        }

    def _goal(self) -> dict[str, Any] | None:
        if (decision := self.decision) is None:
            return None
        return {
            'kind': decision.goal,
            'p_free': decision.p_free,
            'error': decision.error,
            'confidence': self.status.confidence,
            'reached': decision.reached,
            'reason': decision.reason,
            'survival': decision.survival,
            'trusted': [
                {
                    'name': name,
                    'value': each.value,
                    'other': each.other,
                    'p_free': each.p_free,
                    'survival': each.survival,
                }
                for name, each in decision.told.items()
            ],
        }

    def _effect(self, said: Statement) -> dict[str, Any]:
        """Return the effect of a statement of this board."""
        effect = self.effects.get(said.content)
        names = ('p_free', 'hazards')
        return {'effect': effect and {name: getattr(effect, name) for name in names}}

    def _needs(self, steady: float) -> Iterator[dict[str, Any]]:
        """Yield what waits for a person."""
        status, state = self.status, self.state
        for proposal in self.proposals.values():
            yield {
                'what': 'approval',
                **deployment(proposal.key),
                'cells': proposal.path,
                'returns': proposal.returns,
            }
        for key, why in state.held.items() if state else ():
            yield {'what': 'held', **deployment(key), 'why': why}
        if status.ends_by is Helper.OPERATOR and status.obstacle is not Obstacle.UNAPPROVED:
            yield {'what': 'mission', 'obstacle': status.obstacle.name, 'why': status.reason}
        evidence = (state.evidence.epoch, state.events) if state else None
        for nonce, preview in self.previews.items():
            if steady > preview.made + PREVIEWED:
                continue
            yield {
                'what': 'preview',
                'nonce': nonce,
                'order': preview.order,
                'arguments': preview.arguments,
                'message': preview.message,
                'stale': preview.evidence not in (None, evidence),
            }

    def _robot(
        self, agent: str, now: int, steady: float, longest: Callable[[DeploymentKey], float]
    ) -> dict[str, Any]:
        sign, said = self.signs[agent], self.signs[agent].state
        state = self.state
        orders = state.kept_orders if state else []
        sent = [key for key in orders if key.agent == agent]
        last = sent[-1] if sent else None
        out = [key for key in sent if state and key in state.in_flight]
        since = due = None
        if state and out and (status := state.status(out[0])) is not None:
            since = status.stamp if status.state is OrderState.DEPARTED else None
        if since is not None:
            due = since + round(longest(out[0]) * SECOND)
        needs = self.status.waiting.get(agent)
        return {
            'name': agent,
            'state': said.readiness.name if said else None,
            'reason': said.reason if said else '',
            'since': seconds(sign.since) if said else None,
            'waits_for': needs.name if needs else None,
            'at_base': said.is_at_base if said else None,
            'battery': round(sign.health.battery, 2) if sign.health else None,
            'age': age(steady, sign.heard),
            'deployment': stamp(last.stamp) if last else None,
            'number': orders.index(last) + 1 if last else 0,
            'out': bool(out),
            'taken_back': bool(state and {*out} & state.operator.taken_back.keys()),
            'out_since': seconds(since),
            'due': seconds(due),
            'overdue': due is not None and now > due,
        }


def statement_facts(said: Statement) -> dict[str, Any]:
    """Return a statement as values of JSON: hashes as texts, and times in seconds."""
    values = dict(said.values)
    for name in values.keys() & {'report', 'revokes'}:
        values[name] = str(values[name])
    if 'deployment' in values:
        values['deployment'] = stamp(values['deployment'])
    if 'since' in values:
        values['since'] = seconds(values['since'])
    by = said.revoked_by
    return {
        'kind': said.kind,
        'time': seconds(said.stamp),
        'author': said.author,
        'note': said.note,
        'hash': str(said.content) if said.content else None,
        'words': said.words,
        'cells': said.cells,
        **values,
        'holds': said.holds,
        'revoked_by': by.author if by else None,
        'revoked_at': seconds(by.stamp) if by else None,
    }


def deployment(key: DeploymentKey) -> dict[str, Any]:
    """Return the name of a deployment, as the services take it."""
    return {'agent': key.agent, 'deployment': stamp(key.stamp)}


def stamp(nanoseconds: int) -> dict[str, int]:
    """Return a time as the fields of its message."""
    return dict(vars(stamp_fields(nanoseconds)))


def seconds(nanoseconds: int | None) -> float | None:
    """Return a time in seconds, to the millisecond; None if it is not known."""
    return None if nanoseconds is None else round(nanoseconds / SECOND, 3)


def age(steady: float, heard: float) -> int | None:
    """Return the whole seconds since a sign, 0 below `SILENT`; None without a sign."""
    passed = int(steady - heard)
    return None if not heard else passed * (passed >= SILENT)


def as_json(value: Any) -> Any:
    """Return values that JSON has: None for numbers that are not finite, lists for sequences."""
    if isinstance(value, Mapping):
        return {name: as_json(each) for name, each in value.items()}
    if isinstance(value, np.ndarray):
        return as_json(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [*map(as_json, value)]
    return None if isinstance(value, float) and not isfinite(value) else value
