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
from kbnitp_ros.plugins import renamed

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

__getattr__ = renamed(__name__, {'levels_of': 'quantise_belief'})
