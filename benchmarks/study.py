# SPDX-License-Identifier: Apache-2.0
"""Time of a study: one mission of each method at each lethality, on one core."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import time

from cases import Benchmark
from kbnitp_ros.study.scenario_file import read_study
from kbnitp_ros.study.trial import run_trial, Trial

PAPER = Path(__file__).parents[1] / 'config/scenarios/paper.yaml'


STUDY = read_study(PAPER, {'max_visits': 3})
SCENARIO = STUDY.first


def mission_timer(method: str) -> Callable[[], float]:
    """Return a function that times a method's mission in the first world, mean of lethalities."""

    def run() -> float:
        start = time.perf_counter()
        for lethality in SCENARIO.lethalities:
            run_trial(STUDY, Trial(lethality, method, 0))
        return (time.perf_counter() - start) / len(SCENARIO.lethalities)

    return run


BENCHMARKS = (
    Benchmark(
        'A mission of the study `paper`',
        f'{SCENARIO.robots} robots, one after another; the study has {SCENARIO.trials} missions '
        f'at each of {len(SCENARIO.lethalities)} lethalities, for each method.',
        {f'`{method}`': mission_timer(method) for method in SCENARIO.methods},
    ),
)
