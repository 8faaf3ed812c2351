# SPDX-License-Identifier: Apache-2.0
"""What may be relied on by now: the answer to the goal of a mission."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

from kbnitp_ros.core.decision.hazard_draws import HazardDraws, Path, quantile
from kbnitp_ros.core.decision.lanes import SafestPath
from kbnitp_ros.core.field import frozen
import numpy as np
from numpy.typing import ArrayLike

# A confidence must leave out this many of the independent draws at least: what is told by fewer
# is chance.
FEWEST_LEFT_OUT = 5.0


@dataclass(frozen=True, eq=False)
class Decision:
    """
    What may be relied on, given all deployments so far.

    Attributes
    ----------
    goal : str
        What is asked: 'lane', 'area', or a name of another package.
    p_free : float
        Probability that no cell that is asked for has a hazard, in [0, 1].
    cells : ndarray of int, shape (cells,)
        Those that are asked for.
    independent_draws : float
        So many independent draws of the hazards would tell it as well.
    path : ndarray of int, shape (steps + 1,)
        Of a lane: one way, from the base to the goal; empty otherwise.
    survival : float
        Probability that a robot survives that path, in [0, 1]; NaN without one.
    hazards_mean : float
        How many hazards are expected in what is asked.
    hazards_5, hazards_95 : int
        The least numbers of hazards that are not exceeded with a probability of 5 % and of 95 %.
    reached : bool
        Whether the confidence that was asked for is reached; False where none was.
    reason : str
        Why not, in words; empty when it is.

    """

    goal: str
    p_free: float
    cells: Path
    independent_draws: float
    path: Path
    survival: float
    hazards_mean: float
    hazards_5: int
    hazards_95: int
    reached: bool
    reason: str

    @classmethod
    def about(
        cls,
        goal: str,
        draws: HazardDraws,
        cells: ArrayLike,
        confidence: float | None,
        lane: SafestPath | None = None,
    ) -> Decision:
        """Return the decision whether some cells, those of the lane if there is one, are free."""
        count = draws.hazard_count(cells)
        p_free = draws.p_free(cells)
        reason = why_not_reached(p_free, confidence, draws.independent)
        path = np.empty(0, dtype=np.intp) if lane is None else lane.path
        asked = np.unique(cells)
        for each in (path, asked):
            frozen(each)
        return cls(
            goal=goal,
            p_free=p_free,
            cells=asked,
            independent_draws=draws.independent,
            path=path,
            survival=nan if lane is None else lane.survival,
            hazards_mean=float(count @ np.arange(count.size)),
            hazards_5=quantile(count, 0.05),
            hazards_95=quantile(count, 0.95),
            reached=not reason,
            reason=reason,
        )


def why_not_reached(p_free: float, confidence: float | None, independent: float) -> str:
    """Return why a confidence is not reached; empty if it is."""
    if confidence is None:
        return 'no confidence is asked for'
    if p_free < confidence:
        return f'free of hazards with probability {p_free:.3f}: {confidence} is asked for'
    return too_few_draws(confidence, independent)


def too_few_draws(confidence: float, independent: float) -> str:
    """
    Return why a confidence cannot be told from so many independent draws; empty if it can.

    Equation :eq:`draws-needed`.
    """
    if (1.0 - confidence) * independent >= FEWEST_LEFT_OUT:
        return ''
    needed = FEWEST_LEFT_OUT / (1.0 - confidence)
    return (
        f'a confidence of {confidence} takes {needed:.0f} independent draws of the hazards, and '
        f'there are {independent:.0f}: ask for less'
    )


def check_confidence(confidence: float | None) -> None:
    """Check a confidence."""
    if confidence is not None and not 0.0 < confidence < 1.0:
        raise ValueError(f'confidence is {confidence}: it must be between 0 and 1, both excluded')
