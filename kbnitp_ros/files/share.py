# SPDX-License-Identifier: Apache-2.0
"""Where the files are that come with the package but are no code."""

from pathlib import Path


def share(relative: str) -> Path:
    """Return where a file or folder of the package is: in the source tree, or installed."""
    source = Path(__file__).parents[2] / relative
    if source.exists():
        return source
    # pip and colcon both install share/ beside lib/, which site-packages is in.
    return Path(__file__).parents[5] / 'share/kbnitp_ros' / relative
