# SPDX-License-Identifier: Apache-2.0
"""The base's knowledge of a mission, and the plans of its rounds; no rclpy."""
