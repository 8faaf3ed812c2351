# SPDX-License-Identifier: Apache-2.0
"""Only what has an end is opened."""

import os
from pathlib import Path
import socket

from kbnitp_ros.files import open_file
from laws import for_each
import pytest


def test_a_file_and_a_link_to_one_are_read(tmp_path):
    path, link = tmp_path / 'file', tmp_path / 'link'
    path.write_bytes(b'some bytes')
    link.symlink_to(path)
    for each in (path, str(path), link):
        with open_file(each) as file:
            assert file.read() == b'some bytes'


@for_each(
    'kind, complaint',
    [
        ('pipe', 'it is a pipe, not a file'),
        ('folder', 'it is a folder, not a file'),
        ('device', 'it is a device, not a file'),
        ('socket', 'No such device or address'),
        ('nothing', 'No such file or directory'),
    ],
)
def test_everything_else_is_refused_at_once(kind, complaint, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if kind == 'pipe':
        os.mkfifo('it')
    elif kind == 'folder':
        Path('it').mkdir()
    elif kind == 'device':
        Path('it').symlink_to('/dev/zero')
    elif kind == 'socket':
        socket.socket(socket.AF_UNIX).bind('it')
    opened = sum(1 for _ in Path('/proc/self/fd').iterdir())
    with pytest.raises(OSError, match=complaint) as refusal:
        open_file('it')
    assert refusal.value.filename == 'it'
    assert sum(1 for _ in Path('/proc/self/fd').iterdir()) == opened
