# SPDX-License-Identifier: Apache-2.0
"""Forecast a mission: robots sent and lost, and the certainty reached."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from kbnitp_ros.cli.output import command, complain, end_on_signals, say
from kbnitp_ros.cli.parameters import node_values, recorded_planner, set_parameter
from kbnitp_ros.cli.study import count
from kbnitp_ros.configuration import (
    agent_names,
    make_estimator,
    make_goal,
    make_grid,
    with_defaults,
)
from kbnitp_ros.configuration.agents import make_robot_types
from kbnitp_ros.configuration.given import read_sections
from kbnitp_ros.configuration.known import check_own
from kbnitp_ros.configuration.mission import check_search, make_stop, search_options, type_to_plan
from kbnitp_ros.core import forecast, Team
from kbnitp_ros.core.forecast import Course, Forecast, PossibleWorld, wilson_interval
from kbnitp_ros.figures import forecast_figure, save
from kbnitp_ros.log.record import read_ledger
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.nodes.runtime.command_line import add_namespace, command_parser
from kbnitp_ros.report.folder import check_is_free
from kbnitp_ros.study.results import markdown_table
from kbnitp_ros.study.workers import Workers, workers
import numpy as np
from numpy.typing import NDArray
from pandas import DataFrame
from tqdm import tqdm

DESCRIPTION = """
Forecast a mission: how many robots it takes, how many of them are lost, and how sure the belief
becomes. Fields are drawn from the prior of the parameters, or from the posterior of a log. In
each field a mission is run, with the planner, the method and the goal of the parameters.

Each number has its 5 and 95 % quantiles over these missions. The quantiles hold if the model is
right: robots keep to their paths, and hazards agree with the prior and the sensor model.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros forecast --set goal.kind=lane --set goal.cells=[80] --set robots=50',
    'python3 -m kbnitp_ros forecast --params config/mission.yaml --out runs/forecast',
    'python3 -m kbnitp_ros forecast runs/small --set robots=60 --worlds 50',
)

# Numbers of robots with a row in the table, besides the last number.
AFTER = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)

QUANTILES = (0.05, 0.5, 0.95)
SPREAD = ('5 %', 'median', '95 %')


@command('forecast')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = parse(argv)
    end_on_signals()
    try:
        if options.out:
            check_is_free(options.out)
        mission = mission_arguments(options)
        with workers('loky', options.workers) as pool:
            found = forecast(
                **mission, worlds=options.worlds, rng=options.seed, run=partial(run, pool)
            )
        say(*lines(found))
        if options.out:
            say(*(f'wrote {path}' for path in write(found, options.out)))
    except RuntimeError as error:
        complain('forecast', error)
        return 1
    except (ValueError, OSError) as error:
        complain('forecast', error)
        return 2
    return 0


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Return the options."""
    parser = command_parser('forecast', DESCRIPTION, *EXAMPLES)
    parser.add_argument(
        'log',
        metavar='LOG',
        type=Path,
        nargs='?',
        help='the log of a mission to continue: its first file, or its folder. Robots in flight '
        'at its end are sent again',
    )
    add_namespace(parser)
    parser.add_argument(
        '--params',
        metavar='FILE',
        help='YAML file with parameters of planner and estimator, such as config/mission.yaml; '
        'with LOG, only parameters of the planner are used, in place of the recorded values',
    )
    parser.add_argument(
        '--set',
        metavar='[NODE:]NAME=VALUE',
        action='append',
        default=[],
        help='set a parameter of planner and estimator, or of one NODE (with LOG, of the planner '
        'only). Can be repeated; `python3 -m kbnitp_ros NODE --help` lists the parameters',
    )
    number = partial(parser.add_argument, metavar='N', type=count)
    number('--worlds', default=200, help='number of missions to run, at least 1; default 200')
    number(
        '--seed',
        type=partial(count, least=0),
        default=0,
        help='seed of the fields and of the outcomes of robots, at least 0; default 0',
    )
    number(
        '--workers',
        help='number of processes, at least 1; default one per core; no effect on the result',
    )
    parser.add_argument(
        '--out',
        metavar='DIR',
        type=Path,
        help='new or empty folder for the figure and a table with a row for each number of robots',
    )
    return parser.parse_args(argv)


def mission_arguments(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `forecast` for a new mission, or to resume that of a log."""
    log = MissionLog(options.log, options.namespace) if options.log else None
    ledger = read_ledger(log) if log else None
    sections = read_sections(options.params) if options.params else {}
    given = node_values(sections, ('planner',) if log else ('planner', 'estimator'))
    if log and not options.params:
        given['planner'] = recorded_planner(log)
    for rule in options.set:
        set_parameter(given, rule, 'forecast')
    planner = with_defaults('planner', given['planner'])
    if ledger:
        grid, estimator, believed = ledger.grid, ledger.estimator, ledger.robot_types
    else:
        values = with_defaults('estimator', given['estimator'])
        if planner['map_topic']:
            raise ValueError(
                f'map_topic is {planner["map_topic"]}: the forecast subscribes to no map; '
                'set the parameter map instead'
            )
        grid = make_grid(planner)
        if make_grid(values) != grid:
            raise ValueError(
                'planner and estimator have different fields: give both the same field'
            )
        estimator, believed = make_estimator(values, grid), make_robot_types(values, grid)
    before = [ledger.outcomes[key] for key in ledger.deployments] if ledger else []
    if before and len(before) >= planner['robots']:
        raise ValueError(
            f'{options.log} has {len(before)} deployments, and robots is {planner["robots"]}: '
            f'raise it with --set robots={len(before) + 10}'
        )
    check_own(planner)
    check_search(planner, grid, believed)
    types = [type_to_plan(planner, agent, grid, believed) for agent in agent_names(planner, grid)]
    return {
        'grid': grid,
        'estimator': estimator,
        'robots': planner['robots'] - len(before),
        'before': before,
        'options': search_options(planner),
        'team': Team(len(types), planner['allocation'], tuple(types)),
        'goal': make_goal(planner, grid),
        'stop': make_stop(planner),
    }


def run(
    pool: Workers, fly: Callable[[PossibleWorld], Course], drawn: Iterable[PossibleWorld]
) -> list[Course]:
    """Run missions in worker processes with a progress bar; return them in order."""
    worlds, courses = [*drawn], {}
    with tqdm(total=len(worlds), unit='mission', disable=None) as bar:
        for possible, course in pool.run(fly, worlds):
            courses[possible.number] = course
            bar.update()
    return [courses[number] for number in range(len(worlds))]


def lines(found: Forecast) -> Iterator[str]:
    """Yield the results as text."""
    is_goal, is_sure = found.goal != 'map', found.confidence is not None
    sought = f'goal {found.goal}' if is_goal else 'no goal'
    sought += f' at a confidence of {found.confidence:.4g}' if is_sure else ''
    yield f'{len(found.sent)} missions of at most {found.robots} robots, {sought}'
    if is_sure:
        yield f'reached in {in_percent(found.reached[:, -1])} of the missions'
    if is_goal:
        yield (
            f'at the end the {found.goal} is free of hazards in '
            f'{in_percent(found.free)} of the missions; mean believed probability '
            f'{found.p_free[:, -1].mean():.3f}'
        )
    yield ''
    rows = [
        [name, f'{each.mean():.1f}', *(f'{value:.0f}' for value in quantiles(each))]
        for name, each in (('robots sent', found.sent), ('robots lost', found.lost[:, -1]))
    ]
    yield markdown_table('In a mission:', DataFrame(rows, columns=['', 'mean', *SPREAD]))
    what, known, decimals = (
        ('probability', found.p_free, 3) if is_goal else ('entropy', found.entropy, 1)
    )
    rows = [
        [
            str(robots),
            *(f'{value:.0f}' for value in quantiles(found.lost[:, robots])),
            *(f'{value:.{decimals}f}' for value in quantiles(known[:, robots])),
            *([in_percent(found.reached[:, robots])] if is_sure else []),
        ]
        for robots in (*(each for each in AFTER if each < found.robots), found.robots)
    ]
    spreads = [f'{name}, {each}' for name in ('lost', what) for each in SPREAD]
    yield markdown_table(
        'By number of robots sent; missions that ended earlier count with their last values:',
        DataFrame(rows, columns=['robots', *spreads, *(['reached'] if is_sure else [])]),
    )


def quantiles(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the `QUANTILES` of some values over missions, without interpolation."""
    found: NDArray[np.float64] = np.quantile(values, QUANTILES, axis=0, method='inverted_cdf')
    return found


def in_percent(successes: NDArray[np.float64]) -> str:
    """Return a share of missions with its 95 % interval, as text."""
    percent, low, high = (f'{100 * each:.0f}' for each in wilson_interval(successes))
    return f'{percent} % [{low}, {high}]'


def write(found: Forecast, folder: Path) -> list[Path]:
    """Write the table and the figure; return their files."""
    folder.mkdir(parents=True, exist_ok=True)
    table = {'robots': range(found.robots + 1)} | {
        f'{name}_{100 * level:.0f}': spread
        for name in ('lost', 'entropy', 'p_free')
        for level, spread in zip(QUANTILES, quantiles(getattr(found, name)))
    }
    file = folder / 'forecast.csv'
    DataFrame(table | {'reached': found.reached.mean(axis=0)}).to_csv(
        file, index=False, na_rep='nan', lineterminator='\r\n'
    )
    return [file, *save(forecast_figure(found), folder / 'forecast', 'png', 'svg')]
