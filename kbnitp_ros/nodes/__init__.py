# SPDX-License-Identifier: Apache-2.0
"""The nodes of a mission: core, base and robot over ROS."""
