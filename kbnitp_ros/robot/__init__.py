# SPDX-License-Identifier: Apache-2.0
"""A real robot's deployments, walk and whereabouts, without ROS; its one file is the journal."""
