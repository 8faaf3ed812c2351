# SPDX-License-Identifier: Apache-2.0
"""The parts of rclpy that are private or experimental and used here are as they were."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
import rclpy


def test_rclpy_is_of_jazzy():
    text = Path(get_package_share_directory('rclpy'), 'package.xml').read_text()
    assert '<version>7.1.' in text, 'rclpy.experimental may be another'


def test_nodes_hold_what_they_held():
    rclpy.init(args=[])
    node = rclpy.create_node('here')
    assert node._parameter_overrides == {}, 'see nodes/runtime/declared.py'
    node.destroy_node()
    rclpy.try_shutdown()
