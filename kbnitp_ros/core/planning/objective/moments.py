# SPDX-License-Identifier: Apache-2.0
"""
The entropy of a robot's return by moments of its survival.

Of h(p) = -p ln p - (1 - p) ln(1 - p) the first term averages exactly, cell by cell. The second is
replaced by a sum of powers, sum_j WEIGHTS_j p^EXPONENTS_j, since E[p^a] is a product over cells
(equations :eq:`moment-log`, :eq:`entropy-powers` and :eq:`moment-power`).
The exponents were sought for, and the weights are the best for them on the whole of [0, 1].
"""

from __future__ import annotations

import numpy as np

# The first is 1: its moment is the predicted survival itself.
EXPONENTS = np.array([1.0, 2.026, 3.832, 9.407, 28.14, 101.5, 482.6, 4111.0])
WEIGHTS = np.array(
    [
        1.000314622,
        -0.547169326,
        -0.271418285,
        -0.119928225,
        -0.043547782,
        -0.013911176,
        -0.003654438,
        -0.000665898,
    ]
)

# The most that the sum of powers is off, nats.
ERROR = 1.95e-5
