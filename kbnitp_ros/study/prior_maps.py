# SPDX-License-Identifier: Apache-2.0
"""What a map of hazards known beforehand is worth, and what it costs to trust a wrong one."""

from __future__ import annotations

from itertools import product
from typing import Any

from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import in_short
from kbnitp_ros.study.summary import after_robots, differences, LOG_LOSS, shown, table

# After how many robots missions are compared, and after the last one.
ROBOTS = (0, 10, 25, 50)


def summarise_maps(results: Results) -> dict[str, Any]:
    """
    Return what maps are worth after some of the robots, as JSON can hold it.

    Returns
    -------
    dict
        ``robots``, after how many, and ``rows``: one for each lethality, method and team but the
        first, with as many means and intervals of the first team's total log loss less this one's
        in the same trial (``worth``): positive where the map helps.

    """
    scenario = results.scenario
    first, *others = scenario.teams
    robots = after_robots(ROBOTS, scenario.robots)
    rows = []
    for lethality, method, team in product(scenario.lethalities, scenario.methods, others):
        without, known = (
            results.series(lethality, method, *LOG_LOSS, team=of) for of in (first, team)
        )
        rows.append(
            {
                'lethality': lethality,
                'method': method,
                'survey': team.survey,
                'trusted': team.trusted or team.survey,
                'worth': differences(without, known, robots),
            }
        )
    return {'robots': robots, 'rows': rows}


def maps_markdown(summary: dict[str, Any]) -> str:
    """Return a summary of maps as a table for people."""
    caption = (
        'What a map of hazards known beforehand is worth, in nats: the log loss without one less '
        'that with the map of the row, trial by trial, after so many robots. Right: the part of '
        'the cells of which it is; trusted: that of which it is believed to be.'
    )
    rows = [
        [
            in_short(row['lethality']),
            f'`{row["method"]}`',
            f'{row["survey"]:.4g}',
            f'{row["trusted"]:.4g}',
            *map(shown, row['worth']),
        ]
        for row in summary['rows']
    ]
    heads = ['lethality', 'method', 'right', 'trusted', *map(str, summary['robots'])]
    return table(caption, heads, rows)
