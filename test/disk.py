# SPDX-License-Identifier: Apache-2.0
"""Disks that take no more, and disks that take nothing."""

from contextlib import contextmanager
import resource
import subprocess

import pytest


@contextmanager
def room_for(size):
    """Have every file of this process end at `size` bytes, as if the disk were full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def mounted(folder, options):
    """Mount an empty file system in memory at a folder, which is made; yield the folder."""
    folder.mkdir()
    mount = ['mount', '-t', 'tmpfs', '-o', options, 'tmpfs', str(folder)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip('mounting a disk is not allowed here')
    try:
        yield folder
    finally:
        subprocess.run(['umount', str(folder)], check=True)
