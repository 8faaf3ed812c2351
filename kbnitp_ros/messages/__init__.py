# SPDX-License-Identifier: Apache-2.0
"""Conversions between ROS messages and the core, one module per subject."""
