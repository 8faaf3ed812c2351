# SPDX-License-Identifier: Apache-2.0
"""Studies from Python: compare planners and methods in the same worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from pickle import PicklingError
from typing import Any

from kbnitp_ros.core import METHODS, PLANNERS
from kbnitp_ros.core.field.check import in_short, listed
from kbnitp_ros.figures import FORMATS, save
from kbnitp_ros.files import naming, read_yaml
from kbnitp_ros.plugins import entry_name
from kbnitp_ros.study.charts import study_figures
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario_file import parse_study, scenario_file, Study
from kbnitp_ros.study.trial import check_memory, list_trials, run_trial, Trial
from kbnitp_ros.study.workers import workers as worker_processes
from pandas import DataFrame
from tqdm import tqdm

Given = Iterable[str | Callable[..., Any]] | Mapping[str, Callable[..., Any]]


def compare(
    scenario: str | Path | Mapping[str, Any] = 'calibrated',
    *,
    planners: Given = (),
    methods: Given = (),
    workers: int | None = None,
    **changes: Any,
) -> Results:
    """
    Run missions with every planner and method, at every lethality, in the same worlds.

    The default is the paper's experiment with a prior that is right.

    `scenario` is a name, a file or the content of a file; planners and methods are names,
    functions or classes, and a mapping names them. `changes` are values of the scenario by their
    names, such as ``trials=4`` or ``**{'prior.kappa': [0.5, 0.8]}``; a list is an axis of choices.
    """
    if not isinstance(scenario, str | Path | Mapping):
        raise TypeError(
            f'scenario is {in_short(scenario)}: it must be a name, a file or a mapping'
        )
    content = dict(
        scenario if isinstance(scenario, Mapping) else read_yaml(scenario_file(str(scenario)))
    )
    paths, updates = by_name('planner', planners), by_name('method', methods)
    if updates:
        content['methods'] = list(updates)
    if paths:
        teams = content.get('teams') or [{}]
        # Others are refused when the study is parsed.
        if isinstance(teams, list) and all(isinstance(team, dict) for team in teams):
            content['teams'] = [{**team, 'planner': name} for team in teams for name in paths]
    own = [
        {name: each for name, each in named.items() if not isinstance(each, str)}
        for named in (paths, updates)
    ]
    with PLANNERS.including(own[0]), METHODS.including(own[1]):
        study = parse_study(content, changes)
    check_memory(study)
    trials = list_trials(study)
    try:
        with worker_processes('loky', workers) as pool:
            done = pool.run(partial(run_own, own[0], own[1], study), trials)
            bar = tqdm(done, total=len(trials), unit='mission', disable=None)
            return Results.of(study, dict(bar))
    except PicklingError as error:
        raise TypeError(
            'a planner or a method cannot be sent to other processes: define it in a module, or '
            'use workers=1'
        ) from error


def run_own(
    planners: Mapping[str, Callable[..., Any]],
    methods: Mapping[str, Callable[..., Any]],
    study: Study,
    trial: Trial,
) -> DataFrame:
    """Run a trial; planners and methods are passed to the process as objects."""
    with PLANNERS.including(planners), METHODS.including(methods):
        return run_trial(study, trial)


def by_name(kind: str, given: Given) -> dict[str, str | Callable[..., Any]]:
    """Return the planners or methods to compare, by their names in tables."""
    if isinstance(given, str) or callable(given):
        raise TypeError(f'{kind}s is {given!r}: it must be a list, such as {kind}s=[{given!r}]')
    named: dict[str, str | Callable[..., Any]] = {}
    entries = listed(f'{kind}s', given.values() if isinstance(given, Mapping) else given)
    for entry in entries:
        if not (isinstance(entry, str) or callable(entry)):
            raise TypeError(f'{kind} is {in_short(entry)}: it must be a name or a function')
    if isinstance(given, Mapping):
        return dict(given)
    for entry in entries:
        name = entry_name(entry).rpartition('.')[-1]
        if name in named or not name.isidentifier():
            reason = 'it has no name' if name not in named else 'two have this name'
            raise ValueError(
                f'{kind} {name!r}: {reason}; name them, as in {kind}s={{"mine": ...}}'
            )
        named[name] = entry
    return named


def write_report(results: Results, folder: Path) -> list[Path]:
    """Write the table, the figures and the summary of a study."""
    written = results.write(folder)
    for name, figure in study_figures(results).items():
        with naming(folder):
            written += save(figure, folder / name, *FORMATS)
    for ending, text in (('md', results.markdown()), ('tex', results.latex())):
        written.append(folder / f'summary.{ending}')
        with naming(written[-1]):
            written[-1].write_text(text)
    return written
