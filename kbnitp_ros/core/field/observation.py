# SPDX-License-Identifier: Apache-2.0
"""The observation of one deployment: outcome of the path-based sensor, and target readings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from kbnitp_ros.core.field.check import (
    as_array,
    as_floats,
    flag,
    in_short,
    listed,
    probability,
    read_only,
    Value,
    whole_number,
    yes_or_no,
)
import numpy as np
from numpy.typing import ArrayLike, NDArray


def as_path(path: ArrayLike, name: str = 'path') -> NDArray[np.intp]:
    """Return a copy of `path` as cell numbers; ValueError if it has no step."""
    try:
        array = np.array(path)
    except ValueError:
        # Lists of different lengths.
        array = np.empty(0)
    if array.ndim != 1 or array.size < 2:
        raise ValueError(
            f'{name} is {in_short(path)}: it must list at least two cells, the base first and last'
        )
    if array.dtype.kind not in 'iu':
        raise ValueError(f'{name} is of type {array.dtype}: cells are whole numbers')
    return array.astype(np.intp, copy=False)


@dataclass(frozen=True, eq=False, repr=False)
class Observation(Value):
    """
    The outcome of one deployment.

    Parameters
    ----------
    path : array_like of int, shape (steps + 1,)
        Cells in order: the start, then the end of each step; the base is first and last. Of a
        robot that returned, the cells it visited; of a lost robot, the cells it was ordered to.
    survived : bool
        Whether the robot came back (the path-based sensor did not trigger, Theta = 0).
    readings : array_like of bool or int, shape (steps,), optional
        The target sensor's reading Y in the cell each step leads to, -1 where it did not look;
        None when the robot was lost.
    steps_survived : int
        Number of steps that a lost robot is known to have survived, by its last contact; 0 without
        a contact.
    lost_at : array_like, shape (steps,), optional
        Likelihood of a loss in each step of a lost robot: P(observed | lost in the step) up to a
        factor, at least 0 and not all 0; None if all steps are alike. It is evidence of when the
        robot was lost, not of the cause.

        Stored normalised: the largest value is 1, steps before the first possible one are 0 and
        counted in `steps_survived`, and None stands for equal values in all remaining steps.
    entered : array_like of bool, shape (steps,), optional
        For each step of a robot that returned, whether it was in the cell for certain. A step that
        the robot cannot vouch for gives neither survival nor reading. None if all steps count.
    by_hazard : bool, optional
        Cause of a loss, as a person found it: True, a hazard of the cell or one that reaches it;
        False, something else, such as a flat battery; None if it is unknown.

    Raises
    ------
    ValueError
        If the path is not closed or has no step, or the readings, `steps_survived`, `lost_at`,
        `entered` or `by_hazard` do not fit the outcome.

    """

    path: NDArray[np.intp]
    survived: bool
    readings: NDArray[np.bool_] | NDArray[np.int8] | None = None
    steps_survived: int = 0
    lost_at: NDArray[np.float64] | None = None
    entered: NDArray[np.bool_] | None = None
    by_hazard: bool | None = None

    def __post_init__(self) -> None:
        path = as_path(self.path)
        if path.min() < 0:
            raise ValueError(f'path has the cell {path.min()}: cells are numbered from 0')
        if path[0] != path[-1]:
            raise ValueError(
                f'path starts at cell {path[0]} and ends at {path[-1]}: it must return to its base'
            )
        survived = self.survived
        if not isinstance(survived, bool):
            survived = flag('survived', survived)
        vars(self).update(path=read_only(path), survived=survived)
        if self.entered is not None:
            self._check_entered(yes_or_no('entered', self.entered))
        if self.readings is not None:
            self._check_readings(as_array('readings', self.readings, 'readings'))
        elif survived:
            raise ValueError('readings are missing: a robot that returned has one for each step')
        steps = whole_number('steps_survived', self.steps_survived, 0)
        if survived and steps:
            raise ValueError(f'steps_survived is {steps}: leave it at 0 for a robot that returned')
        if steps >= self.steps:
            raise ValueError(
                f'steps_survived is {steps}: a robot lost on a path of {self.steps} steps '
                f'survived at most {self.steps - 1}'
            )
        vars(self).update(steps_survived=steps)
        if self.lost_at is not None:
            self._check_lost_at(as_floats('lost_at', self.lost_at))
        if self.by_hazard is not None:
            if survived:
                raise ValueError('by_hazard is given, but the robot returned: leave it out')
            vars(self).update(by_hazard=flag('by_hazard', self.by_hazard))

    def _check_entered(self, entered: NDArray[np.bool_]) -> None:
        if not self.survived:
            raise ValueError('entered is given, but the robot was lost: leave it out')
        self._check_shape('entered', entered)
        vars(self).update(entered=None if entered.all() else read_only(entered))

    def _check_readings(self, given: NDArray[Any]) -> None:
        if self.entered is not None and given.shape == self.entered.shape:
            given = np.where(self.entered, given, -1)
        if not self.survived:
            raise ValueError(
                f'readings has {given.size} values: a robot that was lost brings none'
            )
        self._check_shape('readings', given)
        unseen = given == -1
        if given.dtype != bool:
            yes_or_no('readings', given[~unseen])
        # Readings are stored as booleans, or as -1, 0 and 1 if a step has no reading.
        readings = given.astype(np.int8 if unseen.any() else bool, copy=False)
        vars(self).update(readings=read_only(readings))

    def _check_lost_at(self, lost_at: NDArray[np.float64]) -> None:
        if self.survived:
            raise ValueError('lost_at is given, but the robot returned: leave it out')
        self._check_shape('lost_at', lost_at)
        bad = np.flatnonzero(~((lost_at >= 0.0) & (lost_at < np.inf)))
        if bad.size:
            raise ValueError(
                f'lost_at[{bad[0]}] is {lost_at[bad[0]]}: it must be a finite number, at least 0'
            )
        if not lost_at.any():
            raise ValueError('lost_at is 0 in all steps: one of them must be possible')
        lost_at[: self.steps_survived] = 0.0
        if not lost_at.any():
            raise ValueError(
                f'lost_at is 0 in all steps after the first {self.steps_survived}, which were '
                'survived: the loss must be possible in one of the later steps'
            )
        lost_at /= lost_at.max()
        first = int(np.argmax(lost_at > 0.0))
        is_alike = bool((lost_at[first:] == 1.0).all())
        vars(self).update(steps_survived=first, lost_at=None if is_alike else read_only(lost_at))

    def _check_shape(self, name: str, values: NDArray[Any]) -> None:
        """Check that there is one value for each step."""
        if values.shape != (self.steps,):
            raise ValueError(
                f'{name} has shape {values.shape}: it must be ({self.steps},), one for each step'
            )

    @property
    def steps(self) -> int:
        """Return the number of steps of the path."""
        return len(self.path) - 1

    @property
    def is_unmoved(self) -> bool:
        """Return whether the robot came back without a step into another cell."""
        return self.survived and bool((self.path == self.path[0]).all())

    @property
    def is_entered(self) -> NDArray[np.bool_]:
        """Return a mask of the steps that count, shape (steps,)."""
        return np.ones(self.steps, dtype=bool) if self.entered is None else self.entered

    @property
    def evidence(self) -> tuple[NDArray[np.intp], NDArray[np.bool_] | NDArray[np.int8] | None]:
        """Return the start and the cells of the steps that count, and their readings."""
        if self.entered is None or self.readings is None:
            return self.path, self.readings
        return self.path[np.append(True, self.entered)], self.readings[self.entered]

    @property
    def lost_on(self) -> tuple[NDArray[np.intp], NDArray[np.float64] | None]:
        """Return the stretch of the path where the robot may have been lost, with likelihoods."""
        first = self.steps_survived
        if self.lost_at is None:
            return self.path[first:], None
        end = int(np.flatnonzero(self.lost_at)[-1]) + 1
        lost_at = self.lost_at[first:end]
        last = end + 1
        return self.path[first:last], None if (lost_at == 1.0).all() else lost_at


def as_observations(name: str, given: Iterable[Observation]) -> list[Observation]:
    """Return a collection of observations as a list."""
    observations = listed(name, given, ' of Observation')
    for observation in observations:
        if not isinstance(observation, Observation):
            raise TypeError(f'{name} has {in_short(observation)}: it must have Observation(...)')
    return observations


def lost_after_contact(path: ArrayLike, steps_survived: int, contact: float) -> Observation:
    """Return the observation of a loss after a last contact (:eq:`contact-probability`)."""
    heard = Observation(as_path(path), False, steps_survived=steps_survived)
    if contact == 0.0:
        return heard
    unheard = np.arange(heard.steps) - heard.steps_survived
    silence = (1.0 - probability('contact', contact)) ** np.maximum(unheard, 0)
    return Observation(heard.path, False, None, heard.steps_survived, silence)


@dataclass(frozen=True, eq=False)
class Visits:
    """The number of visits of a path to each of its cells."""

    # The cells visited, ascending, shape (n,). The return to the base is a visit, the start is
    # not.
    cells: NDArray[np.intp]
    # Number of visits to each cell, shape (n,).
    counts: NDArray[np.intp]
    # Index into `cells` of each step's cell, shape (steps,).
    of_step: NDArray[np.intp]

    @classmethod
    def of(cls, path: NDArray[np.intp]) -> Visits:
        """Count the visits of `path`, or of a stretch of it, shape (steps + 1,)."""
        # Faster than np.unique for paths of robots.
        cells = np.array(sorted({*path[1:].tolist()}), dtype=np.intp)
        of_step = cells.searchsorted(path[1:])
        return cls(cells, np.bincount(of_step), of_step)


@dataclass(frozen=True, eq=False)
class Exposures:
    """The cells whose hazards act on a path: those of its steps, and those around them."""

    # These cells, ascending, shape (n,).
    cells: NDArray[np.intp]
    # Index into `cells` of each step's cell, shape (steps,).
    of_step: NDArray[np.intp]
    # Whether each step leads into a cell, or into one beside it, shape (steps, n).
    inside: NDArray[np.bool_]
    beside: NDArray[np.bool_]

    @classmethod
    def of(cls, path: NDArray[np.intp], around: NDArray[np.intp]) -> Exposures:
        """Find the exposures of `path`, shape (steps + 1,), given `Grid.around`."""
        entered, near = path[1:], around[path[1:]]
        cells = np.unique(np.concatenate([entered, near[near >= 0]]))
        of_step = cells.searchsorted(entered)
        inside = of_step[:, None] == np.arange(cells.size)
        beside = np.zeros((entered.size, cells.size + 1), np.bool_)
        # The last column is of no cell.
        place = np.where(near >= 0, cells.searchsorted(near), cells.size)
        np.put_along_axis(beside, place, values=True, axis=1)
        return cls(cells, of_step, inside, beside[:, :-1])
