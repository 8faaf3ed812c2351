# SPDX-License-Identifier: Apache-2.0
"""Kernel over deployments in many fields: their outcomes, and the beliefs given them."""

from __future__ import annotations

from math import exp, expm1, inf, log, log1p

from kbnitp_ros.core.field.check import Floats, Places
from kbnitp_ros.core.field.compiled import compiled, inlined
import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]


@inlined
def cell_entropy(joint: Floats, field: int, cell: int) -> float:
    """Return H(Z, X) of a cell, nats."""
    entropy = 0.0
    for z in range(2):
        for x in range(2):
            p = joint[field, cell, z, x]
            entropy -= p * log(p) if p > 0.0 else 0.0
    return entropy


@compiled
def conclude(
    fields: Places,
    paths: Places,
    steps: Places,
    drawn: Floats,
    worlds: Flags,
    log_step: Floats,
    camera: Floats,
    joint: Floats,
    gained: Floats,
    returned: Flags,
) -> None:
    """
    Draw the outcomes of deployments and condition on them (:eq:`returned`, :eq:`loss-exact`).

    Paths, random numbers and outcomes have a row for each of `fields`, worlds and joints one for
    each field. `log_step` is indexed by hazard, `camera` by target.
    """
    visits = np.zeros(joint.shape[1], np.int64)
    for k in range(fields.size):
        field, end = fields[k], steps[k] + 1
        path = paths[k, 1:end]
        for step in range(path.size):
            visits[path[step]] += 1
            if drawn[k, 0, step] >= exp(log_step[int(worlds[0, field, path[step]])]):
                returned[k] = False
        cells, counts = np.empty(path.size, np.int64), np.empty(path.size, np.int64)
        log_survival, most = np.empty(path.size), 0
        for cell in path:
            if visits[cell] > 0:
                n, z = visits[cell], min(joint[field, cell, 1, 0] + joint[field, cell, 1, 1], 1.0)
                loss = -(1.0 - z) * expm1(n * log_step[0]) - z * expm1(n * log_step[1])
                log_survival[most] = log1p(-loss) if loss < 1.0 else -inf
                cells[most], counts[most], visits[cell] = cell, n, 0
                gained[k] += cell_entropy(joint, field, cell)
                most += 1
        for step in range(path.size if returned[k] else 0):
            cell = path[step]
            is_read = drawn[k, 1, step] < camera[int(worlds[1, field, cell])]
            for x in range(2):
                chance = camera[x] if is_read else 1.0 - camera[x]
                joint[field, cell, 0, x] *= chance
                joint[field, cell, 1, x] *= chance
        for i in range(most):
            others, total, cell = 0.0, 0.0, cells[i]
            for j in range(most):
                others += log_survival[j] if j != i else 0.0
            for z in range(2):
                own = counts[i] * log_step[z]
                likelihood = exp(own) if returned[k] else -expm1(others + own)
                for x in range(2):
                    joint[field, cell, z, x] *= likelihood
                    total += joint[field, cell, z, x]
            joint[field, cell] /= total
            gained[k] -= cell_entropy(joint, field, cell)
