# SPDX-License-Identifier: Apache-2.0
"""The image of a map as a picture to lay under other things."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from kbnitp_ros.maps.files import read_image, read_map_file
import numpy as np
from PIL import Image

# More pixels a side than that are nothing to see in a page.
MOST_SHOWN = 1000


@dataclass(frozen=True)
class Site:
    """The image of a map, and where it lies, in metres and rad."""

    # A data URI with a PNG file of at most `MOST_SHOWN` pixels a side, the top row first.
    source: str
    # What it covers along and across the map's rows.
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
    picture.thumbnail((MOST_SHOWN, MOST_SHOWN))
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
