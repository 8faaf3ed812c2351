# SPDX-License-Identifier: Apache-2.0
"""The scenarios that come with the package."""

from __future__ import annotations

from pathlib import Path

from kbnitp_ros.files import share


def shipped() -> list[str]:
    """Return the names of the scenarios that come with the package."""
    return sorted(path.stem for path in share('scenarios').glob('*.yaml'))


def scenario_file(name: str) -> Path:
    """Return the path of a scenario: a file, or one shipped with the package."""
    if name in shipped():
        return share('scenarios') / f'{name}.yaml'
    if not Path(name).is_file():
        raise ValueError(f'scenario {name} is no file, and none of {", ".join(shipped())}')
    return Path(name)
