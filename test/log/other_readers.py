# SPDX-License-Identifier: Apache-2.0
"""Read logs and write bags with the tools of users, and compare the messages."""

import base64
from importlib import import_module
import json
from pathlib import Path
import subprocess
from types import SimpleNamespace
from typing import Any, NamedTuple

from kbnitp_ros.log.files import log_parts
from kbnitp_ros.log.read import read_part, read_recorded, RecordedMessage
from kbnitp_ros.log.schema import describe
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mission_log import same
from rclpy.serialization import deserialize_message
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}

QOS = Qos(
    QosHistory.KEEP_LAST,
    7,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(0, 0),
    QosTime(0, 0),
    QosLiveliness.AUTOMATIC,
    QosTime(0, 0),
    False,
)

NODE = ['node', Path(__file__).with_name('read_mcap.mjs')]


class Read(NamedTuple):
    """A message as a library reads it; None where the library has no value."""

    topic: str
    type_name: str
    log_time: int
    data: bytes
    message: Any
    qos: list
    type_hash: str
    publish_time: int | None = None
    sequence: int | None = None


def with_mcap(path):
    """Yield the messages of a finished file, read by mcap and mcap-ros2-support."""
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for decoded in reader.iter_decoded_messages():
            yield Read(
                decoded.channel.topic,
                decoded.schema.name,
                decoded.message.log_time,
                decoded.message.data,
                decoded.decoded_message,
                yaml.safe_load(decoded.channel.metadata['offered_qos_profiles']),
                decoded.channel.metadata['topic_type_hash'],
                decoded.message.publish_time,
                decoded.message.sequence,
            )


def with_node(path):
    """Yield the messages of a finished file, read by @mcap/core and Foxglove's libraries."""

    def exact(fields):
        return int(fields['bigint']) if 'bigint' in fields else SimpleNamespace(**fields)

    done = subprocess.run([*NODE, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines():
        read = json.loads(line, object_hook=exact)
        yield Read(
            read.topic,
            read.type_name,
            read.log_time,
            base64.b64decode(read.data),
            read.message,
            yaml.safe_load(read.metadata.offered_qos_profiles),
            read.metadata.topic_type_hash,
            read.publish_time,
            read.sequence,
        )


def deserialized(store, data, type_name):
    definition = store.get_msgdef(type_name)
    message, end = definition.deserialize_cdr_le(data[4:], 0, definition.cls, store)
    assert len(data) - 4 - end < 24
    return message


def with_rosbags(path):
    """Yield the messages of a finished file, or of a bag's folder, read by rosbags."""
    with Reader(path) as reader:
        store = get_typestore(Stores.EMPTY)
        for connection in reader.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, time, data in reader.messages():
            yield Read(
                connection.topic,
                connection.msgtype,
                time,
                data,
                deserialized(store, data, connection.msgtype),
                [plain(profile) for profile in connection.ext.offered_qos_profiles],
                connection.digest or store.hash_rihs01(connection.msgtype),
            )


def plain(qos):
    """Return a QoS profile of rosbags in the notation of a file."""

    def duration(time):
        return {'sec': time.sec, 'nsec': time.nsec}

    return {
        'history': qos.history.name.lower(),
        'depth': qos.depth,
        'reliability': qos.reliability.name.lower(),
        'durability': qos.durability.name.lower(),
        'deadline': duration(qos.deadline),
        'lifespan': duration(qos.lifespan),
        'liveliness': qos.liveliness.name.lower(),
        'liveliness_lease_duration': duration(qos.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': qos.avoid_ros_namespace_conventions,
    }


def check_same(read, written):
    """Check that a library read all written messages, field by field."""
    read = sorted(read, key=lambda each: (each.log_time, each.topic, each.data))
    written = [each for each in written if isinstance(each, RecordedMessage)]
    written.sort(key=lambda each: (each.log_time, each.channel.topic, each.data))
    assert len(read) == len(written)
    for one, original in zip(read, written):
        assert (one.topic, one.type_name) == (original.channel.topic, original.schema.name)
        assert (one.log_time, one.data) == (original.log_time, original.data)
        assert one.publish_time in (None, original.publish_time)
        assert one.sequence in (None, original.sequence)
        assert one.qos == yaml.safe_load(original.channel.metadata['offered_qos_profiles'])
        assert one.type_hash == describe(one.type_name)[1]
        package, kind, name = one.type_name.split('/')
        message_class = getattr(import_module(f'{package}.{kind}'), name)
        assert same(one.message, deserialize_message(original.data, message_class))


def check_all_read(log):
    """Check that all libraries read a whole log: each file singly, and the folder as a bag."""
    for part in log_parts(log):
        for library in (with_mcap, with_node, with_rosbags):
            check_same(library(part), read_part(part))
    check_same(with_rosbags(log.parent), read_recorded(log))


def write_bag(folder, sent, storage='mcap', version=9, compression=None):
    """Write a bag by rosbags, with a version of rosbag2's metadata and a compression."""
    writer = Writer(folder, version=version, storage_plugin=STORAGES[storage])
    if compression:
        writer.set_compression(*compression)
    with writer as bag:
        connections = {}
        for message in sent:
            if message.topic not in connections:
                definition, type_hash = describe(message.type_name)
                connections[message.topic] = bag.add_connection(
                    message.topic,
                    message.type_name,
                    msgdef=definition,
                    rihs01=type_hash,
                    offered_qos_profiles=[QOS],
                )
            bag.write(connections[message.topic], message.time + 500, message.data)
    return folder
