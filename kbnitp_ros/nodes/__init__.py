# SPDX-License-Identifier: Apache-2.0
"""The four nodes of a mission: thin rclpy shells over core and messages."""
