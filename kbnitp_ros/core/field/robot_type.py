# SPDX-License-Identifier: Apache-2.0
"""What sets robots of one type apart from all others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from kbnitp_ros.core.field.check import cost, probability, whole_number
from kbnitp_ros.core.field.sensor import SensorModel

SENSORS = tuple(field.name for field in fields(SensorModel))

# The whole numbers, and the least that each may be.
LEAST = {'max_steps': 1, 'base': 0}


@dataclass(frozen=True)
class RobotType:
    """
    What robots of one type have of their own; None where they are like all others.

    Parameters
    ----------
    lethality, malfunction, false_negative, true_positive, false_positive : float, optional
        As of a `SensorModel`. A number of their own is known, whatever is learnt of the others.
    max_steps : int, optional
        The most steps of their paths, at least 1.
    max_distance : float, optional
        How long their paths may be, metres, at least 0; 0 for no limit.
    loss_cost : float, optional
        What a lost one is worth, nats, at least 0.
    base : int, optional
        The cell that they leave from and return to, one of the grid's bases.

    Raises
    ------
    ValueError
        If a number is out of range; it is named.

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
        for name, value in self.own.items():
            checked: float
            if name in LEAST:
                checked = whole_number(name, value, LEAST[name])
            else:
                checked = (probability if name in SENSORS else cost)(name, value)
            object.__setattr__(self, name, checked)

    @property
    def own(self) -> dict[str, Any]:
        """Return what they have of their own, by name."""
        return {name: value for name, value in vars(self).items() if value is not None}

    @property
    def sensors(self) -> dict[str, Any]:
        """Return what of that are numbers of the sensor model."""
        return {name: value for name, value in self.own.items() if name in SENSORS}

    def model(self, common: SensorModel) -> SensorModel:
        """Return their sensor model, from that of all others."""
        return replace(common, **self.sensors)


ORDINARY = RobotType()


def of_each(robots: int, robot_types: Sequence[RobotType]) -> tuple[RobotType, ...]:
    """Return the type of each of so many robots."""
    if robot_types and len(robot_types) != robots:
        raise ValueError(
            f'robot_types has {len(robot_types)} values: it must have one for each of {robots}'
        )
    return tuple(robot_types) or (ORDINARY,) * robots
