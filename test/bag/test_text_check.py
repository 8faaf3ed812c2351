# SPDX-License-Identifier: Apache-2.0
"""What other readers could not read is told before it is written."""

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.bag.text_check import check_texts
from laws import for_each
from nav_msgs.msg import Path
import pytest
from rclpy.serialization import serialize_message

REPORT = DeploymentReport(agent='scout_1')


@for_each('message', [REPORT, DeploymentReport(agent='é'), Path(), BeliefMaps(joint=[0.25] * 4)])
def test_what_can_be_read_is_taken(message):
    package = type(message).__module__.split('.')[0]
    check_texts(f'{package}/msg/{type(message).__name__}', serialize_message(message))


@for_each('text', [b'scout_\xff', b's\0out_1', b'scou\xc0\x801'])
def test_a_text_that_is_not_utf_8_is_refused(text):
    data = serialize_message(REPORT).replace(b'scout_1', text[:7].ljust(7, b'1'))
    if b'\0o' in text:
        check_texts('kbnitp_msgs/msg/DeploymentReport', data)
        return
    with pytest.raises(ValueError, match='a text that is not UTF-8'):
        check_texts('kbnitp_msgs/msg/DeploymentReport', data)


# Without `source`, its last byte, and much earlier; four bytes follow that pad it.
@for_each('end', [56, 20, 4])
def test_a_message_that_ends_too_early_is_refused(end):
    data = serialize_message(REPORT)[:end]
    with pytest.raises(ValueError, match='it is not of the type kbnitp_msgs/msg/Deployment'):
        check_texts('kbnitp_msgs/msg/DeploymentReport', data)
