# SPDX-License-Identifier: Apache-2.0
"""Write the mission log: an MCAP file as rosbag2 and its relatives expect it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import os
from pathlib import Path
from types import TracebackType

from kbnitp_ros.log.schema import describe, TypeDescription
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer
import yaml

# rosbag2's metadata version of ROS 2 Jazzy, where a topic's QoS is a list and policies have names.
BAG_VERSION = 9


@dataclass
class Topic:
    """A topic on record and how many messages it has."""

    name: str
    type_name: str
    type_hash: str
    qos_profiles_yaml: str
    channel: int
    messages: int = 0


class LogWriter:
    """
    Writes messages, as the bytes that came off the wire, to a new MCAP file.

    Messages are collected in chunks. After `sync` all that was written is on the disk and stays
    readable whatever happens to the process or the machine; `close` makes the file a finished one,
    with indexes. Used in a ``with`` statement it closes itself.

    Parameters
    ----------
    path : str or Path
        The file to make.

    Raises
    ------
    OSError
        If there is such a file already, its folder is missing, or the disk refuses; also from all
        methods that write.

    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._file = self.path.open('xb')
        self._writer = Writer(self._file, compression=CompressionType.NONE)
        self._writer.start(Profile.ROS2, f'kbnitp_ros, {LIBRARY_IDENTIFIER}')
        self._types: dict[str, tuple[int, TypeDescription]] = {}
        self._topics: dict[str, Topic] = {}
        self._first = self._last = 0
        self.sync()
        sync_folder(self.path.parent)

    def add_topic(self, topic: str, type_name: str, qos_profiles_yaml: str) -> None:
        """
        Put a topic on record; each is added before its first message.

        Parameters
        ----------
        topic : str
            Its full name.
        type_name : str
            Its message type, such as 'nav_msgs/msg/Path'. It must be installed.
        qos_profiles_yaml : str
            What its publishers offer, as `schema.qos_profiles_yaml` puts it.

        Raises
        ------
        LookupError
            If the type's package is not installed.

        """
        if type_name not in self._types:
            description = describe(type_name)
            schema = self._writer.register_schema(
                type_name, SchemaEncoding.ROS2, description.definition.encode()
            )
            self._types[type_name] = schema, description
        schema, description = self._types[type_name]
        channel = self._writer.register_channel(
            topic,
            MessageEncoding.CDR,
            schema,
            {
                'offered_qos_profiles': qos_profiles_yaml,
                'topic_type_hash': description.type_hash,
            },
        )
        self._topics[topic] = Topic(
            topic, type_name, description.type_hash, qos_profiles_yaml, channel
        )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a record of named values into the file, such as how the run was configured."""
        self._writer.add_metadata(name, dict(values))

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """
        Write a message.

        Parameters
        ----------
        topic : str
            One that was added.
        data : bytes
            The message in CDR, with its encapsulation header.
        log_time, publish_time : int
            When it was received and when it was sent, in nanoseconds.

        """
        entry = self._topics[topic]
        entry.messages += 1
        self._first = min(self._first or log_time, log_time)
        self._last = max(self._last, log_time)
        self._writer.add_message(entry.channel, log_time, data, publish_time, entry.messages)

    def sync(self) -> None:
        """Put everything written so far onto the disk."""
        self._writer.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Finish the file and put it onto the disk."""
        with self._file:
            self.add_metadata(
                'rosbag2',
                {'serialized_metadata': yaml.safe_dump(self._bag_metadata(), sort_keys=False)},
            )
            self._writer.finish()
            self.sync()

    def __enter__(self) -> LogWriter:
        """Return the writer itself."""
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the file, also after an error: what was written is worth having."""
        self.close()

    def _bag_metadata(self) -> dict[str, object]:
        """Return what rosbag2 wants to know of a bag that consists of this file."""
        messages = sum(topic.messages for topic in self._topics.values())
        span = {
            'duration': {'nanoseconds': self._last - self._first},
            'starting_time': {'nanoseconds_since_epoch': self._first},
            'message_count': messages,
        }
        return {
            'version': BAG_VERSION,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': topic.name,
                        'type': topic.type_name,
                        'serialization_format': MessageEncoding.CDR,
                        'offered_qos_profiles': yaml.safe_load(topic.qos_profiles_yaml),
                        'type_description_hash': topic.type_hash,
                    },
                    'message_count': topic.messages,
                }
                for topic in self._topics.values()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self.path.name],
            'files': [{'path': self.path.name, **span}],
            'custom_data': {},
            'ros_distro': os.environ.get('ROS_DISTRO', 'jazzy'),
        }


def sync_folder(folder: Path) -> None:
    """Put onto the disk which files the folder has."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
