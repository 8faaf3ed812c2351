# SPDX-License-Identifier: Apache-2.0
"""
The update methods: what each makes of a lost robot.

A returned robot is evidence that all methods take in alike. They differ in the likelihood
P(lost | Z_i = z) they give the cells of a lost robot's path, and in whether they hold hazard and
target correlated. A new one-pass method is one file with that likelihood and one line here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from kbnitp_ros.core.field import SensorModel, Visits
from kbnitp_ros.core.inference import exact, multi_universe, published
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class OnePass:
    """
    A method that folds each deployment into the belief once and forgets it.

    Attributes
    ----------
    lost : callable
        (hazard of the visited cells (n,), model, visits) -> likelihood, shape (n, 2), indexed
        [visited cell, z]; any common factor is normalised away.
    correlated : bool
        Whether it holds kappa; without it a mission starts from kappa := target.

    """

    lost: Callable[[NDArray[np.float64], SensorModel, Visits], NDArray[np.float64]]
    correlated: bool


ONE_PASS = {
    'relaxed_itp': OnePass(multi_universe.lost_likelihood, correlated=False),
    'relaxed_bnitp': OnePass(published.lost_likelihood, correlated=False),
    'kappa_bnitp_published': OnePass(published.lost_likelihood, correlated=True),
    'kappa_bnitp': OnePass(exact.lost_likelihood, correlated=True),
}
