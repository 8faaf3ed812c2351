# SPDX-License-Identifier: Apache-2.0
"""What it changes to plan for behavioral entropies, beside what a loss cost changes."""

from __future__ import annotations

from itertools import product
from typing import Any

from kbnitp_ros.study.loss_cost import compare, EQUAL, trade
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import differ_only_in, in_short, Scenario, Team
from kbnitp_ros.study.summary import after_robots, against, as_json, Mean, shown, table

# After how many robots missions are compared, and after the last one.
ROBOTS = (10, 25, 50)


def differ_in_objective(scenario: Scenario) -> bool:
    """Return whether the teams of a scenario differ in what they seek, and in that alone."""
    objectives = {team.objective for team in scenario.teams}
    return len(objectives) > 1 and differ_only_in(scenario, 'objective', 'alpha', 'loss_cost')


def summarise_objectives(results: Results) -> dict[str, Any]:
    """
    Return how objectives compare with the scenario's first one, as JSON can hold it.

    Returns
    -------
    dict
        ``first`` (that objective), ``robots``, after how many, and ``rows``: one for each
        lethality, method and other objective, with what `against` finds, and how many more robots
        it has lost when both have come to the same log loss (``lost_at_equal``).

    """
    scenario = results.scenario
    first, *others = scenario.teams
    robots = after_robots(ROBOTS, scenario.robots)
    rows = []
    for lethality, method, team in product(scenario.lethalities, scenario.methods, others):
        equal = compare(*(trade(results, lethality, method, of) for of in (first, team)))
        at_equal = dict(zip(EQUAL, zip(*equal)))['difference']
        rows.append(
            {
                'lethality': lethality,
                'method': method,
                'objective': in_words(team),
                **against(results, lethality, method, (first, team), robots),
                'lost_at_equal': as_json(Mean(*at_equal)),
            }
        )
    return {'first': in_words(first), 'robots': robots, 'rows': rows}


def in_words(team: Team) -> str:
    """Return what a team seeks."""
    return f'{team.sought}, loss cost {team.loss_cost:.4g}' if team.loss_cost else team.sought


def objectives_markdown(summary: dict[str, Any]) -> str:
    """Return a summary of objectives as a table for people."""
    first = summary['first']
    caption = (
        f'Log loss with the objective of the row less that with {first}, trial by trial, in nats, '
        'after so many robots; the robots lost at the end, and how many more than with '
        f'{first}; and how many more when both had come to the same log loss.'
    )
    rows = [
        [
            in_short(row['lethality']),
            row['objective'],
            *map(shown, row['difference']),
            shown(row['lost']),
            shown(row['lost_more']),
            shown(row['lost_at_equal']),
        ]
        for row in summary['rows']
    ]
    heads = ['lethality', 'objective', *map(str, summary['robots'])]
    return table(caption, [*heads, 'lost', 'more lost', 'at equal log loss'], rows)
