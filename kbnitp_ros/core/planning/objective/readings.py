# SPDX-License-Identifier: Apache-2.0
"""What readings are expected to tell: moments, predictions and their information."""

from __future__ import annotations

from functools import lru_cache
from math import lgamma
from typing import NamedTuple

from kbnitp_ros.core.field import SensorModel, surprisal, times_log
from kbnitp_ros.core.planning.objective.information_kernels import new_readings, Readings
from kbnitp_ros.core.planning.objective.options import beta_of, SHANNON
import numpy as np
from numpy.typing import NDArray

# The first is 1: its moment is the predicted survival itself.
EXPONENTS = np.array([1.0, 2.026, 3.832, 9.407, 28.14, 101.5, 482.6, 4111.0])
WEIGHTS = np.array(
    [
        1.000314622,
        -0.547169326,
        -0.271418285,
        -0.119928225,
        -0.043547782,
        -0.013911176,
        -0.003654438,
        -0.000665898,
    ]
)

# The most that the sum of powers is off, nats.
ERROR = 1.95e-5


# How many different cameras robots may have that are planned for together, and in how many ways
# readings may then be shared out among them: where cameras differ, more readings of a cell by one
# than that allows count as so many, which tells all but nothing less.
MOST_CAMERAS = 6
MOST_WAYS = 1024


class Camera(NamedTuple):
    """What of a sensor model readings depend on, as there."""

    true_positive: float
    false_positive: float

    @classmethod
    def of(cls, model: SensorModel) -> Camera:
        """Return the camera of robots with this model."""
        return cls(model.true_positive, model.false_positive)


# Of each camera the most readings that it brings of a cell.
Most = tuple[tuple[Camera, int], ...]


def most_counted(cameras: int) -> int | None:
    """Return to how many the readings of a cell by one of so many cameras count; None for all."""
    return None if cameras < 2 else int(MOST_WAYS ** (1.0 / cameras)) - 1


def check_cameras(cameras: int) -> None:
    """Check that it can be planned for robots with so many different cameras."""
    if cameras > MOST_CAMERAS:
        raise ValueError(
            f'the robots have {cameras} different cameras: paths can be planned for at most '
            f'{MOST_CAMERAS}, by true_positive and false_positive, at a time'
        )


@lru_cache(maxsize=8)
def readings_of(model: SensorModel, visits: int, earlier: Most) -> Readings:
    """Return what up to `visits` readings of a robot, and those of others before, may be."""
    own = Camera.of(model)
    most = dict(earlier)
    before = tuple(count + 1 for count in most.values())
    most[own] = most.get(own, 0) + visits
    tables = [positives(camera, count) for camera, count in most.items()]
    counts = np.indices([count + 1 for count in most.values()]).reshape(len(most), -1).T
    outcomes = (counts + 1).prod(axis=1)
    likelihood = np.zeros((len(counts), outcomes.max(), 2))
    for state, of_cameras in enumerate(counts):
        row = np.ones((1, 2))
        for table, count in zip(tables, of_cameras):
            # The last camera's count of positives varies fastest.
            row = (row[:, None] * table[count, : count + 1]).reshape(-1, 2)
        likelihood[state, : len(row)] = row
    places = np.arange(len(counts)).reshape([count + 1 for count in most.values()])
    start = places[tuple(slice(size) for size in before)]
    if own not in dict(earlier):
        start = start[..., 0]
    further = places.strides[list(most).index(own)] // places.itemsize
    return Readings(
        survival=np.exp(times_log(np.arange(visits + 1)[:, None], model.log_survival)),
        after=start.reshape(-1, 1) + further * np.arange(visits + 1),
        outcomes=outcomes,
        likelihood=likelihood,
        noise=surprisal(likelihood).sum(axis=1),
    )


def new_information(
    readings: Readings,
    joint: NDArray[np.float64],
    earlier: NDArray[np.float64],
    visits: NDArray[np.intp],
    alpha: float = SHANNON,
) -> NDArray[np.float64]:
    """Return what a robot that survives n visits reads of cells on top of earlier readings."""
    found = np.empty(joint.shape[:-2])
    new_readings(
        readings,
        np.ascontiguousarray(joint).reshape(-1, 2, 2),
        np.ascontiguousarray(earlier).reshape(-1, earlier.shape[-1]),
        np.broadcast_to(visits, found.shape).ravel(),
        alpha,
        beta_of(alpha),
        found.reshape(-1),
    )
    return found


def positives(camera: Camera, most: int) -> NDArray[np.float64]:
    """
    Return P(k of m readings are positive | X = x), indexed [m, k, x]; m is up to `most`.

    Equation :eq:`reading-counts`.
    """
    m, k = np.ogrid[: most + 1, : most + 1]
    log_factorial = np.array([lgamma(count + 1.0) for count in range(most + 1)])
    orderings = log_factorial[m] - log_factorial[k] - log_factorial[np.maximum(m - k, 0)]
    read_not, read = SensorModel(0.0, 0.0, 0.0, *camera).log_reading
    log_likelihood = times_log(k[..., None], read)
    log_likelihood = log_likelihood + times_log(np.maximum(m - k, 0)[..., None], read_not)
    likelihood: NDArray[np.float64] = np.exp(orderings[..., None] + log_likelihood)
    return likelihood * (k <= m)[..., None]
