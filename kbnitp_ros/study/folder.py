# SPDX-License-Identifier: Apache-2.0
"""The folder a study works in: its scenario, and a file for each trial that is done."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
import fcntl
import os
from pathlib import Path
from typing import BinaryIO

from kbnitp_ros.files import naming
from kbnitp_ros.study.scenario import ALONE, NUMBERS, read_scenario, Scenario
from kbnitp_ros.study.trial import LEARNT, measures_of, MissionResult, Trial, trials_of
import numpy as np
import yaml


class Folder:
    """The outcomes of one scenario's trials, as far as they are known."""

    def __init__(self, path: Path, scenario: Scenario) -> None:
        self._scenario = scenario
        self._trials = path / 'trials'
        kept = path / 'scenario.yaml'
        if kept.exists():
            _check_same(path, asdict(read_scenario(kept)), asdict(scenario))
        elif self._trials.exists():
            raise ValueError(f'{path} holds results of an unknown scenario: name another folder')
        elif any(path.glob('*.mcap')):
            raise ValueError(f'{path} holds a mission: name another folder with --out')
        path.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f'{path} has another study at work in it') from error
        text = yaml.safe_dump(asdict(scenario), sort_keys=False)
        _write(kept, lambda file: file.write(text.encode()))
        self._trials.mkdir(exist_ok=True)

    def save(self, trial: Trial, outcome: MissionResult) -> None:
        """Keep the outcome of a trial; on disk when this returns."""
        _write(self._file(trial), lambda file: np.savez(file, **outcome._asdict()))

    def outcomes(self) -> dict[Trial, MissionResult]:
        """Return the outcomes of the trials whose files are there and whole."""
        outcomes = {}
        for trial in trials_of(self._scenario):
            try:
                file = self._file(trial).open('rb')
            except FileNotFoundError:
                continue
            # There is no end to what zipfile and numpy raise when a file is corrupt.
            with file, suppress(Exception):
                outcomes[trial] = self._read(file)
        return outcomes

    def _read(self, file: BinaryIO) -> MissionResult:
        """Return the outcome in a file; fails if it is corrupt or of another scenario."""
        extent = self._scenario.grid
        maps = 2, extent.width * extent.height
        rows, numbers = self._scenario.robots + 1, len(NUMBERS)
        measures = rows, len(measures_of(self._scenario))
        shapes = [measures, maps, maps, (rows, numbers, len(LEARNT)), (numbers,)]
        types = ['<f8', '<f8', '|b1', '<f8', '<f8']
        with np.load(file, allow_pickle=False) as arrays:
            outcome = MissionResult(**arrays)
        if [(array.shape, array.dtype.str) for array in outcome] != [*zip(shapes, types)]:
            raise ValueError('its arrays are of another shape')
        return outcome

    def _file(self, trial: Trial) -> Path:
        strategy = vars(trial.team).items()
        # Without these the names are those of studies that had none.
        earlier = ('agents', 'allocation', 'loss_cost')
        unnamed = (*earlier, 'last_contact', 'planner')
        team = '-'.join(
            f'{"" if name in unnamed else name}{value}'
            for name, value in strategy
            if name in earlier or value != getattr(ALONE, name)
        )
        return self._trials / f'{trial.lethality}-{trial.method}-{team}-{trial.number}.npz'


def _check_same(path: Path, kept: dict[str, object], asked: dict[str, object]) -> None:
    for key, value in kept.items():
        # Trials do not depend on how many there are.
        if key != 'trials' and value != asked[key]:
            raise ValueError(
                f'{path} holds results of another scenario, with {key} {value} '
                f'and not {asked[key]}: name another folder'
            )


def _write(path: Path, write: Callable[[BinaryIO], object]) -> None:
    part = path.with_name(f'{path.name}.part')
    with naming(part), part.open('wb') as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
