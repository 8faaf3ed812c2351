# SPDX-License-Identifier: Apache-2.0
"""The ROS graph: discovery, authors of topics, and the roles of subscribers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from typing import Any

from kbnitp_ros.messages.headers import SHOWN
from kbnitp_ros.messages.topics import BELIEF, PATH, RECORDED, REPORT
from rclpy.node import Node

PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def udp_only(environment: Mapping[str, str], config: Path) -> dict[str, str]:
    """Return environment variables that make rmw_fastrtps use UDP and no shared memory."""
    # A killed process leaves locked shared memory behind, which may hide the next process. With
    # the range LOCALHOST rmw_fastrtps adds shared memory despite the profile, so a profile that
    # binds UDP to 127.0.0.1 replaces that range, unless ROS_STATIC_PEERS names other computers.
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
        # ROS warns of this deprecated variable if it is 1.
        if 'ROS_LOCALHOST_ONLY' in environment:
            variables['ROS_LOCALHOST_ONLY'] = '0'
    return variables


def discovery_warning(environment: Mapping[str, str]) -> str:
    """Explain why a node does not discover all nodes with a discovery server; empty if it does."""
    server = environment.get('ROS_DISCOVERY_SERVER')
    if not server or environment.get('ROS_SUPER_CLIENT', '').lower() in ('true', '1'):
        return ''
    return (
        f'ROS_DISCOVERY_SERVER is {server!r} and ROS_SUPER_CLIENT is not TRUE, so nodes do not '
        'discover each other: set ROS_SUPER_CLIENT=TRUE for all nodes of the mission'
    )


# Name in ROS of a node whose name is not known yet, and of a participant that is no ROS node.
NAMELESS = '_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_'


def full_name(namespace: str, name: str) -> str:
    """Return the full name of a node in a namespace."""
    return f'{namespace.rstrip("/")}/{name}'


def decodable(look: Callable[..., Iterable[Any]]) -> Callable[..., list[Any]]:
    """Wrap a query of the graph: warn and return [] if rclpy cannot decode a name."""

    @wraps(look)
    def found(node: Any, *arguments: object) -> list[Any]:
        # DDS allows any bytes in a name, rclpy only UTF-8.
        try:
            return list(look(node, *arguments))
        except UnicodeDecodeError as error:
            node.refuse_once('the graph', f'the name {error.object[:SHOWN]!r} is not UTF-8')
            return []

    return found


# End of the topic of lanes.
LANE = '/decision/lane'

# Message types that identify nodes by role: of AGENT/path, AGENT/report, belief, AGENT/recorded.
PUBLISHED = {
    'planner': PATH,
    'agent': REPORT,
    'estimator': BELIEF,
    'recorder': RECORDED,
}


def listening_roles(node: Node, topics: Iterable[str]) -> dict[str, set[str]]:
    """Return the names and roles of other nodes that subscribe to each topic."""

    @cache
    def types_published(name: str, namespace: str) -> set[str]:
        # The node may have ended, have no known name yet, or be no ROS node.
        with suppress(RuntimeError):
            published = node.get_publisher_names_and_types_by_node(name, namespace)
            # The lane of an estimator has the type of paths.
            return {
                kind for topic, kinds in published if not topic.endswith(LANE) for kind in kinds
            }
        return set()

    own = node.get_name(), node.get_namespace()
    listening: dict[str, set[str]] = {}
    for topic in topics:
        listening[topic] = set()
        for endpoint in node.get_subscriptions_info_by_topic(topic):
            if (name := (endpoint.node_name, endpoint.node_namespace)) != own:
                types = types_published(*name)
                listening[topic] |= {role for role, kind in PUBLISHED.items() if kind in types}
                listening[topic].add(endpoint.node_name)
    return listening
