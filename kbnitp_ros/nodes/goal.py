# SPDX-License-Identifier: Apache-2.0
"""The decisions and draws that a planner with a goal gets from the estimator."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from kbnitp_msgs.msg import Decision as DecisionMessage
from kbnitp_msgs.srv import Draws
from kbnitp_ros.base.state import BaseState, EvidenceName
from kbnitp_ros.configuration import make_goal
from kbnitp_ros.configuration.mission import make_stop
from kbnitp_ros.core import Decision, HazardDraws
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import content_hash, from_stamp, to_stamp
from kbnitp_ros.messages.progress import read_decision, read_draws
from kbnitp_ros.messages.topics import DECISION
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode

# Seconds between two requests for the same draws.
PAUSE = 1.0

# Seconds for which a decision that ends the mission, or takes its end back, must stay the same.
CONFIRMED = 1.0


class GoalState:
    """The goal of the planner, the decision on it, and draws of the hazards for its plans."""

    def __init__(self, node: FieldNode, state: BaseState, act: Callable[[], object]) -> None:
        self._node = node
        self._state = state
        self._act = act
        # None to map the field. Decisions are judged by the present confidence, not by the goal's.
        self.goal = make_goal(node.values, state.grid)
        self._newest = EvidenceName(0, 0)
        # The last decision with its evidence and no-go cells, the hash of its message, and the
        # time since which it is the same, seconds.
        self._decided: tuple[EvidenceName, tuple[int, ...], Decision] | None = None
        self._content, self._same_since = 0, 0.0
        self._drawn: tuple[EvidenceName, HazardDraws] | None = None
        # The belief of the last request for draws, unless it was answered.
        self._asked: EvidenceName | None = None
        # Time of the next request after one without draws, seconds.
        self._ask_at = 0.0
        # Reason why the plans for the newest belief end the mission, None if they do not; and the
        # reason logged last.
        self.not_worth: str | None = None
        self._said: str | None = None
        if self.goal is not None:
            node.subscribe(DecisionMessage, 'decision', self._on_decision, qos.LATCHED)
            self._draws = node.create_client(Draws, 'draws')

    def take(self, newest: Snapshot) -> None:
        """Await the decision on the newest belief."""
        self._newest, self._asked = EvidenceName(*newest.evidence), None
        self.not_worth = None
        self._act()

    def _on_decision(self, message: DecisionMessage) -> None:
        """Keep a decision; the goal of the estimator must be that of this planner."""
        values, goal = self._node.values, self.goal
        try:
            decision = read_decision(self._state.grid, message)
            theirs = message.goal, [*message.goal_cells]
            if goal is not None and theirs != (ours := (goal.name, [*values['goal.cells']])):
                raise ValueError(
                    f'the goal is {theirs[0]} of cells {theirs[1]} for the estimator, but '
                    f'{ours[0]} of cells {ours[1]} for this planner: set the same parameters '
                    'goal.* for both'
                )
        except ValueError as error:
            self._node.diagnostics.refuse('decision', error)
            return
        if (content := content_hash(message)) != self._content:
            self._content, self._same_since = content, time.monotonic()
        evidence = EvidenceName(from_stamp(message.epoch), message.changes)
        self._decided = evidence, tuple(message.no_go), decision
        # An estimator that was restarted answers in place of the one that ended.
        self._asked = None
        self._act()

    @property
    def is_decided(self) -> bool:
        """Return whether the decision on the newest belief counts, or is not needed."""
        if self.goal is None:
            return True
        decision = self._decision
        if decision is None:
            return False
        changes_end = decision.reached or self._state.operator.reached
        return not changes_end or self._is_confirmed

    @property
    def is_reached(self) -> bool | None:
        """Return whether the goal is reached; None without a goal, or until it is decided."""
        if self.goal is None or not self.is_decided:
            return None
        decision = self._decision
        return decision is not None and decision.reached

    @property
    def _is_confirmed(self) -> bool:
        """Return whether a decision stayed the same, with one node that publishes decisions."""
        named = self._node.named_authors('decision', DECISION)
        is_old = time.monotonic() > self._same_since + CONFIRMED
        return is_old and len({*named}) == 1

    @property
    def _decision(self) -> Decision | None:
        """Return the decision on the newest belief, by the confidence of this planner."""
        if self._decided is None:
            return None
        *of, decision = self._decided
        if of != [self._newest, self._state.operator.no_go]:
            return None
        return decision.judged(self._node.values['stop.confidence'] or None)

    def why_over(self) -> str | None:
        """Return the reason why no more robots leave; None if robots may leave."""
        decision = self._decision if self.goal is not None else None
        why = make_stop(self._node.values).why(decision, self._state.lost) or self.not_worth
        if why != self._said:
            self._said = why
            if why is not None:
                self._node.get_logger().info(f'no more robots leave: {why}')
        return why

    @property
    def draws(self) -> HazardDraws | None:
        """Return draws for the newest belief; None until they have arrived."""
        if self._drawn is None or self._drawn[0] != self._newest:
            return None
        return self._drawn[1]

    @property
    def awaits_draws(self) -> bool:
        """Return whether a plan waits for draws."""
        return self.goal is not None and self.draws is None

    def ask_for_draws(self) -> None:
        """Ask the estimator for draws, unless a request is under way."""
        is_due = self._asked != self._newest and time.monotonic() > self._ask_at
        if is_due and self._draws.service_is_ready():
            newest = self._asked = self._newest
            request = Draws.Request(epoch=to_stamp(newest.epoch), changes=newest.changes)
            self._draws.call_async(request).add_done_callback(
                self._node.guarded(lambda answer: self._on_draws(newest, answer.result()))
            )

    def _on_draws(self, newest: EvidenceName, answer: Any) -> None:
        if newest == self._asked:
            self._asked, self._ask_at = None, time.monotonic() + PAUSE
        if not answer.success:
            return
        try:
            grid = self._state.grid
            self._drawn = newest, read_draws(answer, grid.cells, grid.around)
        except ValueError as error:
            self._node.diagnostics.refuse('draws', error)
        else:
            self._ask_at = 0.0
            self._act()
