# SPDX-License-Identifier: Apache-2.0
"""Maps are read like map_server does, and become grids."""

from itertools import pairwise, product

from extent import FULL
from hypothesis import given, Phase, settings
from hypothesis import strategies as st
from kbnitp_ros.maps import Map, MapError, read_map
from laws import for_each, spoilt
import numpy as np
from PIL import Image
import pytest

FILE = {
    'image': 'map.pgm',
    'resolution': 0.05,
    'origin': [-1.5, 2.0, 0.0],
    'negate': 0,
    'occupied_thresh': 0.65,
    'free_thresh': 0.196,
}


def write(folder, pixels, name='map.pgm', **changes):
    """Write an image, by hand or by another library, and its YAML file; return the latter."""
    rows, columns = pixels.shape
    if name == 'ascii.pgm':
        lines = [' '.join(map(str, row)) for row in pixels]
        text = f'P2\n# made by hand\n{columns} {rows}\n255\n' + '\n'.join(lines) + '\n'
        folder.joinpath(name).write_text(text)
    elif name.endswith('.pgm'):
        head = f'P5\n# made by hand\n{columns} {rows}\n255\n'.encode()
        folder.joinpath(name).write_bytes(head + pixels.astype(np.uint8).tobytes())
    else:
        Image.fromarray(pixels.astype(np.uint8)).save(folder / name)
    return write_yaml(folder, image=name, **changes)


def write_yaml(folder, **changes):
    said = {key: value for key, value in {**FILE, **changes}.items() if value is not None}
    path = folder / 'map.yaml'
    path.write_text(''.join(f'{key}: {value}\n' for key, value in said.items()))
    return path


def published(pixel, mode, negate, occupied, free):
    """Return map_server's value of a pixel, computed in its single precision."""
    if mode == 'raw':
        return pixel if pixel <= 100 else -1
    p = np.float32(pixel) / np.float32(255)
    if not negate:
        p = np.float32(1) - p
    if p <= np.float32(free):
        return 0
    if p >= np.float32(occupied):
        return 100
    if mode == 'trinary':
        return -1
    part = (p - np.float32(free)) / np.float32(occupied - free) * np.float32(100)
    return int(np.floor(part + np.float32(0.5)))


@for_each(
    'mode, negate, name, thresholds',
    product(
        ['trinary', 'scale', 'raw', None],
        [0, 1],
        ['map.pgm', 'ascii.pgm', 'map.png'],
        [
            (0.65, 0.196),
            (0.65, 0.25),
            (1.0, 0.0),
            (0.5, 0.499),
            (0.6, 0.6),
            (128 / 255, 128 / 255),
        ],
    ),
)
def test_grey_values_but_that_of_map_saver_equal_those_of_map_server(
    tmp_path, mode, negate, name, thresholds
):
    pixels = np.arange(256).reshape(8, 32)
    occupied, free = thresholds
    path = write(
        tmp_path,
        pixels,
        name,
        mode=mode,
        negate=negate,
        occupied_thresh=occupied,
        free_thresh=free,
    )
    found = read_map(path)
    expected = [
        [published(pixel, mode or 'trinary', negate, occupied, free) for pixel in row]
        for row in pixels[::-1]
    ]
    assert found.data.dtype == np.int8
    if mode in ('trinary', None) and not negate:
        # What map_saver writes for unknown pixels, whatever its threshold.
        assert pixels[::-1][1][13] == 205
        expected[1][13] = -1
    assert found.data.tolist() == expected
    assert found.resolution == 0.05
    assert found.origin == (-1.5, 2.0)


@for_each('changes', [
    {'negate': "'0'", 'mode': 'Trinary'},
    {'negate': 'n', 'resolution': '5e-2', 'origin': '[-1.5e0, "2", 0]'},
    {'negate': 'false', 'occupied_thresh': '"0.65"', 'free_thresh': '196e-3'},
])  # fmt: skip
def test_values_are_written_as_map_server_takes_them(tmp_path, changes):
    expected = read_map(write(tmp_path, np.arange(256).reshape(8, 32)))
    found = read_map(write_yaml(tmp_path, **changes))
    assert found.data.tolist() == expected.data.tolist()
    assert (found.resolution, found.origin) == (expected.resolution, expected.origin)
    turned = read_map(write_yaml(tmp_path, **{**changes, 'negate': "'1'"}))
    assert turned.data[-1, 0] == 0


COLOURS = [[[255, 255, 255], [255, 255, 0], [0, 0, 255]]]


@for_each('name, pixels, expected', [
    *((name, np.array([[0, 255]], dtype=np.uint8), [[100, 0]])
      for name in ('map.bmp', 'map.png', 'map.pgm')),
    ('deep.png', np.array([[0, 65535]], dtype=np.uint16), [[100, 0]]),
    ('flat.png', np.array([[False, True]]), [[100, 0]]),
    ('map.png', np.array(COLOURS, dtype=np.uint8), [[0, 0, 100]]),
    *(('map.png', np.array([[[0, 0, 0, 255], [0, 0, 0, alpha]]], dtype=np.uint8), [[100, value]])
      for alpha, value in ((255, 100), (254, -1), (0, -1))),
])  # fmt: skip
def test_images_are_recognised_by_content(tmp_path, name, pixels, expected):
    """A transparent pixel is unknown, and a coloured one counts by its brightness."""
    Image.fromarray(pixels).save(tmp_path / name)
    (tmp_path / name).rename(tmp_path / 'map')
    assert read_map(write_yaml(tmp_path, image='map')).data.tolist() == expected


@for_each('form', ['EPS', 'GIF', 'ICNS', 'ICO', 'PDF', 'SPIDER', 'TGA', 'TIFF', 'WEBP'])
def test_other_formats_are_not_decoded_under_any_name(tmp_path, form, monkeypatch):
    started = tmp_path / 'started'
    ghostscript = tmp_path / 'gs'
    ghostscript.write_text(f'#!/bin/sh\ntouch {started}\n')
    ghostscript.chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path), prepend=':')
    mode = 'F' if form == 'SPIDER' else 'RGB'
    other = tmp_path / 'map.other'
    # After one save as SPIDER, Pillow saves every file of that suffix as SPIDER.
    Image.new(mode, (32, 32)).save(other, format=form)
    other.rename(tmp_path / 'map.png')
    with pytest.raises(MapError, match='map.png is no image in PGM, PNG or BMP'):
        read_map(write_yaml(tmp_path, image='map.png'))
    assert not started.exists()


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore::PIL.Image.DecompressionBombWarning')
@given(st.data())
@settings(max_examples=800 if FULL else 60, phases=[Phase.generate])
def test_a_corrupt_map_is_read_or_refused_in_a_line(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp('map')
    name = data.draw(st.sampled_from(['map.bmp', 'map.png', 'map.pgm', 'ascii.pgm', 'map.yaml']))
    pixels = np.random.default_rng(4).integers(256, size=(9, 11))
    path = write(folder, pixels, 'map.pgm' if name == 'map.yaml' else name)
    file = folder / name
    file.write_bytes(data.draw(spoilt(file.read_bytes())))
    try:
        read_map(path)
        return
    except MapError as error:
        said = str(error)
    assert str(folder) in said
    assert '\n' not in said


def test_a_turned_map_has_its_stated_pose(tmp_path):
    write(tmp_path, np.full((2, 3), 254))
    found = read_map(write_yaml(tmp_path, resolution=0.5, origin=[4, -1, 0.3]))
    assert (found.origin, found.yaw) == ((4.0, -1.0), 0.3)
    grid = found.grid(unknown_blocks=False)
    assert (grid.origin, grid.yaw) == ((4.0, -1.0), 0.3)


@for_each('changes, message', [
    ({'image': 'nothere.pgm'}, 'nothere.pgm cannot be read: No such file'),
    ({'image': 'map.yaml'}, 'map.yaml is no image in PGM, PNG or BMP'),
    ({'resolution': 'nan'}, "resolution.*'nan'.*finite"),
    ({'resolution': -0.05}, 'resolution of .* is -0.05.*positive'),
    ({'resolution': None}, 'no resolution'),
    ({'origin': [0, 0]}, 'origin.*x, y, yaw'),
    ({'origin': [0, 0, '.nan']}, 'origin.*finite'),
    ({'mode': 'binary'}, "mode.*'binary'.*trinary, scale, raw"),
    ({'negate': 2}, 'negate.*2.*0 or 1'),
    ({'free_thresh': 0.7}, 'free_thresh.*0.7.*not be above occupied_thresh, 0.65'),
    ({'occupied_thresh': '[1]'}, 'occupied_thresh.*finite number'),
])  # fmt: skip
def test_bad_files_are_refused(tmp_path, changes, message):
    write(tmp_path, np.zeros((2, 2)))
    with pytest.raises(MapError, match=message):
        read_map(write_yaml(tmp_path, **changes))


def random_map(rng):
    coarse = rng.choice([0, 0, 0, 0, 0, 0, 50, 100, -1], rng.integers(1, 11, 2))
    data = coarse.repeat(rng.integers(1, 4), axis=0).repeat(rng.integers(1, 4), axis=1)
    yaw = rng.choice([0.0, rng.uniform(-np.pi, np.pi)])
    return Map(data.astype(np.int8), 0.25, (-3.0, 1.5), yaw)


def turned(points, angle):
    at = np.exp(1j * angle) * (points @ (1, 1j))
    return np.stack([at.real, at.imag], axis=-1)


def touched_pixels(field, points):
    """Return the values of all pixels crossed or touched by straight lines between points."""
    values = []
    for start, end in pairwise(points):
        along = np.linspace(start, end, 201)
        pixel = turned(along - np.array(field.origin), -field.yaw) / field.resolution
        # A line on the edge of a pixel touches both pixels.
        for nudge in ((-1e-9, -1e-9), (-1e-9, 1e-9), (1e-9, -1e-9), (1e-9, 1e-9)):
            column, row = np.floor(pixel + nudge).astype(int).T
            inside = (row < field.data.shape[0]) & (column < field.data.shape[1])
            values.append(field.data[row[inside], column[inside]])
    return np.concatenate(values)


def random_grid(rng, connectivity, unknown_blocks):
    side = rng.choice([0.25, 0.5, 0.6, 0.75, 1.0])
    while True:
        field = random_map(rng)
        size = np.array(field.data.shape[::-1]) * field.resolution
        place = turned(rng.uniform(0, 1, 2) * size, field.yaw) + field.origin
        try:
            return field, field.grid(side, tuple(place), connectivity, unknown_blocks)
        except MapError:
            continue


@pytest.mark.slow
@for_each('seed, connectivity', product(range(200), [4, 8]), every=7)
def test_no_walk_touches_an_occupied_pixel(seed, connectivity):
    rng = np.random.default_rng(seed)
    unknown_blocks = bool(rng.integers(2))
    field, free = random_grid(rng, connectivity, unknown_blocks)
    cell, walk = free.base, [free.base]
    for _ in range(60):
        cell = int(rng.choice(free.neighbors(cell)))
        walk.append(cell)
    touched = touched_pixels(field, free.centers(walk))
    assert not (touched == 100).any()
    assert not (unknown_blocks and (touched == -1).any())


def test_a_cell_is_blocked_by_any_of_its_pixels():
    data = np.array([[0, 0, 0, 0], [0, 0, 0, 100], [0, 0, 0, 0], [-1, 0, 0, 0]], dtype=np.int8)
    field = Map(data, 0.5, (1.0, 2.0))
    assert field.grid(1.0, (1.1, 2.1)).blocked == {1, 2}
    assert field.grid(1.0, (1.1, 2.1), unknown_blocks=False).blocked == {1}
    assert field.grid(base_position=(1.1, 2.1)).blocked == {7, 12}


@for_each('value, thresh', product([-1, 0, 50, 64, 65, 86, 99, 100], [0.5, 0.65, 0.86, 1.0]))
def test_a_pixel_is_an_obstacle_from_the_threshold(value, thresh):
    data = np.array([[0, value]], dtype=np.int8)
    field = Map(data, 1.0, (0.0, 0.0))
    is_obstacle = value >= 100 * thresh
    assert bool(field.grid(occupied_thresh=thresh).blocked) == (is_obstacle or value == -1)
    assert field.graded(thresh) == (value > 0 and not is_obstacle)


@for_each('seed', range(60))
def test_obstacles_are_widened_by_what_exceeds_half_a_cell(seed):
    """By the distance of every pixel to every cell."""
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(1, 25, 2)
    data = np.where(rng.random((rows, columns)) < 0.02, 100, 0).astype(np.int8)
    side, radius = float(rng.choice([0.1, 0.2, 0.5])), float(rng.uniform(0.0, 0.9))
    field = Map(data, 0.1, (0.0, 0.0))
    height, width = (int(np.ceil(count * 0.1 / side - 1e-6)) for count in data.shape)
    wanted = np.zeros((height, width), dtype=bool)
    for row, column in np.argwhere(data == 100):
        for y, x in np.ndindex(height, width):
            # Of each pixel under the cell, since pixels are widened.
            under = [
                (up, aside)
                for up in range(round(y * side / 0.1), round((y + 1) * side / 0.1))
                for aside in range(round(x * side / 0.1), round((x + 1) * side / 0.1))
                if up < rows and aside < columns
            ]
            gaps = [
                np.hypot(max(abs(up - row) - 1, 0), max(abs(aside - column) - 1, 0))
                for up, aside in under
            ]
            is_under = (row, column) in under
            widths = (radius - side / 2) / 0.1
            wanted[y, x] |= is_under or any(gap < widths - 1e-6 for gap in gaps)
    wanted.flat[0] = False
    try:
        grid = field.grid(side, robot_radius=radius, unknown_blocks=False)
    except MapError:
        return
    assert grid.blocked == set(np.flatnonzero(wanted).tolist())


def test_widening_opens_no_wall_and_leaves_the_base():
    data = np.zeros((20, 20), dtype=np.int8)
    data[:, 9:11] = 86
    field = Map(data, 0.5, (0.0, 0.0))
    assert len(field.grid(0.5).blocked) == 40
    assert len(field.grid(0.5, occupied_thresh=0.9).blocked) == 0
    # Half a cell is 0.25 m; a robot of 0.5 m in radius keeps a further cell away.
    assert len(field.grid(0.5, robot_radius=0.5).blocked) == 80
    assert len(field.grid(0.5, robot_radius=0.25).blocked) == 40


def test_cells_that_extend_beyond_the_map_are_unknown_there():
    field = Map(np.zeros((3, 5), dtype=np.int8), 1.0, (0.0, 0.0))
    grid = field.grid(2.0)
    assert (grid.width, grid.height, grid.resolution) == (3, 2, 2.0)
    assert grid.blocked == {2, 3, 4, 5}
    assert not field.grid(2.0, unknown_blocks=False).blocked


def test_resolutions_that_are_not_exact_in_binary_divide_evenly():
    field = Map(np.zeros((60, 90), dtype=np.int8), 0.05, (-1.0, 0.0))
    grid = field.grid(0.15)
    assert (grid.width, grid.height) == (30, 20)
    assert not grid.blocked


def test_a_cell_that_shares_part_of_an_occupied_pixel_is_blocked():
    data = np.zeros((1, 6), dtype=np.int8)
    data[0, 2] = 100
    blocked = Map(data, 1.0, (0.0, 0.0)).grid(1.5, unknown_blocks=False).blocked
    assert blocked == {1}
    data[0, [2, 1]] = 0, 100
    assert Map(data, 1.0, (0.0, 0.0)).grid(1.5, unknown_blocks=False, base=3).blocked == {0, 1}


def test_a_free_cell_of_the_largest_part_is_proposed_in_place_of_a_blocked_base():
    data = np.zeros((5, 9), dtype=np.int8)
    # Cell 0 is in a wall; cell 10, the nearest, is enclosed by it.
    data[:3, :3] = 100
    data[1, 1] = 0
    with pytest.raises(ValueError, match=r'the nearest free cell is 3 around \(3\.5, 0\.5\)'):
        Map(data, 1.0, (0.0, 0.0)).grid()
    with pytest.raises(ValueError, match='all cells of 5 m are blocked: choose a finer'):
        Map(data, 1.0, (0.0, 0.0)).grid(5.0)


@pytest.mark.parametrize('suffix', ['.pgm', '.PNG', '.bmp'])
def test_an_image_in_place_of_its_yaml_file_is_refused(tmp_path, suffix):
    file = tmp_path / f'yard{suffix}'
    told = r'is an image: name the YAML file that describes it'
    with pytest.raises(ValueError, match=f'{told}$'):
        read_map(file)
    file.with_suffix('.yaml').touch()
    with pytest.raises(ValueError, match=f'{told}: .*yard.yaml is beside it$'):
        read_map(file)


@for_each('arguments, message', [
    ({'resolution': 0.4}, 'grid resolution is 0.4.*0.5'),
    ({'base_position': (3.0, 0.2)}, 'outside the grid'),
    ({'base_position': (0.7, 0.2)}, 'base, cell 1 .*blocked'),
    ({'base': 1}, 'base, cell 1 .*blocked'),
])  # fmt: skip
def test_bad_grids_of_maps_are_refused(arguments, message):
    data = np.array([[0, 100], [0, 0]], dtype=np.int8)
    with pytest.raises(ValueError, match=message):
        Map(data, 0.5, (0.0, 0.0)).grid(**arguments)
