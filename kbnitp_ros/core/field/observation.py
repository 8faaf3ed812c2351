# SPDX-License-Identifier: Apache-2.0
"""What one deployment tells: the path-based sensor's and the target sensor's outcome."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field.check import frozen, whole_number, yes_no_or_unseen, yes_or_no
from kbnitp_ros.core.field.value import Value
import numpy as np
from numpy.typing import ArrayLike, NDArray


def as_path(path: ArrayLike) -> NDArray[np.intp]:
    """
    Return a copy of `path` as cell numbers: at least one step.

    Raises
    ------
    ValueError
        If it is not a flat sequence of whole numbers or has no step.

    """
    array = np.asarray(path)
    if array.ndim != 1 or array.size < 2:
        raise ValueError(
            f'path has shape {array.shape}: it must list at least two cells, the base twice'
        )
    if not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f'path is of type {array.dtype}: cells are whole numbers')
    return np.array(array, dtype=np.intp)


@dataclass(frozen=True, eq=False, repr=False)
class Observation(Value):
    """
    The outcome of one deployment.

    Parameters
    ----------
    path : array_like of int, shape (steps + 1,)
        The cells in order, the base first and last. The robot starts in the first one; each of
        the others is the end of a step. Of a robot that returned it is the way it went, of a lost
        one the way it was sent.
    survived : bool
        Whether the robot came back (the path-based sensor did not trigger, Theta = 0).
    readings : array_like of bool or int, shape (steps,), optional
        The target sensor's reading Y in the cell each step leads to, -1 where it did not look;
        None when the robot was lost.
    steps_survived : int
        How many of its first steps a lost robot is known to have survived, from a last contact; 0
        when nothing is known.

    Raises
    ------
    ValueError
        If the path is not closed or has no step, or the readings or `steps_survived` do not fit
        the outcome.

    """

    path: NDArray[np.intp]
    survived: bool
    readings: NDArray[np.bool_] | NDArray[np.int8] | None = None
    steps_survived: int = 0

    def __post_init__(self) -> None:
        path = as_path(self.path)
        if path.min() < 0:
            raise ValueError(f'path has the cell {path.min()}: cells are numbered from 0')
        if path[0] != path[-1]:
            raise ValueError(
                f'path starts at cell {path[0]} and ends at {path[-1]}: it must return to its base'
            )
        frozen(path)
        object.__setattr__(self, 'path', path)
        object.__setattr__(self, 'survived', bool(yes_or_no('survived', self.survived)))
        self._check_readings()
        self._check_steps_survived()

    def _check_readings(self) -> None:
        if self.readings is None:
            if self.survived:
                raise ValueError(
                    'readings are missing: a robot that returned has one for each step'
                )
            return
        readings = yes_no_or_unseen('readings', self.readings)
        if not self.survived:
            raise ValueError(
                f'readings has {readings.size} values: a robot that was lost brings none'
            )
        if readings.shape != (self.steps,):
            raise ValueError(
                f'readings has shape {readings.shape}: it must be ({self.steps},), one each step'
            )
        frozen(readings)
        object.__setattr__(self, 'readings', readings)

    def _check_steps_survived(self) -> None:
        steps = whole_number('steps_survived', self.steps_survived, 0)
        if self.survived and steps:
            raise ValueError(f'steps_survived is {steps}: a robot that returned survived them all')
        if steps >= self.steps:
            raise ValueError(
                f'steps_survived is {steps}: a robot lost on a path of {self.steps} steps '
                f'survived at most {self.steps - 1}'
            )
        object.__setattr__(self, 'steps_survived', steps)

    @property
    def steps(self) -> int:
        """How many steps the path has."""
        return len(self.path) - 1


@dataclass(frozen=True, eq=False)
class Visits:
    """
    How often a path enters each of its cells.

    Attributes
    ----------
    cells : ndarray of int, shape (n,)
        The cells that some step leads to, ascending. The start is not a visit; the return is.
    counts : ndarray of int, shape (n,)
        Steps into each.
    of_step : ndarray of int, shape (steps,)
        For each step, the place of its cell in `cells`.

    """

    cells: NDArray[np.intp]
    counts: NDArray[np.intp]
    of_step: NDArray[np.intp]

    @classmethod
    def of(cls, path: NDArray[np.intp]) -> Visits:
        """Count the visits of `path`, or of a stretch of it, shape (steps + 1,)."""
        cells, of_step, counts = np.unique(path[1:], return_inverse=True, return_counts=True)
        return cls(cells, counts, of_step)
