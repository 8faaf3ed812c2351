# SPDX-License-Identifier: Apache-2.0
"""What the ROS messages mean: conversions between them and the core, one module a subject."""
