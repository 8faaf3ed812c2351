# SPDX-License-Identifier: Apache-2.0
"""The configuration of a run in its log: versions, processor, and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timezone
from importlib.metadata import distributions
import json
import os
from pathlib import Path
import platform
import subprocess
from typing import Any
import xml.etree.ElementTree as ElementTree

import numpy as np


def numerical_environment() -> dict[str, str]:
    """Return the processor, C library and numerical packages of this process, by name."""
    extensions: dict[str, dict[str, list[str]]] = np.show_config(mode='dicts')  # type: ignore
    found = extensions['SIMD Extensions']
    numba = next((each.version for each in distributions(name='numba')), 'none')
    return {
        'processor': _processor(),
        # The logarithms of numpy and of the C library depend on the processor's features.
        'processor_features': ' '.join([*found.get('baseline', ()), *found.get('found', ())]),
        'c_library': ' '.join(platform.libc_ver()),
        'numpy': np.__version__,
        'numba': numba,
    }


def _processor() -> str:
    """Return the processor's name, or its architecture."""
    with suppress(OSError):
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith('model name'):
                return line.partition(':')[2].strip()
    return platform.machine()


def run_record(rmw_implementation: str) -> dict[str, str]:
    """Return the record `RUN` of a log: the time (UTC) and the environment of the run."""
    packages = ('kbnitp_ros', 'kbnitp_msgs', 'rclpy', rmw_implementation)
    return {
        'time': datetime.now(timezone.utc).isoformat(),
        **{package: _package_version(package) for package in packages},
        'rmw_implementation': rmw_implementation,
        'ros_distro': os.environ.get('ROS_DISTRO', 'jazzy'),
        'python': platform.python_version(),
        'platform': platform.platform(),
        **numerical_environment(),
        **_revision(Path(__file__).resolve().parents[2]),
    }


def parameters_record(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the record of a node's parameters: each value as JSON."""
    # ROS passes a byte as bytes of length one.
    return {name: json.dumps(value, default=ord) for name, value in sorted(values.items())}


def _package_version(package: str) -> str:
    """Return the version in a ROS package's manifest."""
    # Imported here, since only writers of logs need it.
    from ament_index_python.packages import get_package_share_directory

    try:
        manifest = Path(get_package_share_directory(package), 'package.xml')
        return ElementTree.parse(manifest).findtext('version', 'unknown')
    except (LookupError, OSError):
        return 'unknown'


def _revision(source: Path) -> dict[str, str]:
    """Return the git revision of a folder; empty outside a checkout or without git."""
    if not source.joinpath('.git').exists():
        return {}
    command = ['git', 'describe', '--always', '--dirty', '--abbrev=40', '--exclude=*']
    try:
        described = subprocess.run(command, cwd=source, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return {}
    return {'git_revision': described.stdout.strip()}
