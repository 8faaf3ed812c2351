# SPDX-License-Identifier: Apache-2.0
"""Teams of several sizes: what they learn by the robots sent, and by the rounds it takes."""

from __future__ import annotations

from collections.abc import Iterator

from kbnitp_ros.study.charts import LOG_LOSS_LABEL, means_chart
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Scenario, team_labels
from kbnitp_ros.study.summary import LOG_LOSS, mean_of, Row
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray


def differ_in_size(scenario: Scenario) -> bool:
    """Return whether its teams are of several sizes, and else alike but for their allocations."""
    sizes = {team.agents for team in scenario.teams}
    others = {(team.loss_cost, team.last_contact) for team in scenario.teams}
    return len(sizes) > 1 and len(others) == 1


def after_rounds(series: NDArray[np.float64], agents: int) -> NDArray[np.float64]:
    """Return a series before the first round and after each, shape (trials, rounds + 1)."""
    robots = series.shape[1] - 1
    return series[:, [*range(0, robots, agents), robots]]


def common_rounds(scenario: Scenario) -> int:
    """Return how many rounds the largest team can do in full."""
    return scenario.robots // max(team.agents for team in scenario.teams)


def team_rows(results: Results) -> Iterator[Row]:
    """Yield what the teams learn with the same robots and in the same rounds."""
    scenario = results.scenario
    labels, common = team_labels(scenario), common_rounds(scenario)
    smallest = min(scenario.teams, key=lambda team: team.agents)
    for row, team, series in results.missions():
        entropy, log_loss, lost = series('joint_entropy'), series(*LOG_LOSS), series('robots_lost')
        information = entropy[:, :1] - entropy
        rounds = after_rounds(information, team.agents).shape[1] - 1
        measured = {
            'information_a_robot': information[:, -1] / scenario.robots,
            'information_a_round': information[:, -1] / rounds,
            'log_loss': log_loss[:, -1],
            'difference': (log_loss - series(*LOG_LOSS, team=smallest))[:, -1],
            'early_information': after_rounds(information, team.agents)[:, common],
            'early_log_loss': after_rounds(log_loss, team.agents)[:, common],
            'early_robots_lost': after_rounds(lost, team.agents)[:, common],
        }
        row |= {**vars(team), 'label': labels[team], 'rounds': rounds}
        yield row | {name: mean_of(values) for name, values in measured.items()}


def teams_chart(results: Results) -> Figure:
    """Draw the mean log loss after each round, a panel a lethality."""
    return means_chart(
        results,
        LOG_LOSS,
        'round',
        LOG_LOSS_LABEL,
        'log',
        lambda series, team: after_rounds(series, team.agents),
    )
