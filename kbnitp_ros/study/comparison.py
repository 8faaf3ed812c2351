# SPDX-License-Identifier: Apache-2.0
"""
Comparisons of strategies with a first one, trial by trial: one row of data for each kind of study.

A new kind of study is one more row of `COMPARISONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from typing import Any

from kbnitp_ros.study.loss_cost import at_equal_log_loss_more
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import differ_only_in, in_short, Scenario, Strategy
from kbnitp_ros.study.summary import (
    after_robots,
    as_json,
    differences,
    LOG_LOSS,
    mean_of,
    shown,
    table,
)

Told = Callable[[Strategy, Scenario], Any]


@dataclass(frozen=True)
class Comparison:
    """
    A kind of study that compares strategies with a first one.

    Attributes
    ----------
    name : str
        Of the section in the summary.
    applies : callable
        Whether the strategies of a scenario are to be compared so.
    caption : str
        Of the table; in braces what the summary has under these names.
    told : mapping of str to callable
        What a row has of its strategy, by the names in the summary.
    columns : mapping of str to str
        Which of these the table shows: the head, and the format of the value.
    difference : str
        Name of the differences of the log loss in the summary.
    is_gain : bool
        Whether they are how much lower the log loss is than that of the first strategy; otherwise
        how much higher.
    robots : tuple of int
        After how many robots, and after the last one.
    first : (str, callable), optional
        What the summary has of the first strategy: name, and what it is.
    order : callable, optional
        By which the first strategy is the least; without it, it is the scenario's first.
    further : mapping of str to (str, callable)
        What is measured besides: by name in the summary the head, and what returns it for results,
        lethality, method, the first strategy and this one.
    has_method : bool
        Whether the table names the method.

    """

    name: str
    applies: Callable[[Scenario], bool]
    caption: str
    told: Mapping[str, Told]
    columns: Mapping[str, tuple[str, str]]
    difference: str = 'difference'
    is_gain: bool = False
    robots: tuple[int, ...] = (10, 25, 50)
    first: tuple[str, Told] | None = None
    order: Callable[[Strategy], Any] | None = None
    further: Mapping[str, tuple[str, Callable[..., dict[str, float | None]]]] | None = None
    has_method: bool = True

    def summarise(self, results: Results) -> dict[str, Any]:
        """
        Return how strategies compare with the first one, as JSON can hold it.

        Returns
        -------
        dict
            What the first one is, ``robots``, after how many they are compared, and ``rows``: one
            for each lethality, method and other strategy, with as many means and intervals of the
            difference of the total log loss in the same trial, and what is measured besides.

        """
        scenario = results.scenario
        teams = sorted(scenario.teams, key=self.order) if self.order else scenario.teams
        first, *others = teams
        robots = after_robots(self.robots, scenario.robots)
        rows = []
        for lethality, method, team in product(scenario.lethalities, scenario.methods, others):
            one, other = (
                results.series(lethality, method, *LOG_LOSS, team=of)
                for of in ((first, team) if self.is_gain else (team, first))
            )
            of_pair = results, lethality, method, first, team
            further = {name: of(*of_pair) for name, (_, of) in (self.further or {}).items()}
            rows.append(
                {
                    'lethality': lethality,
                    'method': method,
                    **{name: of(team, scenario) for name, of in self.told.items()},
                    self.difference: differences(one, other, robots),
                    **further,
                }
            )
        head = {self.first[0]: self.first[1](first, scenario)} if self.first else {}
        return {**head, 'robots': robots, 'rows': rows}

    def markdown(self, summary: dict[str, Any]) -> str:
        """Return a summary as a table for people."""
        further = self.further or {}
        heads = ['lethality', *(['method'] if self.has_method else [])]
        heads += [*(head for head, _ in self.columns.values()), *map(str, summary['robots'])]
        heads += [head for head, _ in further.values()]
        rows = [
            [
                in_short(row['lethality']),
                *([f'`{row["method"]}`'] if self.has_method else []),
                *(form.format(row[name]) for name, (_, form) in self.columns.items()),
                *map(shown, row[self.difference]),
                *(shown(row[name]) for name in further),
            ]
            for row in summary['rows']
        ]
        return table(self.caption.format(**summary), heads, rows)


def differ_in_objective(scenario: Scenario) -> bool:
    """Return whether the strategies of a scenario differ in what they seek, and in that alone."""
    objectives = {team.objective for team in scenario.teams}
    return len(objectives) > 1 and differ_only_in(scenario, 'objective', 'alpha', 'loss_cost')


def lost(
    results: Results, lethality: float | None, method: str, first: Strategy, team: Strategy
) -> dict[str, float | None]:
    """Return the robots lost at the end."""
    return as_json(mean_of(_lost(results, lethality, method, team)))


def lost_more(
    results: Results, lethality: float | None, method: str, first: Strategy, team: Strategy
) -> dict[str, float | None]:
    """Return how many more robots are lost at the end than with the first strategy."""
    these, those = (_lost(results, lethality, method, each) for each in (team, first))
    return as_json(mean_of(these - those))


def _lost(results: Results, lethality: float | None, method: str, team: Strategy) -> Any:
    return results.series(lethality, method, 'robots_lost', team=team)[:, -1]


def own(name: str) -> Told:
    """Return what reads a field of a strategy."""
    return lambda team, _: getattr(team, name)


def planner_of(team: Strategy, scenario: Scenario) -> str:
    """Return the planner of a strategy."""
    return scenario.options(team).planner


def objective_of(team: Strategy, _: Scenario) -> str:
    """Return what a strategy seeks."""
    return f'{team.sought}, loss cost {team.loss_cost:.4g}' if team.loss_cost else team.sought


LOST = {'lost': ('lost', lost), 'lost_more': ('more lost', lost_more)}

CONTACT = Comparison(
    name='last_contact',
    applies=lambda scenario: differ_only_in(scenario, 'last_contact'),
    caption=(
        'What last contacts are worth, in nats: the log loss with a contact of {least:.4g} less '
        'that with the contact of the row, trial by trial, after so many robots. Contact: the '
        'probability, after each step, that the base hears how far the robot is.'
    ),
    told={name: own(name) for name in vars(Strategy())},
    columns={'last_contact': ('contact', '{:.4g}')},
    difference='value',
    is_gain=True,
    robots=(10, 25, 50, 100, 200),
    first=('least', own('last_contact')),
    order=attrgetter('last_contact'),
)

BY_PLANNER = Comparison(
    name='planners',
    applies=lambda scenario: differ_only_in(scenario, 'planner'),
    caption=(
        'Log loss by the planner of the row less that by `{first}`, trial by trial, in nats, '
        'after so many robots; and the robots lost at the end, and how many more than by '
        '`{first}`.'
    ),
    told={'planner': planner_of},
    columns={'planner': ('planner', '`{}`')},
    first=('first', planner_of),
    further=LOST,
)

BY_OBJECTIVE = Comparison(
    name='objectives',
    applies=differ_in_objective,
    caption=(
        'Log loss with the objective of the row less that with {first}, trial by trial, in nats, '
        'after so many robots; the robots lost at the end, and how many more than with {first}; '
        'and how many more when both had come to the same log loss.'
    ),
    told={'objective': objective_of},
    columns={'objective': ('objective', '{}')},
    first=('first', objective_of),
    further={**LOST, 'lost_at_equal': ('at equal log loss', at_equal_log_loss_more)},
    has_method=False,
)

BY_MAP = Comparison(
    name='prior_maps',
    applies=lambda scenario: differ_only_in(scenario, 'survey', 'trusted'),
    caption=(
        'What a map of hazards known beforehand is worth, in nats: the log loss without one less '
        'that with the map of the row, trial by trial, after so many robots. Right: the part of '
        'the cells of which it is; trusted: that of which it is believed to be.'
    ),
    told={
        'survey': own('survey'),
        'trusted': lambda team, _: team.trusted or team.survey,
    },
    columns={'survey': ('right', '{:.4g}'), 'trusted': ('trusted', '{:.4g}')},
    difference='value',
    is_gain=True,
    robots=(0, 10, 25, 50),
)

COMPARISONS = (CONTACT, BY_PLANNER, BY_OBJECTIVE, BY_MAP)
