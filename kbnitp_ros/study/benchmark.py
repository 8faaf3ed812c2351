# SPDX-License-Identifier: Apache-2.0
"""The benchmark: planners on frozen beliefs, and planners and methods in the same missions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from time import process_time
from typing import NamedTuple

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
from kbnitp_ros.figures import FORMATS, LETTERS, save, WIDTH
from kbnitp_ros.files import naming, share
from kbnitp_ros.study.charts import draw_mean, LOG_LOSS_LABEL
from kbnitp_ros.study.comparing import compare
from kbnitp_ros.study.results import (
    as_json,
    bootstrap_mean,
    Cell,
    LOG_LOSS,
    Mean,
    Results,
    shown,
    Table,
)
from kbnitp_ros.study.scenario import Scenario
from kbnitp_ros.study.scenario_file import read_scenario, scenario_file
from kbnitp_ros.styles import SERIES
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

# Version of the frozen data: raised whenever a belief, a world or a parameter of the missions
# changes.
VERSION = 2
NAME = 'benchmark'

HEADS = (
    'planner',
    'method',
    'value / bound',
    'least',
    'ms a plan',
    'log loss',
    'entropy',
    'robots lost',
    'ms an update',
)

# The planner with which all methods run, and the method with which all planners run.
PLANNER, METHOD = 'beam', 'kappa_bnitp'


# A belief of a mission, the believed sensor model, and a proven upper bound on the information of
# any path, nats.
FrozenBelief = tuple[Belief, SensorModel, float]


class Entry(NamedTuple):
    """A row of the table: a planner and a method, with their missions."""

    planner: str
    method: str
    results: Results

    def final(self, *measures: str) -> Mean:
        """Return the mean over trials of a sum of measures after the last robot."""
        return bootstrap_mean(self.series(*measures)[:, -1])

    def series(self, *measures: str) -> NDArray[np.float64]:
        """Return the sum of measures, shape (trials, robots + 1)."""
        scenario = self.results.scenario
        (team,) = (each for each in scenario.teams if each.planner == self.planner)
        return self.results.series(scenario.lethalities[0], self.method, *measures, team=team)


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
    planners: Iterable[str], methods: Iterable[str], workers: int | None, **changes: int
) -> Iterator[Entry]:
    """Run the missions of every planner with one method, and of every method with one planner."""
    others = [each for each in methods if each != METHOD]
    by_planner = compare(NAME, planners=[*planners], methods=[METHOD], workers=workers, **changes)
    by_method = compare(NAME, planners=[PLANNER], methods=others, workers=workers, **changes)
    for planner in planners:
        yield Entry(planner, METHOD, by_planner)
    for method in others:
        yield Entry(PLANNER, method, by_method)


def benchmark_table(
    entries: Sequence[Entry], worths: dict[str, NDArray[np.float64]], seconds: dict[str, float]
) -> Table:
    """Return the table of the benchmark."""

    def mean(value: Mean, decimals: int = 1) -> Cell:
        return Cell(as_json(value), shown(as_json(value), decimals))

    def number(value: float, decimals: int) -> Cell:
        return Cell(value, f'{value:.{decimals}f}')

    rows = []
    for entry in entries:
        ratio, times = worths[entry.planner]
        rows.append(
            [
                Cell(entry.planner, f'`{entry.planner}`'),
                Cell(entry.method, f'`{entry.method}`'),
                mean(bootstrap_mean(ratio), 3),
                number(float(ratio.min()), 3),
                number(1e3 * float(np.median(times)), 1),
                mean(entry.final(*LOG_LOSS)),
                mean(entry.final('entropy')),
                mean(entry.final('robots_lost')),
                number(1e3 * seconds[entry.method], 2),
            ]
        )
    beliefs = worths[PLANNER].shape[1]
    caption = (
        f'Benchmark, version {VERSION}. Value / bound: the information of a plan divided by a '
        f'proven upper bound for any path, mean and least over {beliefs} frozen beliefs. Log loss '
        'and entropy (nats) and robots lost: after the last robot of missions in the same worlds, '
        'with 95 % bootstrap intervals. Times are processor times on this machine: medians for '
        'plans and means for updates.'
    )
    return Table(caption, HEADS, rows)


def benchmark_figure(entries: Sequence[Entry]) -> Figure:
    """Draw the log loss after each robot, with a panel for planners and a panel for methods."""
    with rc_context(LETTERS):
        figure = Figure(figsize=(WIDTH, 0.45 * WIDTH), layout='constrained')
        left, right = figure.subplots(1, 2, sharey=True)
        draw(left, {each.planner: each for each in entries if each.method == METHOD})
        draw(right, {each.method: each for each in entries if each.planner == PLANNER})
        left.set_title(f'planners, by {METHOD}')
        right.set_title(f'methods, by {PLANNER}')
        left.set_ylabel(LOG_LOSS_LABEL)
        figure.supxlabel('deployment')
    return figure


def draw(axes: Axes, entries: dict[str, Entry]) -> None:
    """Draw the mean log loss of each entry, with its interval."""
    for place, (name, entry) in enumerate(entries.items()):
        draw_mean(axes, entry.series(*LOG_LOSS), SERIES[place % len(SERIES)], name)
    axes.grid(alpha=0.3)
    axes.legend()


def run_benchmark(folder: Path, workers: int | None = None, **changes: int) -> list[Path]:
    """Run the benchmark and write its table and its figure."""
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    planners, methods = entered()
    scenario, beliefs = read_scenario(scenario_file(NAME)), frozen()
    field, steps = scenario.field(), scenario.planning.max_steps
    worths = {each: plan_worths(each, field, steps, beliefs) for each in planners}
    seconds = {each: time_method(each, scenario) for each in methods}
    entries = list(missions(planners, methods, workers, **changes))
    table = benchmark_table(entries, worths, seconds)
    written = save(benchmark_figure(entries), folder / NAME, *FORMATS)
    for suffix, text in (('md', table.markdown()), ('tex', table.latex())):
        written.append(folder / f'{NAME}.{suffix}')
        written[-1].write_text(text)
    return written
