# SPDX-License-Identifier: Apache-2.0
"""A participant in the mission's network that is no ROS node: Cyclone DDS only."""

# No annotations from __future__: Cyclone DDS evaluates them.

import ctypes
from dataclasses import dataclass
from functools import cache
import gc

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

# Same as config/loopback.xml for Fast DDS: this machine only, no multicast.
LOOPBACK = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <LeaseDuration>1s</LeaseDuration>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>31</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>
"""

LATCHED = Qos(Policy.Durability.TransientLocal, Policy.Reliability.Reliable(0))

# Type names on the wire that belong to no message.
HOSTILE = (
    'unittest::__main__::dds_::X_',
    'planted::msg::dds_::X_',
    'planted::x::dds_::Y_',
    'planted::srv::dds_::X_',
    'this::msg::dds_::X_',
    'antigravity::x::dds_::X_',
    'os::path::dds_::join_',
    'planted.msg::msg::dds_::X_',
    'std_msgs.msg::msg::dds_::String_',
    '..::msg::dds_::X_',
    '..::..::dds_::X_',
    '::msg::dds_::X_',
    '/etc/passwd',
    'std_msgs::msg::dds_::__builtins___',
    'std_msgs::msg::dds_::String.__init___',
    'std_msgs::..::dds_::String_',
    'std_srvs::srv::dds_::Empty_Request_',
    'ünïcode::msg::dds_::X_',
    '::::',
    'x' * 200 + '::msg::dds_::' + 'Y' * 30 + '_',
)


class BareParticipant:
    """Announces writers with names that rclpy refuses."""

    def __init__(self, domain):
        # A separate DDS domain entity in this process, with the same number.
        self._domain = Domain(domain, LOOPBACK)
        self._participant = DomainParticipant(domain)
        self._writers = []

    def announce(self, topic, type_name, type_hash=''):
        text = text_type(type_name)
        # As a node of ROS states the hash of a message's type.
        stated = Qos(Policy.Userdata(f'typehash={type_hash};'.encode()), base=LATCHED)
        qos = stated if type_hash else LATCHED
        writer = DataWriter(self._participant, Topic(self._participant, topic, text), qos=qos)
        writer.write(text(data='x'))
        self._writers.append(writer)

    def leave(self):
        self._writers.clear()
        self._participant = self._domain = None
        gc.collect()


@cache
def text_type(type_name):
    """Return a type of this name that holds a text."""

    @dataclass
    class Text(IdlStruct, typename=type_name):
        data: str

    return Text


def not_utf8(text):
    """Return a text that ends in é; passed to C it ends in two bytes FF."""
    size = ctypes.c_ssize_t()
    utf8 = ctypes.pythonapi.PyUnicode_AsUTF8AndSize
    utf8.restype, utf8.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_void_p]
    start = utf8(text, ctypes.byref(size))
    ctypes.memset(start + size.value - 2, 0xFF, 2)
    return text
