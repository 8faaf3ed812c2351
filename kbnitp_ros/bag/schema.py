# SPDX-License-Identifier: Apache-2.0
"""How topics are described in a log: their type's definition and hash, and the QoS offered."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

import yaml

ENCODING = 'ros2msg'

# Metadata of a channel.
QOS = 'offered_qos_profiles'
TYPE_HASH = 'topic_type_hash'

SEPARATOR = '=' * 80

# The resource of the ament index in which a package lists its interfaces, one a line.
INTERFACES = 'rosidl_interfaces'


@dataclass(frozen=True)
class TypeDescription:
    """What a reader needs to know of a message type."""

    # The type's definition, then that of every type it refers to, directly or not.
    definition: str
    # REP-2011 hash, 'RIHS01_' and 64 hex digits.
    type_hash: str


def check_installed(type_name: str) -> None:
    """Check that the ament index lists a message type."""
    package, _, interface = type_name.partition('/')
    # Only who writes a log needs to know what is installed.
    from ament_index_python.resources import get_resource, get_resources

    listed: list[str] = []
    if interface.startswith('msg/') and package in get_resources(INTERFACES):
        listed = get_resource(INTERFACES, package)[0].splitlines()
    if f'{interface}.msg' not in listed:
        raise LookupError(
            f'type {type_name!r} is not installed: no package of the ament index lists it '
            'among its messages'
        )


def describe(type_name: str) -> TypeDescription:
    """Return the description of an installed message type."""
    check_installed(type_name)
    description = json.loads(installed_text(type_name, 'json'))
    hashes = {entry['type_name']: entry['hash_string'] for entry in description['type_hashes']}
    message = description['type_description_msg']
    sections = [installed_text(type_name, 'msg')]
    for referenced in message['referenced_type_descriptions']:
        text = installed_text(referenced['type_name'], 'msg')
        short_name = referenced['type_name'].replace('/msg/', '/')
        sections.append(f'{SEPARATOR}\nMSG: {short_name}\n{text}')
    return TypeDescription('\n'.join(sections), hashes[type_name])


def installed_text(type_name: str, suffix: str) -> str:
    """Return what is installed of a message type, as 'msg' or as 'json'."""
    from ament_index_python.packages import get_package_share_directory

    package, kind, name = type_name.split('/')
    try:
        return Path(get_package_share_directory(package), kind, f'{name}.{suffix}').read_text()
    except OSError as error:
        raise LookupError(f'type {type_name} is not installed: {error}') from error


def qos_profiles_yaml(profiles: Iterable[Any]) -> str:
    """Return the QoS that a topic's publishers offer, as rosbag2 keeps it with a topic."""

    def duration(value: Any) -> dict[str, int]:
        seconds, nanoseconds = divmod(value.nanoseconds, 10**9)
        return {'sec': seconds, 'nsec': nanoseconds}

    text: str = yaml.safe_dump(
        [
            {
                'history': profile.history.name.lower(),
                'depth': profile.depth,
                'reliability': profile.reliability.name.lower(),
                'durability': profile.durability.name.lower(),
                'deadline': duration(profile.deadline),
                'lifespan': duration(profile.lifespan),
                'liveliness': profile.liveliness.name.lower(),
                'liveliness_lease_duration': duration(profile.liveliness_lease_duration),
                'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
            }
            for profile in profiles
        ],
        sort_keys=False,
    )
    return text
