# SPDX-License-Identifier: Apache-2.0
"""Where a field is by the parameters on record: its datum, and the image of its map."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import Any

from kbnitp_ros.core import Grid
from kbnitp_ros.maps import Datum, MapError, read_site, Site
from kbnitp_ros.messages.grids import rounded_yaw

Parameters = Mapping[str, Mapping[str, Any]]

# How much of a cell a map may end before the field does.
PART = 1e-3


def datum_of(parameters: Parameters) -> Datum | None:
    """Return the datum of a mission; None if none is on record."""
    given = {tuple(each['datum']) for each in parameters.values() if each.get('datum')}
    if len(given) > 1:
        raise ValueError(f'nodes had different datums: {sorted(given)}')
    return Datum.of(*given) if given else None


def site_of(parameters: Parameters, grid: Grid) -> tuple[Site | None, str]:
    """Return the image of the map that a mission took its field from, and why there is none."""
    name = next((each['map'] for each in parameters.values() if each.get('map')), '')
    if not name:
        return None, ''
    try:
        site = read_site(name)
    except MapError as error:
        return None, f'The map is not shown: {error}.'
    if not lies_under(site, grid):
        return None, f'The map is not shown: {name} does not lie on the field any more.'
    return site, ''


def lies_under(site: Site, grid: Grid) -> bool:
    """Say whether a grid is one of this map."""
    columns, rows = (ceil(side / grid.resolution - PART) for side in (site.width, site.height))
    return (site.origin, rounded_yaw(site.yaw), columns, rows) == (
        grid.origin,
        grid.yaw,
        grid.width,
        grid.height,
    )
