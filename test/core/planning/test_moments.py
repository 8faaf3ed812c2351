# SPDX-License-Identifier: Apache-2.0
"""The sum of powers that stands for the surprisal of a loss."""

from kbnitp_ros.core.planning.objective import ERROR, EXPONENTS, WEIGHTS
import numpy as np

# Dense where the powers and the surprisal change, near 0 and near 1.
LOGIT = np.linspace(-30, 30, 600_001)
LOSS = 1 / (1 + np.exp(LOGIT))


def error():
    surprisal = -LOSS * np.log(LOSS)
    return surprisal - np.exp(-np.log1p(np.exp(-LOGIT))[:, None] * EXPONENTS) @ WEIGHTS


def test_the_error_is_as_said_from_0_to_1():
    assert np.abs(error()).max() <= ERROR
    assert abs(WEIGHTS.sum()) <= ERROR  # at 1, where nothing is lost; at 0 all is 0


def test_no_other_weights_are_better():
    """The error is as large, in turn above and below, once more often than there are weights."""
    far = error()[np.abs(error()) > 0.999 * np.abs(error()).max()]
    turns = 1 + (np.diff(np.sign(far)) != 0).sum()
    assert turns == WEIGHTS.size + 1


def test_the_first_moment_is_the_survival():
    assert EXPONENTS[0] == 1
