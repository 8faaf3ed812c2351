# SPDX-License-Identifier: Apache-2.0
"""The files of a log: parts, schemas, metadata and repair. Knows bags, and nothing of missions."""

from kbnitp_ros.log.bag.errors import LogError, same_types
from kbnitp_ros.log.bag.legible import check_texts
from kbnitp_ros.log.bag.lock import LogLock
from kbnitp_ros.log.bag.parts import check_is_new, parts_of
from kbnitp_ros.log.bag.reader import is_finished, log_size, LoggedMessage, read_log, read_metadata
from kbnitp_ros.log.bag.recorded import Recorded
from kbnitp_ros.log.bag.repair import repair
from kbnitp_ros.log.bag.schema import qos_profiles_yaml
from kbnitp_ros.log.bag.writer import LogWriter

__all__ = [
    'LogError',
    'LogLock',
    'LogWriter',
    'LoggedMessage',
    'Recorded',
    'check_is_new',
    'check_texts',
    'is_finished',
    'log_size',
    'parts_of',
    'qos_profiles_yaml',
    'read_log',
    'read_metadata',
    'repair',
    'same_types',
]
