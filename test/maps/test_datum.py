# SPDX-License-Identifier: Apache-2.0
"""Positions on the earth are those of geodesics, and of plain geometry nearby."""

from math import hypot, inf, nan

from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.maps import Datum
from laws import for_each
import numpy as np
from pyproj import Geod
import pytest

EARTH = Geod(ellps='WGS84')

# Semi-major axis in metres, and flattening, of WGS84.
AXIS, FLATTENING = 6378137.0, 1 / 298.257223563

datums = st.builds(
    Datum,
    latitude=st.floats(-89.0, 89.0),
    longitude=st.floats(-180.0, 180.0),
    heading=st.floats(-7.0, 7.0),
)
points = st.tuples(st.floats(-2e4, 2e4), st.floats(-2e4, 2e4))


@given(datums, points)
def test_a_point_lies_on_the_geodesic_that_its_direction_begins(datum, point):
    x, y = point
    azimuth = 90.0 - np.degrees(datum.heading + np.arctan2(y, x))
    longitude, latitude, _ = EARTH.fwd(datum.longitude, datum.latitude, azimuth, hypot(x, y))
    ((found_latitude, found_longitude),) = datum.on_earth([point])
    *_, off = EARTH.inv(longitude, latitude, found_longitude, found_latitude)
    assert off < 0.001
    assert datum.in_map(found_latitude, found_longitude) == pytest.approx(point, abs=1e-3)


def earth_centred(latitude, longitude):
    """Return x, y and z of a point on the ellipsoid, in metres from the centre of the earth."""
    phi, lam = np.radians([latitude, longitude])
    squared = FLATTENING * (2 - FLATTENING)
    normal = AXIS / np.sqrt(1 - squared * np.sin(phi) ** 2)
    around = normal * np.cos(phi)
    return np.array(
        [around * np.cos(lam), around * np.sin(lam), normal * (1 - squared) * np.sin(phi)]
    )


@given(datums, points)
def test_a_point_nearby_lies_in_the_tangent_plane_of_the_datum(datum, point):
    ((latitude, longitude),) = datum.on_earth([point])
    away = earth_centred(latitude, longitude) - earth_centred(datum.latitude, datum.longitude)
    phi, lam = np.radians([datum.latitude, datum.longitude])
    east = np.array([-np.sin(lam), np.cos(lam), 0.0])
    north = np.array([-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)])
    along = complex(east @ away, north @ away) * np.exp(-1j * datum.heading)
    assert abs(along - complex(*point)) < 0.1


@for_each('latitude', [90.0, -90.0])
def test_a_pole_is_a_place(latitude):
    ((found, _),) = Datum(latitude, 10.0, 0.3).on_earth([(0.0, 111_694.0)])
    assert abs(found) == pytest.approx(89.0, abs=1e-4)


def test_without_numbers_there_is_none():
    assert Datum.of(()) is None
    assert Datum.of([55.9, -3.2, 0.1]) == Datum(55.9, -3.2, 0.1)


@for_each('numbers, message', [
    ([91.0, 0.0, 0.0], 'datum has latitude 91.0: it must be from -90 to 90, in degrees'),
    ([nan, 0.0, 0.0], 'datum has latitude nan'),
    ([0.0, -180.1, 0.0], 'datum has longitude -180.1: it must be from -180 to 180'),
    ([0.0, inf, 0.0], 'datum has longitude inf'),
    ([0.0, 0.0, nan], 'datum has heading nan: it must be finite, in rad'),
    ([0.0, 0.0], r'parameter datum is \[0.0, 0.0\]: it must be .latitude, longitude, head'),
    ([0.0, 0.0, 0.0, 0.0], 'parameter datum is'),
])  # fmt: skip
def test_what_is_no_place_on_the_earth_is_refused(numbers, message):
    with pytest.raises(ValueError, match=message):
        Datum.of(numbers)


def test_a_field_beyond_the_earth_is_refused():
    with pytest.raises(ValueError, match='is 1e.08 m from the datum: at most 1e.07'):
        Datum(0.0, 0.0, 0.0).on_earth([(1e8, 0.0)])
