# SPDX-License-Identifier: Apache-2.0
"""Bags in rosbag2's own form, made by rosbags."""

from kbnitp_ros.log.schema import describe
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer

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


def write_bag(folder, sent, storage='mcap', version=9, compression=None):
    """Write messages to a bag, in a version of rosbag2's metadata, with rosbags' compression."""
    writer = Writer(folder, version=version, storage_plugin=STORAGES[storage])
    if compression:
        writer.set_compression(*compression)
    with writer as bag:
        connections = {}
        for each in sent:
            if each.topic not in connections:
                description = describe(each.type_name)
                connections[each.topic] = bag.add_connection(
                    each.topic,
                    each.type_name,
                    msgdef=description.definition,
                    rihs01=description.type_hash,
                    offered_qos_profiles=[QOS],
                )
            bag.write(connections[each.topic], each.time + 500, each.data)
    return folder
