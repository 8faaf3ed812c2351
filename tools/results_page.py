#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""
Bring the figures and tables of studies into the documentation.

``python3 tools/results_page.py RUNS DOCS`` takes them from RUNS/<scenario>/, puts the tables
between their marks in DOCS/tables/<scenario>.md, and of the figures those that DOCS/results.md
and DOCS/results/ show into DOCS/images/, as <scenario>_<figure>.png.
"""

from __future__ import annotations

from pathlib import Path
import re
import sys

from PIL import Image

TABLE = re.compile(r'(?<=<!-- table -->\n)(.*?)(?=<!-- end -->)', re.DOTALL)
# Of a figure in the page, in pixels, and how many colours it has there.
WIDTH, COLOURS = 1600, 128

FIGURE = re.compile(r'images/(\w+\.png)\)')


def main(runs: Path, docs: Path) -> None:
    """Bring every study that has a page of tables."""
    pages = sorted((docs / 'tables').glob('*.md'))
    shown = [docs / 'results.md', *docs.glob('results/*.md')]
    for figure in FIGURE.findall(''.join(page.read_text() for page in shown)):
        # The name of a scenario may begin with another's.
        of = [each.stem for each in pages if figure.startswith(f'{each.stem}_')]
        if of:
            scenario = max(of, key=len)
            drawn = runs / scenario / figure.removeprefix(f'{scenario}_')
            bring(drawn, docs / 'images' / figure)
    for page in pages:
        begin, _, end = TABLE.split(page.read_text())
        page.write_text(begin + (runs / page.stem / 'summary.md').read_text() + end)


def bring(drawn: Path, shown: Path) -> None:
    """Bring a figure, as large as a page shows it and in as few colours as it needs."""
    with Image.open(drawn) as image:
        image.thumbnail((WIDTH, 2 * WIDTH))
        # Refined, since the median cut alone turns the colours of lines into others.
        image.convert('RGB').quantize(COLOURS, kmeans=3).save(shown, optimize=True)


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:]))
