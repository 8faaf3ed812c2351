# SPDX-License-Identifier: Apache-2.0
"""Teams of several sizes: what they learn by the robots sent, and by the rounds it takes."""

from __future__ import annotations

from itertools import product
from typing import Any

from kbnitp_ros.study.charts import LOG_LOSS_LABEL, means_chart
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import in_short, Scenario, Strategy, team_labels
from kbnitp_ros.study.summary import as_json, LOG_LOSS, mean_of, shown, table
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray


def differ_in_size(scenario: Scenario) -> bool:
    """Return whether its teams are of several sizes, and else alike but for their allocations."""
    sizes = {team.agents for team in scenario.teams}
    others = {(team.loss_cost, team.last_contact) for team in scenario.teams}
    return len(sizes) > 1 and len(others) == 1


def information_gained(
    results: Results, lethality: float | None, method: str, team: Strategy
) -> NDArray[np.float64]:
    """Return the joint entropy of the prior less that of the belief, (trials, robots + 1)."""
    entropy = results.series(lethality, method, 'joint_entropy', team=team)
    return entropy[:, :1] - entropy


def after_rounds(series: NDArray[np.float64], agents: int) -> NDArray[np.float64]:
    """
    Return what a series is before the first round and after each.

    Parameters
    ----------
    series : ndarray, shape (trials, robots + 1)
        Before the first robot and after each.
    agents : int
        That leave together; fewer in the last round if the robots do not come out even.

    Returns
    -------
    ndarray, shape (trials, rounds + 1)

    """
    robots = series.shape[1] - 1
    return series[:, [*range(0, robots, agents), robots]]


def summarise_teams(results: Results) -> dict[str, Any]:
    """
    Return what the teams learn with the same robots and in the same rounds, as JSON can hold it.

    Returns
    -------
    dict
        ``robots``, ``rounds`` (as many as the largest team can do in full) and ``rows``: one for
        each lethality, method and team, with what tells the team from the others (``label``), how
        many rounds it takes (``rounds``) and the mean
        and interval of: the information gained a robot and a round, nats, over the whole mission;
        the total log loss at its end; ``difference``, that less the smallest team's in the same
        trial; and what is reached after the common ``rounds``.

    """
    scenario = results.scenario
    labels = team_labels(scenario)
    smallest = min(scenario.teams, key=lambda team: team.agents)
    common = scenario.robots // max(team.agents for team in scenario.teams)
    rows = []
    for lethality, (method, team) in product(scenario.lethalities, scenario.contenders):
        information = information_gained(results, lethality, method, team)
        log_loss = results.series(lethality, method, *LOG_LOSS, team=team)
        lost = results.series(lethality, method, 'robots_lost', team=team)
        rounds = after_rounds(information, team.agents).shape[1] - 1
        of_smallest = results.series(lethality, method, *LOG_LOSS, team=smallest)
        measured = {
            'information_a_robot': information[:, -1] / scenario.robots,
            'information_a_round': information[:, -1] / rounds,
            'log_loss': log_loss[:, -1],
            'difference': log_loss[:, -1] - of_smallest[:, -1],
            'early_information': after_rounds(information, team.agents)[:, common],
            'early_log_loss': after_rounds(log_loss, team.agents)[:, common],
            'early_robots_lost': after_rounds(lost, team.agents)[:, common],
        }
        row: dict[str, Any] = {'lethality': lethality, 'method': method, **vars(team)}
        row |= {'label': labels[team], 'rounds': rounds}
        rows.append(row | {name: as_json(mean_of(values)) for name, values in measured.items()})
    return {'robots': scenario.robots, 'rounds': common, 'rows': rows}


def teams_markdown(summary: dict[str, Any]) -> str:
    """Return a summary of teams as a table for people."""
    rounds = summary['rounds']
    columns = {
        'information_a_robot': ('information a robot', 3),
        'information_a_round': ('information a round', 2),
        'log_loss': ('log loss', 1),
        'difference': ('difference', 1),
        'early_information': (f'information after {rounds} rounds', 1),
        'early_log_loss': (f'log loss after {rounds} rounds', 1),
        'early_robots_lost': (f'robots lost after {rounds} rounds', 1),
    }
    caption = (
        f'What the {summary["robots"]} robots bring, and what {rounds} rounds bring. Information: '
        'the joint entropy of hazards and targets that a mission takes from the prior, in nats. '
        'Difference: the log loss less that of the smallest team, trial by trial.'
    )
    rows = []
    for row in summary['rows']:
        cells = [
            in_short(row['lethality']),
            f'`{row["method"]}`',
            row['label'],
            str(row['rounds']),
        ]
        cells += [shown(row[name], decimals) for name, (_, decimals) in columns.items()]
        rows.append(cells)
    heads = ['lethality', 'method', 'team', 'rounds', *(head for head, _ in columns.values())]
    return table(caption, heads, rows)


def teams_chart(results: Results) -> Figure:
    """Draw the mean log loss after each round, a panel a lethality."""

    def series(lethality: float | None, method: str, team: Strategy) -> NDArray[np.float64]:
        log_loss = results.series(lethality, method, *LOG_LOSS, team=team)
        return after_rounds(log_loss, team.agents)

    return means_chart(results.scenario, series, 'round', LOG_LOSS_LABEL, 'log')
