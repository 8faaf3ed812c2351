# SPDX-License-Identifier: Apache-2.0
"""Message types and metadata of MCAP files, as rosbag2 expects them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
from typing import Any

from kbnitp_ros.files import naming, parse_yaml, sync_folder, yaml_text
from kbnitp_ros.log.files import INFORMATION, METADATA, read_information

# Keys of the metadata of a channel.
QOS = 'offered_qos_profiles'
TYPE_HASH = 'topic_type_hash'

# The resource of the ament index in which a package lists its interfaces, one a line.
INTERFACES = 'rosidl_interfaces'


def check_installed(type_name: str) -> None:
    """Check that the ament index lists a message type."""
    package, _, interface = type_name.partition('/')
    # Imported here, since only writers of logs need it.
    from ament_index_python.resources import get_resource, get_resources

    listed: list[str] = []
    if interface.startswith('msg/') and package in get_resources(INTERFACES):
        listed = get_resource(INTERFACES, package)[0].splitlines()
    if f'{interface}.msg' not in listed:
        raise LookupError(
            f'type {type_name!r} is not installed: no package of the ament index lists it '
            'among its messages'
        )


def describe(type_name: str) -> tuple[str, str]:
    """Return the definition of an installed type, with the types of its fields, and its hash."""
    check_installed(type_name)
    description = json.loads(installed_text(type_name, 'json'))
    hashes = {entry['type_name']: entry['hash_string'] for entry in description['type_hashes']}
    message = description['type_description_msg']
    sections = [installed_text(type_name, 'msg')]
    for referenced in message['referenced_type_descriptions']:
        text = installed_text(referenced['type_name'], 'msg')
        short_name = referenced['type_name'].replace('/msg/', '/')
        sections.append(f'{"=" * 80}\nMSG: {short_name}\n{text}')
    # The REP-2011 hash: 'RIHS01_' and 64 hex digits.
    return '\n'.join(sections), hashes[type_name]


def installed_text(type_name: str, suffix: str) -> str:
    """Return the installed definition of a message type in the format 'msg' or 'json'."""
    from ament_index_python.packages import get_package_share_directory

    package, kind, name = type_name.split('/')
    try:
        return Path(get_package_share_directory(package), kind, f'{name}.{suffix}').read_text()
    except OSError as error:
        raise LookupError(f'type {type_name} is not installed: {error}') from error


def qos_profiles_yaml(profiles: Iterable[Any]) -> str:
    """Return the QoS of a topic's publishers, in rosbag2's format."""

    def duration(value: Any) -> dict[str, int]:
        seconds, nanoseconds = divmod(value.nanoseconds, 10**9)
        return {'sec': seconds, 'nsec': nanoseconds}

    return yaml_text(
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
        ]
    )


# rosbag2's metadata version of ROS 2 Jazzy, where a topic's QoS is a list and policies have names.
VERSION = 9


# A topic with one QoS, as in rosbag2: message_count, and topic_metadata with name, type,
# serialization_format, offered_qos_profiles and type_description_hash.
BagTopic = dict[str, Any]


def bag_topic(name: str, type_name: str, encoding: str, metadata: Mapping[str, str]) -> BagTopic:
    """Return a topic without messages, from the metadata of its channel."""
    qos: object = []
    with suppress(ValueError):
        qos = parse_yaml(metadata.get(QOS, '')) or []
    described = {
        'name': name,
        'type': type_name,
        'serialization_format': encoding,
        'offered_qos_profiles': qos,
        'type_description_hash': metadata.get(TYPE_HASH, ''),
    }
    return {'topic_metadata': described, 'message_count': 0}


@dataclass
class BagFile:
    """A description of a file of a bag: its topics and times."""

    name: str
    # By id of the channel.
    topics: dict[int, BagTopic] = field(default_factory=dict)
    # Times of the first and last message, nanoseconds. Without messages the first is the largest
    # possible time and the last is 0.
    first: int = 2**63 - 1
    last: int = 0

    def count(self, channel: int, time: int) -> None:
        """Count a message of a channel."""
        self.topics[channel]['message_count'] += 1
        self.first, self.last = min(self.first, time), max(self.last, time)

    @property
    def messages(self) -> int:
        """Return the number of messages in the file."""
        return sum(topic['message_count'] for topic in self.topics.values())


def information(files: Sequence[BagFile]) -> dict[str, Any]:
    """Return the description of a bag of these files."""
    first, last = min(file.first for file in files), max(file.last for file in files)
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        **span(first, last, sum(file.messages for file in files)),
        'topics_with_message_count': merged(files),
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [
            {'path': file.name, **span(file.first, file.last, file.messages)} for file in files
        ],
        'custom_data': {},
        'ros_distro': os.environ.get('ROS_DISTRO', 'jazzy'),
    }


def span(first: int, last: int, messages: int) -> dict[str, Any]:
    """Return the start, the duration and the number of messages of a bag or a file."""
    start = min(first, last)
    return {
        'duration': {'nanoseconds': last - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': messages,
    }


def merged(files: Sequence[BagFile]) -> list[BagTopic]:
    """Return the topics of all files; a topic appears once for each QoS."""
    topics: dict[str, BagTopic] = {}
    for topic in (topic for file in files for topic in file.topics.values()):
        same = topics.setdefault(repr(topic['topic_metadata']), {**topic, 'message_count': 0})
        same['message_count'] += topic['message_count']
    return [*topics.values()]


def write_metadata(folder: Path, files: Sequence[BagFile]) -> bool:
    """Write metadata.yaml, unless it describes another bag; return whether it was written."""
    if is_of_another_bag(folder, files[0].name):
        return False
    target = folder / METADATA
    # Another log in the folder may be finished at the same time.
    new = target.with_name(f'{files[0].name}.{METADATA}.new')
    try:
        with naming(new), new.open('w') as file:
            file.write(yaml_text({INFORMATION: information(files)}))
            file.flush()
            os.fsync(file.fileno())
        new.replace(target)
    except BaseException:
        new.unlink(missing_ok=True)
        raise
    sync_folder(folder)
    return True


def is_of_another_bag(folder: Path, first: str) -> bool:
    """Return whether metadata.yaml in the folder describes a bag with another first file."""
    listed = read_information(folder).get('relative_file_paths')
    if not isinstance(listed, list) or listed[:1] == [first]:
        return False
    # If all listed files are missing, their log was renamed.
    return any((folder / str(name)).exists() for name in listed)
