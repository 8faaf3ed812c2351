# SPDX-License-Identifier: Apache-2.0
"""The base without rclpy: its mission, evidence, rounds, and deployments in flight."""
