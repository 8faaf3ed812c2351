# SPDX-License-Identifier: Apache-2.0
"""Findings of people: likelihoods over the states of cells, or changes of them."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import (
    as_array,
    flag,
    in_short,
    number,
    on_field,
    probability,
    read_only,
    Value,
    whole_number,
)
import numpy as np
from numpy.typing import NDArray

# States of a cell's hazard, in this order: no hazard, a live one, a dud.
HAZARD_STATES = 3


@dataclass(frozen=True, eq=False, repr=False)
class Finding(Value):
    """
    Knowledge of a person about cells, the same about each of them.

    A finding multiplies P(state) of each of its cells by its likelihood (:eq:`finding`), or, if
    the field was changed, moves probability (:eq:`finding-changed`). It speaks of its own cells
    only, and takes no time: nothing changes in the field because of it.

    Parameters
    ----------
    cells : array_like of int
        Cells that it speaks of, each of them; stored ascending, each once.
    hazard : bool, optional
        False: there is no hazard, neither a live one nor a dud. True: there is one. None: nothing
        is said.
    target : bool, optional
        Likewise for targets.
    confidence : float
        Confidence c in [0, 1) in `hazard` and in `target`: states that contradict them are
        multiplied by 1 - c. With `changed`, the share of the probability that moves.
    walked : float
        Probability that a live hazard would have destroyed somebody who went through the cell
        and is well: live hazards are multiplied by 1 - `walked`. 0 if nobody went.
    since : int, optional
        Time since when it is so, nanoseconds of ROS time; None for now.
    changed : bool
        Whether the field was changed just then: a hazard was removed (`hazard` is False) or placed
        (True), a target was taken away or placed. A hazard that is placed is live. It is no
        evidence of the state before, nor of unknown numbers.

    Raises
    ------
    ValueError
        If it has no cell, a value is out of range, nothing is said, or `changed` comes without a
        change or with `walked`.

    """

    cells: NDArray[np.intp]
    hazard: bool | None = None
    target: bool | None = None
    confidence: float = 0.99
    walked: float = 0.0
    since: int | None = None
    changed: bool = False

    def __post_init__(self) -> None:
        cells = as_array('cells', self.cells, 'cells')
        if cells.ndim != 1 or not cells.size:
            raise ValueError(
                f'cells is {in_short(cells.tolist())}: it must list at least one cell, as [12, 13]'
            )
        if cells.dtype.kind not in 'iu':
            raise TypeError(
                f'cells is {in_short(self.cells)}: it must be of cells, whole numbers; of a mask '
                'give np.flatnonzero(mask)'
            )
        if cells.min() < 0:
            raise ValueError(f'cells has the cell {cells.min()}: cells are numbered from 0')
        told = {name: getattr(self, name) for name in ('hazard', 'target')}
        confidence = number(
            'confidence',
            self.confidence,
            'at least 0 and below 1, so that other evidence can contradict it',
            lambda c: 0.0 <= c < 1.0,
        )
        walked, changed = probability('walked', self.walked), flag('changed', self.changed)
        if not walked and self.hazard is None and self.target is None:
            raise ValueError(
                'hazard and target are None, and walked is 0: say one of them, or leave the '
                'finding out'
            )
        if changed and walked:
            raise ValueError(
                f'walked is {walked}, and changed is True: make two findings, of the walk and of '
                'the change'
            )
        vars(self).update(
            {name: None if each is None else flag(name, each) for name, each in told.items()},
            cells=read_only(np.unique(cells).astype(np.intp)),
            confidence=confidence,
            walked=walked,
            since=None if self.since is None else whole_number('since', self.since, 0),
            changed=changed,
        )

    @property
    def of_hazard(self) -> NDArray[np.float64]:
        """Return the matrix that acts on P(no hazard, live, dud), shape (3, 3)."""
        matrix = self._matrix(self.hazard, HAZARD_STATES)
        matrix[:, 1] *= 1.0 - self.walked
        return matrix

    @property
    def of_target(self) -> NDArray[np.float64]:
        """Return the matrix that acts on P(X), shape (2, 2)."""
        return self._matrix(self.target, 2)

    def _matrix(self, is_there: bool | None, states: int) -> NDArray[np.float64]:
        """Return the matrix of a statement (:eq:`finding`, :eq:`finding-changed`)."""
        matrix: NDArray[np.float64] = np.eye(states)
        if is_there is None:
            return matrix
        if self.changed:
            matrix *= 1.0 - self.confidence
            matrix[int(is_there)] += self.confidence
        else:
            contradicts = (np.arange(states) > 0) != is_there
            matrix[contradicts] *= 1.0 - self.confidence
        return matrix

    def check(self, belief: Belief) -> None:
        """Check that the cells are those of a belief, and may have what was placed in them."""
        on_field('cells', self.cells, belief.cells)
        for what, chance in (('hazard', belief.hazard), ('target', belief.target)):
            never = self.cells[chance[self.cells] == 0.0]
            if self.changed and getattr(self, what) and never.size:
                raise ValueError(
                    f'a {what} was placed in cell {never[0]}, whose probability of one is 0, as '
                    f'of bases and obstacles: leave the cell out'
                )
