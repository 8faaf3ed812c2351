# SPDX-License-Identifier: Apache-2.0
"""Map files in Nav2's format: reading, writing, pictures, and prior probabilities."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import product
from math import isfinite, remainder, tau
from pathlib import Path
from typing import Any

from kbnitp_ros.core import Belief, Grid
from kbnitp_ros.files import in_words, read_yaml, yaml_text
from kbnitp_ros.maps.occupancy import Map, MapError, OCCUPIED, ON_THE_EDGE, shares, UNKNOWN
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

# Formats of Nav2's map_saver, PGM, PNG and BMP, by Pillow's names. Other decoders are excluded,
# since the decoder of EPS starts another program.
FORMATS = ('PPM', 'PNG', 'BMP')

MODES = ('trinary', 'scale', 'raw')

# Values of `negate`, a number or a boolean of YAML.
SWITCHES = dict.fromkeys(('0', 'false', 'no', 'off', 'n'), False) | dict.fromkeys(
    ('1', 'true', 'yes', 'on', 'y'), True
)


@dataclass(frozen=True)
class MapFile:
    """The content of a map's YAML file."""

    # The image file.
    image: Path
    # Side of a pixel in metres.
    resolution: float
    # Lower-left corner of the map in metres.
    origin: tuple[float, float]
    # Angle from the frame's x axis to the map's rows, counterclockwise, in rad.
    yaw: float
    # Whether white is occupied.
    negate: bool
    # Minimum darkness of an occupied pixel, and maximum darkness of a free pixel.
    occupied_thresh: float
    free_thresh: float
    # One of `MODES`.
    mode: str


# Grey of the unknown pixels that map_saver writes in mode trinary. With its threshold of 0.25 for
# free pixels map_server would read them as free.
SAVED_UNKNOWN = 205


def read_map(yaml_path: str | Path) -> Map:
    """Return the map of a YAML file, with the values that map_server publishes."""
    file = read_map_file(Path(yaml_path))
    gray, opaque = read_image(file.image)
    if file.mode == 'raw':
        data = np.where(gray <= OCCUPIED, gray, UNKNOWN).astype(np.int8)
    else:
        data = occupancy(darkness(gray, file.negate), file)
        data[~opaque] = UNKNOWN
        if file.mode == 'trinary' and not file.negate:
            data[gray == SAVED_UNKNOWN] = UNKNOWN
    return Map(data, file.resolution, file.origin, file.yaw)


def darkness(gray: NDArray[np.uint8], negate: bool) -> NDArray[np.float32]:
    """Return the darkness of each pixel in [0, 1], in map_server's precision."""
    light = gray.astype(np.float32) / np.float32(255.0)
    return light if negate else np.float32(1.0) - light


def scaled(dark: NDArray[np.float32], file: MapFile) -> NDArray[np.float32]:
    """Return the darkness of each pixel, scaled: `free_thresh` to 0, `occupied_thresh` to 1."""
    width = np.float32(max(file.occupied_thresh - file.free_thresh, 1e-30))
    result: NDArray[np.float32] = (dark - np.float32(file.free_thresh)) / width
    return result


def occupancy(dark: NDArray[np.float32], file: MapFile) -> NDArray[np.int8]:
    """Return the occupancy of each pixel, 0 to 100 or -1, in mode trinary or scale."""
    between = np.full(dark.shape, np.float32(UNKNOWN))
    if file.mode == 'scale':
        # Halves are rounded up, as C++ rounds positive numbers.
        between = np.floor(scaled(dark, file) * np.float32(OCCUPIED) + np.float32(0.5))
    data = np.where(dark >= np.float32(file.occupied_thresh), OCCUPIED, between)
    data = np.where(dark <= np.float32(file.free_thresh), 0, data)
    return data.astype(np.int8)


def read_map_file(path: Path) -> MapFile:
    """Read a map's YAML file."""
    if path.suffix.lower() in ('.pgm', '.png', '.bmp'):
        beside = path.with_suffix('.yaml')
        wanted = f': {beside} is beside it' if beside.exists() else ''
        raise MapError(f'{path} is an image: name the YAML file that describes it{wanted}')
    try:
        said = read_yaml(path)
    except OSError as error:
        raise MapError(f'{path} cannot be read: {error.strerror}') from error
    except ValueError as error:
        raise MapError(f'{path}: {error}') from error
    if not isinstance(said, Mapping):
        raise MapError(f'{path} must hold image, resolution, origin and thresholds of a map')

    def value(name: str, *default: Any) -> Any:
        if name not in said and not default:
            raise MapError(f'{path} has no {name}, which a map needs')
        return said.get(name, *default)

    def number(name: str, found: Any) -> float:
        # map_server accepts numbers in quotes as well.
        with suppress(TypeError, ValueError):
            if not isinstance(found, bool) and isfinite(float(found)):
                return float(found)
        raise MapError(f'{name} of {path} is {found!r}: it must be a finite number')

    origin = value('origin')
    if not isinstance(origin, list) or len(origin) != 3:
        raise MapError(f'origin of {path} is {origin!r}: it must be [x, y, yaw], in m and rad')
    x, y, yaw = (number('origin', coordinate) for coordinate in origin)
    mode = str(value('mode', 'trinary')).lower()
    if mode not in MODES:
        raise MapError(f'mode of {path} is {mode!r}: known are {", ".join(MODES)}')
    negate = str(value('negate')).lower()
    if negate not in SWITCHES:
        raise MapError(f'negate of {path} is {value("negate")!r}: it must be 0 or 1')
    resolution, occupied, free = (
        number(name, value(name)) for name in ('resolution', 'occupied_thresh', 'free_thresh')
    )
    if resolution <= 0:
        raise MapError(f'resolution of {path} is {resolution}: it must be positive, in metres')
    if free > occupied:
        raise MapError(
            f'free_thresh of {path} is {free}: it must not be above occupied_thresh, {occupied}'
        )
    return MapFile(
        image=path.parent / str(value('image')),
        resolution=resolution,
        origin=(x, y),
        yaw=yaw,
        negate=SWITCHES[negate],
        occupied_thresh=occupied,
        free_thresh=free,
        mode=mode,
    )


def read_image(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the grey values of an image and its opaque pixels, bottom row first."""
    try:
        with Image.open(path, formats=FORMATS) as image:
            image.load()
            opaque = np.ones((image.height, image.width), dtype=bool)
            if image.has_transparency_data:
                opaque = np.asarray(image.convert('RGBA').getchannel('A')) == 255
            gray = gray_values(image)
    except UnidentifiedImageError as error:
        raise MapError(f'{path} is no image in PGM, PNG or BMP, or it is corrupt') from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise MapError(f'image {path} cannot be read: {reason}') from error
    return gray[::-1], opaque[::-1]


def gray_values(image: Image.Image) -> NDArray[np.uint8]:
    """Return the grey values of an image of any depth, 0 to 255."""
    if image.mode.startswith('I'):  # 16 bits
        wide = np.asarray(image, dtype=np.int64)
        return ((wide + 128) // 257).astype(np.uint8)
    if image.mode in ('P', 'LA', 'PA', 'RGBA'):
        image = image.convert('RGBA').convert('RGB')
    return np.asarray(image.convert('L'))


WHITE = 255


def write_probabilities(yaml_path: Path, grid: Grid, levels: NDArray[np.uint8]) -> None:
    """Write the probability of each cell as a map in mode scale, black for 1."""
    image = yaml_path.with_suffix('.pgm')
    rows = (WHITE - levels).reshape(grid.height, grid.width)[::-1]
    Image.fromarray(np.ascontiguousarray(rows)).save(image)
    said = {
        'image': image.name,
        'mode': 'scale',
        'resolution': grid.resolution,
        'origin': [*grid.origin, grid.yaw],
        'negate': 0,
        'occupied_thresh': 1.0,
        'free_thresh': 0.0,
    }
    yaml_path.write_text(yaml_text(said))


def quantise_belief(belief: Belief) -> dict[str, NDArray[np.uint8]]:
    """Return the maps of a belief, rounded to steps of 1/255 so that they still form a belief."""
    exact = np.stack([belief.hazard, belief.target, belief.kappa]) * WHITE
    best = np.rint(exact)
    distance = np.full(belief.cells, np.inf)
    for rounding in product((np.floor, np.ceil), repeat=3):
        tried = np.stack([each(values) for each, values in zip(rounding, exact)])
        hazard, target, kappa = tried
        both = kappa * hazard
        fits = (both <= WHITE * target) & (WHITE * target <= both + WHITE * (WHITE - hazard))
        off = np.where(fits, np.abs(tried - exact).max(axis=0), np.inf)
        best = np.where(off < distance, tried, best)
        distance = np.minimum(off, distance)
    return dict(zip(('hazard', 'target', 'kappa'), best.astype(np.uint8)))


# Maximum number of pixels along a side; a page shows no more.
MAX_PIXELS = 1000


@dataclass(frozen=True)
class Site:
    """The image of a map, with its position in metres and rad."""

    # A data URI with a PNG file of at most `MAX_PIXELS` pixels a side, the top row first.
    source: str
    # Extent of the image along and across the map's rows.
    width: float
    height: float
    # The lower-left corner.
    origin: tuple[float, float]
    yaw: float


def read_site(yaml_path: str | Path) -> Site:
    """Return the image of a map."""
    file = read_map_file(Path(yaml_path))
    gray, opaque = read_image(file.image)
    shade = np.stack([gray, np.where(opaque, 255, 0).astype(np.uint8)], axis=-1)[::-1]
    picture = Image.fromarray(np.ascontiguousarray(shade), 'LA')
    picture.thumbnail((MAX_PIXELS, MAX_PIXELS))
    content = BytesIO()
    picture.save(content, 'PNG')
    rows, columns = gray.shape
    return Site(
        source=f'data:image/png;base64,{b64encode(content.getvalue()).decode()}',
        width=columns * file.resolution,
        height=rows * file.resolution,
        origin=file.origin,
        yaw=file.yaw,
    )


def read_probabilities(
    path: str | Path, grid: Grid, elsewhere: float, resample: bool = False
) -> NDArray[np.float64]:
    """Read the probabilities of a grid's cells from a file."""
    path = Path(path)
    if path.suffix == '.npy':
        probability = read_array(path)
        rows, columns = probability.shape
        if (rows, columns) != (grid.height, grid.width) and not resample:
            is_transposed = (columns, rows) == (grid.height, grid.width)
            raise MapError(
                f'{path} has {rows} rows and {columns} columns, but the field has {grid.height} '
                f'and {grid.width}: '
                + ('transpose it' if is_transposed else 'set prior.resample to true to take means')
            )
        resolution = (
            grid.height * grid.resolution / rows,
            grid.width * grid.resolution / columns,
        )
        first = grid.in_cells(grid.origin)
    else:
        file = read_map_file(path)
        if file.mode != 'scale':
            raise MapError(f'mode of {path} is {file.mode}: probabilities need mode scale')
        gray, opaque = read_image(file.image)
        probability = scaled(darkness(gray, file.negate), file).astype(np.float64).clip(0.0, 1.0)
        probability[~opaque] = np.nan
        resolution = (file.resolution, file.resolution)
        if abs(remainder(file.yaw - grid.yaw, tau)) * max(grid.width, grid.height) > ON_THE_EDGE:
            raise MapError(
                f'origin of {path} has a yaw of {file.yaw} rad, but the field has {grid.yaw}: a '
                'map of the prior must have the yaw of the field'
            )
        rows, columns = probability.shape
        image = Grid(columns, rows, resolution=file.resolution, origin=file.origin, yaw=grid.yaw)
        first = image.in_cells(grid.origin)
    by_row, by_column = (
        shares(cells, grid.resolution / pixel, begin, pixels)
        for cells, pixel, begin, pixels in zip(
            (grid.height, grid.width), resolution, reversed(first), probability.shape
        )
    )
    covered = by_row @ ~np.isnan(probability) @ by_column.T
    total = by_row @ np.nan_to_num(probability) @ by_column.T
    with np.errstate(invalid='ignore'):
        mean = np.where(covered > 0.0, total / covered, elsewhere)
    return mean.ravel().clip(0.0, 1.0)


def read_array(path: Path) -> NDArray[np.float64]:
    """Read the probabilities in a .npy file."""
    try:
        array = np.load(path, allow_pickle=False)
        if array.ndim != 2 or not array.size or array.dtype.kind not in 'fiu':
            raise ValueError(
                f'it has shape {array.shape} of {array.dtype}, not rows and columns of numbers'
            )
    except OSError as error:
        raise MapError(f'{path} cannot be read: {error.strerror or error}') from error
    except Exception as error:
        # numpy raises many types on a corrupt header.
        raise MapError(f'{path} is no array of numbers: {in_words(error)}') from error
    values: NDArray[np.float64] = array.astype(np.float64)
    wrong = np.argwhere(~((values >= 0.0) & (values <= 1.0)))
    if len(wrong):
        row, column = wrong[0]
        raise MapError(
            f'{path} is {values[row, column]} in row {row}, column {column}: '
            'a probability must be from 0 to 1'
        )
    return values
