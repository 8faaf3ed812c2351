# SPDX-License-Identifier: Apache-2.0
"""
Bring the figures and tables of studies into the documentation.

``python3 -m kbnitp_ros.study.page RUNS DOCS`` takes them from RUNS/<scenario>/, puts the figures
into DOCS/images/ and each table between its marks in DOCS/results.md.
"""

from __future__ import annotations

from pathlib import Path
import re
import shutil
import sys

FIGURES = ('entropy', 'log_loss', 'reliability')

TABLE = re.compile(r'(<!-- table (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)


def main(runs: Path, docs: Path) -> None:
    """Bring every study that the page has a table of."""

    def table(match: re.Match[str]) -> str:
        begin, scenario, end = match.groups()
        for figure in FIGURES:
            shutil.copy(
                runs / scenario / f'{figure}.png', docs / f'images/{scenario}_{figure}.png'
            )
        return begin + (runs / scenario / 'summary.md').read_text() + end

    page = docs / 'results.md'
    page.write_text(TABLE.sub(table, page.read_text()))


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:]))
