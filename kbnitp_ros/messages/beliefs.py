# SPDX-License-Identifier: Apache-2.0
"""
What the belief message means.

Its joint is the belief, bit for bit; the hazard, target and kappa maps are views for those who do
not want to derive them. With the grid, the rules, the method and the sensor model in it, every
message says how it can be computed again from the deployments.
"""

from __future__ import annotations

from array import array
from dataclasses import asdict, dataclass, fields
from typing import Any

from kbnitp_msgs.msg import BeliefMaps
from kbnitp_ros.core import Belief, DeploymentKey, Grid, Ledger, SensorModel
from kbnitp_ros.messages.grids import map_metadata, read_map_metadata
from kbnitp_ros.messages.headers import (
    check_frame,
    from_stamp,
    header,
    read_name,
    read_stamp,
    to_stamp,
)
from kbnitp_ros.messages.missions import mission_of_belief, NOT_TOLD
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Snapshot:
    """
    A belief message in the terms of the core.

    Attributes
    ----------
    stamp : int
        When the base learnt what it took in last, in nanoseconds; of a prior, when the estimator
        started.
    mission : int
        When the mission began, in nanoseconds.
    grid : Grid
        The field.
    max_steps : int
        The most steps of a path.
    model : SensorModel
        What the estimator believes of robots and sensors.
    method : str
        How it takes deployments in.
    deployments : int
        How many it has taken in.
    newest : DeploymentKey or None
        Whose evidence it took in last; None when there is none.
    belief : Belief
        Given those.

    """

    stamp: int
    mission: int
    grid: Grid
    max_steps: int
    model: SensorModel
    method: str
    deployments: int
    newest: DeploymentKey | None
    belief: Belief


def belief_maps(ledger: Ledger, started: int, mission: int = NOT_TOLD) -> BeliefMaps:
    """
    Return the message of what is believed now.

    Nothing in it depends on when it is made: the same evidence gives the same message.

    Parameters
    ----------
    ledger : Ledger
        The deployments so far.
    started : int
        The stamp of a prior: when the estimator started, in nanoseconds.
    mission : int
        When the mission began, in nanoseconds.

    """
    belief, grid = ledger.belief, ledger.grid
    info = map_metadata(grid)
    info.map_load_time = to_stamp(mission)
    newest = ledger.newest or DeploymentKey('', 0)
    return BeliefMaps(
        header=header(ledger.newest_stamp if ledger.newest else started),
        info=info,
        base=grid.base,
        blocked=sorted(grid.blocked),
        max_steps=ledger.max_steps,
        method=ledger.estimator.method,
        **asdict(ledger.estimator.model),
        deployments=len(ledger.deployments),
        agent=newest.agent,
        deployment=to_stamp(newest.stamp),
        hazard=float64s(belief.hazard),
        target=float64s(belief.target),
        kappa=float64s(belief.kappa),
        joint=float64s(belief.joint),
    )


def read_belief_maps(message: Any) -> Snapshot:
    """
    Return what a kbnitp_msgs/BeliefMaps says.

    Raises
    ------
    ValueError
        If it is in another frame, its geometry or sensor model is out of range, its joint is of
        another size or no distribution, or it holds deployments and names none.

    """
    check_frame('header.frame_id', message.header.frame_id)
    if message.deployments and not message.agent:
        raise ValueError(
            f"agent is '' with {message.deployments} deployments: it must name the newest one's"
        )
    grid = read_map_metadata(message.info, message.base, message.blocked)
    joint = np.asarray(message.joint, dtype=np.float64)
    if joint.size != 4 * grid.cells:
        raise ValueError(
            f'joint has {joint.size} values: it must have 4 * width * height = {4 * grid.cells}'
        )
    read_name('deployment', message.deployment)
    return Snapshot(
        stamp=read_stamp('header.stamp', message.header.stamp),
        mission=mission_of_belief(message),
        grid=grid,
        max_steps=message.max_steps,
        model=SensorModel(
            **{field.name: getattr(message, field.name) for field in fields(SensorModel)}
        ),
        method=message.method,
        deployments=message.deployments,
        newest=newest_deployment(message),
        belief=Belief(joint.reshape(-1, 2, 2)),
    )


def newest_deployment(message: Any) -> DeploymentKey | None:
    """Return whose evidence a belief took in last; None if it is a prior."""
    if not message.deployments:
        return None
    return DeploymentKey(message.agent, from_stamp(message.deployment))


def float64s(values: NDArray[np.float64]) -> array[float]:
    """Return a float64[] field: of all that can be assigned, what is not checked one by one."""
    return array('d', values.tobytes())
