# SPDX-License-Identifier: Apache-2.0
"""Full disks and read-only disks."""

from contextlib import contextmanager
import resource
import subprocess

import pytest


@contextmanager
def room_for(size):
    """Limit every file of this process to `size` bytes, like a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def mounted(folder, options):
    """Mount an empty file system in memory at a new folder; yield the folder."""
    folder.mkdir()
    mount = ['mount', '-t', 'tmpfs', '-o', options, 'tmpfs', str(folder)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip('mounting a disk is not allowed here')
    try:
        yield folder
    finally:
        subprocess.run(['umount', str(folder)], check=True)
