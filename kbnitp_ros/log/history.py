# SPDX-License-Identifier: Apache-2.0
"""A recorded mission in the terms of the core."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kbnitp_ros.core import Belief, deployment_order, Grid, Observation, World
from kbnitp_ros.log.bag import LogError, read_log, same_types
from kbnitp_ros.log.evidence import Evidence
from kbnitp_ros.log.replay import BELIEF, GRID, PATH, REPORT
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.grids import read_occupancy_grid
import numpy as np


@dataclass(frozen=True, eq=False)
class History:
    """
    What a log tells of its mission.

    Attributes
    ----------
    grid : Grid
        The field.
    beliefs : list of Belief
        Those on record, the prior first.
    observations : list of Observation
        The deployments on record in their order, each once: the return if a loss was reported too.
    world : World or None
        The hidden truth, if the agent published it.

    """

    grid: Grid
    beliefs: list[Belief]
    observations: list[Observation]
    world: World | None


def read_history(path: str | Path) -> History:
    """
    Read what happened in a mission.

    Parameters
    ----------
    path : str or Path
        Its log.

    Raises
    ------
    LogError
        If the file cannot be read or has no belief on record.
    ValueError
        If what is on record is no mission: a path or report that does not fit the grid.

    """
    snapshots = []
    evidence = Evidence()
    truth = {}
    with same_types(path):
        for logged in read_log(path, (BELIEF, GRID, PATH, REPORT)):
            if logged.type_name == BELIEF:
                snapshots.append(read_belief_maps(logged.message))
            elif logged.type_name == PATH:
                evidence.take_path(logged.topic, logged.message)
            elif logged.type_name == REPORT:
                evidence.take_report(logged.topic, logged.message)
            elif logged.topic.endswith(('/truth/hazard', '/truth/target')):
                truth[logged.topic.rpartition('/')[2]] = read_occupancy_grid(logged.message) > 0.0
        if not snapshots:
            raise LogError(
                f'{path} has no beliefs on record: it must have messages of type {BELIEF}'
            )
        grid = snapshots[0].grid
        observations = []
        for key in sorted(evidence.complete, key=deployment_order):
            report = evidence.report(key)
            cells = evidence.path(key, grid)
            readings = np.array([detected for _, detected in report.readings], dtype=bool)
            observations.append(
                Observation(cells, report.survived, readings if report.survived else None)
            )
    return History(
        grid=grid,
        beliefs=[snapshot.belief for snapshot in snapshots],
        observations=observations,
        world=World(truth['hazard'], truth['target']) if len(truth) == 2 else None,
    )
