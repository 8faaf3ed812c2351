# SPDX-License-Identifier: Apache-2.0
"""What went wrong, and which of many things are meant, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import errno
from pathlib import Path

# What a user can do about an error of the disk.
REMEDIES = {
    errno.ENOSPC: 'free some space on that disk',
    errno.EDQUOT: 'free some space within the disk quota',
    errno.EFBIG: 'raise the limit on the size of files, see ulimit -f',
    errno.EROFS: 'name a file on a disk that can be written to',
    errno.EACCES: 'check the permissions of the file and its folder',
    errno.EPERM: 'check the permissions of the file and its folder',
    errno.EIO: 'check the disk',
}

# How many of many topics, or robots, a line names.
NAMED = 3


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Have every OSError name a file."""
    # The system names a file that is opened, but not an open one that is written.
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def in_words(error: BaseException) -> str:
    """Return an error as one line; of an error of the system the file, the reason and a remedy."""
    if isinstance(error, OSError) and error.strerror:
        about = [error.filename] if error.filename is not None else []
        remedy = REMEDIES.get(error.errno or 0)
        return ': '.join(map(str, [*about, error.strerror])) + (f' ({remedy})' if remedy else '')
    return ' '.join(str(error).split()) or type(error).__name__


def some(items: Iterable[object], named: int = NAMED) -> str:
    """Return the first few of some items in words, and how many more there are."""
    first = [str(each) for each in items]
    more = len(first) - named
    return ', '.join(first[:named]) + (f' and {more} more' if more > 0 else '')


def counted(number: int, what: str) -> str:
    """Return a number of things in words."""
    return f'{number} {what}' if number == 1 else f'{number} {what}s'
