# SPDX-License-Identifier: Apache-2.0
"""Numbers that a decision trusts: told, not learnt, and able to change what it states."""

from __future__ import annotations

from dataclasses import replace
from math import isnan

from kbnitp_ros.core.decision.decision import Decision, Trusted
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.core.field.check import typed, whole_number
from kbnitp_ros.core.inference.estimator import Estimator

# Factor on a told number, up and down; a change of a probability that counts, and one that never
# does.
FACTOR, MOVED, LEAST = 1.5, 0.01, 0.001


@typed
def with_told(decision: Decision, estimator: Estimator, deployments: int) -> Decision:
    """
    Return a decision with the numbers that it trusts without having learnt them.

    Each told number is multiplied and divided by 1.5, within [0, 1], and all evidence is
    assimilated again. A number is trusted if that changes `p_free` or `survival` of the
    decision's cells by more than .01, or by more than it lacks to 1, and by more than .001.

    Parameters
    ----------
    decision : Decision
        The decision.
    estimator : Estimator
        The estimator by which it was made.
    deployments : int
        Number of deployments so far.

    """
    deployments, told = whole_number('deployments', deployments, 0), {}
    for name, value in estimator.told.items():
        seen = []
        for other in (value / FACTOR, min(value * FACTOR, 1.0)):
            try:
                changed = estimator.retold(name, other / value)
            except ValueError:
                # The evidence is impossible with that number.
                continue
            hazards, survival = joint_hazards(changed, deployments), decision.survival
            if decision.path.size:
                survival = hazards.survival(decision.path, changed.model)
            seen.append(Trusted(value, other, hazards.p_free(decision.cells), survival))
        moves = [moved(each, decision) for each in seen]
        if max(moves, default=0.0) > 1.0:
            told[name] = seen[moves.index(max(moves))]
    return replace(decision, told=told)


def moved(trusted: Trusted, decision: Decision) -> float:
    """Return the larger change of `p_free` and `survival`, in units of what may pass."""
    pairs = ((trusted.p_free, decision.p_free), (trusted.survival, decision.survival))
    changes = (
        abs(other - stated) / max(min(MOVED, 1.0 - stated), LEAST)
        for other, stated in pairs
        if not isnan(stated)
    )
    return max(changes, default=0.0)
