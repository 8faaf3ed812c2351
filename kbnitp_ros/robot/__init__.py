# SPDX-License-Identifier: Apache-2.0
"""What a real robot does and remembers of its deployments: no ROS, and one file, its journal."""
