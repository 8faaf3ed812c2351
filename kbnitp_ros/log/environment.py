# SPDX-License-Identifier: Apache-2.0
"""What the last bits of a computed belief depend on: the processor and the libraries."""

from __future__ import annotations

from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
import platform

import numpy as np


def numerical_environment() -> dict[str, str]:
    """Return what this process computes with, by what it is."""
    return {
        'processor': _processor(),
        # numpy and the C library compute logarithms otherwise where the processor can do more.
        'processor_features': ' '.join(_processor_features()),
        'c_library': ' '.join(platform.libc_ver()),
        'numpy': np.__version__,
        'numba': _installed_version('numba'),
    }


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


def _installed_version(package: str) -> str:
    """Return the version of a Python package; 'none' if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return 'none'
