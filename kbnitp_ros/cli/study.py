# SPDX-License-Identifier: Apache-2.0
"""Run a study: missions without ROS, by every method, at every lethality, in the same worlds."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from kbnitp_ros.cli.output import command, complain, end_on_signals, say
from kbnitp_ros.files import in_words, share
from kbnitp_ros.nodes.runtime.command_line import command_parser
from tqdm import tqdm

# Name of the benchmark, which is run in place of a study.
BENCHMARK = 'benchmark'

DESCRIPTION = """
Run a study: missions without ROS, by every method, at every lethality, in the same worlds. It
writes a table, figures and a summary.

After an interruption the same command continues. The scenario benchmark is not a study: it
compares planners and methods, including plug-ins, on frozen beliefs and in the same worlds.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros study paper --out runs/paper',
    'python3 -m kbnitp_ros study mine.yaml --out runs/mine --workers 4',
    'python3 -m kbnitp_ros study paper --out runs/kappa --trials 10 --set prior.kappa=0.5,0.8',
    'python3 -m kbnitp_ros study benchmark --out runs/benchmark',
)


@command('study')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = parse(argv)
    end_on_signals()
    return study(options)


def study(options: argparse.Namespace) -> int:
    """Run the benchmark, or the missing trials of a study; return the exit code."""
    is_benchmark = options.scenario == BENCHMARK
    try:
        # Pandas takes a second to import, and the help does not need it.
        written = run_benchmark(options) if is_benchmark else run_trials(options)
    except KeyboardInterrupt:
        further = '' if is_benchmark else f'; the same command continues in {options.out}'
        complain('study', f'interrupted{further}')
        return 130
    except ValueError as error:
        complain('study', error)
        return 2
    except (RuntimeError, OSError) as error:
        complain('study', error)
        return 1
    say(*(f'wrote {path}' for path in written))
    return 0


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Return the options."""
    parser = command_parser('study', DESCRIPTION, *EXAMPLES)
    parser.add_argument(
        'scenario',
        metavar='SCENARIO',
        help='a YAML file (its format: docs/files.md), or the name of a shipped study: '
        f'{", ".join(sorted(path.stem for path in share("config/scenarios").glob("*.yaml")))}',
    )
    parser.add_argument(
        '--out',
        metavar='DIR',
        type=Path,
        required=True,
        help='folder for the results; trials whose results it holds are not run again',
    )
    number = partial(parser.add_argument, metavar='N', type=count)
    parser.add_argument(
        '--anew',
        action='store_true',
        help='run all trials again, such as those of another version; default: only missing ones',
    )
    number('--trials', help='number of worlds, at least 1; default that of the scenario')
    parser.add_argument(
        '--set',
        metavar='NAME=VALUE',
        action='append',
        default=[],
        help='value of the scenario, such as max_visits=3 or prior.kappa=0.5; several with commas '
        'are choices, each of which is run; may be repeated',
    )
    parser.add_argument(
        '--backend',
        choices=('loky', 'dask'),
        default='loky',
        help='where trials run: processes of this machine (loky, the default) or Dask',
    )
    number('--workers', help='number of processes, at least 1; default one per core')
    parser.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='address of a running Dask scheduler; by default one is started',
    )
    return parser.parse_args(argv)


def count(text: str, least: int = 1) -> int:
    """Parse a whole number that is at least `least`."""
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f'{text!r} must be a whole number of at least {least}')
    return int(text)


def changes(options: argparse.Namespace) -> dict[str, Any]:
    """Return the values that replace those of the scenario."""
    from kbnitp_ros.study.scenario_file import read_changes

    trials = {} if options.trials is None else {'trials': options.trials}
    return trials | read_changes(options.set)


def run_benchmark(options: argparse.Namespace) -> list[Path]:
    """Run the benchmark; return the files written."""
    from kbnitp_ros.study import benchmark

    if options.backend != 'loky':
        raise ValueError(f'backend is {options.backend}: the benchmark runs on this machine')
    return benchmark.run_benchmark(options.out, options.workers, changes(options))


def run_trials(options: argparse.Namespace) -> list[Path]:
    """Run the missing trials of a study, then write the report; return the files written."""
    from kbnitp_ros.study.comparing import write_report
    from kbnitp_ros.study.results import Results
    from kbnitp_ros.study.scenario_file import read_study, scenario_file
    from kbnitp_ros.study.trial import check_memory, list_trials, run_trial
    from kbnitp_ros.study.workers import Folder, workers

    with ExitStack() as stack:
        try:
            scenario = read_study(scenario_file(options.scenario), changes(options))
            check_memory(scenario)
            folder = Folder(options.out, scenario, anew=options.anew)
            pool = stack.enter_context(
                workers(options.backend, options.workers, options.scheduler)
            )
        except OSError as error:
            raise ValueError(in_words(error)) from error
        outcomes = folder.outcomes()
        trials = list_trials(scenario)
        missing = [trial for trial in trials if trial not in outcomes]
        # World after world, so that an interrupted study has complete worlds.
        missing.sort(key=attrgetter('number'))
        with tqdm(
            initial=len(outcomes), total=len(trials), unit='trial', desc='missions', disable=None
        ) as bar:
            for trial, outcome in pool.run(partial(run_trial, scenario), missing):
                folder.save(trial, outcome)
                outcomes[trial] = outcome
                bar.update()
        return write_report(Results.of(scenario, outcomes), options.out)
