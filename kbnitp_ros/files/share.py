# SPDX-License-Identifier: Apache-2.0
"""What is installed, and where its files are that are no code."""

from importlib.metadata import version
from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def installed() -> str:
    """Return the version of the package in use and its folder: there may be several installed."""
    return f'kbnitp_ros {version("kbnitp_ros")} in {PACKAGE}'


def share(relative: str) -> Path:
    """Return where a file or folder of the package is: in the source tree, or installed."""
    source = PACKAGE.parent / relative
    if source.exists():
        return source
    # pip and colcon both install share/ beside lib/, which site-packages is in.
    return PACKAGE.parents[3] / 'share/kbnitp_ros' / relative
