# SPDX-License-Identifier: Apache-2.0
"""Where on the earth the frame of the map lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Any

from kbnitp_ros.plugins import extra
import numpy as np
from numpy.typing import ArrayLike, NDArray

HIGHEST = {'latitude': 90.0, 'longitude': 180.0}

# A quarter of the way round the earth, in metres.
FARTHEST = 1e7


@dataclass(frozen=True)
class Datum:
    """
    The place and the turn of the frame map, as robot_localization's parameter `datum` has them.

    Positions are those of the azimuthal equidistant projection about the datum on the ellipsoid of
    WGS84: distances and directions from the datum are those of the geodesic.

    """

    # Of the frame's origin, WGS84, in degrees.
    latitude: float
    longitude: float
    # The angle from east to the frame's x axis, counterclockwise, in rad.
    heading: float

    def __post_init__(self) -> None:
        for name, most in HIGHEST.items():
            if not abs(value := getattr(self, name)) <= most:
                raise ValueError(
                    f'datum has {name} {value}: it must be from {-most:g} to {most:g}, in degrees'
                )
        if not isfinite(self.heading):
            raise ValueError(f'datum has heading {self.heading}: it must be finite, in rad')

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Datum | None:
        """Return the datum that the parameter of this name gives; None if it is empty."""
        if not numbers:
            return None
        if len(numbers) != 3:
            raise ValueError(
                f'parameter datum is {list(numbers)}: it must be [latitude, longitude, heading], '
                'in degrees, degrees and rad'
            )
        return cls(*numbers)

    @cached_property
    def _projection(self) -> Any:
        with extra('report'):
            from pyproj import Proj
        return Proj(proj='aeqd', lat_0=self.latitude, lon_0=self.longitude, ellps='WGS84')

    def on_earth(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return latitude and longitude, WGS84 in degrees, of points of the map in metres."""
        at = np.exp(1j * self.heading) * (np.asarray(points) @ (1, 1j))
        if at.size and abs(at).max() > FARTHEST:
            raise ValueError(
                f'the field is {abs(at).max():.4g} m from the datum: at most {FARTHEST:g} m are '
                'shown on the earth'
            )
        east, north = at.real.tolist(), at.imag.tolist()
        longitude, latitude = self._projection(east, north, inverse=True)
        return np.stack([latitude, longitude], axis=-1)

    def in_map(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Return x and y in metres of a place on the earth; the inverse of `on_earth`."""
        at = np.exp(-1j * self.heading) * complex(*self._projection(longitude, latitude))
        return float(at.real), float(at.imag)
