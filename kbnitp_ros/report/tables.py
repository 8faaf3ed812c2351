# SPDX-License-Identifier: Apache-2.0
"""A mission in numbers: curves after each moment, tables and arrays."""

from __future__ import annotations

from csv import DictWriter
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from typing import Any

from kbnitp_ros.core import log_loss, path_information
from kbnitp_ros.core.field.belief import binary_entropy
from kbnitp_ros.core.field.compiled import interpreted
from kbnitp_ros.maps import quantise_belief, write_probabilities
from kbnitp_ros.report.mission import MissionSummary
import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Curves:
    """Curves over the moments of a mission, each of shape (moments,)."""

    # H(Z) and H(X) summed over the cells, nats.
    hazard_entropy: Numbers
    target_entropy: Numbers
    # H(Z, X) summed over the cells, nats.
    joint_entropy: Numbers
    # Log loss of the maps, nats; NaN without a recorded truth.
    hazard_loss: Numbers
    target_loss: Numbers
    # Expected information of the deployment assimilated, given the belief before: I(Z, X; Theta,
    # Y) in nats. NaN for the first moment, for a return that replaces a loss, and where the belief
    # before is missing.
    expected: Numbers
    # Decrease of H(Z, X), nats; negative if entropy rose. It equals the expected information on
    # average, not for each robot. NaN for the first moment and where the belief before is missing.
    gained: Numbers
    # Number of robots known to be lost.
    lost: NDArray[np.intp]
    # Number of robots in flight.
    out: NDArray[np.intp]

    @property
    def entropy(self) -> Numbers:
        """Return H(Z) + H(X), nats, shape (moments,)."""
        return self.hazard_entropy + self.target_entropy

    @property
    def log_loss(self) -> Numbers:
        """Return the log loss of both maps, nats, shape (moments,); NaN if no truth is known."""
        return self.hazard_loss + self.target_loss


# Number of moments below which computing without numba is faster than loading numba.
MAX_INTERPRETED = 400


def mission_curves(mission: MissionSummary) -> Curves:
    """Return the curves of a mission."""
    moments, world = mission.moments, mission.world
    beliefs = [each.belief for each in moments]
    joint_entropy = np.array([each.joint_entropy() for each in beliefs])
    gaps = np.array([each.is_after_gap for each in moments])
    gained = np.concatenate([[nan], -np.diff(joint_entropy)])
    gained[gaps] = nan
    with interpreted(len(moments) < MAX_INTERPRETED):
        expected = [information_at(mission, place) for place in range(len(moments))]
    unknown = np.full(len(moments), nan)
    return Curves(
        hazard_entropy=np.array([binary_entropy(each.hazard).sum() for each in beliefs]),
        target_entropy=np.array([binary_entropy(each.target).sum() for each in beliefs]),
        joint_entropy=joint_entropy,
        hazard_loss=np.array([log_loss(each.hazard, world.hazard) for each in beliefs])
        if world
        else unknown,
        target_loss=np.array([log_loss(each.target, world.target) for each in beliefs])
        if world
        else unknown,
        expected=np.array(expected),
        gained=gained,
        lost=lost_by(mission),
        out=np.array([each.size for each in out_at(mission)], dtype=np.intp),
    )


def information_at(mission: MissionSummary, place: int) -> float:
    """Return the expected information of a moment's deployment, nats; NaN if unknown."""
    moment = mission.moments[place]
    if place == 0 or moment.deployment is None or moment.is_late or moment.is_after_gap:
        return nan
    before, deployment = mission.moments[place - 1], mission.deployments[moment.deployment]
    model = before.agent_model(deployment.key.agent)
    return float(path_information(before.belief, model, deployment.path))


def lost_by(mission: MissionSummary) -> NDArray[np.intp]:
    """Return the number of robots known to be lost at each moment; late returns are subtracted."""
    is_lost: dict[int, bool] = {}
    counts = []
    for moment in mission.moments:
        if moment.is_after_gap:
            for place, each in enumerate(mission.deployments):
                if each.outcome and each.reported is not None and each.reported <= moment.time:
                    is_lost.setdefault(place, not each.outcome.survived)
        if moment.deployment is not None and moment.outcome is not None:
            is_lost[moment.deployment] = not moment.outcome.survived
        counts.append(sum(is_lost.values()))
    return np.array(counts, dtype=np.intp)


def out_at(mission: MissionSummary) -> list[NDArray[np.intp]]:
    """Return the robots in flight at each moment, by index of their deployments."""
    never = np.iinfo(np.int64).max
    sent = np.array([each.sent or 0 for each in mission.deployments])
    reported = [each.reported for each in mission.deployments]
    home = np.array([never if time is None else time for time in reported])
    return [np.flatnonzero((sent <= each.time) & (home > each.time)) for each in mission.moments]


# Columns of deployments.csv, with their types. Lists of cells and readings are texts of numbers.
COLUMNS = {
    'deployment': 'int64',
    'agent': 'string',
    'stamp': 'int64',
    'sent': 'int64',
    'told': 'int64',
    'outcome': 'string',
    'steps': 'int64',
    'steps_survived': 'int64',
    'detected': 'int64',
    'looked': 'int64',
    'information_expected': 'float64',
    'information_gained': 'float64',
    'moment': 'int64',
    'held': 'int64',
    'entropy': 'float64',
    'log_loss': 'float64',
    'path': 'string',
    'walk': 'string',
    'readings': 'string',
}


def rows(mission: MissionSummary, curves: Curves) -> list[dict[str, Any]]:
    """Return one row for each deployment, by the names of `COLUMNS`; None if unknown."""
    entropy = curves.entropy
    loss = curves.log_loss
    first = {each.deployment: place for place, each in reversed([*enumerate(mission.moments)])}
    table = []
    for number, deployment in enumerate(mission.deployments):
        seen = deployment.outcome
        at, began = deployment.moment, first.get(number)
        survived = None
        if seen is not None:
            # A lost robot without a contact may have survived any number of steps.
            survived = seen.steps if seen.survived else seen.steps_survived or None
        # 1 where a target was read, 0 where none was, -1 without a reading.
        read = None if seen is None or seen.readings is None else seen.readings.astype(int)
        table.append(
            {
                'deployment': number + 1,
                'agent': deployment.key.agent,
                'stamp': deployment.key.stamp,
                'sent': deployment.sent,
                'told': deployment.reported,
                'outcome': 'out' if seen is None else 'returned' if seen.survived else 'lost',
                'steps': deployment.path.size - 1 if seen is None else seen.steps,
                'steps_survived': survived,
                'detected': None if read is None else int((read == 1).sum()),
                'looked': None if read is None else int((read >= 0).sum()),
                'information_expected': known(curves.expected, began),
                'information_gained': known(curves.gained, began),
                'moment': at,
                'held': None if at is None else mission.moments[at].held,
                'entropy': known(entropy, at),
                'log_loss': known(loss, at),
                'path': text(deployment.path),
                'walk': text(seen.path) if seen and seen.survived else None,
                'readings': None if read is None else text(read),
            }
        )
    return table


def known(values: NDArray[np.float64], place: int | None) -> float | None:
    """Return the value at an index; None without an index, or if the value is NaN."""
    return None if place is None or isnan(values[place]) else float(values[place])


def text(numbers: NDArray[np.integer]) -> str:
    """Return numbers separated by blanks."""
    return ' '.join(map(str, numbers.tolist()))


def write_tables(folder: Path, mission: MissionSummary, curves: Curves) -> None:
    """Write deployments.csv; raises OSError."""
    with (folder / 'deployments.csv').open('w', encoding='utf-8', newline='') as file:
        table = DictWriter(file, COLUMNS, lineterminator='\n')
        table.writeheader()
        table.writerows(rows(mission, curves))


def write_beliefs(folder: Path, mission: MissionSummary, curves: Curves) -> None:
    """Write belief.npz and the last belief as maps of map_server; raises OSError."""
    moments = mission.moments
    arrays: dict[str, Any] = {
        name: np.stack([getattr(each.belief, name) for each in moments])
        for name in ('joint', 'hazard', 'target', 'kappa')
    }
    arrays['held'] = np.array([each.held for each in moments])
    arrays['shape'] = np.array([mission.grid.height, mission.grid.width])
    if mission.world:
        arrays |= {f'true_{name}': getattr(mission.world, name) for name in ('hazard', 'target')}
    np.savez_compressed(folder / 'belief.npz', **arrays, **vars(curves))
    for name, levels in quantise_belief(moments[-1].belief).items():
        write_probabilities(folder / f'{name}.yaml', mission.grid, levels)
