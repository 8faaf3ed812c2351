# SPDX-License-Identifier: Apache-2.0
"""Annotations of people: corrections of the reports of single deployments."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

from kbnitp_ros.core.field.observation import Observation
import numpy as np
from numpy.typing import NDArray


class AnnotationKind(IntEnum):
    """The kind of an annotation, as in kbnitp_msgs/Annotation."""

    # Where, or by what, the robot was lost.
    LOCATED = 1
    # The robot survived a number of steps, and then failed without any hazard.
    NO_HAZARD = 2
    # The robot was carried home.
    RECOVERED = 3
    # The deployment says nothing.
    WITHDRAW = 4
    # The robot was lost before, or after, the field was changed.
    BEFORE = 5
    AFTER = 6

    @property
    def is_of_order(self) -> bool:
        """Return whether it orders a loss and a change of the field."""
        return self in (AnnotationKind.BEFORE, AnnotationKind.AFTER)


@dataclass(frozen=True)
class Annotation:
    """
    Knowledge of a person about one deployment, by the report that it speaks of.

    Attributes
    ----------
    kind : AnnotationKind
        What is said.
    report : int
        Hash of the report; another report of the deployment makes the annotation lapse.
    steps : tuple of int
        LOCATED: steps in which the robot may have been lost, from 1; empty if all may be.
        NO_HAZARD: the number of steps that it survived. RECOVERED: steps in which it entered its
        cell, from 1.
    by_hazard : bool, optional
        LOCATED: whether a hazard destroyed it (True), or something else (False); None: unknown.
    stamp : int
        Time when it was said, nanoseconds of ROS time; ignored in comparisons.

    """

    kind: AnnotationKind
    report: int
    steps: tuple[int, ...] = ()
    by_hazard: bool | None = None
    stamp: int = field(default=0, compare=False)

    def applied(self, path: NDArray[np.intp], outcome: Observation | None) -> Observation:
        """
        Return the outcome of a deployment as annotated.

        Parameters
        ----------
        path : ndarray of int, shape (steps + 1,)
            Path of the deployment.
        outcome : Observation or None
            Outcome by its report; None if the report is refused.

        Raises
        ------
        ValueError
            If the annotation does not fit the outcome.

        """
        if self.kind is AnnotationKind.WITHDRAW:
            return unentered(path, np.zeros(len(path) - 1, bool))
        if self.kind is AnnotationKind.RECOVERED:
            return self._recovered(path, outcome)
        if outcome is None or outcome.survived:
            raise ValueError(
                f'the robot is not reported lost, so that {self.kind.name} cannot be said of it'
            )
        if self.kind.is_of_order:
            return outcome
        contact = outcome.steps_survived
        if self.kind is AnnotationKind.NO_HAZARD:
            (survived,) = self.steps
            if not contact <= survived < outcome.steps:
                raise ValueError(
                    f'steps is {survived}: the robot survived at least {contact} of its '
                    f'{outcome.steps} steps, and was lost in one of them'
                )
            at = (np.arange(outcome.steps) == survived).astype(float)
            return Observation(path, False, None, 0, at, by_hazard=False)
        lost_at = self._mask(outcome.steps).astype(float) if self.steps else outcome.lost_at
        return Observation(path, False, None, contact, lost_at, by_hazard=self.by_hazard)

    def _recovered(self, path: NDArray[np.intp], outcome: Observation | None) -> Observation:
        """Return the outcome of a robot that was carried home: readings that both vouch for."""
        if outcome is None or not outcome.survived:
            return unentered(path, self._mask(len(path) - 1))
        entered = outcome.is_entered & self._mask(outcome.steps)
        return Observation(outcome.path, True, outcome.readings, entered=entered)

    def _mask(self, steps: int) -> NDArray[np.bool_]:
        mask = np.zeros(steps, bool)
        wrong = [step for step in self.steps if not 1 <= step <= steps]
        if wrong:
            raise ValueError(f'steps has {wrong[0]}: the robot has the steps 1 to {steps}')
        mask[np.array(self.steps, int) - 1] = True
        return mask


def unentered(path: NDArray[np.intp], entered: NDArray[np.bool_]) -> Observation:
    """Return the outcome of a robot that is home without readings."""
    return Observation(path, True, np.full(len(path) - 1, -1), entered=entered)
