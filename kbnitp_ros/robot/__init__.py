# SPDX-License-Identifier: Apache-2.0
"""Deployments, walk and position of a real robot, without ROS; writes only the journal."""
