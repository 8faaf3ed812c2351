# SPDX-License-Identifier: Apache-2.0
"""What is done to the nodes of a mission, and when: drawn at random, the same for a seed."""

from dataclasses import dataclass, replace
from signal import SIGKILL, Signals, SIGSTOP

import numpy as np

NODES = ('recorder', 'estimator', 'agent', 'planner')

# How many nodes each kind of fault strikes.
STRUCK = {'kill': 1, 'stop': 1, 'two': 2, 'all': len(NODES)}

# A mixed mission has faults of all kinds.
KINDS = (*STRUCK, 'mixed')


@dataclass(frozen=True)
class Fault:
    """One or more nodes struck at a moment, each back after a pause."""

    kind: str
    reports: int
    delay: float
    pauses: dict[str, float]
    # Whether the operator pauses the mission meanwhile, or is about to.
    is_held: bool = False

    @property
    def signal(self) -> Signals:
        """Return what strikes: nodes that are stopped go on, those killed are started again."""
        return SIGSTOP if self.kind == 'stop' else SIGKILL


def draw_faults(rng: np.random.Generator, kind: str, robots: int) -> list[Fault]:
    """Draw one to five faults of a kind, in the order of the reports they wait for."""
    reports_at = rng.integers(0, robots, size=2)
    faults = []
    for reports in sorted(rng.choice(reports_at, size=rng.integers(1, 6)).tolist()):
        drawn = rng.choice(list(STRUCK), p=(0.4, 0.2, 0.2, 0.2)) if kind == 'mixed' else kind
        struck = rng.permutation(NODES)[: STRUCK[drawn]]
        longest = 2.0 if not reports or rng.random() < 0.15 else 0.06
        pauses = {str(node): rng.uniform(0.0, 0.5) for node in struck}
        faults.append(Fault(str(drawn), reports, rng.uniform(0.0, longest), pauses))
    return [replace(each, is_held=bool(rng.random() < 0.3)) for each in faults]
