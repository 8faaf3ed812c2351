# SPDX-License-Identifier: Apache-2.0
"""The laws that every method, planner and allocation keeps, to be run on one of your own."""

from kbnitp_ros.testing.methods import check_method

__all__ = ['check_method']
