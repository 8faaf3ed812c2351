# SPDX-License-Identifier: Apache-2.0
"""Open files that have an end."""

from __future__ import annotations

import errno
import os
from pathlib import Path
import stat
from typing import BinaryIO

FILE_TYPES = {
    stat.S_IFDIR: 'a folder',
    stat.S_IFIFO: 'a pipe',
    stat.S_IFCHR: 'a device',
    stat.S_IFBLK: 'a device',
}


def open_file(path: str | Path) -> BinaryIO:
    """
    Open a regular file, or a link to one, to read its bytes.

    Raises
    ------
    OSError
        If it cannot be opened, or is something else: a pipe might never say anything, a device
        never end.

    """
    # Without O_NONBLOCK a pipe is waited for until someone writes to it.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    file_type = stat.S_IFMT(os.fstat(descriptor).st_mode)
    if file_type != stat.S_IFREG:
        os.close(descriptor)
        raise OSError(
            errno.EINVAL, f'it is {FILE_TYPES.get(file_type, "no file")}, not a file', str(path)
        )
    return os.fdopen(descriptor, 'rb')
