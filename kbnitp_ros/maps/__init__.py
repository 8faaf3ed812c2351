# SPDX-License-Identifier: Apache-2.0
"""Maps in map_server's format, and grids and prior beliefs made from them."""

from kbnitp_ros.maps.files import (
    quantise_belief,
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
    'quantise_belief',
    'read_map',
    'read_probabilities',
    'read_site',
    'write_probabilities',
]
