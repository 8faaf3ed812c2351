# SPDX-License-Identifier: Apache-2.0
"""What the operator of a mission has decided, as its log has it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from kbnitp_ros.core import DeploymentKey, Grid
from kbnitp_ros.log.bag import LoggedMessage, read_log, same_types
from kbnitp_ros.messages.decisions import Action, Decision, read_decision
import numpy as np
from numpy.typing import NDArray

OPERATOR = 'kbnitp_msgs/msg/OperatorAction'

Paths = Mapping[DeploymentKey, NDArray[np.intp]]


class Decisions:
    """
    What holds by what the operator has decided.

    Attributes
    ----------
    taken : dict of int to Decision
        All decisions by the times that name them, in the order they were taken.
    is_paused : bool
        Whether no robot leaves for now.
    is_ended : bool
        Whether none leaves any more.
    given_up : dict of DeploymentKey to int
        The robots that were given up, and how many steps each is known to have survived.

    """

    def __init__(self) -> None:
        self.taken: dict[int, Decision] = {}
        self.is_paused = False
        self.is_ended = False
        self.given_up: dict[DeploymentKey, int] = {}

    def take(self, decision: Decision) -> bool:
        """Take note of a decision; return whether it was not known."""
        if decision.stamp in self.taken:
            return False
        self.taken[decision.stamp] = decision
        if decision.action in (Action.PAUSE, Action.RESUME):
            self.is_paused = decision.action == Action.PAUSE
        elif decision.action == Action.GIVE_UP:
            self.given_up |= dict.fromkeys(decision.paths, decision.steps_survived)
        elif decision.action == Action.END:
            self.is_ended = True
        return True

    def refused(self, robots_left: int) -> list[list[NDArray[np.intp]]]:
        """Return the rounds of paths that were refused since the last robot left."""
        return [
            list(each.paths.values())
            for each in self.taken.values()
            if each.action == Action.REFUSE and each.robots_left == robots_left
        ]

    def is_approved(self, robots_left: int, paths: Paths) -> bool:
        """
        Return whether paths were approved since the last robot left.

        The times that name them may be others: an estimator that is restarted has another prior.
        """
        return any(
            each.action == Action.APPROVE
            and each.robots_left == robots_left
            and are_same(each.paths, paths)
            for each in self.taken.values()
        )


def are_same(ones: Paths, others: Paths) -> bool:
    """Return whether robots of the same agents go the same ways."""
    ways = [{key.agent: path.tolist() for key, path in paths.items()} for paths in (ones, others)]
    return ways[0] == ways[1]


def is_decision(logged: LoggedMessage) -> bool:
    """Return whether a message on record is a decision of the mission's operator."""
    return logged.type_name == OPERATOR and logged.topic.endswith('/operator')


def read_decisions(log: str | Path, grid: Grid) -> Iterator[tuple[Decision, bytes]]:
    """
    Yield what the operator decided, and the messages as they came off the wire.

    Parameters
    ----------
    log : str or Path
        The log of one mission, finished or not.
    grid : Grid
        The mission's.

    Raises
    ------
    LogError
        If it cannot be read or is damaged.

    """
    with same_types(log):
        for logged in read_log(log, (OPERATOR,)):
            if is_decision(logged):
                # What is none would not have been taken, either.
                with suppress(ValueError):
                    yield read_decision(grid, logged.message), logged.data
