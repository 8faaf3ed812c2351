# SPDX-License-Identifier: Apache-2.0
"""Maps as map_server reads them, and the grids and prior beliefs made of them."""

from kbnitp_ros.maps.files import (
    levels_of,
    read_map,
    read_probabilities,
    read_site,
    Site,
    write_probabilities,
)
from kbnitp_ros.maps.occupancy import Datum, Map, MapError

__all__ = [
    'Datum',
    'Map',
    'MapError',
    'Site',
    'levels_of',
    'read_map',
    'read_probabilities',
    'read_site',
    'write_probabilities',
]
