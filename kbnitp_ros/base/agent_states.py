# SPDX-License-Identifier: Apache-2.0
"""The states of the agents of a team, compared with the field of the base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.core import Grid
from kbnitp_ros.messages.states import AgentState, Readiness


class AgentStates:
    """The newest state of each agent of a team."""

    def __init__(self, fields: Mapping[str, Grid], values: Mapping[str, Any]) -> None:
        # The field of each agent, with its base.
        self._fields = fields
        self._values = values
        self._states: dict[str, AgentState] = {}
        # Time at which each agent first stated another journal than before, nanoseconds.
        self._replaced: dict[str, int] = {}
        # Differences between the field of an agent and the field of the base, by agent.
        self.foreign: dict[str, str] = {}

    def take(self, agent: str, state: AgentState) -> bool:
        """Keep a state; return whether the agent withdraws the reason of its last state."""
        known = self._states.get(agent)
        self._states[agent] = state
        if known is not None and known.journal != state.journal:
            self._replaced[agent] = state.stamp
        self.foreign.pop(agent, None)
        if differs := state.difference(self._fields[agent]):
            self.foreign[agent] = differs
        is_clear = state.readiness is Readiness.READY and not state.reason
        return known is not None and bool(known.reason) and is_clear

    @property
    def unstated(self) -> list[str]:
        """Return the agents whose field is not known, so that they get no order."""
        # An agent whose departures are presumed may be out of radio range: its reports say which
        # field it has.
        if self._values['presume_departure']:
            return []
        return [each for each in self._fields if each not in self._states]

    def reason(self, agent: str) -> str:
        """Return the agent's field if it differs, or else the reason of its state; '' if none."""
        if agent in self.foreign:
            return f'its field differs: {self.foreign[agent]}'
        state = self._states.get(agent)
        return '' if state is None else state.reason

    def words(self, agent: str) -> str:
        """Return the reason of an agent after its name; '' if none."""
        if agent in self.foreign or agent not in self._states:
            return f'{agent} says: {reason}' if (reason := self.reason(agent)) else ''
        words = self._states[agent].words
        return f'{agent} {words}' if words else ''

    def reasons(self) -> str:
        """Return what the agents say, in a sentence; empty if none gives a reason."""
        return '; '.join(filter(None, map(self.words, self._fields)))

    def why_not_lost(self, agent: str, departed: int) -> str:
        """Explain why a robot that departed at a time, in ns, is not lost; '' if it may be."""
        if agent in self.foreign:
            return f'a loss in another field is no evidence: {self.foreign[agent]}'
        state = self._states.get(agent)
        # A state from before the departure says nothing about the robot after it.
        if state is None or state.stamp < departed:
            return ''
        if state.readiness is Readiness.NO_JOURNAL:
            return state.reason
        if not state.is_at_base:
            return ''
        why = f' ({state.reason})' if state.reason else ''
        if self._replaced.get(agent, 0) > departed:
            why += ', with another journal than at the departure: give it up if it was replaced'
        return f'its robot stands at its base{why}'

    def is_left_to_operator(self, agent: str) -> bool:
        """Return whether a robot that is not lost may only be given up by the operator."""
        state = self._states.get(agent)
        has_no_journal = state is not None and state.readiness is Readiness.NO_JOURNAL
        return has_no_journal or agent in self.foreign
