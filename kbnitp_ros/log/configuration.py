# SPDX-License-Identifier: Apache-2.0
"""How a run was configured, as it stands in its log: versions, and the parameters of each node."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
import json
import os
from pathlib import Path
import platform
import subprocess
from typing import Any
import xml.etree.ElementTree as ElementTree

from ament_index_python.packages import get_package_share_directory
from kbnitp_ros.log.bag import LogError, read_metadata
import numpy as np

# Names of metadata records; a node's full name, which starts with a slash, follows the second.
RUN = 'run'
PARAMETERS = 'parameters'


def run_record(rmw_implementation: str) -> dict[str, str]:
    """
    Return what the record `RUN` of a log says: the time (UTC) and what the run runs on.

    Parameters
    ----------
    rmw_implementation : str
        Such as 'rmw_fastrtps_cpp'.

    """
    packages = ('kbnitp_ros', 'kbnitp_msgs', 'rclpy', rmw_implementation)
    return {
        'time': datetime.now(timezone.utc).isoformat(),
        **{package: _package_version(package) for package in packages},
        'rmw_implementation': rmw_implementation,
        'ros_distro': os.environ.get('ROS_DISTRO', 'jazzy'),
        'python': platform.python_version(),
        'platform': platform.platform(),
        **arithmetic(),
        **_revision(Path(__file__).resolve().parents[2]),
    }


def arithmetic() -> dict[str, str]:
    """Return what the last bits of a computed belief depend on: processor and libraries."""
    return {
        'processor': _processor(),
        # numpy and the C library compute logarithms otherwise where the processor can do more.
        'processor_features': ' '.join(_processor_features()),
        'c_library': ' '.join(platform.libc_ver()),
        'numpy': np.__version__,
        'numba': _wheel_version('numba'),
    }


def other_arithmetic(path: str | Path) -> list[str]:
    """
    Return in which words of `arithmetic` a log and this process differ, and how.

    Raises
    ------
    LogError
        If it is no log.

    """
    recorded = read_metadata(path).get(RUN, {})
    return [
        f'{name.replace("_", " ")} {here}, of the recorder {recorded.get(name, "not on record")}'
        for name, here in arithmetic().items()
        if recorded.get(name) != here
    ]


def parameters_record(values: Mapping[str, Any]) -> dict[str, str]:
    """Return what the record of a node's parameters says: each value as JSON."""
    # ROS hands a byte over as bytes of length one.
    return {name: json.dumps(value, default=ord) for name, value in sorted(values.items())}


def read_parameters(path: str | Path) -> dict[str, dict[str, Any]]:
    """
    Return the parameters that the nodes of a run had at its end.

    Parameters
    ----------
    path : str or Path
        The log: a file, its first part or its folder.

    Returns
    -------
    dict
        Values by parameter name, by the node's full name. Lists are lists; a value is None where
        a parameter was declared but not set.

    Raises
    ------
    LogError
        If it is no log, or a record of parameters in it is not as `parameters_record` makes it.

    """
    parameters = {}
    for name, record in read_metadata(path).items():
        if name.startswith(f'{PARAMETERS}/'):
            try:
                values = {key: json.loads(text) for key, text in record.items()}
            except ValueError as error:
                raise LogError(f'{path}: record {name!r} is damaged: {error}') from error
            parameters[name.removeprefix(PARAMETERS)] = values
    return parameters


def _processor() -> str:
    """Return the processor's name, its architecture if it has none."""
    with suppress(OSError):
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith('model name'):
                return line.partition(':')[2].strip()
    return platform.machine()


def _processor_features() -> list[str]:
    """Return what numpy found that the processor can do, and uses."""
    extensions: dict[str, dict[str, list[str]]] = np.show_config(mode='dicts')  # type: ignore
    found = extensions['SIMD Extensions']
    return [*found.get('baseline', ()), *found.get('found', ())]


def _wheel_version(package: str) -> str:
    """Return the version of a Python package; 'none' if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return 'none'


def _package_version(package: str) -> str:
    """Return the version that a ROS package's manifest gives."""
    try:
        manifest = Path(get_package_share_directory(package), 'package.xml')
        return ElementTree.parse(manifest).findtext('version', 'unknown')
    except (LookupError, OSError):
        return 'unknown'


def _revision(source: Path) -> dict[str, str]:
    """Return the git revision of a folder; nothing if it is no checkout or git is missing."""
    if not source.joinpath('.git').exists():
        return {}
    command = ['git', 'describe', '--always', '--dirty', '--abbrev=40', '--exclude=*']
    try:
        described = subprocess.run(command, cwd=source, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return {}
    return {'git_revision': described.stdout.strip()}
