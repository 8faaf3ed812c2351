# SPDX-License-Identifier: Apache-2.0
"""A benchmark: cases that are timed on one machine in one run, and compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import re
from statistics import median
import time

PAGE = Path(__file__).parents[1] / 'docs' / 'performance.md'

# Maximum number of runs of a case, and seconds of repetition.
RUNS = 20
SECONDS = 2.0


@dataclass(frozen=True)
class Benchmark:
    """
    Cases that are compared with the first.

    Attributes
    ----------
    title : str
        What is measured.
    text : str
        What the cases have in common.
    cases : dict of str to callable
        By name: returns the seconds that it takes.

    """

    title: str
    text: str
    cases: dict[str, Callable[[], float]]


def timed(call: Callable[[], object]) -> float:
    """
    Return the median seconds of a call.

    Called once before, since the first call of a kernel loads or compiles it.
    """
    call()
    times: list[float] = []
    while not times or (len(times) < RUNS and sum(times) < SECONDS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return median(times)


def in_words(seconds: float) -> str:
    """Return a time to three digits, in a suitable unit."""
    for unit, size in (('s', 1.0), ('ms', 1e-3)):
        if seconds >= size:
            return f'{seconds / size:.3g} {unit}'
    return f'{seconds / 1e-6:.3g} µs'


def write(name: str, text: str, page: Path = PAGE) -> None:
    """Replace the text between a name's marks on a page."""
    marked = re.compile(rf'(?<=<!-- table {name} -->\n)(.*?)(?=<!-- end -->)', re.DOTALL)
    # Once: after an empty match the same place would match again.
    page.write_text(marked.sub(lambda old: f'{text}\n', page.read_text(), 1), encoding='utf-8')
