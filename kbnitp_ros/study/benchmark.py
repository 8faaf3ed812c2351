# SPDX-License-Identifier: Apache-2.0
"""The benchmark: planners on frozen beliefs, and planners and methods in the same missions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any

from kbnitp_ros.core import (
    Belief,
    Estimator,
    Grid,
    METHODS,
    plan,
    PLANNERS,
    run_mission,
    SearchOptions,
    SensorModel,
    World,
)
from kbnitp_ros.figures import FORMATS, LETTERS, save
from kbnitp_ros.files import naming, share
from kbnitp_ros.study.charts import curves
from kbnitp_ros.study.comparing import compare
from kbnitp_ros.study.results import (
    bootstrap,
    by,
    latex_table,
    markdown_table,
    mean_with_interval,
    Results,
)
from kbnitp_ros.study.scenario import Scenario
from kbnitp_ros.study.scenario_file import full_name, read_study, scenario_file
from matplotlib import rc_context
import numpy as np
from numpy.typing import NDArray
import pandas
from pandas import DataFrame
from tqdm import tqdm

# Version of the frozen data: raised whenever a belief, a world or a parameter of the missions
# changes.
VERSION = 2
NAME = 'benchmark'

# The planner with which all methods run, and the method with which all planners run.
PLANNER, METHOD = 'beam', 'kappa_bnitp'


# A belief of a mission, the believed sensor model, and a proven upper bound on the information of
# any path, nats.
FrozenBelief = tuple[Belief, SensorModel, float]


def frozen() -> list[FrozenBelief]:
    """Return the frozen beliefs of this version of the benchmark."""
    with np.load(share('config/scenarios') / f'{NAME}_{VERSION}.npz', allow_pickle=False) as file:
        return [
            (Belief(joint), SensorModel(lethality), float(bound))
            for joint, lethality, bound in zip(file['joint'], file['lethality'], file['bound'])
        ]


def entered() -> tuple[list[str], list[str]]:
    """Return the planners and methods to benchmark, including entry points of other packages."""
    planners = ['random', 'coverage', 'shortest_unvisited', PLANNER]
    return [*planners, *PLANNERS.added], [*METHODS.own, *METHODS.added]


def plan_worths(
    planner: str, field: Grid, steps: int, beliefs: Sequence[FrozenBelief]
) -> NDArray[np.float64]:
    """Return information / bound and processor seconds of a planner's plans, (2, beliefs)."""

    def planned(belief: Belief, model: SensorModel, bound: float) -> tuple[float, float]:
        begun = process_time()
        found = plan(field, belief, model, SearchOptions(planner, steps))
        return found.information / bound, process_time() - begun

    # The first plan compiles kernels.
    planned(*beliefs[0])
    return np.array([planned(*each) for each in tqdm(beliefs, planner, disable=None)]).T


def time_method(method: str, scenario: Scenario) -> float:
    """Return the mean processor seconds that a method takes for one deployment."""
    field, truth = scenario.field(), scenario.truth(scenario.lethalities[0], 0)
    prior, model = scenario.belief(truth), scenario.model(truth)
    world = World.random(field, 0, **{name: truth[name] for name in vars(scenario.world)})
    options = SearchOptions('coverage', scenario.planning.max_steps)
    mission = run_mission(field, prior, model, world, scenario.robots, 0, options=options)
    # The first run compiles kernels.
    for _ in range(2):
        estimator = Estimator(prior, model, method)
        begun = process_time()
        for deployment in mission:
            estimator.assimilate(deployment.observation)
        seconds = (process_time() - begun) / len(mission)
    return seconds


def missions(
    planners: Sequence[str],
    methods: Sequence[str],
    workers: int | None,
    changes: Mapping[str, Any],
) -> Results:
    """Run the missions of every planner with one method, and of every method with one planner."""
    others = [each for each in methods if each != METHOD]
    by_planner, by_method = (
        compare(NAME, planners=one, methods=other, workers=workers, **changes).to_dataframe()
        for one, other in (([*planners], [METHOD]), ([PLANNER], others))
    )
    table = pandas.concat([by_planner, by_method], ignore_index=True)
    # Categories of two tables become plain texts.
    return Results(table.astype({'strategy': 'category'}))


def benchmark_table(
    results: Results, worths: dict[str, NDArray[np.float64]], seconds: dict[str, float]
) -> DataFrame:
    """Return the table of the benchmark: a row for each planner, method and choice."""
    means = results.means('log_loss', 'entropy', 'robots_lost')
    chosen = [name for name in results.axes if means[name].nunique() > 1]
    rows = []
    for named, own in by(means, ['strategy', *chosen]):
        method, planner = named.pop('strategy').split(', ')
        ratio, times = worths[planner]
        rows.append(
            {
                'planner': f'`{planner}`',
                'method': f'`{method}`',
                **named,
                'value / bound': mean_with_interval(bootstrap(ratio)._asdict(), 3),
                'least': f'{ratio.min():.3f}',
                'ms a plan': f'{1e3 * np.median(times):.1f}',
                **{
                    row['measure'].replace('_', ' '): mean_with_interval(row)
                    for _, row in own.iterrows()
                },
                'ms an update': f'{1e3 * seconds[method]:.2f}',
            }
        )
    return DataFrame(rows)


def run_benchmark(folder: Path, workers: int | None, changes: Mapping[str, Any]) -> list[Path]:
    """Run the benchmark and write its tables and its figure."""
    for name in changes:
        if full_name(name) in ('methods', 'teams'):
            raise ValueError(f'{name} cannot be set: the benchmark compares all that there are')
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    planners, methods = entered()
    scenario, beliefs = read_study(scenario_file(NAME), changes).first, frozen()
    field, steps = scenario.field(), scenario.planning.max_steps
    worths = {each: plan_worths(each, field, steps, beliefs) for each in planners}
    seconds = {each: time_method(each, scenario) for each in methods}
    results = missions(planners, methods, workers, changes)
    table = benchmark_table(results, worths, seconds)
    caption = (
        f'Benchmark, version {VERSION}. Value / bound: the information of a plan divided by a '
        f'proven upper bound for any path, mean and least over {len(beliefs)} frozen beliefs. Log '
        'loss and entropy (nats) and robots lost: after the last robot of missions in the same '
        'worlds, with 95 % bootstrap intervals. Times are processor times on this machine: '
        'medians for plans and means for updates.'
    )
    with rc_context(LETTERS):
        written = save(curves(results, 'log_loss', 'log'), folder / NAME, *FORMATS)
    texts = {
        'md': markdown_table(caption, table),
        'tex': latex_table(caption, table),
    }
    for suffix, text in texts.items():
        written.append(folder / f'{NAME}.{suffix}')
        written[-1].write_text(text)
    return [*written, *results.write(folder)]
