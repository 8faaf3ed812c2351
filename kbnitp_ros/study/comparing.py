# SPDX-License-Identifier: Apache-2.0
"""Studies from Python: compare planners and methods in the same worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from pickle import PicklingError
from typing import Any

from kbnitp_ros.core import METHODS, PLANNERS
from kbnitp_ros.files import read_yaml
from kbnitp_ros.plugins import entry_name
from kbnitp_ros.study.results import check_memory, Results
from kbnitp_ros.study.scenario import Scenario
from kbnitp_ros.study.scenario_file import parse_scenario, scenario_file
from kbnitp_ros.study.trial import list_trials, MissionResult, run_trial, Trial
from kbnitp_ros.study.workers import workers as worker_processes
from tqdm import tqdm

Given = Iterable[str | Callable[..., Any]] | Mapping[str, Callable[..., Any]]


def compare(
    scenario: str | Path | Mapping[str, Any] = 'paper',
    *,
    planners: Given = (),
    methods: Given = (),
    workers: int | None = None,
    **changes: Any,
) -> Results:
    """Run missions with every planner and method, at every lethality, in the same worlds."""
    if not isinstance(scenario, str | Path | Mapping):
        raise TypeError(f'scenario is {scenario!r}: it must be a name, a file or a mapping')
    given = scenario if isinstance(scenario, Mapping) else read_yaml(scenario_file(str(scenario)))
    content = {**given, **changes}
    paths, updates = by_name('planner', planners), by_name('method', methods)
    if updates:
        content['methods'] = list(updates)
    if paths:
        teams = content.get('teams', [{}])
        content['teams'] = [{**team, 'planner': name} for team in teams for name in paths]
    own = [
        {name: each for name, each in named.items() if not isinstance(each, str)}
        for named in (paths, updates)
    ]
    with PLANNERS.including(own[0]), METHODS.including(own[1]):
        study = parse_scenario(content)
    check_memory(study)
    trials = list_trials(study)
    try:
        with worker_processes('loky', workers) as pool:
            done = pool.run(partial(run_own, own[0], own[1], study), trials)
            bar = tqdm(done, total=len(trials), unit='mission', disable=None)
            return Results(study, dict(bar))
    except PicklingError as error:
        raise TypeError(
            'a planner or a method cannot be sent to other processes: define it in a module, or '
            'use workers=1'
        ) from error


def run_own(
    planners: Mapping[str, Callable[..., Any]],
    methods: Mapping[str, Callable[..., Any]],
    scenario: Scenario,
    trial: Trial,
) -> MissionResult:
    """Run a trial; planners and methods are passed to the process as objects."""
    with PLANNERS.including(planners), METHODS.including(methods):
        return run_trial(scenario, trial)


def by_name(kind: str, given: Given) -> dict[str, str | Callable[..., Any]]:
    """Return the planners or methods to compare, by their names in tables."""
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise TypeError(f'{kind}s is {given!r}: it must be a list, such as {kind}s=[{given!r}]')
    named: dict[str, str | Callable[..., Any]] = {}
    for entry in given:
        name = entry_name(entry).rpartition('.')[-1]
        if name in named or not name.isidentifier():
            reason = 'it has no name' if name not in named else 'two have this name'
            raise ValueError(
                f'{kind} {name!r}: {reason}; name them, as in {kind}s={{"mine": ...}}'
            )
        named[name] = entry
    return named
