# SPDX-License-Identifier: Apache-2.0
"""
The belief message, and the rules of its estimator.

The field `joint` is the belief, bit for bit; the fields hazard, target and kappa are derived from
`joint`. The message also contains the grid, the rules, the method and the sensor model, and names
the standings whose evidence it holds, so the belief can be computed again from the deployments.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import (
    Belief,
    Beta,
    Clustering,
    DeploymentKey,
    Dynamics,
    Estimator,
    Grid,
    Ledger,
    ORDINARY,
    RobotType,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.core.field.clustering import LEARNT_COUPLING
from kbnitp_ros.core.field.sensor import OF_HAZARDS, SENSORS
from kbnitp_ros.core.field.unknowns import TARGET_VANISH
from kbnitp_ros.messages.grids import metadata_fields, read_map_metadata
from kbnitp_ros.messages.headers import (
    Fields,
    filled,
    header_fields,
    NO_MISSION,
    read_header,
    read_name,
    read_stamp,
    shown,
    stamp_fields,
)
import numpy as np

if TYPE_CHECKING:
    from kbnitp_msgs.msg import BeliefMaps


# Maximum difference of two sums of the same probabilities.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A belief message, converted to objects of `kbnitp_ros.core`."""

    # Time of the last evidence (in a prior: the start of the estimator), nanoseconds.
    stamp: int
    # Start of the mission, nanoseconds.
    mission: int
    # Full name of the estimator, its start in nanoseconds, and its number of changes of evidence.
    author: str
    epoch: int
    changes: int
    grid: Grid
    # The maximum number of steps of a path.
    max_steps: int
    # The current sensor model of robots of the common type, to plan with.
    model: SensorModel
    # Robot types that differ from the common type, by agent.
    robot_types: Mapping[str, RobotType]
    # The learnt numbers of the sensor model and of the prior.
    unknowns: Unknowns
    # The inference method.
    method: str
    # Version of the method's arithmetic.
    version: int
    # Seed of the method's random draws.
    seed: int
    dynamics: Dynamics
    target_dynamics: Dynamics
    # The clustering of hazards; None if they are independent.
    clustering: Clustering | None
    # Number of deployments assimilated.
    deployments: int
    # The deployment assimilated last; None if there is none.
    newest: DeploymentKey | None
    # The belief given these deployments.
    belief: Belief
    # In the first message, the prior set by parameters: `belief` is its mean over learnt numbers
    # and clustered hazards. In later messages, the same as `belief`.
    prior: Belief

    def agent_base(self, agent: str) -> int:
        """Return the base of an agent's robots."""
        return self.grid.at(self.robot_types.get(agent, ORDINARY).base).base

    def rules(self) -> dict[str, Any]:
        """Return the rules of an estimator by name: the fields that its beliefs share."""
        unknowns = self.unknowns.priors
        model = {each: value for each, value in asdict(self.model).items() if each not in unknowns}
        return {
            'grid': self.grid,
            'max_steps': self.max_steps,
            'method': self.method,
            'version': self.version,
            'model': model,
            'own': dict(self.robot_types),
            'unknowns': unknowns,
            'seed': self.seed,
            'dynamics': self.dynamics,
            'target_dynamics': self.target_dynamics,
            'clustering': self.clustering,
        }

    @property
    def evidence(self) -> tuple[int, int]:
        """Return the name of the evidence that this belief holds: epoch and changes."""
        return self.epoch, self.changes

    def ledger(self) -> Ledger:
        """Return an estimator's ledger with these rules before the first deployment."""
        estimator = Estimator(
            self.prior,
            self.model,
            self.method,
            self.unknowns,
            self.seed,
            dynamics=self.dynamics,
            clustering=self.clustering,
            target_dynamics=self.target_dynamics,
        )
        return Ledger(self.grid, self.max_steps, estimator, self.robot_types)


def belief_fields(
    ledger: Ledger,
    started: int,
    mission: int = NO_MISSION,
    author: str = '',
    epoch: int = 0,
    changes: int | None = None,
) -> Fields:
    """Return the message fields of a ledger's belief."""
    belief, grid = ledger.belief, ledger.grid
    newest = ledger.newest or DeploymentKey('', 0)
    stamp = ledger.newest_stamp if ledger.deployments or ledger.remarks else started
    estimator = ledger.estimator
    targets = estimator.target_dynamics
    learnt = {
        **estimator.unknowns.priors,
        **estimator.dynamics.unknown_rates,
        **targets.target_rates,
    }
    rates = {
        name: 0.0 if name in learnt else getattr(estimator.dynamics, name)
        for name in ('appear', 'vanish', 'move')
    }
    coupling = 0.0 if estimator.clustering is None else estimator.clustering.coupling
    is_other = not ledger.deployments and (learnt or coupling or len(estimator.kinds) > 1)
    given = estimator.prior.joint if is_other else np.empty(0)
    return Fields(
        header=header_fields(stamp),
        mission=stamp_fields(mission),
        info=metadata_fields(grid),
        base=grid.base,
        blocked=sorted(grid.blocked),
        connectivity=grid.connectivity,
        through_corners=grid.through_corners,
        max_steps=ledger.max_steps,
        method=estimator.method,
        method_version=estimator.version,
        **{name: getattr(estimator.model, name) for name in (*SENSORS, *OF_HAZARDS)},
        unknowns=[Fields(name=name, **asdict(prior)) for name, prior in learnt.items()],
        seed=estimator.seed,
        own=[
            Fields(agent=agent, name=name, value=float(value))
            for agent, robot_type in sorted(ledger.robot_types.items())
            for name, value in robot_type.own.items()
        ],
        dynamics=estimator.dynamics.kind,
        **rates,
        target_dynamics=targets.kind,
        target_appear=targets.appear,
        target_vanish=0.0 if targets.target_rates else targets.vanish,
        clustering=np.nan if coupling == LEARNT_COUPLING else float(coupling),
        author=author,
        epoch=stamp_fields(epoch),
        changes=ledger.changes if changes is None else changes,
        deployments=len(ledger.deployments),
        agent=newest.agent,
        deployment=stamp_fields(newest.stamp),
        hazard=belief.hazard,
        target=belief.target,
        kappa=belief.kappa,
        joint=belief.joint.ravel(),
        dud_joint=np.empty(0) if belief.duds is None else belief.duds.ravel(),
        prior=given.ravel(),
    )


@cache
def belief_field_names() -> set[str]:
    """Return the names of all fields of a kbnitp_msgs/BeliefMaps."""
    grid = Grid(1, 1)
    prior = Estimator(Belief.prior(grid, 0.0, 0.0, 0.0), SensorModel(0.0))
    return set(vars(belief_fields(Ledger(grid, 1, prior), 0)))


def belief_maps(
    ledger: Ledger,
    started: int,
    mission: int = NO_MISSION,
    author: str = '',
    epoch: int = 0,
) -> BeliefMaps:
    """Return the belief message with the fields of `belief_fields`."""
    from kbnitp_msgs.msg import BeliefMaps, OwnNumber, UnknownNumber

    content = belief_fields(ledger, started, mission, author, epoch)
    message = filled(BeliefMaps(), content)
    message.unknowns = [filled(UnknownNumber(), each) for each in content.unknowns]
    message.own = [filled(OwnNumber(), each) for each in content.own]
    return message


def read_belief_maps(message: Any) -> Snapshot:
    """Convert a kbnitp_msgs/BeliefMaps."""
    stamp = read_header(message)
    if message.deployments and not message.agent:
        raise ValueError(
            f"agent is '' with {message.deployments} deployments: it must name the agent of the "
            'newest deployment'
        )
    robot_types = read_robot_types(message.own)
    grid = read_map_metadata(
        message.info,
        base=message.base,
        other_bases=tuple(each.base for each in robot_types.values() if each.base is not None),
        blocked=tuple(message.blocked),
        connectivity=message.connectivity,
        through_corners=message.through_corners,
    )
    belief = read_joint('joint', message.joint, grid)
    if len(duds := getattr(message, 'dud_joint', ())):
        belief = with_dud_joint(belief, duds)
    priors = read_unknowns(message.unknowns)
    rates = {'vanish': message.vanish, 'move': message.move}
    rates.update({name: priors.pop(name) for name in rates if name in priors})
    targets = read_target_dynamics(message, priors.pop(TARGET_VANISH, None))
    newest = read_name('deployment', message.deployment)
    return Snapshot(
        stamp=stamp,
        mission=read_stamp('mission', message.mission),
        author=message.author,
        epoch=read_name('epoch', message.epoch),
        changes=message.changes,
        grid=grid,
        max_steps=message.max_steps,
        model=SensorModel(
            # Earlier logs have neither reach nor duds.
            **{name: getattr(message, name, 0.0) for name in (*SENSORS, *OF_HAZARDS)}
        ),
        robot_types=robot_types,
        unknowns=Unknowns(**priors),
        method=message.method,
        version=message.method_version,
        seed=message.seed,
        dynamics=Dynamics(message.dynamics, message.appear, **rates),
        target_dynamics=targets,
        clustering=read_clustering(message.clustering, grid),
        deployments=message.deployments,
        newest=DeploymentKey(message.agent, newest) if message.deployments else None,
        belief=belief,
        prior=read_joint('prior', message.prior, grid) if len(message.prior) else belief,
    )


def read_target_dynamics(message: Any, unknown: Beta | None) -> Dynamics:
    """Return the dynamics of targets, with the prior of an unknown rate."""
    # Logs of 1.x have still targets.
    kind = getattr(message, 'target_dynamics', 'static')
    if unknown is not None:
        # Learnt kinds set the probability of 0 themselves.
        zero = 0.0 if kind == 'learn' else unknown.zero
        return Dynamics(kind, message.target_appear, replace(unknown, zero=zero))
    rates = (getattr(message, f'target_{name}', 0.0) for name in ('appear', 'vanish'))
    return Dynamics(kind, *rates)


def read_joint(name: str, values: Any, grid: Grid) -> Belief:
    """Return the belief in an array field of a message."""
    joint = np.asarray(values, dtype=np.float64)
    if joint.size != 4 * grid.cells:
        raise ValueError(
            f'{name} has {joint.size} values: it must have 4 * width * height = {4 * grid.cells}'
        )
    try:
        return Belief(joint.reshape(-1, 2, 2), grid)
    except ValueError as error:
        raise ValueError(str(error).replace('joint', name, 1)) from error


def with_dud_joint(belief: Belief, values: Any) -> Belief:
    """Return the belief with the part of the joint that belongs to duds."""
    duds = np.asarray(values, dtype=np.float64)
    if duds.size != 2 * belief.cells:
        raise ValueError(
            f'dud_joint has {duds.size} values: it must have none, or 2 * width * height = '
            f'{2 * belief.cells}'
        )
    duds = duds.reshape(-1, 2)
    # The two are rounded apart.
    if not ((duds >= 0.0) & (duds <= belief.joint[:, 1] + ROUNDING)).all():
        raise ValueError('dud_joint has a value that is not within joint of a hazard')
    return Belief.computed(belief.joint, belief.grid, duds)


def read_clustering(coupling: float, grid: Grid) -> Clustering | None:
    """Return the clustering; the coupling is 0 without clustering, and NaN if it is learnt."""
    if coupling == 0.0:
        return None
    try:
        return Clustering(grid, LEARNT_COUPLING if np.isnan(coupling) else coupling)
    except ValueError as error:
        raise ValueError(f'clustering: {error}') from error


def read_unknowns(numbers: Iterable[Any]) -> dict[str, Beta]:
    """Return the priors of the learnt numbers and rates, by name."""
    priors: dict[str, Beta] = {}
    known = [*(field.name for field in fields(Unknowns)), 'vanish', 'move', TARGET_VANISH]
    for number in numbers:
        if number.name not in known or number.name in priors:
            raise ValueError(
                f'unknowns has {shown(number.name)}: it must name numbers of {", ".join(known)}, '
                'each once'
            )
        # Logs of 1.x have no zero.
        own = number.a, number.b, number.low, number.high, getattr(number, 'zero', 0.0)
        priors[number.name] = Beta(*own)
    return priors


def read_robot_types(numbers: Iterable[Any]) -> dict[str, RobotType]:
    """Return the robot types in a list of kbnitp_msgs/OwnNumber, by agent."""
    own: dict[str, dict[str, Any]] = {}
    known = [field.name for field in fields(RobotType)]
    for number in numbers:
        of_agent = own.setdefault(number.agent, {})
        if not number.agent or number.name not in known or number.name in of_agent:
            raise ValueError(
                f'own has {shown(number.name)} of agent {shown(number.agent)}: it must name an '
                f'agent, and numbers of {", ".join(known)}, each once'
            )
        of_agent[number.name] = number.value
    try:
        return {agent: RobotType(**numbers) for agent, numbers in own.items()}
    except ValueError as error:
        raise ValueError(f'own: {error}') from error
