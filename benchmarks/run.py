# SPDX-License-Identifier: Apache-2.0
"""
Time all that may take long, in one run on one machine; print it and write docs/performance.md.

    make benchmarks
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import os
import platform
import sys

from cases import Benchmark, in_words, PAGE, write
import nodes
import numba
import numpy as np
import peers
import planning
import sampling
import study
from tqdm import tqdm
import updates

BENCHMARKS = (
    *planning.BENCHMARKS,
    *updates.BENCHMARKS,
    *sampling.BENCHMARKS,
    *nodes.BENCHMARKS,
    *study.BENCHMARKS,
    *peers.BENCHMARKS,
)

# A benchmark, and the seconds of each of its cases.
Measured = tuple[Benchmark, dict[str, float]]


def main() -> int:
    """Run all; return the exit code."""
    measured: list[Measured] = []
    with tqdm(total=sum(len(each.cases) for each in BENCHMARKS), unit='case', disable=None) as bar:
        for benchmark in BENCHMARKS:
            seconds = {}
            for name, case in benchmark.cases.items():
                bar.set_postfix_str(f'{benchmark.title}: {name}')
                seconds[name] = case()
                bar.update()
            measured.append((benchmark, seconds))
    print('\n'.join(summary(measured)))
    write('benchmarks', '\n'.join(page(measured)), PAGE)
    return 0


def rows(seconds: dict[str, float]) -> Iterator[tuple[str, str, str]]:
    """Yield each case with its time and the ratio to the first."""
    first = next(iter(seconds.values()))
    for name, each in seconds.items():
        yield name, in_words(each), f'{each / first:.3g}'


def summary(measured: Sequence[Measured]) -> Iterator[str]:
    """Yield one table of all benchmarks, in Markdown."""
    yield '| | | takes | ratio |'
    yield '|---|---|---|---|'
    for benchmark, seconds in measured:
        for name, takes, ratio in rows(seconds):
            yield f'| {benchmark.title} | {name} | {takes} | {ratio} |'


def page(measured: Sequence[Measured]) -> Iterator[str]:
    """Yield the tables, in Markdown."""
    yield (
        f'Measured with Python {platform.python_version()}, numpy {np.__version__} and numba '
        f'{numba.__version__}\non {os.cpu_count()} cores, {platform.machine()}.'
    )
    for benchmark, seconds in measured:
        yield f'\n## {benchmark.title}\n\n{benchmark.text}\n\n| | takes | ratio |\n|---|---|---|'
        for row in rows(seconds):
            yield f'| {" | ".join(row)} |'


if __name__ == '__main__':
    sys.exit(main())
