# SPDX-License-Identifier: Apache-2.0
"""
What the belief message means.

Its joint is the belief, bit for bit; the hazard, target and kappa maps are views for those who do
not want to derive them. With the grid, the rules, the method and the sensor model in it, every
message says how it can be computed again from the deployments.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from kbnitp_msgs.msg import BeliefMaps, OwnNumber, UnknownNumber
from kbnitp_ros.core import (
    Belief,
    Beta,
    DeploymentKey,
    Grid,
    Kind,
    Ledger,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.messages.grids import map_metadata, read_map_metadata
from kbnitp_ros.messages.headers import (
    check_frame,
    from_stamp,
    header,
    read_name,
    read_stamp,
    shown,
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
        What the estimator believes by then of robots like all others: what to plan with.
    kinds : mapping of str to Kind
        Of the robots of agents that have something of their own.
    unknowns : Unknowns
        Which numbers of that, and of the prior, it learns.
    method : str
        How it takes deployments in.
    seed : int
        Of what the method draws at random.
    deployments : int
        How many it has taken in.
    newest : DeploymentKey or None
        Whose evidence it took in last; None when there is none.
    belief : Belief
        Given those.
    prior : Belief
        As it was given, of the first belief: that is averaged over what is learnt of the prior.

    """

    stamp: int
    mission: int
    grid: Grid
    max_steps: int
    model: SensorModel
    kinds: Mapping[str, Kind]
    unknowns: Unknowns
    method: str
    seed: int
    deployments: int
    newest: DeploymentKey | None
    belief: Belief
    prior: Belief

    def rules(self) -> dict[str, Any]:
        """Return what an estimator was started with, by name: the same in all its beliefs."""
        unknowns = self.unknowns.priors
        model = {each: value for each, value in asdict(self.model).items() if each not in unknowns}
        return {
            'grid': self.grid,
            'max_steps': self.max_steps,
            'method': self.method,
            'model': model,
            'own': dict(self.kinds),
            'unknowns': unknowns,
            'seed': self.seed,
        }


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
    estimator = ledger.estimator
    unknowns = estimator.unknowns.priors
    given = estimator.prior.joint if unknowns and not ledger.deployments else np.empty(0)
    return BeliefMaps(
        header=header(ledger.newest_stamp if ledger.newest else started),
        info=info,
        base=grid.base,
        blocked=sorted(grid.blocked),
        connectivity=grid.connectivity,
        through_corners=grid.through_corners,
        max_steps=ledger.max_steps,
        method=estimator.method,
        **asdict(estimator.model),
        unknowns=[UnknownNumber(name=name, **asdict(prior)) for name, prior in unknowns.items()],
        seed=estimator.seed,
        own=[
            OwnNumber(agent=agent, name=name, value=float(value))
            for agent, kind in sorted(ledger.kinds.items())
            for name, value in kind.own.items()
        ],
        deployments=len(ledger.deployments),
        agent=newest.agent,
        deployment=to_stamp(newest.stamp),
        hazard=float64s(belief.hazard),
        target=float64s(belief.target),
        kappa=float64s(belief.kappa),
        joint=float64s(belief.joint),
        prior=float64s(given),
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
    grid = read_map_metadata(
        message.info,
        base=message.base,
        blocked=message.blocked,
        # Beliefs of earlier versions are of fields where robots may step past corners.
        connectivity=getattr(message, 'connectivity', 8),
        through_corners=getattr(message, 'through_corners', True),
    )
    belief = read_joint('joint', message.joint, grid)
    # Those of earlier versions had no numbers to learn.
    given = getattr(message, 'prior', ())
    read_name('deployment', message.deployment)
    return Snapshot(
        stamp=read_stamp('header.stamp', message.header.stamp),
        mission=mission_of_belief(message),
        grid=grid,
        max_steps=message.max_steps,
        model=SensorModel(
            **{field.name: getattr(message, field.name) for field in fields(SensorModel)}
        ),
        kinds=read_kinds(getattr(message, 'own', ())),
        unknowns=read_unknowns(getattr(message, 'unknowns', ())),
        method=message.method,
        seed=getattr(message, 'seed', 0),
        deployments=message.deployments,
        newest=newest_deployment(message),
        belief=belief,
        prior=read_joint('prior', given, grid) if len(given) else belief,
    )


def read_joint(name: str, values: Any, grid: Grid) -> Belief:
    """
    Return the belief that a field holds.

    Raises
    ------
    ValueError
        If it has not four values a cell, or they are no distribution.

    """
    joint = np.asarray(values, dtype=np.float64)
    if joint.size != 4 * grid.cells:
        raise ValueError(
            f'{name} has {joint.size} values: it must have 4 * width * height = {4 * grid.cells}'
        )
    try:
        return Belief(joint.reshape(-1, 2, 2))
    except ValueError as error:
        raise ValueError(str(error).replace('joint', name, 1)) from error


def read_unknowns(numbers: Iterable[Any]) -> Unknowns:
    """
    Return what kbnitp_msgs/UnknownNumbers say is learnt.

    Raises
    ------
    ValueError
        If there is no such number, one stands twice, or its distribution is none.

    """
    priors: dict[str, Beta] = {}
    known = [field.name for field in fields(Unknowns)]
    for number in numbers:
        if number.name not in known or number.name in priors:
            raise ValueError(
                f'unknowns has {shown(number.name)}: it must name each once, of {", ".join(known)}'
            )
        priors[number.name] = Beta(number.a, number.b, number.low, number.high)
    return Unknowns(**priors)


def read_kinds(numbers: Iterable[Any]) -> dict[str, Kind]:
    """
    Return what kbnitp_msgs/OwnNumbers say of the robots of agents, by the agents' names.

    Raises
    ------
    ValueError
        If an agent has no name, there is no such number, one stands twice, or is out of range.

    """
    own: dict[str, dict[str, Any]] = {}
    known = [field.name for field in fields(Kind)]
    for number in numbers:
        of_agent = own.setdefault(number.agent, {})
        if not number.agent or number.name not in known or number.name in of_agent:
            raise ValueError(
                f'own has {shown(number.name)} of agent {shown(number.agent)}: it must name each '
                f'once, with its agent, of {", ".join(known)}'
            )
        of_agent[number.name] = number.value
    try:
        return {agent: Kind(**numbers) for agent, numbers in own.items()}
    except ValueError as error:
        raise ValueError(f'own: {error}') from error


def newest_deployment(message: Any) -> DeploymentKey | None:
    """Return whose evidence a belief took in last; None if it is a prior."""
    if not message.deployments:
        return None
    return DeploymentKey(message.agent, from_stamp(message.deployment))


def float64s(values: NDArray[np.float64]) -> array[float]:
    """Return a float64[] field: of all that can be assigned, what is not checked one by one."""
    return array('d', values.tobytes())
