# SPDX-License-Identifier: Apache-2.0
"""What a mission's log comes to, for people and for other programs."""

from kbnitp_ros.report.comparison import check_one_field, comparison_of, Pair
from kbnitp_ros.report.folder import check_is_free, PARTS, write_comparison, write_report
from kbnitp_ros.report.mission import DeploymentSummary, Mission, Moment, read_mission
from kbnitp_ros.report.tables import Curves, curves_of

__all__ = [
    'PARTS',
    'Curves',
    'DeploymentSummary',
    'Mission',
    'Moment',
    'Pair',
    'check_is_free',
    'check_one_field',
    'comparison_of',
    'curves_of',
    'read_mission',
    'write_comparison',
    'write_report',
]
