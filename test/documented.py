# SPDX-License-Identifier: Apache-2.0
"""Read pages, for tests that compare them with measurements."""

from pathlib import Path
import re

ROOT = Path(__file__).parents[1]


def words(page: str) -> str:
    """Return a page's text without line breaks; `page` is its path in the project."""
    return ' '.join(ROOT.joinpath(page).read_text().split())


def blocks(page: str | Path) -> list[tuple[str, str]]:
    """Return the language and the text of each code block of a page."""
    return re.findall(r'^```(\w+)\n(.*?)^```', ROOT.joinpath(page).read_text(), re.M | re.S)


def rows(page: str, head: str) -> dict[str, list[str]]:
    """Return a table's cells by its first column; its header contains `head`."""
    tables = re.findall(r'(?:^\|.*\n)+', ROOT.joinpath(page).read_text(), re.MULTILINE)
    (table,) = (table for table in tables if head in table.splitlines()[0])
    _, _, *lines = (
        [cell.strip(' `') for cell in line.strip('|').split('|')] for line in table.splitlines()
    )
    return {first: rest for first, *rest in lines}
