# SPDX-License-Identifier: Apache-2.0
"""One process at a time writes a log: it holds a lock on the log's first file."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import IO

from kbnitp_ros.bag.errors import LogError


class LogLock:
    """Keeps all other processes from writing a log."""

    def __init__(self, first: Path) -> None:
        self.path = first
        self._file = locked(first)
        try:
            # Who held the lock until now may have put another file in its place.
            check_in_place(self._file, first)
        except OSError as error:
            self.release()
            raise LogError(f'{first} was replaced just now: try again') from error

    def put_in_place(self, new: Path, part: Path) -> None:
        """Give a new file the name of a part; if that is the first, it is locked before."""
        if part != self.path:
            new.replace(part)
            return
        file = locked(new)
        new.replace(part)
        self._file.close()
        self._file = file

    def check_in_place(self) -> None:
        """Check that the locked file is there; raises FileNotFoundError."""
        check_in_place(self._file, self.path)

    def release(self) -> None:
        """Let others write the log."""
        self._file.close()


def locked(path: Path) -> IO[bytes]:
    """Return a file opened for reading and writing that no other process can lock."""
    try:
        # Of a network file system only what is open for writing can be locked.
        file = path.open('r+b')
    except OSError as error:
        raise LogError(f'{path} cannot be gone on with: {error.strerror}') from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.close()
        raise LogError(
            f'{path} is being written by another recorder: end that one before going on with it'
        ) from error
    except OSError as error:
        file.close()
        raise LogError(
            f'{path} cannot be locked against a second recorder: {error.strerror}; '
            'name a file on another file system'
        ) from error
    return file


def check_in_place(file: IO[bytes], path: Path) -> None:
    """Check that an open file is still the one that goes by its name."""
    try:
        is_in_place = os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        is_in_place = False
    if not is_in_place:
        raise FileNotFoundError(f'{path} is gone: it was removed or replaced while in use')
