# SPDX-License-Identifier: Apache-2.0
"""The sensor model of a robot, its type, and its survival of the cells it visits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

from kbnitp_ros.core.field.check import (
    cost,
    in_short,
    listed,
    probabilities,
    probability,
    read_only,
    whole_number,
)
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class SensorModel:
    """
    Probabilities of the path-based sensor and of the target sensor.

    Parameters
    ----------
    lethality : float
        Chance in [0, 1] that a hazard strikes a robot which steps into its cell.
    malfunction : float
        Chance in [0, 1] that a robot fails in a step, with or without a hazard in the cell: the
        path-based sensor's false positive.
    false_negative : float
        Chance in [0, 1] that a robot survives a hazard's strike: the path-based sensor's false
        negative.
    true_positive, false_positive : float
        Chances in [0, 1] that the target sensor reads a target where there is one, and where
        there is none.
    reach : float
        Lethality of a hazard in each of the eight cells around it, as a share in [0, 1] of the
        lethality in its own cell. It reaches over obstacles, whatever the grid's connectivity.
    duds : float
        Share in [0, 1] of the hazards that never strike, each for the whole mission.

    Raises
    ------
    ValueError
        If a probability is NaN or outside [0, 1].

    """

    lethality: float
    malfunction: float = 0.05
    false_negative: float = 0.05
    true_positive: float = 0.95
    false_positive: float = 0.05
    reach: float = 0.0
    duds: float = 0.0

    def __post_init__(self) -> None:
        vars(self).update({name: probability(name, value) for name, value in vars(self).items()})

    @property
    def step_survival(self) -> tuple[float, float]:
        """Return P(step survived | Z = z) for z = 0, 1 (:eq:`step-survival`)."""
        intact = 1.0 - self.malfunction
        return intact, intact * (1.0 - self.lethality * (1.0 - self.false_negative))

    def survival(self, hazard: ArrayLike) -> NDArray[np.float64]:
        """Return P(step survived | Z), per step (:eq:`step-survival`)."""
        strike = self.lethality * (1.0 - self.false_negative)
        return (1.0 - self.malfunction) * (1.0 - probabilities('hazard', hazard) * strike)

    @property
    def strikes(self) -> tuple[float, float]:
        """Return P(destroyed by a hazard in a step) into its cell and into a cell beside it."""
        strike = self.lethality * (1.0 - self.false_negative)
        return strike, strike * self.reach

    def reading(self, target: ArrayLike) -> NDArray[np.float64]:
        """Return P(Y = 1 | X), per step (:eq:`reading`)."""
        present = probabilities('target', target)
        return present * self.true_positive + (1.0 - present) * self.false_positive

    # Cached, since each update and each plan needs the arrays several times.
    @property
    @lru_cache(maxsize=64)  # noqa: B019
    def log_survival(self) -> NDArray[np.float64]:
        """Log P(step survived | Z = z) for z = 0, 1, shape (2,) (:eq:`step-survival`)."""
        strike = self.lethality * (1.0 - self.false_negative)
        with np.errstate(divide='ignore'):
            return read_only(np.log1p(-strike * np.arange(2.0)) + np.log1p(-self.malfunction))

    @property
    @lru_cache(maxsize=64)  # noqa: B019
    def log_reading(self) -> NDArray[np.float64]:
        """Log P(Y = y | X = x), indexed [y, x], shape (2, 2), in [-inf, 0] (:eq:`reading`)."""
        positive = self.reading((0, 1))
        with np.errstate(divide='ignore'):
            return read_only(np.log(np.stack([1.0 - positive, positive])))


def times_log(count: ArrayLike, log: ArrayLike) -> NDArray[np.float64]:
    """Return ``count * log``, the log of a power, broadcast, with 0 * -inf = 0."""
    with np.errstate(invalid='ignore'):
        return np.where(np.equal(count, 0), 0.0, np.multiply(count, log))


def log_predicted_survival(
    hazard: NDArray[np.float64], counts: NDArray[np.intp], log_survival: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return log S of n visits, S = (1 - z) s0^n + z s1^n (:eq:`predicted-survival`)."""
    _, lost, survived = powers(*log_survival.tolist(), int(counts.max(initial=0)))
    lost, survived, safe = lost.take(counts, 1), survived.take(counts, 1), 1.0 - hazard
    loss = safe * lost[0] + hazard * lost[1]
    with np.errstate(divide='ignore'):
        # Avoid rounding: 1 - loss is inaccurate for losses near 1, the sum of survivals for losses
        # near 0.
        return np.where(
            loss < 0.5, np.log1p(-loss), np.log(safe * survived[0] + hazard * survived[1])
        )


# Cached, since each update and each plan needs the arrays several times.
@lru_cache(maxsize=64)
def powers(safe: float, deadly: float, most: int) -> tuple[NDArray[np.float64], ...]:
    """Return log s_z^n, 1 - s_z^n and s_z^n for n up to `most`, each of shape (2, most + 1)."""
    log_power = times_log(np.arange(most + 1), np.array([[safe], [deadly]]))
    return log_power, 0.0 - np.expm1(log_power), np.exp(log_power)


# Numbers of the hazards, and numbers that robot types may have of their own.
OF_HAZARDS = ('reach', 'duds')
SENSORS = tuple(f.name for f in fields(SensorModel) if f.name not in OF_HAZARDS)

# Minima of the fields of `RobotType` that are whole numbers.
LEAST = {'max_steps': 1, 'base': 0}


@dataclass(frozen=True)
class RobotType:
    """
    The properties of a robot type; None for the common values.

    Parameters
    ----------
    lethality, malfunction, false_negative, true_positive, false_positive : float, optional
        As in `SensorModel`; a value given here is known, even if the common value is learnt.
    max_steps : int, optional
        Maximum steps of a path, at least 1.
    max_distance : float, optional
        Maximum length of a path, metres, at least 0; 0 for no limit.
    loss_cost : float, optional
        Cost of a lost robot, nats, at least 0.
    base : int, optional
        Cell of the base, one of the grid's bases.

    Raises
    ------
    ValueError
        If a number is out of range.

    """

    lethality: float | None = None
    malfunction: float | None = None
    false_negative: float | None = None
    true_positive: float | None = None
    false_positive: float | None = None
    max_steps: int | None = None
    max_distance: float | None = None
    loss_cost: float | None = None
    base: int | None = None

    def __post_init__(self) -> None:
        for name, value in [*vars(self).items()]:
            if value is None:
                continue
            if name in LEAST:
                vars(self)[name] = whole_number(name, value, LEAST[name])
            else:
                vars(self)[name] = (probability if name in SENSORS else cost)(name, value)

    @cached_property
    def own(self) -> dict[str, Any]:
        """Return the values that the type sets itself, by name."""
        given = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: value for name, value in given.items() if value is not None}

    @cached_property
    def sensors(self) -> dict[str, Any]:
        """Return the values of the sensor model that the type sets itself, by name."""
        return {name: value for name, value in self.own.items() if name in SENSORS}

    def model(self, common: SensorModel) -> SensorModel:
        """Return the sensor model of the type, given the common sensor model."""
        if not isinstance(common, SensorModel):
            raise TypeError(f'common is {in_short(common)}: it must be SensorModel(...)')
        sensors = self.sensors
        return replace(common, **sensors) if sensors else common


ORDINARY = RobotType()


def of_each(robots: int, robot_types: Sequence[RobotType]) -> tuple[RobotType, ...]:
    """Return the type of each robot."""
    robot_types = listed('robot_types', robot_types, ' of RobotType')
    for robot_type in robot_types:
        if not isinstance(robot_type, RobotType):
            raise TypeError(f'robot type is {in_short(robot_type)}: it must be RobotType(...)')
    if robot_types and len(robot_types) != robots:
        raise ValueError(
            f'robot_types has {len(robot_types)} values: it must have {robots}, one for each robot'
        )
    return tuple(robot_types) or (ORDINARY,) * robots
