# SPDX-License-Identifier: Apache-2.0
"""The files of a log: parts, schemas, metadata and repair. Knows bags, and nothing of missions."""

from kbnitp_ros.bag.errors import LogError
from kbnitp_ros.bag.lock import LogLock
from kbnitp_ros.bag.log_files import check_is_new, parts_of
from kbnitp_ros.bag.reader import (
    check_readable,
    is_finished,
    log_size,
    LoggedMessage,
    metadata_of_part,
    read_log,
    read_metadata,
    read_recorded,
    Recorded,
    RecordedMessage,
)
from kbnitp_ros.bag.repair import repair
from kbnitp_ros.bag.schema import check_installed, qos_profiles_yaml
from kbnitp_ros.bag.writer import LogWriter, MAX_MESSAGE

__all__ = [
    'MAX_MESSAGE',
    'LogError',
    'LogLock',
    'LogWriter',
    'LoggedMessage',
    'Recorded',
    'RecordedMessage',
    'check_installed',
    'check_is_new',
    'check_readable',
    'is_finished',
    'log_size',
    'metadata_of_part',
    'parts_of',
    'qos_profiles_yaml',
    'read_log',
    'read_metadata',
    'read_recorded',
    'repair',
]
