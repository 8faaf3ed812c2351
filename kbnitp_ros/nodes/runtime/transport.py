# SPDX-License-Identifier: Apache-2.0
"""How nodes find each other, and talk: by UDP, and no shared memory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def udp_only(environment: Mapping[str, str], config: Path) -> dict[str, str]:
    """Return the variables with which rmw_fastrtps uses UDP and no shared memory."""
    # A killed process leaves locked shared memory behind, and the next one may not be discovered.
    # For the range LOCALHOST rmw_fastrtps adds shared memory whatever the profile says: a profile
    # that binds UDP to 127.0.0.1 replaces it, unless ROS_STATIC_PEERS names peers elsewhere.
    if environment.get(PROFILES):
        return {}
    is_local = (
        environment.get('ROS_LOCALHOST_ONLY') == '1'
        or environment.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'LOCALHOST'
    ) and not environment.get('ROS_STATIC_PEERS')
    variables = {
        PROFILES: str(config / ('loopback.xml' if is_local else 'fastdds.xml')),
        'RMW_FASTRTPS_USE_QOS_FROM_XML': '1',
    }
    if is_local:
        variables['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'
        # ROS warns of this variable wherever it is set.
        if 'ROS_LOCALHOST_ONLY' in environment:
            variables['ROS_LOCALHOST_ONLY'] = '0'
    return variables


def deaf_to_server(environment: Mapping[str, str]) -> str:
    """Return why nodes that a discovery server introduces see too little; empty if they do not."""
    server = environment.get('ROS_DISCOVERY_SERVER')
    if not server or environment.get('ROS_SUPER_CLIENT', '').lower() in ('true', '1'):
        return ''
    return (
        f'ROS_DISCOVERY_SERVER is {server!r} and ROS_SUPER_CLIENT is not TRUE, so nodes wait for '
        'each other for ever: set ROS_SUPER_CLIENT=TRUE for all nodes of the mission'
    )
