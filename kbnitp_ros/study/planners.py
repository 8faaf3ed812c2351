# SPDX-License-Identifier: Apache-2.0
"""What it is worth to plan for information, against planners that do not."""

from __future__ import annotations

from itertools import product
from typing import Any

from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import in_short
from kbnitp_ros.study.summary import after_robots, against, shown, table

# After how many robots missions are compared, and after the last one.
ROBOTS = (10, 25, 50)


def summarise_planners(results: Results) -> dict[str, Any]:
    """
    Return how planners compare with the scenario's first one, as JSON can hold it.

    Returns
    -------
    dict
        ``first`` (that planner), ``robots``, after how many, and ``rows``: one for each lethality,
        method and other planner, with as many means and intervals of its total log loss less the
        first one's in the same trial (``difference``, positive where the first one is better), and
        at the end the robots lost (``lost``), and how many more (``lost_more``).

    """
    scenario = results.scenario
    first, *others = scenario.teams
    robots = after_robots(ROBOTS, scenario.robots)
    rows = []
    for lethality, method, team in product(scenario.lethalities, scenario.methods, others):
        rows.append(
            {
                'lethality': lethality,
                'method': method,
                'planner': team.planner or scenario.planning.planner,
                **against(results, lethality, method, (first, team), robots),
            }
        )
    return {'first': first.planner or scenario.planning.planner, 'robots': robots, 'rows': rows}


def planners_markdown(summary: dict[str, Any]) -> str:
    """Return a summary of planners as a table for people."""
    first = summary['first']
    caption = (
        f'Log loss by the planner of the row less that by `{first}`, trial by trial, in nats, '
        'after so many robots; and the robots lost at the end, and how many more than by '
        f'`{first}`.'
    )
    rows = [
        [
            in_short(row['lethality']),
            f'`{row["method"]}`',
            f'`{row["planner"]}`',
            *map(shown, row['difference']),
            shown(row['lost']),
            shown(row['lost_more']),
        ]
        for row in summary['rows']
    ]
    heads = ['lethality', 'method', 'planner', *map(str, summary['robots']), 'lost', 'more lost']
    return table(caption, heads, rows)
