# SPDX-License-Identifier: Apache-2.0
"""What it is worth to know when a robot was last heard."""

from __future__ import annotations

from itertools import product
from typing import Any

from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import in_short
from kbnitp_ros.study.summary import after_robots, differences, LOG_LOSS, shown, table

# After how many robots missions are compared, and after the last one.
ROBOTS = (10, 25, 50, 100, 200)


def summarise_contact(results: Results) -> dict[str, Any]:
    """
    Return what last contacts are worth after some of the robots, as JSON can hold it.

    Returns
    -------
    dict
        ``least`` (the lowest probability of a contact), ``robots``, after how many, and ``rows``:
        one for each lethality, method and other probability, with as many means and intervals of
        the total log loss at the lowest less that with contact in the same trial (``worth``):
        positive where it helps.

    """
    scenario = results.scenario
    least, *others = sorted(scenario.teams, key=lambda team: team.last_contact)
    robots = after_robots(ROBOTS, scenario.robots)
    rows = []
    for lethality, method, team in product(scenario.lethalities, scenario.methods, others):
        without, heard = (
            results.series(lethality, method, *LOG_LOSS, team=of) for of in (least, team)
        )
        worth = differences(without, heard, robots)
        rows.append({'lethality': lethality, 'method': method, **vars(team), 'worth': worth})
    return {'least': least.last_contact, 'robots': robots, 'rows': rows}


def contact_markdown(summary: dict[str, Any]) -> str:
    """Return a summary of last contacts as a table for people."""
    caption = (
        f'What last contacts are worth, in nats: the log loss with a contact of '
        f'{summary["least"]:.4g} less that with the contact of the row, trial by trial, after so '
        'many robots. Contact: the probability, after each step, that the base hears how far the '
        'robot is.'
    )
    rows = [
        [
            in_short(row['lethality']),
            f'`{row["method"]}`',
            f'{row["last_contact"]:.4g}',
            *map(shown, row['worth']),
        ]
        for row in summary['rows']
    ]
    heads = ['lethality', 'method', 'contact', *map(str, summary['robots'])]
    return table(caption, heads, rows)
