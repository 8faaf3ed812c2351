# SPDX-License-Identifier: Apache-2.0
"""A recorded mission in the terms of the core."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kbnitp_ros.core import Belief, deployment_order, Grid, Observation, World
from kbnitp_ros.log.bag import LogError, read_log, same_types
from kbnitp_ros.log.evidence import BELIEF, Evidence, first_belief, GRID, MODEL, PATH, REPORT
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.grids import read_occupancy_grid
from kbnitp_ros.messages.models import Known, read_model_belief


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
    learnt : list of dict of str to Known
        What was known of the numbers that were learnt, by their names; in the order on
        record, empty if none were.
    world : World or None
        The hidden truth, if the agent published it.

    """

    grid: Grid
    beliefs: list[Belief]
    observations: list[Observation]
    learnt: list[dict[str, Known]]
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
        If a belief on record is none, or what was learnt.

    """
    first = first_belief(path)
    if first is None:
        raise LogError(f'{path} has no beliefs on record: it must have messages of type {BELIEF}')
    evidence = Evidence(first.grid, first.max_steps)
    snapshots = []
    learnt = []
    truth = {}
    with same_types(path):
        for logged in read_log(path, (BELIEF, GRID, MODEL, PATH, REPORT)):
            if logged.type_name == BELIEF:
                snapshots.append(read_belief_maps(logged.message))
                evidence.max_steps = max(evidence.max_steps, snapshots[-1].max_steps)
            elif logged.type_name in (PATH, REPORT):
                evidence.take(logged)
            elif logged.type_name == MODEL:
                learnt.append(read_model_belief(logged.message))
            elif logged.topic.endswith(('/truth/hazard', '/truth/target')):
                truth[logged.topic.rpartition('/')[2]] = read_occupancy_grid(logged.message) > 0.0
    return History(
        grid=first.grid,
        beliefs=[snapshot.belief for snapshot in snapshots],
        observations=[
            evidence.observation(key) for key in sorted(evidence.reports, key=deployment_order)
        ],
        learnt=learnt,
        world=World(truth['hazard'], truth['target']) if len(truth) == 2 else None,
    )
