# SPDX-License-Identifier: Apache-2.0
"""The files that a study leaves for people and for other programs."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path

from kbnitp_ros.figures import FORMATS, LETTERS, save
from kbnitp_ros.files import naming
from kbnitp_ros.study.charts import entropy_chart, log_loss_chart, reliability_chart
from kbnitp_ros.study.comparison import COMPARISONS, differ_in_objective, learns
from kbnitp_ros.study.questions import (
    decision_chart,
    differ_in_size,
    loss_cost_chart,
    numbers_chart,
    teams_chart,
)
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import differ_only_in
from kbnitp_ros.study.summary import Row, summarise, Table, table_of
from matplotlib import rc_context
from matplotlib.figure import Figure
from pyarrow import parquet


def figures_of(results: Results) -> dict[str, Figure]:
    """Return the figures of a study, by the names of their files."""
    charts = {'entropy': entropy_chart, 'log_loss': log_loss_chart}
    charts['reliability'] = reliability_chart
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
    """Yield the name of each section of the summary, what it says and its table."""
    summary = summarise(results)
    yield 'summary', summary, table_of(summary)
    for comparison in COMPARISONS:
        if comparison.applies(results.scenario):
            section = comparison.summarise(results)
            yield comparison.name, section, comparison.table(section)


def tables_of(results: Results) -> dict[str, Table]:
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
        for name, figure in figures_of(results).items():
            pictures += save(figure, folder / name, *FORMATS)
        parquet.write_table(results.table(), table)
        as_json.write_text(json.dumps(summary, indent=1) + '\n')
        as_markdown.write_text('\n'.join(t.markdown() for t in (first, *(t for *_, t in others))))
    return [table, *pictures, as_json, as_markdown]
