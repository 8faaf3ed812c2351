# SPDX-License-Identifier: Apache-2.0
"""The transfer matrix of clustered hazards, applied cell by cell."""

from __future__ import annotations

from math import exp, log

from kbnitp_ros.core.field.compiled import compiled
import numpy as np
from numpy.typing import NDArray


@compiled
def transfer(
    free: NDArray[np.bool_], fields: NDArray[np.float64], coupling: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return ln Z and expected hazards of a strip for each field a (:eq:`transfer-matrix`)."""
    log_z, count = np.empty_like(fields), np.empty_like(fields)
    rows, columns = free.shape
    states = 1 << columns
    weight, slope = np.empty(states), np.empty(states)
    for value in range(fields.size):
        hazard, tie = exp(fields[value]), exp(coupling)
        weight[:], slope[:] = 0.0, 0.0
        weight[0] = 1.0
        log_scale = 0.0
        for row in range(rows):
            for column in range(columns):
                bit = 1 << column
                left = bit >> 1
                for base in range(0, states, 2 * bit):
                    for safe in range(base, base + bit):
                        struck = safe + bit
                        by_left = hazard * tie if safe & left else hazard
                        with_hazard, its_slope = 0.0, 0.0
                        if free[row, column]:
                            with_hazard = by_left * (weight[safe] + tie * weight[struck])
                            its_slope = by_left * (slope[safe] + tie * slope[struck])
                        weight[safe] += weight[struck]
                        slope[safe] += slope[struck]
                        weight[struck] = with_hazard
                        slope[struck] = its_slope + with_hazard
            largest = weight.max()
            weight /= largest
            slope /= largest
            log_scale += log(largest)
        total = weight.sum()
        log_z[value] = log_scale + log(total)
        count[value] = slope.sum() / total
    return log_z, count
