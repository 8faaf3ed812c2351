# SPDX-License-Identifier: Apache-2.0
"""Laws that every method, planner and allocation obeys, as checks for plug-ins."""

from kbnitp_ros.testing.allocations import check_allocation
from kbnitp_ros.testing.methods import check_method
from kbnitp_ros.testing.planners import check_planner

__all__ = ['check_allocation', 'check_method', 'check_planner']
