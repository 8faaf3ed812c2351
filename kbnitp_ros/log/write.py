# SPDX-License-Identifier: Apache-2.0
"""Write a mission log as an MCAP file for each run; synced messages survive a crash."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
import os
from pathlib import Path

from kbnitp_ros.files import naming, sync_folder, yaml_text
from kbnitp_ros.log.files import (
    check_in_place,
    check_is_new,
    is_later_part,
    log_parts,
    LogError,
    LogLock,
    part_path,
)
from kbnitp_ros.log.read import read_part, RecordedMessage
from kbnitp_ros.log.schema import (
    bag_topic,
    BagFile,
    describe,
    information,
    is_of_another_bag,
    QOS,
    TYPE_HASH,
    write_metadata,
)
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer

# Maximum bytes of a message. A belief over 1000x1000 cells has 56 million bytes.
MAX_MESSAGE = 63 * 2**20

# Maximum bytes of messages in a chunk; a sync ends a chunk earlier.
CHUNK = 2**20


def check_size(data: bytes) -> None:
    """Check that a message is small enough for a log."""
    if len(data) > MAX_MESSAGE:
        raise ValueError(f'it has {len(data)} bytes: at most {MAX_MESSAGE} are recorded')


class LogWriter:
    """
    Writer of CDR messages to a new log, or with `resume` to the next file of an existing log.

    After `sync` all messages written are on the disk. After an OSError the log is closed.
    """

    def __init__(self, path: str | Path, *, resume: bool = False) -> None:
        if resume:
            path = log_parts(path)[0]
            check_goes_on(path)
        else:
            path = Path(path)
            check_is_new(path)
        self.path = self.current_path = path
        self.shares_folder = is_of_another_bag(path.parent, path.name)
        # Files of the log before this one.
        self._earlier: list[BagFile] = []
        if not resume:
            self._open()
        try:
            self._lock = LogLock(path)
        except BaseException:
            if not resume:
                self._abandon()
            raise
        if resume:
            try:
                # A writer that has just ended may have added a file.
                self._earlier = [described(part) for part in log_parts(path)]
                self.current_path = part_path(path, len(self._earlier))
                self._open()
            except BaseException:
                self._lock.release()
                raise

    def _open(self) -> None:
        """Begin the file, which is on the disk before it has a message."""
        path = self.current_path
        # Topics and times of the file.
        self._contents = BagFile(path.name)
        # Number of messages by topic, and metadata by record.
        self._messages: Counter[str] = Counter()
        self._metadata: dict[str, dict[str, str]] = {}
        # Ids of schemas and channels, and the channel of each topic.
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str, str], int] = {}
        self._channel_of: dict[str, int] = {}
        # Bytes passed to the system, and bytes of messages not yet passed.
        self._written = self._pending = 0
        self._file = path.open('xb')
        # Chunks have no limit of their own: `_flush` ends them.
        self._writer = Writer(
            self._file, chunk_size=2**62, compression=CompressionType.NONE, enable_data_crcs=True
        )
        try:
            with naming(path):
                self._writer.start(Profile.ROS2, f'kbnitp_ros, {LIBRARY_IDENTIFIER}')
            self._flush(to_disk=True)
            sync_folder(path.parent)
        except OSError:
            self._abandon()
            path.unlink(missing_ok=True)
            raise

    def add_topic(self, topic: str, type_name: str, qos_profiles_yaml: str) -> None:
        """Add a topic: call this before its first message, and whenever its QoS changes."""
        text, type_hash = describe(type_name)
        key = topic, type_name, qos_profiles_yaml
        with self._writing():
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(
                    type_name, SchemaEncoding.ROS2, text.encode()
                )
            if key not in self._channels:
                metadata = {QOS: qos_profiles_yaml, TYPE_HASH: type_hash}
                self._channels[key] = self._writer.register_channel(
                    topic, MessageEncoding.CDR, self._schemas[type_name], metadata
                )
                self._contents.topics[self._channels[key]] = bag_topic(
                    topic, type_name, MessageEncoding.CDR, metadata
                )
        self._channel_of[topic] = self._channels[key]

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add or change a metadata record."""
        known = self._metadata.get(name, {})
        new = {key: value for key, value in values.items() if known.get(key) != value}
        if new or name not in self._metadata:
            self._metadata[name] = {**known, **values}
            with self._writing(), naming(self.current_path):
                self._writer.add_metadata(name, new)

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Write a message; times are in nanoseconds."""
        check_size(data)
        with self._writing():
            if len(data) > CHUNK:
                # A large message gets its own chunk: a shared chunk could be too large to read.
                self._flush()
            self._messages[topic] += 1
            channel, log_time = self._channel_of[topic], max(log_time, 0)
            self._writer.add_message(
                channel, log_time, data, max(publish_time, 0), self._messages[topic]
            )
            self._contents.count(channel, log_time)
            self._pending += len(data)
            if self._pending > CHUNK:
                self._flush()

    def sync(self) -> None:
        """Put everything written so far onto the disk; raise an OSError if that fails."""
        with self._writing():
            # Checked first: writing after a cut would fill the gap with zeros.
            self._check_size()
            self._flush(to_disk=True)
            self.check_in_place()

    def check_in_place(self) -> None:
        """Check that no file was removed, replaced or cut; raises an OSError."""
        if not self._file.closed:
            check_in_place(self._file, self.current_path)
            self._check_size()
        self._lock.check_in_place()

    def close(self) -> None:
        """Finish the log, with indexes, and put it onto the disk, unless it is closed already."""
        if self._file.closed:
            return
        with self._writing():
            self._flush()
            # The description of a bag, as rosbag2 writes it.
            bag = {'serialized_metadata': yaml_text(information([self._contents]))}
            with naming(self.current_path):
                self._writer.add_metadata('rosbag2', bag)
                self._writer.finish()
            self._flush(to_disk=True)
            self.check_in_place()
            self._file.close()
        files = [*self._earlier, self._contents]
        self.shares_folder = not write_metadata(self.path.parent, files)
        self._lock.release()

    def __enter__(self) -> LogWriter:
        """Return the writer itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the log, also after an error."""
        self.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Abandon the file after an OSError."""
        if self._file.closed:
            raise ValueError(f'{self.path} is closed')
        try:
            yield
        except OSError:
            self._abandon()
            self._lock.release()
            raise

    def _flush(self, *, to_disk: bool = False) -> None:
        """Pass written messages to the system, where they survive the end of the process."""
        with naming(self.current_path):
            self._writer.flush()
            self._file.flush()
            self._written, self._pending = self._file.tell(), 0
            if to_disk:
                # Unlike fsync, this does not sync the times of the file.
                os.fdatasync(self._file.fileno())

    def _check_size(self) -> None:
        size = os.fstat(self._file.fileno()).st_size
        if size < self._written:
            raise OSError(
                f'{self.current_path} was cut to {size} of the {self._written} bytes written: '
                'exclude it from the rotation of logs'
            )

    def _abandon(self) -> None:
        """Close the unfinished file, cut to its size at the last flush; raise nothing."""
        with suppress(OSError):
            os.ftruncate(self._file.fileno(), self._written)
        with suppress(OSError):
            # Closing the buffer would write again.
            self._file.raw.close()


def check_goes_on(first: Path) -> None:
    """Check that a file is the first file of a log that can be resumed."""
    if is_later_part(first):
        raise LogError(f'{first} is a later part of a log: name its first file')
    if first.suffix != '.mcap':
        raise LogError(f'{first} is no MCAP file: only a log in MCAP files can be resumed')


def described(part: Path) -> BagFile:
    """Return the topics and times of an earlier file, which may be cut, but not corrupt."""
    contents = BagFile(part.name)
    for item in read_part(part):
        if isinstance(item, RecordedMessage):
            channel = item.channel
            if channel.id not in contents.topics:
                contents.topics[channel.id] = bag_topic(
                    channel.topic, item.schema.name, channel.message_encoding, channel.metadata
                )
            contents.count(channel.id, item.log_time)
    return contents
