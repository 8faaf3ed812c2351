# SPDX-License-Identifier: Apache-2.0
"""How missions come to the decision they are asked for, and how far it may be relied on."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from kbnitp_ros.core.decision import FEWEST_LEFT_OUT
from kbnitp_ros.study.charts import means_chart
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Scenario, team_labels
from kbnitp_ros.study.summary import after_robots, mean_of, Row
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

# After how many robots missions are compared.
ROBOTS = (10, 25, 50, 100)
# The probabilities at which missions may end.
CONFIDENCES = (0.9, 0.95, 0.99)
# The part of an area that is to be declared free.
MOST_CELLS = 0.8


def asks_for(scenario: Scenario, goal: str) -> bool:
    """Return whether missions are asked for such a goal, and go on when it is reached."""
    asked = scenario.asked
    return asked is not None and asked.goal == goal and not asked.confidence


def certifies(scenario: Scenario) -> bool:
    """Return whether missions end when they are sure enough."""
    return scenario.asked is not None and bool(scenario.asked.confidence)


def lane_rows(results: Results) -> Iterator[Row]:
    """Yield how often the lane is free, as believed and in truth, of each strategy."""
    scenario, labels = results.scenario, team_labels(results.scenario)
    for row, team, series in results.missions():
        free, base = series('free'), series('free', team=scenario.teams[0])
        for robots in after_robots(ROBOTS, scenario.robots):
            yield row | {
                'label': labels[team],
                'robots': robots,
                'free': mean_of(free[:, robots]),
                'believed': mean_of(series('p_free')[:, robots]),
                'difference': mean_of((free - base)[:, robots]),
                'lost': mean_of(series('robots_lost')[:, robots]),
            }


def certificate_rows(results: Results) -> Iterator[Row]:
    """Yield how often what is asked for is free in missions that stopped, for each confidence."""
    asked = results.scenario.asked
    confidences = [each for each in CONFIDENCES if asked is None or each <= asked.confidence]
    for (row, _, series), confidence in product(results.missions(), confidences):
        p_free, free, draws = map(series, ('p_free', 'free', 'independent_draws'))
        are_enough = (1.0 - confidence) * draws >= FEWEST_LEFT_OUT
        is_sure = are_enough & (p_free >= confidence)
        stopped = is_sure.any(axis=1)
        if not stopped.any():
            continue
        at = np.argmax(is_sure[stopped], axis=1)[:, None]
        stated, true = (
            np.take_along_axis(each[stopped], at, axis=1)[:, 0] for each in (p_free, free)
        )
        yield row | {
            'confidence': confidence,
            'stopped': int(stopped.sum()),
            'sent': mean_of(at[:, 0].astype(np.float64)),
            'stated': mean_of(stated),
            'free': mean_of(true),
            'difference': mean_of(true - stated),
        }


def area_rows(results: Results) -> Iterator[Row]:
    """Yield how many robots it takes to declare most cells of the area free."""
    scenario, labels = results.scenario, team_labels(results.scenario)
    for row, team, series in results.missions():
        declared, right, lost = map(series, ('declared', 'declared_free', 'robots_lost'))
        robots = needed(declared)
        yield row | {
            'label': labels[team],
            'reached': mean_of((declared.max(axis=1) >= MOST_CELLS).astype(np.float64)),
            'needed': mean_of(robots),
            'difference': mean_of(robots - needed(series('declared', team=scenario.teams[0]))),
            'lost': mean_of(lost[np.arange(len(lost)), robots.astype(np.intp)]),
            'declared': mean_of(declared[:, -1]),
            'wrong': mean_of((declared - right)[:, -1]),
        }


def needed(declared: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return after how many robots most cells are declared free, (trials,); all if never."""
    is_most = declared >= MOST_CELLS
    is_most[:, -1] = True
    robots: NDArray[np.float64] = np.argmax(is_most, axis=1).astype(np.float64)
    return robots


def decision_chart(results: Results) -> Figure:
    """Draw how often the lane is free, or the part of the area that is declared free."""
    measure, up = (
        ('declared', 'part of the area declared free')
        if asks_for(results.scenario, 'area')
        else ('free', 'share of worlds in which it is free')
    )
    return means_chart(results, (measure,), 'deployment', up)
