# SPDX-License-Identifier: Apache-2.0
"""All that a study measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from itertools import product
from typing import Any, TYPE_CHECKING

from kbnitp_ros.study.scenario import ALONE, LEARNING, Scenario, Strategy
from kbnitp_ros.study.trial import measures_of, MissionResult, Trial, trials_of
import numpy as np
from numpy.typing import NDArray
import pyarrow as pa

if TYPE_CHECKING:
    from pandas import DataFrame

# Sums of measures by their names, shape (trials, robots + 1); `team` is that of the missions.
Series = Callable[..., NDArray[np.float64]]

# The most bytes that a mission may take, of which each worker has one, and the results of all.
MOST_OF_A_MISSION = 1 << 30
MOST_OF_ALL = 1 << 32


def check_memory(scenario: Scenario) -> None:
    """Check that a study can have the memory that it takes."""
    number = 8
    cells, deployments = scenario.field().cells, scenario.robots + 1
    missions = len(scenario.lethalities) * len(scenario.contenders) * scenario.trials
    # The beliefs of a mission; of each the last maps, the truth and the measures, in two tables.
    mission = 4 * number * cells * deployments
    outcome = 2 * (number + 1) * cells + len(measures_of(scenario)) * number * deployments
    for what, bytes_taken, most in (
        ('a mission', mission, MOST_OF_A_MISSION),
        (f'{missions} missions', 2 * missions * outcome, MOST_OF_ALL),
    ):
        if bytes_taken > most:
            raise ValueError(
                f'{what} of {scenario.robots} robots on {cells} cells takes about '
                f'{bytes_taken / 1e9:.1f} GB, and {most / 1e9:.1f} GB are allowed: lower '
                'grid.width, grid.height, robots or trials'
            )


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """The outcomes of all trials of a scenario, in any order."""

    scenario: Scenario
    outcomes: Mapping[Trial, MissionResult]

    def __repr__(self) -> str:
        methods = ', '.join(self.scenario.methods)
        return (
            f'Results({len(self.outcomes)} missions of {self.scenario.robots} robots: {methods})'
        )

    def table(self) -> pa.Table:
        """Return one row for every deployment of every trial."""
        trials = trials_of(self.scenario)
        rows = self.scenario.robots + 1
        measures = np.concatenate([self.outcomes[trial].measures for trial in trials])
        columns = {
            'trial': np.repeat([trial.number for trial in trials], rows),
            'method': np.repeat([trial.method for trial in trials], rows),
            'lethality': np.repeat([trial.lethality for trial in trials], rows),
            'deployment': np.tile(np.arange(rows), len(trials)),
            **{
                field.name: np.repeat([getattr(trial.team, field.name) for trial in trials], rows)
                for field in fields(Strategy)
            },
            **dict(zip(measures_of(self.scenario), measures.T)),
        }
        columns['lethality'] = pa.array(columns['lethality'].tolist(), pa.float64())
        columns['robots_lost'] = columns['robots_lost'].astype(np.int64)
        return pa.table(columns)

    def to_dataframe(self) -> DataFrame:
        """Return `table` as a table of pandas."""
        return self.table().to_pandas()

    def series(
        self, lethality: float | None, method: str, *measures: str, team: Strategy = ALONE
    ) -> NDArray[np.float64]:
        """Return the sum of some measures, shape (trials, robots + 1)."""
        places = [measures_of(self.scenario).index(measure) for measure in measures]
        outcomes = self._of(lethality, method, team)
        return np.stack([outcome.measures[:, places].sum(axis=1) for outcome in outcomes])

    def missions(
        self, teams: Sequence[Strategy] | None = None
    ) -> Iterator[tuple[dict[str, Any], Strategy, Series]]:
        """Yield lethality and method, the team, and the series of missions, in their order."""
        scenario = self.scenario
        for lethality, method, team in product(
            scenario.lethalities, scenario.methods, scenario.teams if teams is None else teams
        ):
            series = partial(self.series, lethality, method, team=team)
            yield {'lethality': lethality, 'method': method}, team, series

    def final_maps(
        self, lethality: float | None, method: str, team: Strategy = ALONE
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the last hazard and target maps and the truth, each shape (trials, 2, cells)."""
        outcomes = self._of(lethality, method, team)
        believed = np.stack([outcome.believed for outcome in outcomes])
        return believed, np.stack([outcome.truth for outcome in outcomes])

    def learnt(
        self, lethality: float | None, team: Strategy = ALONE
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what the method that learns knew of the numbers, and what they are."""
        outcomes = self._of(lethality, LEARNING, team)
        known = np.stack([outcome.learnt for outcome in outcomes])
        return known, np.stack([outcome.numbers for outcome in outcomes])

    def _of(self, lethality: float | None, method: str, team: Strategy) -> list[MissionResult]:
        numbers = range(self.scenario.trials)
        return [self.outcomes[Trial(lethality, method, number, team)] for number in numbers]
