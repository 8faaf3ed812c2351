# SPDX-License-Identifier: Apache-2.0
"""Maps over grids: of priors, datums and images."""

from base64 import b64decode
from io import BytesIO
from math import hypot, nan

from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.core import Grid
from kbnitp_ros.maps import Datum, MapError, read_probabilities, read_site
from kbnitp_ros.maps.files import MAX_PIXELS
from laws import for_each, spoilt
import numpy as np
from PIL import Image
from pyproj import Geod
import pytest

YAML = """
image: map.png
resolution: {resolution}
origin: [{x}, {y}, {yaw}]
negate: 0
occupied_thresh: {occupied}
free_thresh: {free}
mode: {mode}
"""


def write(
    folder, pixels, resolution=1.0, x=0.0, y=0.0, occupied=1.0, free=0.0, mode='scale', yaw=0.0
):
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(folder / 'map.png')
    path = folder / 'map.yaml'
    path.write_text(
        YAML.format(
            resolution=resolution, x=x, y=y, occupied=occupied, free=free, mode=mode, yaw=yaw
        )
    )
    return path


def test_every_grey_value_is_kept_to_a_255th(tmp_path):
    pixels = np.arange(256).reshape(16, 16)
    found = read_probabilities(write(tmp_path, pixels), Grid(16, 16), elsewhere=0.5)
    assert found == pytest.approx(1.0 - pixels[::-1].ravel() / 255, abs=1e-6)


def test_thresholds_are_certainties(tmp_path):
    path = write(tmp_path, [[0, 51, 127.5, 204, 255]], occupied=0.8, free=0.2)
    found = read_probabilities(path, Grid(5, 1), elsewhere=0.5)
    assert found == pytest.approx([1.0, 1.0, 128 / 255 / 0.6 - 0.2 / 0.6, 0.0, 0.0], abs=1e-6)


def test_one_threshold_makes_certainties_alone(tmp_path):
    path = write(tmp_path, [[255, 128, 127, 0]], occupied=127 / 255, free=127 / 255)
    assert read_probabilities(path, Grid(4, 1), elsewhere=0.5).tolist() == [0.0, 0.0, 1.0, 1.0]


def test_cells_outside_the_map_or_transparent_keep_the_number(tmp_path):
    pixels = np.zeros((2, 2, 4), dtype=np.uint8)
    pixels[..., 3] = [[255, 0], [255, 255]]
    path = write(tmp_path, pixels, x=1.0)
    found = read_probabilities(path, Grid(4, 2), elsewhere=0.3)
    assert found.reshape(2, 4).tolist() == [[0.3, 1.0, 1.0, 0.3], [0.3, 1.0, 0.3, 0.3]]


@for_each('seed', range(30))
def test_means_are_weighted_by_area(tmp_path, seed):
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 256, rng.integers(1, 12, 2))
    # On a raster of 0.1 m, each cell's mean is a plain mean of points.
    step, side = rng.integers(1, 9, 2)
    x, y = rng.integers(-20, 21, 2)
    width, height = rng.integers(1, 8, 2)
    path = write(tmp_path, pixels, resolution=0.1 * step, x=0.1 * x, y=0.1 * y)
    grid = Grid(int(width), int(height), resolution=0.1 * float(side), origin=(-0.5, 0.3))
    found = read_probabilities(path, grid, elsewhere=0.25)
    fine = (1.0 - pixels[::-1] / 255).repeat(step, axis=0).repeat(step, axis=1)
    for cell in range(grid.cells):
        row, column = divmod(cell, grid.width)
        points = [
            fine[r, c]
            for r in range(3 + row * side - y, 3 + (row + 1) * side - y)
            for c in range(-5 + column * side - x, -5 + (column + 1) * side - x)
            if 0 <= r < fine.shape[0] and 0 <= c < fine.shape[1]
        ]
        assert found[cell] == pytest.approx(np.mean(points) if points else 0.25, abs=1e-6)


@for_each('seed', range(30))
def test_a_map_turned_with_its_grid_has_the_same_values(tmp_path, seed):
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 256, rng.integers(1, 12, 2))
    yaw, (x, y) = rng.uniform(-np.pi, np.pi), rng.uniform(-2, 2, 2)
    corner = np.exp(1j * yaw) * complex(x, y)
    straight = Grid(5, 4, resolution=0.7)
    turned = Grid(5, 4, resolution=0.7, yaw=yaw)
    expected = read_probabilities(write(tmp_path, pixels, 0.3, x, y), straight, 0.25)
    path = write(tmp_path, pixels, 0.3, corner.real, corner.imag, yaw=yaw + 2 * np.pi)
    assert read_probabilities(path, turned, 0.25) == pytest.approx(expected, abs=1e-6)


def test_a_map_turned_differently_is_refused(tmp_path):
    path = write(tmp_path, [[0]], yaw=0.2)
    with pytest.raises(MapError, match='yaw of 0.2 rad, but the field has 0.1.*have the yaw'):
        read_probabilities(path, Grid(2, 2, yaw=0.1), 0.5)


def test_an_array_lies_over_the_whole_grid(tmp_path):
    path = tmp_path / 'prior.npy'
    np.save(path, [[0.1, 0.2], [0.3, 0.5]])
    grid = Grid(2, 2, resolution=3.0, origin=(7.0, 8.0))
    assert read_probabilities(path, grid, 0.9) == pytest.approx([0.1, 0.2, 0.3, 0.5])
    assert read_probabilities(path, Grid(1, 2), 0.9, resample=True) == pytest.approx([0.15, 0.4])
    found = read_probabilities(path, Grid(4, 1), 0.9, resample=True)
    assert found == pytest.approx([0.2, 0.2, 0.35, 0.35])


@for_each(
    'width, height, remedy', [(2, 3, 'transpose it'), (3, 3, 'prior.resample to true'), (6, 1, '')]
)
def test_arrays_of_another_shape_are_refused(tmp_path, width, height, remedy):
    path = tmp_path / 'prior.npy'
    np.save(path, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    told = f'has 2 rows and 3 columns, but the field has {height} and {width}: .*{remedy}'
    with pytest.raises(MapError, match=told):
        read_probabilities(path, Grid(width, height), 0.9)


@for_each('array, message', [
    ([[0.1, 1.5]], '1.5 in row 0, column 1.*0 to 1'),
    ([[float('nan')]], 'nan in row 0'),
    ([0.1, 0.2], 'rows and columns'),
    (np.zeros((0, 3)), 'rows and columns'),
    ([['a']], 'no array of numbers'),
])  # fmt: skip
def test_bad_arrays_are_refused(tmp_path, array, message):
    path = tmp_path / 'prior.npy'
    np.save(path, array)
    with pytest.raises(MapError, match=message):
        read_probabilities(path, Grid(2, 2), 0.5)


@given(st.data())
def test_a_corrupt_array_is_read_or_refused_in_a_line(tmp_path_factory, data):
    path = tmp_path_factory.mktemp('array') / 'prior.npy'
    np.save(path, np.full((2, 2), 0.25))
    path.write_bytes(data.draw(spoilt(path.read_bytes())))
    try:
        assert read_probabilities(path, Grid(2, 2), 0.5).shape == (4,)
        return
    except MapError as error:
        said = str(error)
    assert str(path) in said
    assert '\n' not in said


def test_other_files_are_refused(tmp_path):
    with pytest.raises(MapError, match='nothere.npy cannot be read'):
        read_probabilities(tmp_path / 'nothere.npy', Grid(2, 2), 0.5)
    with pytest.raises(MapError, match='trinary.*mode scale'):
        read_probabilities(write(tmp_path, [[0]], mode='trinary'), Grid(2, 2), 0.5)
    with pytest.raises(MapError, match='resolution of .*map.yaml is 0.0: it must be positive'):
        read_probabilities(write(tmp_path, [[0]], resolution=0), Grid(2, 2), 0.5)


EARTH = Geod(ellps='WGS84')

datums = st.builds(
    Datum,
    latitude=st.floats(-89.0, 89.0),
    longitude=st.floats(-180.0, 180.0),
    heading=st.floats(-7.0, 7.0),
)
points = st.tuples(st.floats(-2e4, 2e4), st.floats(-2e4, 2e4))


@given(datums, points)
def test_a_point_lies_on_the_geodesic_in_its_direction(datum, point):
    x, y = point
    azimuth = 90.0 - np.degrees(datum.heading + np.arctan2(y, x))
    longitude, latitude, _ = EARTH.fwd(datum.longitude, datum.latitude, azimuth, hypot(x, y))
    ((found_latitude, found_longitude),) = datum.on_earth([point])
    *_, off = EARTH.inv(longitude, latitude, found_longitude, found_latitude)
    assert off < 0.001
    assert datum.in_map(found_latitude, found_longitude) == pytest.approx(point, abs=1e-3)


@for_each('latitude', [90.0, -90.0])
def test_a_pole_is_a_place(latitude):
    ((found, _),) = Datum(latitude, 10.0, 0.3).on_earth([(0.0, 111_694.0)])
    assert abs(found) == pytest.approx(89.0, abs=1e-4)


def test_without_numbers_there_is_no_datum():
    assert Datum.of(()) is None
    assert Datum.of([55.9, -3.2, 0.1]) == Datum(55.9, -3.2, 0.1)


@for_each('numbers, message', [
    ([91.0, 0.0, 0.0], 'datum has latitude 91.0: it must be from -90 to 90, in degrees'),
    ([0.0, -180.1, 0.0], 'datum has longitude -180.1: it must be from -180 to 180'),
    ([0.0, 0.0, nan], 'datum has heading nan: it must be finite, in rad'),
    ([0.0, 0.0], r'parameter datum is \[0.0, 0.0\]: it must be .latitude, longitude, head'),
])  # fmt: skip
def test_a_bad_datum_is_refused(numbers, message):
    with pytest.raises(ValueError, match=message):
        Datum.of(numbers)


def test_a_field_beyond_the_earth_is_refused():
    with pytest.raises(ValueError, match='is 1e.08 m from the datum: at most 1e.07'):
        Datum(0.0, 0.0, 0.0).on_earth([(1e8, 0.0)])


IMAGE_YAML = """
image: map.png
resolution: 0.05
origin: [3.0, -4.0, 0.3]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def shown(folder, pixels):
    Image.fromarray(pixels).save(folder / 'map.png')
    (folder / 'map.yaml').write_text(IMAGE_YAML)
    site = read_site(folder / 'map.yaml')
    content = b64decode(site.source.removeprefix('data:image/png;base64,'))
    return site, np.asarray(Image.open(BytesIO(content)))


def test_a_site_has_the_rows_of_its_image_and_its_transparency(tmp_path):
    pixels = np.array([[[9, 255], [99, 255], [199, 0]], [[1, 255], [2, 255], [3, 255]]], np.uint8)
    site, picture = shown(tmp_path, pixels)
    assert picture.tolist() == pixels.tolist()
    assert (site.width, site.height) == pytest.approx((0.15, 0.1))
    assert (site.origin, site.yaw) == ((3.0, -4.0), 0.3)


def test_a_large_image_is_made_smaller(tmp_path):
    site, picture = shown(tmp_path, np.full((1500, 3000), 254, np.uint8))
    assert picture.shape[:2] == (MAX_PIXELS // 2, MAX_PIXELS)
    assert (site.width, site.height) == pytest.approx((150.0, 75.0))
