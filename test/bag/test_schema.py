# SPDX-License-Identifier: Apache-2.0
"""How topics are described in a log."""

from pathlib import Path
import shutil

from ament_index_python import packages
from ament_index_python.packages import get_package_share_directory
from kbnitp_ros.log.schema import describe, qos_profiles_yaml
from laws import for_each
import pytest
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml

TYPES = [
    'builtin_interfaces/msg/Time',
    'diagnostic_msgs/msg/DiagnosticArray',
    'kbnitp_msgs/msg/BeliefMaps',
    'kbnitp_msgs/msg/DeploymentReport',
    'nav_msgs/msg/OccupancyGrid',
    'nav_msgs/msg/Path',
    'rosgraph_msgs/msg/Clock',
    'visualization_msgs/msg/Marker',
]


def referenced(field):
    """Yield the message types in a field's description by rosbags."""
    kind, content = field
    if kind is Nodetype.NAME:
        yield content
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from referenced(content[0])


@for_each('type_name', TYPES)
def test_a_definition_is_complete(type_name):
    types = get_types_from_msg(describe(type_name).definition, type_name)
    fields = [field for _, definition in types.values() for _, field in definition]
    assert types.keys() == {type_name, *(name for field in fields for name in referenced(field))}


@for_each('type_name', TYPES)
def test_the_hash_is_that_of_the_definition(type_name):
    """As computed by another implementation of REP-2011, from the text that is recorded."""
    store = get_typestore(Stores.EMPTY)
    description = describe(type_name)
    store.register(get_types_from_msg(description.definition, type_name))
    assert description.type_hash == store.hash_rihs01(type_name)


@for_each('type_name', ['no_such_msgs/msg/Path', 'nav_msgs/msg/NoSuchType'])
def test_a_type_that_is_not_installed_is_no_topic(type_name):
    with pytest.raises(LookupError):
        describe(type_name)


def test_a_type_that_is_defined_in_idl_alone_is_no_topic(tmp_path, monkeypatch):
    described = Path(get_package_share_directory('std_msgs'), 'msg', 'String.json')
    (tmp_path / 'msg').mkdir()
    shutil.copy(described, tmp_path / 'msg')
    monkeypatch.setattr(packages, 'get_package_share_directory', lambda _: tmp_path)
    with pytest.raises(LookupError, match=r'type std_msgs/msg/String is not inst.*String\.msg'):
        describe('std_msgs/msg/String')


def test_all_nine_policies_are_listed_for_every_publisher():
    profiles = [
        QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=42,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
            deadline=Duration(seconds=1, nanoseconds=2),
            lifespan=Duration(seconds=3, nanoseconds=4),
            liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
            liveliness_lease_duration=Duration(seconds=5, nanoseconds=6),
            avoid_ros_namespace_conventions=True,
        ),
        QoSProfile(
            history=HistoryPolicy.KEEP_ALL,
            reliability=ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.VOLATILE,
        ),
    ]
    first, second = yaml.safe_load(qos_profiles_yaml(profiles))
    assert first == {
        'history': 'keep_last',
        'depth': 42,
        'reliability': 'reliable',
        'durability': 'transient_local',
        'deadline': {'sec': 1, 'nsec': 2},
        'lifespan': {'sec': 3, 'nsec': 4},
        'liveliness': 'manual_by_topic',
        'liveliness_lease_duration': {'sec': 5, 'nsec': 6},
        'avoid_ros_namespace_conventions': True,
    }
    assert first.keys() == second.keys()
    assert (second['history'], second['reliability'], second['durability']) == (
        'keep_all',
        'best_effort',
        'volatile',
    )
