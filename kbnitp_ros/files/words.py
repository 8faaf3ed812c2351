# SPDX-License-Identifier: Apache-2.0
"""What went wrong, in words for those who type commands."""

from __future__ import annotations


def in_words(error: BaseException) -> str:
    """Return an error as one line; of an error of the system which file it is about, and why."""
    if isinstance(error, OSError) and error.strerror:
        about = [error.filename] if error.filename is not None else []
        return ': '.join(map(str, [*about, error.strerror]))
    return ' '.join(str(error).split()) or type(error).__name__
