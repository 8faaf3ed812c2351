# SPDX-License-Identifier: Apache-2.0
"""The nodes of a mission: what they do over ROS with what core, base and robot compute."""
