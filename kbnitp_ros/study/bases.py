# SPDX-License-Identifier: Apache-2.0
"""A second base: how many fewer robots come to the same log loss."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from kbnitp_ros.study.loss_cost import at_equal_log_loss, compare, trade
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.summary import Mean, mean_of, Row
import numpy as np
from numpy.typing import NDArray

# What is compared where missions from one base and from two know as much.
EQUAL = ('log_loss', 'sent_from_one', 'sent', 'lost_from_one', 'lost', 'fewer')


def base_rows(results: Results) -> Iterator[Row]:
    """Yield what each second base is worth."""
    scenario = results.scenario
    one, *others = sorted(scenario.teams, key=lambda team: team.second_base)
    for lethality, method, two in product(scenario.lethalities, scenario.methods, others):
        missions = [trade(results, lethality, method, team) for team in (one, two)]
        value = missions[0][:, 1, -1] - missions[1][:, 1, -1]
        compared = compare(*missions, at_equal=at_equal)
        measured = {name: Mean(*values) for name, *values in zip(EQUAL, *compared)}
        yield {
            'lethality': lethality,
            'method': method,
            **vars(two),
            'value': mean_of(value),
            **measured,
        }


def at_equal(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `EQUAL`, shape (6,), of two missions as `at_equal_log_loss` takes them."""
    log_loss, sent_from_one, sent, lost_from_one, lost, _ = at_equal_log_loss(one, two)
    return np.array([log_loss, sent_from_one, sent, lost_from_one, lost, sent_from_one - sent])
