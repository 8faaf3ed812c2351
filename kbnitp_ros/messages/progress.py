# SPDX-License-Identifier: Apache-2.0
"""Messages about a running mission: progress, model and decision."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from math import nan
from typing import Any, NamedTuple, TYPE_CHECKING

from kbnitp_ros.core import (
    Decision,
    DeploymentKey,
    Estimator,
    Grid,
    HazardDraws,
    Ledger,
    log_loss,
    path_information,
    World,
)
from kbnitp_ros.core.decision.decision import Trusted
from kbnitp_ros.core.field.belief import binary_entropy
from kbnitp_ros.core.field.compiled import interpreted
from kbnitp_ros.core.inference.model_check import ModelCheck
from kbnitp_ros.messages.deployments import path_fields
from kbnitp_ros.messages.headers import (
    check_frame,
    Fields,
    filled,
    from_stamp,
    header,
    header_fields,
    read_choice,
    read_header,
    stamp_fields,
)
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from kbnitp_msgs import msg
    from kbnitp_msgs.msg import Decision as DecisionMessage
    from kbnitp_msgs.msg import ModelBelief


class MissionState(IntEnum):
    """The state of a mission, as in kbnitp_msgs/Progress."""

    UNKNOWN = 0
    RUNNING = 1
    PAUSED = 2
    DONE = 3
    ENDED = 4


class Obstacle(IntEnum):
    """A condition that blocks the next deployment, as in kbnitp_msgs/MissionStatus."""

    NONE = 0
    ACTION_UNRECORDED = 1
    UNFOLLOWED = 2
    NO_BELIEF = 3
    UNREPORTED = 4
    UNJUDGED = 5
    BELIEF_BEHIND = 6
    ALL_DEPLOYED = 7
    DECIDING = 8
    OVER = 9
    NO_SUBSCRIBER = 10
    ALL_LEFT = 11
    PAUSED = 12
    NO_FREE_AGENT = 13
    SEARCHING = 14
    WORTHLESS = 15
    UNAPPROVED = 16
    GOAL_LOST = 17

    @property
    def is_end(self) -> bool:
        """Return whether the condition ends the mission."""
        return self in (Obstacle.ALL_DEPLOYED, Obstacle.OVER)


class Helper(IntEnum):
    """The part that can end a condition, as in kbnitp_msgs/MissionStatus."""

    NOBODY = 0
    OPERATOR = 1
    ROBOT = 2
    ESTIMATOR = 3
    RECORDER = 4


class Need(IntEnum):
    """A condition that keeps one robot at its base, as in kbnitp_msgs/MissionStatus."""

    BATTERY = 1
    READY = 2
    SEPARATION = 3


@dataclass(frozen=True)
class MissionStatus:
    """How a mission stands, as its planner says."""

    # Time of the message, nanoseconds.
    stamp: int = 0
    # Full name of the planner.
    author: str = ''
    state: MissionState = MissionState.UNKNOWN
    # What keeps the next robot from leaving, and who can end that.
    obstacle: Obstacle = Obstacle.NONE
    ends_by: Helper = Helper.NOBODY
    # Whether departures are held.
    hold: bool = False
    # Numbers of robots that were sent, that have left and are not reported, and that count as
    # lost; and of deployments that the operator has to decide on.
    ordered: int = 0
    out: int = 0
    lost: int = 0
    held: int = 0
    # Probability of the goal at which the mission ends as successful; 0 for never.
    confidence: float = 0.0
    # Agents whose robots are kept at their base, and why.
    waiting: Mapping[str, Need] = field(default_factory=dict)
    # Cells that no robot is sent into.
    no_go: tuple[int, ...] = ()
    # The obstacle in words; empty if it needs none.
    reason: str = ''


NOT_KNOWN = MissionStatus()


def mission_status_message(status: MissionStatus) -> msg.MissionStatus:
    """Return the message of the status of a mission."""
    from kbnitp_msgs import msg

    return msg.MissionStatus(
        header=header(status.stamp),
        author=status.author,
        state=status.state,
        obstacle=status.obstacle,
        ends_by=status.ends_by,
        hold=status.hold,
        ordered=status.ordered,
        out=status.out,
        lost=status.lost,
        held=status.held,
        confidence=status.confidence,
        waiting=[*status.waiting],
        waits_for=[*status.waiting.values()],
        no_go=[*status.no_go],
        reason=status.reason,
    )


def read_mission_status(message: Any) -> MissionStatus:
    """Convert a kbnitp_msgs/MissionStatus."""
    stamp = read_header(message)
    if not message.author:
        raise ValueError("author is '': it must name the planner")
    state = read_choice('state', message.state, MissionState)
    if state is MissionState.UNKNOWN:
        raise ValueError('state is 0: it must say how the mission stands')
    if not 0 <= message.confidence < 1:
        raise ValueError(f'confidence is {message.confidence}: it must be from 0 to below 1')
    if len(message.waits_for) != len(message.waiting):
        raise ValueError(
            f'waits_for has {len(message.waits_for)} values: it must have one for each of the '
            f'{len(message.waiting)} agents in waiting'
        )
    return MissionStatus(
        stamp=stamp,
        author=message.author,
        state=state,
        obstacle=read_choice('obstacle', message.obstacle, Obstacle),
        ends_by=read_choice('ends_by', message.ends_by, Helper),
        hold=message.hold,
        ordered=message.ordered,
        out=message.out,
        lost=message.lost,
        held=message.held,
        confidence=message.confidence,
        waiting={
            agent: read_choice('waits_for', each, Need)
            for agent, each in zip(message.waiting, message.waits_for)
        },
        no_go=tuple(map(int, message.no_go)),
        reason=message.reason,
    )


# Steps of a path from which on an estimator loads numba: half a second and 135 MB. Without it the
# information of a path of 100 steps takes 7 ms.
MAX_INTERPRETED = 100


def progress_message(
    ledger: Ledger,
    before: tuple[Sequence[DeploymentKey], Estimator] | None,
    world: World | None,
    stamp: int,
    status: MissionStatus = NOT_KNOWN,
) -> msg.Progress:
    """Return a progress message; `before`: deployments and estimator of the previous belief."""
    from kbnitp_msgs import msg

    belief, gained, expected = ledger.belief, nan, nan
    if before is not None:
        deployments, estimator = before
        gained = estimator.belief.joint_entropy() - belief.joint_entropy()
        added = {*ledger.deployments} - {*deployments}
        if len(added) == 1 and len(ledger.deployments) == len(deployments) + 1:
            (key,) = added
            model = ledger.robot_type(key).model(estimator.model)
            path = ledger.paths[key]
            with interpreted(len(path) < MAX_INTERPRETED):
                expected = path_information(estimator.belief, model, path)
    return msg.Progress(
        header=header(stamp),
        deployments=len(ledger.deployments),
        lost=ledger.lost,
        ordered=status.ordered,
        out=status.out,
        hazard_entropy=float(binary_entropy(belief.hazard).sum()),
        target_entropy=float(binary_entropy(belief.target).sum()),
        joint_entropy=belief.joint_entropy(),
        information_expected=expected,
        information_gained=gained,
        hazard_log_loss=log_loss(belief.hazard, world.hazard) if world else nan,
        target_log_loss=log_loss(belief.target, world.target) if world else nan,
        upper_bound=nan,
        state=status.state,
        reason=status.reason,
    )


# Columns of the numbers that a decision trusts: fields told_... of the message.
TOLD = 'value', 'other', 'probability', 'survival'

# Percent.
QUANTILES = (5, 25, 50, 75, 95)


@dataclass(frozen=True)
class LearntNumber:
    """The belief about a learnt number after some deployments."""

    # Mean and standard deviation of the number.
    mean: float
    sd: float
    # Quantiles of the number at the percentages `QUANTILES`.
    quantiles: tuple[float, ...]
    # Number of independent draws of equal precision.
    effective_samples: float


class Checked(NamedTuple):
    """A check of the model, and the deployments and stamp of the belief that was checked."""

    check: ModelCheck
    deployments: int
    # Nanoseconds of ROS time; 0 if no belief was checked.
    stamp: int


NOT_CHECKED = Checked(ModelCheck(False, {}, ''), 0, 0)


class ModelState(NamedTuple):
    """Learnt numbers, kinds of hazard with their probabilities, and the last check."""

    numbers: dict[str, LearntNumber]
    kinds: dict[str, float]
    checked: Checked


NOTHING_LEARNT = ModelState({}, {}, NOT_CHECKED)


def model_fields(ledger: Ledger, stamp: int) -> Fields:
    """Return the fields of the model message that follow from a belief of this stamp."""
    estimator = ledger.estimator
    parameters = estimator.parameters.values()
    return Fields(
        header=header_fields(stamp),
        deployments=len(ledger.deployments),
        name=list(estimator.parameters),
        mean=np.array([each.mean for each in parameters]),
        sd=np.array([each.sd for each in parameters]),
        effective_sample_size=np.array([each.effective_samples for each in parameters]),
        **{
            f'quantile_{percent}': np.array([each.quantile(percent / 100) for each in parameters])
            for percent in QUANTILES
        },
        kind=list(estimator.kinds),
        kind_probability=np.array(list(estimator.kinds.values())),
    )


def check_fields(checked: Checked) -> Fields:
    """Return the fields of the model message that follow from a check of the model."""
    check, deployments, stamp = checked
    return Fields(
        alternative=list(check.alternatives),
        alternative_ratio=np.array(list(check.alternatives.values())),
        in_doubt=check.is_in_doubt,
        reason=check.reason,
        checked=deployments,
        checked_stamp=stamp_fields(stamp),
    )


def model_belief(ledger: Ledger, stamp: int, checked: Checked) -> ModelBelief:
    """Return the model message of a belief of this stamp, with the last check."""
    from kbnitp_msgs.msg import ModelBelief

    return filled(filled(ModelBelief(), model_fields(ledger, stamp)), check_fields(checked))


def checked_belief(message: Any) -> tuple[int, int]:
    """Return the deployments and the stamp of the belief whose check a message has."""
    return message.checked, from_stamp(message.checked_stamp)


def read_model_belief(message: Any) -> ModelState:
    """Convert a kbnitp_msgs/ModelBelief."""
    check_frame('header.frame_id', message.header.frame_id)
    fields = ('mean', 'sd', *(f'quantile_{each}' for each in QUANTILES), 'effective_sample_size')
    listed = {'kind_probability': 'kind', 'alternative_ratio': 'alternative'}
    for column, names in {**dict.fromkeys(fields, 'name'), **listed}.items():
        values, named = len(getattr(message, column)), len(getattr(message, names))
        if values != named:
            raise ValueError(
                f'{column} has {values} values: it must have one for each of the {named} {names}s'
            )
    numbers = {
        name: LearntNumber(mean, sd, tuple(quantiles), samples)
        for name, mean, sd, *quantiles, samples in zip(
            message.name, *(getattr(message, field) for field in fields)
        )
    }
    kinds = dict(zip(message.kind, message.kind_probability))
    ratios = dict(zip(message.alternative, message.alternative_ratio))
    check = ModelCheck(message.in_doubt, ratios, message.reason)
    return ModelState(numbers, kinds, Checked(check, *checked_belief(message)))


def decision_fields(
    grid: Grid,
    decision: Decision,
    deployments: int,
    stamp: int,
    mission: int,
    goal_cells: Sequence[int] = (),
    author: str = '',
    epoch: int = 0,
    changes: int = 0,
    no_go: Sequence[int] = (),
) -> Fields:
    """Return the fields of a decision on a belief, without ways through `no_go`."""
    return Fields(
        header=header_fields(stamp),
        deployments=deployments,
        author=author,
        epoch=stamp_fields(epoch),
        changes=changes,
        goal=decision.goal,
        probability=decision.p_free,
        error=decision.error,
        survival=decision.survival,
        hazards_mean=decision.hazards_mean,
        hazards_5=float(decision.hazards_5),
        hazards_95=float(decision.hazards_95),
        path=path_fields(grid, decision.path, stamp, mission),
        reached=decision.reached,
        reason=decision.reason,
        goal_cells=[*goal_cells],
        no_go=[*no_go],
        told=[*decision.told],
        **{
            f'told_{column}': np.array(values)
            for column, values in zip(
                TOLD,
                zip(*decision.told.values()) if decision.told else [()] * 4,
            )
        },
    )


def decision_message(fields: Fields) -> DecisionMessage:
    """Return the message with the `decision_fields` of a decision."""
    from geometry_msgs.msg import PoseStamped
    from kbnitp_msgs.msg import Decision as DecisionMessage

    message = filled(DecisionMessage(), fields)
    message.path.poses = [filled(PoseStamped(), each) for each in fields.path.poses]
    return message


def check_decision(message: Any) -> None:
    """Check that a message is a valid decision."""
    names = ('hazards_mean', 'hazards_5', 'hazards_95', 'probability', 'error')
    if wrong := [name for name in names if not 0.0 <= getattr(message, name) < np.inf]:
        raise ValueError(f'{wrong[0]} is {getattr(message, wrong[0])}: it must be 0 or more')
    if message.probability > 1.0:
        raise ValueError(f'probability is {message.probability}: it must be in [0, 1]')
    if message.path.poses and not 0.0 <= message.survival <= 1.0:
        raise ValueError(f'survival is {message.survival}: it must be in [0, 1]')


def read_decision(grid: Grid, message: Any) -> Decision:
    """Return the decision of a message."""
    check_decision(message)
    at = [(each.pose.position.x, each.pose.position.y) for each in message.path.poses]
    path = grid.cells_at(at) if at else np.empty(0, dtype=np.intp)
    return Decision(
        goal=message.goal,
        p_free=message.probability,
        # The message of a lane has its path, that of an area has its cells.
        cells=np.unique(path if path.size else message.goal_cells),
        error=message.error,
        path=path,
        survival=message.survival,
        hazards_mean=message.hazards_mean,
        hazards_5=int(message.hazards_5),
        hazards_95=int(message.hazards_95),
        reached=message.reached,
        reason=message.reason,
        told={name: Trusted(*each) for name, *each in zip(message.told, *told_columns(message))},
    )


def told_columns(message: Any) -> list[Sequence[float]]:
    """Return the columns of a decision's told numbers."""
    columns = [getattr(message, f'told_{column}') for column in TOLD]
    for column, values in zip(TOLD, columns):
        if len(values) != len(message.told):
            raise ValueError(
                f'told_{column} has {len(values)} values: it must have one for each of the '
                f'{len(message.told)} numbers in told'
            )
    return columns


def fill_draws(response: Any, draws: HazardDraws) -> None:
    """Fill the response of the service `draws`."""
    response.success, response.count = True, len(draws.hazardous)
    response.independent_draws = draws.independent
    response.hazardous = array('B', np.packbits(draws.hazardous).tobytes())
    if draws.live is not None:
        response.live = array('B', np.packbits(draws.live).tobytes())
    response.weight = array('d', draws.weight.tobytes())


def read_draws(response: Any, cells: int, around: NDArray[np.intp] | None = None) -> HazardDraws:
    """Return the draws of a response, on a field of so many cells, given `Grid.around`."""
    count, weight = int(response.count), np.asarray(response.weight)
    sizes = {'hazardous': -(-count * cells // 8), 'weight': count}
    if len(response.live):
        sizes['live'] = sizes['hazardous']
    for name, size in sizes.items():
        if not count or len(getattr(response, name)) != size:
            raise ValueError(
                f'{name} has {len(getattr(response, name))} values: {count} draws of {cells} '
                f'cells have {size}, and there must be at least one draw'
            )
    if not ((weight >= 0.0).all() and np.isclose(weight.sum(), 1.0)):
        raise ValueError(f'weight has the sum {weight.sum()}: it must have at least 0 each, and 1')
    if not response.independent_draws > 0.0:
        raise ValueError(f'independent_draws is {response.independent_draws}: it must be above 0')

    def unpacked(values: Any) -> NDArray[np.bool_]:
        bits = np.unpackbits(np.asarray(values, np.uint8), count=count * cells)
        return bits.astype(bool).reshape(count, cells)

    hazardous = unpacked(response.hazardous)
    live = unpacked(response.live) if len(response.live) else None
    return HazardDraws(hazardous, response.independent_draws, weight, around, live)
