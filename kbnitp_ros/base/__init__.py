# SPDX-License-Identifier: Apache-2.0
"""What the base knows of a mission, and how it plans the next robots; no rclpy."""
