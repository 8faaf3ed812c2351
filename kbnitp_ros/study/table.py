# SPDX-License-Identifier: Apache-2.0
"""A table of results for people: in Markdown, in LaTeX and for pandas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
import re
from typing import Any, NamedTuple, TYPE_CHECKING

if TYPE_CHECKING:
    from pandas import DataFrame

# Of a mean: the names of its parts, and what their columns have behind the head.
MEAN = (('mean',), ('low', 'low'), ('high', 'high'))

ESCAPED = str.maketrans({each: f'\\{each}' for each in '&%$#_{}'})


class Cell(NamedTuple):
    """A value, of a mean a dict with its interval, and how it is shown."""

    value: Any
    text: str


@dataclass(frozen=True)
class Table:
    """
    A caption and a table under it.

    Attributes
    ----------
    caption : str
        In Markdown, like what cells show.
    heads : sequence of str
        Of the columns.
    rows : sequence of sequence of Cell
        One cell a column.

    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Cell]]

    def markdown(self) -> str:
        """Return it in Markdown."""
        lines = [self.caption, '', f'| {" | ".join(self.heads)} |', '|' + '---|' * len(self.heads)]
        lines += [f'| {" | ".join(cell.text for cell in row)} |' for row in self.rows]
        return '\n'.join(lines) + '\n'

    def latex(self) -> str:
        """Return it as a ``table`` of LaTeX, which needs the package booktabs."""
        head, *rows = (
            f'{" & ".join(map(in_latex, texts))} \\\\'
            for texts in (self.heads, *([cell.text for cell in row] for row in self.rows))
        )
        lines = (
            r'\begin{table}',
            rf'\caption{{{in_latex(self.caption)}}}',
            rf'\begin{{tabular}}{{{"l" * len(self.heads)}}}',
            r'\toprule',
            head,
            r'\midrule',
            *rows,
            r'\bottomrule',
            r'\end{tabular}',
            r'\end{table}',
        )
        return '\n'.join(lines) + '\n'

    def to_dataframe(self) -> DataFrame:
        """
        Return it as a table of pandas.

        Returns
        -------
        pandas.DataFrame
            A column a head; of means two more, with the words low and high behind the head, the
            ends of the 95 % intervals.

        """
        import pandas

        rows = [map(columns_of, self.heads, row) for row in self.rows]
        return pandas.DataFrame([dict(chain.from_iterable(row)) for row in rows])


def columns_of(head: str, cell: Cell) -> list[tuple[str, Any]]:
    """Return the names and values that a cell has in a table of pandas."""
    if not isinstance(cell.value, dict):
        return [(head, cell.value)]
    return [(' '.join([head, *end]), cell.value[name]) for name, *end in MEAN]


def in_latex(text: str) -> str:
    """Return a line of Markdown in LaTeX."""
    return re.sub('`([^`]*)`', r'\\texttt{\1}', text.translate(ESCAPED))
