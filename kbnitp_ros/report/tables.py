# SPDX-License-Identifier: Apache-2.0
"""A mission as tables and arrays for other programs."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Any

from kbnitp_ros.core import Observation
from kbnitp_ros.maps import levels_of, write_probabilities
from kbnitp_ros.report.curves import Curves
from kbnitp_ros.report.mission import Mission
import numpy as np
from numpy.typing import NDArray
import pyarrow
from pyarrow import csv, parquet

# One row a deployment. Cells and readings are texts of numbers between blanks, so that both files
# hold the same.
COLUMNS = pyarrow.schema(
    [
        ('deployment', pyarrow.int64()),
        ('agent', pyarrow.string()),
        ('stamp', pyarrow.int64()),
        ('sent', pyarrow.int64()),
        ('told', pyarrow.int64()),
        ('outcome', pyarrow.string()),
        ('steps', pyarrow.int64()),
        ('steps_survived', pyarrow.int64()),
        ('detected', pyarrow.int64()),
        ('looked', pyarrow.int64()),
        ('information_expected', pyarrow.float64()),
        ('information_gained', pyarrow.float64()),
        ('gap', pyarrow.float64()),
        ('moment', pyarrow.int64()),
        ('held', pyarrow.int64()),
        ('entropy', pyarrow.float64()),
        ('log_loss', pyarrow.float64()),
        ('path', pyarrow.string()),
        ('walk', pyarrow.string()),
        ('readings', pyarrow.string()),
    ]
)


def rows(mission: Mission, curves: Curves) -> list[dict[str, Any]]:
    """Return one row a deployment, by the names of `COLUMNS`; None where nothing is known."""
    entropy = curves.entropy
    loss = curves.log_loss
    first = {each.deployment: place for place, each in reversed([*enumerate(mission.moments)])}
    table = []
    for number, deployment in enumerate(mission.deployments):
        seen = deployment.outcome
        at, began = deployment.moment, first.get(number)
        table.append(
            {
                'deployment': number + 1,
                'agent': deployment.key.agent,
                'stamp': deployment.key.stamp,
                'sent': deployment.sent,
                'told': deployment.reported,
                'outcome': outcome_word(seen),
                'steps': deployment.path.size - 1 if seen is None else seen.steps,
                'steps_survived': steps_survived(seen),
                'detected': None if not (seen and seen.survived) else readings(seen).count(1),
                'looked': None if not (seen and seen.survived) else looked(seen),
                'information_expected': known(curves.expected, began),
                'information_gained': known(curves.gained, began),
                'gap': known(curves.gap, began),
                'moment': at,
                'held': None if at is None else mission.moments[at].held,
                'entropy': known(entropy, at),
                'log_loss': known(loss, at),
                'path': text(deployment.path.tolist()),
                'walk': text(seen.path.tolist()) if seen and seen.survived else None,
                'readings': text(readings(seen)) if seen and seen.survived else None,
            }
        )
    return table


def outcome_word(seen: Observation | None) -> str:
    """Return how a deployment ended, in a word."""
    if seen is None:
        return 'out'
    return 'returned' if seen.survived else 'lost'


def steps_survived(seen: Observation | None) -> int | None:
    """Return how many steps a robot is known to have survived; None if nothing is known."""
    if seen is None:
        return None
    return seen.steps if seen.survived else seen.steps_survived or None


def readings(seen: Observation) -> list[int]:
    """Return what a robot that returned read in each step: 1, 0, or -1 where it did not look."""
    assert seen.readings is not None
    return [int(each) for each in seen.readings]


def looked(seen: Observation) -> int:
    """Return in how many steps it looked."""
    return sum(each >= 0 for each in readings(seen))


def known(values: NDArray[np.float64], place: int | None) -> float | None:
    """Return a value; None where it is not known."""
    return None if place is None or isnan(values[place]) else float(values[place])


def text(numbers: list[int]) -> str:
    """Return numbers between blanks."""
    return ' '.join(map(str, numbers))


def write_tables(folder: Path, mission: Mission, curves: Curves) -> None:
    """Write deployments.parquet and deployments.csv; raises OSError if that is not possible."""
    table = pyarrow.Table.from_pylist(rows(mission, curves), schema=COLUMNS)
    parquet.write_table(table, folder / 'deployments.parquet')
    csv.write_csv(table, folder / 'deployments.csv')


def write_beliefs(folder: Path, mission: Mission, curves: Curves) -> None:
    """Write belief.npz and the last belief as maps of map_server; raises OSError if impossible."""
    moments = mission.moments
    arrays: dict[str, Any] = {
        name: np.stack([getattr(each.belief, name) for each in moments])
        for name in ('joint', 'hazard', 'target', 'kappa')
    }
    arrays['held'] = np.array([each.held for each in moments])
    arrays['shape'] = np.array([mission.grid.height, mission.grid.width])
    if mission.world:
        arrays |= {f'true_{name}': values for name, values in vars(mission.world).items()}
    np.savez_compressed(folder / 'belief.npz', **arrays, **vars(curves))
    for name, levels in levels_of(moments[-1].belief).items():
        write_probabilities(folder / f'{name}.yaml', mission.grid, levels)
