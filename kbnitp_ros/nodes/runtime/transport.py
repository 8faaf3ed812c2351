# SPDX-License-Identifier: Apache-2.0
"""How nodes find each other, and talk: by UDP, and no shared memory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def udp_only(environment: Mapping[str, str], config: Path) -> dict[str, str]:
    """
    Return the variables with which rmw_fastrtps uses UDP and no shared memory.

    A process that is killed leaves its shared memory in ``/dev/shm``, now and then locked, and one
    that is started after it may then not be discovered. For the discovery range LOCALHOST,
    rmw_fastrtps adds a shared memory transport to those of the profile, whatever the profile says
    (rmw_fastrtps_shared_cpp, ``participant.cpp``). So LOCALHOST is replaced by a profile that
    binds UDP to 127.0.0.1. With ``ROS_STATIC_PEERS`` it is not, since those may be elsewhere.

    Parameters
    ----------
    environment : mapping
        That of the user. If it names a profile nothing is changed.
    config : Path
        The folder of ``fastdds.xml`` and ``loopback.xml``.

    """
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
    """
    Return why nodes that a discovery server introduces see too little; empty if they do not.

    It tells a client only of those that it talks to; nodes of a mission look at the whole graph.
    """
    server = environment.get('ROS_DISCOVERY_SERVER')
    if not server or environment.get('ROS_SUPER_CLIENT', '').lower() in ('true', '1'):
        return ''
    return (
        f'ROS_DISCOVERY_SERVER is {server!r} and ROS_SUPER_CLIENT is not TRUE, so nodes wait for '
        'each other for ever: set ROS_SUPER_CLIENT=TRUE for all nodes of the mission'
    )
