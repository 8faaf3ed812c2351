# SPDX-License-Identifier: Apache-2.0
"""
Bring the figures and tables of studies into the documentation.

``python3 -m kbnitp_ros.study.page RUNS DOCS`` takes them from RUNS/<scenario>/, puts the tables
between their marks in DOCS/results.md, and of the figures those that the page shows into
DOCS/images/, as <scenario>_<figure>.png.
"""

from __future__ import annotations

from pathlib import Path
import re
import shutil
import sys

TABLE = re.compile(r'(<!-- table (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)


def main(runs: Path, docs: Path) -> None:
    """Bring every study that the page has a table of."""
    page = docs / 'results.md'
    text = page.read_text()

    def table(match: re.Match[str]) -> str:
        begin, scenario, end = match.groups()
        for figure in re.findall(rf'\(images/{scenario}_(\w+\.png)\)', text):
            shutil.copy(runs / scenario / figure, docs / 'images' / f'{scenario}_{figure}')
        return begin + (runs / scenario / 'summary.md').read_text() + end

    page.write_text(TABLE.sub(table, text))


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:]))
