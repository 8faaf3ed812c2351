# SPDX-License-Identifier: Apache-2.0
"""Where the log of a mission goes when nobody says where."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

NAME = 'mission.mcap'


def new_log(folder: Path | None = None) -> Path:
    """Return the path of a new log, in a folder of its own: runs/TIME."""
    folder = folder or Path('runs', datetime.now().strftime('%Y-%m-%d-%H-%M-%S'))
    make_folder(folder)
    return folder / NAME


def make_folder(folder: Path) -> None:
    """Make the folder of a log; raises OSError if it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(
            f'folder {folder} cannot be made ({error.strerror}): name another'
        ) from error
