# SPDX-License-Identifier: Apache-2.0
"""Packages of strangers: a folder on Python's path, as pip would install into it."""

from collections.abc import Mapping
import os
from pathlib import Path

ROOT = Path(__file__).parents[1]


def install(
    folder: Path, name: str, source: str, added: Mapping[str, Mapping[str, str]]
) -> dict[str, str]:
    """Make a distribution of one module; return an environment that has it."""
    folder.joinpath(f'{name}.py').write_text(source)
    info = folder / f'{name}-1.0.dist-info'
    info.mkdir()
    info.joinpath('METADATA').write_text(f'Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n')
    lines = []
    for kinds, entries in added.items():
        lines.append(f'[kbnitp_ros.{kinds}]')
        for entry, value in entries.items():
            lines.append(f'{entry} = {value if ":" in value else f"{name}:{value}"}')
    info.joinpath('entry_points.txt').write_text('\n'.join(lines))
    paths = [str(folder), str(ROOT), os.environ.get('PYTHONPATH', '')]
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, paths))}
