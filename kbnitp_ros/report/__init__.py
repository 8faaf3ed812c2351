# SPDX-License-Identifier: Apache-2.0
"""What a mission's log comes to, for people and for other programs."""

from kbnitp_ros.report.curves import Curves, curves_of
from kbnitp_ros.report.folder import check_is_free, PARTS, write_report
from kbnitp_ros.report.mission import Mission, Moment, read_mission, Sortie

__all__ = [
    'PARTS',
    'Curves',
    'Mission',
    'Moment',
    'Sortie',
    'check_is_free',
    'curves_of',
    'read_mission',
    'write_report',
]
