# SPDX-License-Identifier: Apache-2.0
"""Prior probabilities from maps."""

from __future__ import annotations

from math import remainder, tau
from pathlib import Path

from kbnitp_ros.core import Grid
from kbnitp_ros.files import in_words
from kbnitp_ros.maps.files import darkness, read_image, read_map_file, scaled
from kbnitp_ros.maps.occupancy import MapError, ON_THE_EDGE, shares
import numpy as np
from numpy.typing import NDArray


def read_probabilities(
    path: str | Path, grid: Grid, elsewhere: float, resample: bool = False
) -> NDArray[np.float64]:
    """Return a probability for each cell of a grid, from a file."""
    path = Path(path)
    if path.suffix == '.npy':
        probability = read_array(path)
        rows, columns = probability.shape
        if (rows, columns) != (grid.height, grid.width) and not resample:
            is_transposed = (columns, rows) == (grid.height, grid.width)
            raise MapError(
                f'{path} has {rows} rows and {columns} columns, and the field {grid.height} and '
                f'{grid.width}: '
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
                f'origin of {path} is turned by {file.yaw} rad, and the field by {grid.yaw}: the '
                'map of a prior must have the rows of the field'
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
    """Return the probabilities of a .npy file."""
    try:
        array = np.load(path, allow_pickle=False)
        if array.ndim != 2 or not array.size or array.dtype.kind not in 'fiu':
            raise ValueError(
                f'it has shape {array.shape} of {array.dtype}: it must have rows and columns'
            )
    except OSError as error:
        raise MapError(f'{path} cannot be read: {error.strerror or error}') from error
    except Exception as error:
        # numpy fails in many ways on a corrupt header.
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
