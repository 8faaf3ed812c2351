# SPDX-License-Identifier: Apache-2.0
"""A table of results for people: in Markdown, in LaTeX and for pandas."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
import re
from typing import Any, NamedTuple

import pandas

ESCAPED = str.maketrans({each: f'\\{each}' for each in '&%$#_{}'})


class Cell(NamedTuple):
    """A value, of a mean a dict with its interval, and how it is shown in Markdown."""

    value: Any
    text: str


class Table:
    """A caption and a table of cells under it."""

    def __init__(self, caption: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
        self.caption = caption
        self._cells = pandas.DataFrame(rows, columns=heads, dtype=object)
        self._texts = self._cells.map(attrgetter('text'))

    def markdown(self) -> str:
        """Return it in Markdown."""
        heads = self._texts.columns
        head, *rows = (f'| {" | ".join(row)} |' for row in (heads, *self._texts.to_numpy()))
        return '\n'.join([self.caption, '', head, '|' + '---|' * len(heads), *rows, ''])

    def latex(self) -> str:
        """Return it as a ``table`` of LaTeX, which needs the package booktabs."""
        texts = self._texts.map(in_latex).rename(columns=in_latex)
        return str(texts.to_latex(index=False, caption=in_latex(self.caption)))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return it as a table of pandas; HEAD low and HEAD high are the interval of a mean."""
        rows = self._cells.map(attrgetter('value')).to_dict('records')
        known = [{head: value for head, value in row.items() if value is not None} for row in rows]
        return pandas.json_normalize(known, sep=' ').rename(
            columns=lambda name: name.removesuffix(' mean')
        )


def in_latex(text: str) -> str:
    """Return a line of Markdown in LaTeX."""
    return re.sub('`([^`]*)`', r'\\texttt{\1}', text.translate(ESCAPED))
