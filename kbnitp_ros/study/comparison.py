# SPDX-License-Identifier: Apache-2.0
"""Comparisons of a study's strategies, with a table row for each, and the study's files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
import json
from operator import attrgetter
from pathlib import Path
from typing import Any

from kbnitp_ros.figures import FORMATS, LETTERS, save
from kbnitp_ros.files import naming
from kbnitp_ros.study.charts import (
    decision_chart,
    LOG_LOSS_LABEL,
    loss_cost_chart,
    means_chart,
    numbers_chart,
    reliability_chart,
    teams_chart,
)
from kbnitp_ros.study.questions import (
    area_rows,
    at_equal_log_loss_more,
    base_rows,
    certificate_rows,
    certifies,
    common_rounds,
    cost_of_learning,
    differ_in_size,
    equal_rows,
    lane_rows,
    log_loss_at_equal_losses,
    number_rows,
    ROBOTS,
    SHARE_OF_AREA,
    team_rows,
)
from kbnitp_ros.study.results import (
    after_robots,
    bootstrap_mean,
    Cell,
    json_row,
    lethality_cell,
    LOG_LOSS,
    Mean,
    means_after,
    Results,
    Row,
    Series,
    shown,
    summarise,
    summary_table,
    Table,
)
from kbnitp_ros.study.scenario import (
    asks_for,
    differ_only_in,
    LEARNING,
    Scenario,
    Strategy,
    team_labels,
)
from kbnitp_ros.study.trial import DECLARED
from matplotlib import rc_context
from matplotlib.figure import Figure
from pyarrow import parquet

Stated = Callable[[Strategy, Scenario], Any]
Measured = Callable[[Series, Strategy, Strategy], Mean]

# Head of a table column, and the format of its values or, for means, the number of decimals.
Column = tuple[str, 'str | int']
METHOD: dict[str, Column] = {'method': ('method', '`{}`')}


@dataclass(frozen=True)
class Comparison:
    """A kind of study with its own section in the summary."""

    # Name of the section.
    name: str
    # Returns whether a scenario has this section.
    applies: Callable[[Scenario], bool]
    # Caption of the table; names in braces, also in heads, are replaced by entries of the section.
    caption: str
    # Columns of the table besides the lethality; a value that is a list fills one column for each
    # of the section's ``robots``.
    columns: Mapping[str, Column]
    # Yields the rows.
    rows: Callable[[Results], Iterable[Row]]
    # Returns further entries of the section.
    head: Callable[[Scenario], Row]

    def summarise(self, results: Results) -> Row:
        """Return the section with its ``rows``, as JSON values."""
        return {**self.head(results.scenario), 'rows': [json_row(r) for r in self.rows(results)]}

    def table(self, summary: Row) -> Table:
        """Return the section as a table to print."""
        heads = ['lethality']
        for name, (head, _) in self.columns.items():
            is_list = any(isinstance(row[name], list) for row in summary['rows'])
            heads += map(str, summary['robots']) if is_list else [head.format(**summary)]
        rows = [
            [lethality_cell(row)]
            + [
                cell
                for name, (_, form) in self.columns.items()
                for cell in table_cells(row[name], form)
            ]
            for row in summary['rows']
        ]
        return Table(self.caption.format(**summary), heads, rows)


def table_cells(value: Any, form: str | int) -> list[Cell]:
    """Return the table cells of a value."""
    if isinstance(form, str):
        return [Cell(value, form.format(value))]
    return [
        Cell(each, shown(each, form)) for each in (value if isinstance(value, list) else [value])
    ]


def with_first(
    stated: Mapping[str, Stated],
    difference: str = 'difference',
    is_gain: bool = False,
    robots: tuple[int, ...] = (10, 25, 50),
    first: tuple[str, Stated] | None = None,
    order: Callable[[Strategy], Any] | None = None,
    further: Mapping[str, Measured] | None = None,
) -> dict[str, Any]:
    """Return head and rows of a comparison with the first strategy, paired by trial."""

    def in_order(scenario: Scenario) -> list[Strategy]:
        return sorted(scenario.teams, key=order) if order else list(scenario.teams)

    def head(scenario: Scenario) -> Row:
        own = {first[0]: first[1](in_order(scenario)[0], scenario)} if first else {}
        return {**own, 'robots': after_robots(robots, scenario.robots)}

    def rows(results: Results) -> Iterable[Row]:
        scenario = results.scenario
        base, *others = in_order(scenario)
        for row, team, series in results.missions(others):
            this, that = series(*LOG_LOSS), series(*LOG_LOSS, team=base)
            yield row | {
                **{name: of(team, scenario) for name, of in stated.items()},
                difference: means_after(
                    that - this if is_gain else this - that,
                    after_robots(robots, scenario.robots),
                ),
                **{name: of(series, base, team) for name, of in (further or {}).items()},
            }

    return {'head': head, 'rows': rows}


def differ_in_objective(scenario: Scenario) -> bool:
    """Return whether the strategies differ only in their objectives."""
    objectives = {team.objective for team in scenario.teams}
    return len(objectives) > 1 and differ_only_in(scenario, 'objective', 'alpha', 'loss_cost')


def differ_in_hazards(scenario: Scenario) -> bool:
    """Return whether the strategies differ only in their beliefs about hazards."""
    return differ_only_in(scenario, 'dynamics', 'clustering', 'paths')


def learns(scenario: Scenario) -> bool:
    """Return whether the learning method is among the methods."""
    return LEARNING in scenario.methods


def lost(series: Series, first: Strategy, team: Strategy) -> Mean:
    """Return the mean number of robots lost at the end."""
    return bootstrap_mean(series('robots_lost')[:, -1])


def lost_more(series: Series, first: Strategy, team: Strategy) -> Mean:
    """Return the mean number of robots lost at the end, minus that of the first strategy."""
    return bootstrap_mean((series('robots_lost') - series('robots_lost', team=first))[:, -1])


def own(name: str) -> Stated:
    """Return a function that reads a field of a strategy."""
    return lambda team, _: getattr(team, name)


def team_planner(team: Strategy, scenario: Scenario) -> str:
    """Return the planner of a strategy."""
    return team.planner or scenario.planning.planner


def team_objective(team: Strategy, _: Scenario) -> str:
    """Return the objective of a strategy."""
    return f'{team.sought}, loss cost {team.loss_cost:.4g}' if team.loss_cost else team.sought


def believed_by(team: Strategy, scenario: Scenario) -> str:
    """Return the label of a strategy's belief about hazards."""
    return team_labels(scenario)[team]


def hazard_rows(results: Results) -> Iterable[Row]:
    """Yield the hazard log loss, a row for each contender."""
    robots = after_robots((25, 50, 100), results.scenario.robots)
    for row, team, series in results.missions():
        yield row | {
            'believed': believed_by(team, results.scenario),
            'hazard_log_loss': means_after(series('hazard_log_loss'), robots),
        }


LOST = {'lost': lost, 'lost_more': lost_more}
LOST_COLUMNS: dict[str, Column] = {'lost': ('lost', 1), 'lost_more': ('more lost', 1)}

BY_SIZE = Comparison(
    name='teams',
    applies=differ_in_size,
    caption=(
        'Results with {robots} robots, and after {rounds} rounds. Information: the decrease of '
        'the joint entropy of hazards and targets since the prior, in nats. Difference: the log '
        'loss minus the log loss of the smallest team, paired by world.'
    ),
    columns={
        **METHOD,
        'label': ('team', '{}'),
        'rounds': ('rounds', '{}'),
        'information_a_robot': ('information a robot', 3),
        'information_a_round': ('information a round', 2),
        'log_loss': ('log loss', 1),
        'difference': ('difference', 1),
        'early_information': ('information after {rounds} rounds', 1),
        'early_log_loss': ('log loss after {rounds} rounds', 1),
        'early_robots_lost': ('robots lost after {rounds} rounds', 1),
    },
    head=lambda scenario: {'robots': scenario.robots, 'rounds': common_rounds(scenario)},
    rows=team_rows,
)

BY_LOSS_COST = Comparison(
    name='loss_cost',
    applies=lambda scenario: differ_only_in(scenario, 'loss_cost'),
    caption=(
        'Comparison at equal log loss: the lowest mean log loss that is reached both with a loss '
        'cost of {least:.4g} and with the loss cost of the row, and the robots sent and lost '
        'until then. Difference: the robots lost minus those lost at {least:.4g}, paired by '
        'world.'
    ),
    columns={
        **METHOD,
        'loss_cost': ('loss cost', '{:.4g}'),
        'log_loss': ('log loss', 1),
        'sent_at_least': ('robots sent at {least:.4g}', 1),
        'sent': ('robots sent', 1),
        'lost_at_least': ('robots lost at {least:.4g}', 1),
        'lost': ('robots lost', 1),
        'difference': ('difference', 1),
    },
    head=lambda scenario: {'least': min(team.loss_cost for team in scenario.teams)},
    rows=equal_rows,
)

CONTACT = Comparison(
    name='last_contact',
    applies=lambda scenario: differ_only_in(scenario, 'last_contact'),
    caption=(
        'Value of last contacts, in nats, by number of robots: the log loss with a contact of '
        '{least:.4g} minus the log loss with the contact of the row, paired by world. Contact: '
        "the probability, after each step, that the base receives the robot's progress."
    ),
    columns={**METHOD, 'last_contact': ('contact', '{:.4g}'), 'value': ('', 1)},
    **with_first(
        stated={name: own(name) for name in vars(Strategy())},
        difference='value',
        is_gain=True,
        robots=(10, 25, 50, 100, 200),
        first=('least', own('last_contact')),
        order=attrgetter('last_contact'),
    ),
)

BY_PLANNER = Comparison(
    name='planners',
    applies=lambda scenario: differ_only_in(scenario, 'planner'),
    caption=(
        'Differences from the planner `{first}`, paired by world: log loss by number of robots, '
        'in nats, and robots lost at the end (more lost). Lost: the robots lost in the row.'
    ),
    columns={
        **METHOD,
        'planner': ('planner', '`{}`'),
        'difference': ('', 1),
        **LOST_COLUMNS,
    },
    **with_first({'planner': team_planner}, first=('first', team_planner), further=LOST),
)

BY_OBJECTIVE = Comparison(
    name='objectives',
    applies=differ_in_objective,
    caption=(
        'Differences from the objective {first}, paired by world: log loss, in nats, by number of '
        'robots and at equal losses; robots lost at the end and at equal log loss. Lost: the '
        "robots lost at the end with the row's objective."
    ),
    columns={
        'objective': ('objective', '{}'),
        'difference': ('', 1),
        **LOST_COLUMNS,
        'lost_at_equal': ('more lost at equal log loss', 1),
        'log_loss_at_equal': ('log loss at equal losses', 1),
    },
    **with_first(
        {'objective': team_objective},
        first=('first', team_objective),
        further={
            **LOST,
            'lost_at_equal': at_equal_log_loss_more,
            'log_loss_at_equal': log_loss_at_equal_losses,
        },
    ),
)

BY_MAP = Comparison(
    name='prior_maps',
    applies=lambda scenario: differ_only_in(scenario, 'survey', 'trusted'),
    caption=(
        'Value of a prior map of hazards, in nats: the log loss without a map minus the log loss '
        'with the map of the row, paired by world, by number of robots. Right: the share of cells '
        'in which the map is right; trusted: the believed share.'
    ),
    columns={
        **METHOD,
        'survey': ('right', '{:.4g}'),
        'trusted': ('trusted', '{:.4g}'),
        'value': ('', 1),
    },
    **with_first(
        {'survey': own('survey'), 'trusted': lambda team, _: team.trusted or team.survey},
        difference='value',
        is_gain=True,
        robots=(0, 10, 25, 50),
    ),
)

OF_HAZARDS = Comparison(
    name='hazards',
    applies=differ_in_hazards,
    caption='Log loss of the current hazards, in nats, by number of robots.',
    columns={**METHOD, 'believed': ('believed', '{}'), 'hazard_log_loss': ('', 1)},
    head=lambda scenario: {'robots': after_robots((25, 50, 100), scenario.robots)},
    rows=hazard_rows,
)

BY_KIND = Comparison(
    name='kinds',
    applies=differ_in_hazards,
    caption=(
        'Differences from `{first}`, paired by world: log loss of hazards and targets by number '
        'of robots, in nats, and robots lost at the end (more lost). Lost: the robots lost in the '
        'row.'
    ),
    columns={
        **METHOD,
        'believed': ('believed', '{}'),
        'difference': ('', 1),
        **LOST_COLUMNS,
    },
    **with_first(
        {'believed': believed_by},
        robots=(25, 50, 100),
        first=('first', believed_by),
        further=LOST,
    ),
)

BY_BASE = Comparison(
    name='bases',
    applies=lambda scenario: differ_only_in(scenario, 'second_base'),
    caption=(
        'Comparison of one base with two, paired by world. Value: the log loss at the end with '
        'one base minus the log loss with two, in nats. Robots sent and lost: at equal log loss. '
        'Fewer: the robots sent from one base minus the robots sent from two.'
    ),
    columns={
        **METHOD,
        'second_base': ('second base', '{}'),
        'value': ('value', 1),
        'log_loss': ('log loss', 1),
        'sent_from_one': ('sent from one', 1),
        'sent': ('sent from two', 1),
        'fewer': ('fewer', 1),
        'lost_from_one': ('lost from one', 1),
        'lost': ('lost from two', 1),
    },
    head=lambda scenario: {'robots': scenario.robots, 'base': scenario.grid.base},
    rows=base_rows,
)

OF_NUMBERS = Comparison(
    name='numbers',
    applies=learns,
    caption=(
        'Learnt numbers after {robots} robots: standard deviation before the first and after '
        'the last, distance of the mean from the truth, and how often the truth lies '
        'between the 5 and 95 % quantiles.'
    ),
    columns={
        'number': ('number', '{}'),
        'sd_before': ('sd before', 2),
        'sd': ('sd', 2),
        'error': ('error', 2),
        'within': ('within', 2),
    },
    head=lambda scenario: {'robots': scenario.robots},
    rows=number_rows,
)

OF_LEARNING = Comparison(
    name='value',
    applies=learns,
    caption=(
        f'Log loss of `{LEARNING}` minus the log loss of methods that are given the numbers, '
        'paired by world, in nats, by number of robots.'
    ),
    columns={**METHOD, 'costs': ('', 1)},
    head=lambda scenario: {'robots': after_robots(ROBOTS, scenario.robots)},
    rows=cost_of_learning,
)

LANES = Comparison(
    name='lanes',
    applies=lambda scenario: asks_for(scenario, 'lane'),
    caption=(
        'By number of robots: the share of worlds in which the safest lane found is free of '
        'hazards, the mean probability believed, the difference of the share from the first '
        'strategy in the same worlds, and the robots lost.'
    ),
    columns={
        **METHOD,
        'label': ('strategy', '{}'),
        'robots': ('robots', '{}'),
        'free': ('free', 2),
        'believed': ('believed', 2),
        'difference': ('more free', 2),
        'lost': ('lost', 1),
    },
    head=lambda _: {},
    rows=lane_rows,
)

CERTIFICATES = Comparison(
    name='certificates',
    applies=certifies,
    caption=(
        'Missions that stopped at a confidence: the robots sent, the mean stated probability, the '
        'share of goals that are free of hazards, and this share minus the stated probability.'
    ),
    columns={
        **METHOD,
        'confidence': ('confidence', '{}'),
        'stopped': ('missions', '{}'),
        'sent': ('robots', 1),
        'stated': ('stated', 3),
        'free': ('free', 3),
        'difference': ('difference', 3),
    },
    head=lambda _: {},
    rows=certificate_rows,
)

AREAS = Comparison(
    name='areas',
    applies=lambda scenario: asks_for(scenario, 'area'),
    caption=(
        f'Cells are declared free at a probability of {DECLARED}. Worlds: the share of worlds in '
        f'which {SHARE_OF_AREA:.0%} of the area is declared free. Robots: the robots sent until '
        'then (all {robots} if never); more robots: the difference from the first strategy in '
        'the same worlds; lost: the robots lost until then. Declared, wrongly: the shares of the '
        'area that are declared free, and declared free wrongly, at the end.'
    ),
    columns={
        **METHOD,
        'label': ('strategy', '{}'),
        'reached': ('worlds', 2),
        'needed': ('robots', 1),
        'difference': ('more robots', 1),
        'lost': ('lost', 1),
        'declared': ('declared', 2),
        'wrong': ('wrongly', 3),
    },
    head=lambda scenario: {'robots': scenario.robots},
    rows=area_rows,
)

COMPARISONS = (
    BY_SIZE,
    BY_LOSS_COST,
    CONTACT,
    BY_PLANNER,
    BY_OBJECTIVE,
    BY_MAP,
    OF_HAZARDS,
    BY_KIND,
    BY_BASE,
    OF_NUMBERS,
    OF_LEARNING,
    LANES,
    CERTIFICATES,
    AREAS,
)


def study_figures(results: Results) -> dict[str, Figure]:
    """Return the figures of a study, by the names of their files."""
    means = partial(means_chart, results, across='deployment')
    charts: dict[str, Callable[[Results], Figure]] = {
        # The figure of arXiv:2305.06929.
        'entropy': lambda _: means(('entropy',), up='entropy H(Z) + H(X) (nats)'),
        'log_loss': lambda _: means(LOG_LOSS, up=LOG_LOSS_LABEL, scale='log'),
        'reliability': reliability_chart,
    }
    if differ_in_size(results.scenario):
        charts['by_round'] = teams_chart
    if differ_only_in(results.scenario, 'loss_cost') or differ_in_objective(results.scenario):
        charts['robots_lost'] = loss_cost_chart
    if learns(results.scenario):
        charts['numbers'] = numbers_chart
    if results.scenario.asked is not None:
        charts['decision'] = decision_chart
    with rc_context(LETTERS):
        return {name: draw(results) for name, draw in charts.items()}


def sections(results: Results) -> Iterator[tuple[str, Row, Table]]:
    """Yield the name, the content and the table of each section of the summary."""
    summary = summarise(results)
    yield 'summary', summary, summary_table(summary)
    for comparison in COMPARISONS:
        if comparison.applies(results.scenario):
            section = comparison.summarise(results)
            yield comparison.name, section, comparison.table(section)


def study_tables(results: Results) -> dict[str, Table]:
    """Return the tables of a study."""
    return {name: table for name, _, table in sections(results)}


def write_report(results: Results, folder: Path) -> list[Path]:
    """Write the table, the figures and the summary of a study."""
    (_, summary, first), *others = sections(results)
    summary.update({name: section for name, section, _ in others})
    pictures = []
    table, as_json, as_markdown = (
        folder / name for name in ('table.parquet', 'summary.json', 'summary.md')
    )
    with naming(folder):
        for name, figure in study_figures(results).items():
            pictures += save(figure, folder / name, *FORMATS)
        parquet.write_table(results.table(), table)
        as_json.write_text(json.dumps(summary, indent=1) + '\n')
        as_markdown.write_text('\n'.join(t.markdown() for t in (first, *(t for *_, t in others))))
    return [table, *pictures, as_json, as_markdown]
