# SPDX-License-Identifier: Apache-2.0
"""Write a mission log as MCAP files; synced messages survive a crash."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from kbnitp_ros.log.files import (
    check_is_new,
    is_later_part,
    log_parts,
    LogError,
    LogLock,
    part_path,
)
from kbnitp_ros.log.mcap_file import COMPRESSIONS, Definition, FileWriter, finished
from kbnitp_ros.log.schema import (
    BagFile,
    describe,
    is_of_another_bag,
    QOS,
    TYPE_HASH,
    write_metadata,
)
from mcap.well_known import MessageEncoding, SchemaEncoding

# Maximum bytes of a message. A belief over 1000x1000 cells has 56 million bytes.
MAX_MESSAGE = 63 * 2**20


class LogWriter:
    """
    Writer of CDR messages to a new log, or with `resume` to a new part of an existing log.

    After `sync` all messages written are on the disk. After an OSError the log is closed.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        resume: bool = False,
        compression: str = 'none',
        max_file_size: int = 0,
        max_file_duration: float = 0.0,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise ValueError(f'compression is {compression!r}: it must be none or zstd')
        self._compression = compression
        self._max_size = max_file_size or 2**63
        self._max_duration = round(max_file_duration * 1e9) or 2**63
        # Definition of the type, and metadata of the channel, by topic.
        self._topics: dict[str, tuple[Definition, dict[str, str]]] = {}
        # Ids of the channels in the current part.
        self._channels: dict[str, int] = {}
        # Number of messages written by topic, over all parts.
        self._messages: Counter[str] = Counter()
        self._metadata: dict[str, dict[str, str]] = {}
        self._finished: list[BagFile] = []
        self._number = 0
        if resume:
            parts = log_parts(path)
            self.path = parts[0]
            check_goes_on(self.path)
            self.shares_folder = is_of_another_bag(self.path.parent, self.path.name)
            self._lock = LogLock(self.path)
            try:
                # A writer that has just ended may have added a part.
                parts = log_parts(path)
                self._finished = [finished(part, compression, self._lock) for part in parts]
                self._number = len(parts)
                self.current_path = part_path(self.path, self._number)
                part = FileWriter(self.current_path, compression)
            except BaseException:
                self._lock.release()
                raise
        else:
            self.path = self.current_path = Path(path)
            check_is_new(self.path)
            self.shares_folder = is_of_another_bag(self.path.parent, self.path.name)
            part = FileWriter(self.path, compression)
            try:
                self._lock = LogLock(self.path)
            except BaseException:
                part.abandon()
                raise
        self._part: FileWriter | None = part

    def add_topic(self, topic: str, type_name: str, qos_profiles_yaml: str) -> None:
        """Add a topic: call this before its first message, and whenever its QoS changes."""
        text, type_hash = describe(type_name)
        definition = type_name, SchemaEncoding.ROS2, text.encode()
        self._topics[topic] = definition, {QOS: qos_profiles_yaml, TYPE_HASH: type_hash}
        self._add_channel(topic)

    def _add_channel(self, topic: str) -> None:
        """Add a topic to the current part."""
        with self._writing() as part:
            self._channels[topic] = part.add_channel(
                topic, MessageEncoding.CDR, *self._topics[topic]
            )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add or change a metadata record, in this file and all later files."""
        known = self._metadata.get(name, {})
        new = {key: value for key, value in values.items() if known.get(key) != value}
        if name in self._metadata and not new:
            return
        self._metadata[name] = {**known, **values}
        with self._writing() as part:
            part.add_metadata(name, new)

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Write a message."""
        if len(data) > MAX_MESSAGE:
            raise ValueError(
                f'a message of topic {topic} has {len(data)} bytes: at most {MAX_MESSAGE} are '
                'written'
            )
        with self._writing() as part:
            contents = part.contents
            self._messages[topic] += 1
            if contents.last and (
                part.size - part.preamble >= self._max_size
                or log_time - contents.first >= self._max_duration
            ):
                part = self._next_part()
            channel, number = self._channels[topic], self._messages[topic]
            part.write(channel, data, max(log_time, 0), max(publish_time, 0), number)

    def sync(self) -> None:
        """Put everything written so far onto the disk."""
        with self._writing() as part:
            part.sync()
            self._lock.check_in_place()

    def check_in_place(self) -> None:
        """Check that the log was not removed or replaced; raises FileNotFoundError."""
        if self._part is not None:
            self._part.check_in_place()
        self._lock.check_in_place()

    def close(self) -> None:
        """Finish the log and put it onto the disk, unless it is closed already."""
        if self._part is None:
            return
        self._finish_part()
        self._part = None
        self._lock.release()

    def __enter__(self) -> LogWriter:
        """Return the writer itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the log, also after an error."""
        self.close()

    @contextmanager
    def _writing(self) -> Iterator[FileWriter]:
        """Yield the current part; after an OSError, abandon it."""
        if self._part is None:
            raise ValueError(f'{self.path} is closed')
        try:
            yield self._part
        except OSError:
            if self._part is not None:
                self._part.abandon()
                self._part = None
                self._lock.release()
            raise

    def _next_part(self) -> FileWriter:
        """Start another file, which can be read without the earlier files."""
        self._finish_part()
        self._number += 1
        self.current_path = part_path(self.path, self._number)
        self._part = FileWriter(self.current_path, self._compression)
        for name, values in self._metadata.items():
            self._part.add_metadata(name, values)
        for topic in self._topics:
            self._add_channel(topic)
        return self._part

    def _finish_part(self) -> None:
        with self._writing() as part:
            part.finish()
            self._finished.append(part.contents)
            self.shares_folder = not write_metadata(self.path.parent, self._finished)


def check_goes_on(first: Path) -> None:
    """Check that a file is the first file of a log that can be resumed."""
    if is_later_part(first):
        raise LogError(f'{first} is a later part of a log: name its first file')
    if first.suffix != '.mcap':
        raise LogError(f'{first} is no MCAP file: only a log in MCAP files can be resumed')
