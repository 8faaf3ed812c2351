# SPDX-License-Identifier: Apache-2.0
"""An error of the disk names the file, the reason and a remedy, in one line."""

from pathlib import Path

from disk import mounted, room_for
from kbnitp_ros.files import in_words, naming, read_yaml, some
import pytest


def test_a_full_disk_is_named_when_an_open_file_is_written():
    with pytest.raises(OSError) as refusal, naming('/dev/full'):
        Path('/dev/full').write_bytes(b'some bytes')
    assert in_words(refusal.value) == (
        '/dev/full: No space left on device (free some space on that disk)'
    )


def test_a_file_that_may_not_grow_is_named(tmp_path):
    path = tmp_path / 'file'
    with room_for(10), pytest.raises(OSError) as refusal, naming(path):
        path.write_bytes(bytes(20))
    assert in_words(refusal.value) == (
        f'{path}: File too large (raise the limit on the size of files, see ulimit -f)'
    )


@pytest.mark.processes
def test_a_disk_that_cannot_be_written_to_is_named(tmp_path):
    with mounted(tmp_path / 'disk', 'ro') as folder:
        path = folder / 'file'
        with pytest.raises(OSError) as refusal, naming(tmp_path):
            path.write_bytes(b'')
    assert in_words(refusal.value) == (
        f'{path}: Read-only file system (name a file on a disk that can be written to)'
    )


def test_a_file_that_cannot_be_read_to_its_end_is_named():
    # The first page of no process can be read.
    with pytest.raises(OSError) as refusal:
        read_yaml('/proc/self/mem')
    assert in_words(refusal.value) == '/proc/self/mem: Input/output error (check the disk)'


def test_other_errors_are_said_as_they_are():
    assert in_words(FileExistsError('it is there already:\nname another')) == (
        'it is there already: name another'
    )
    assert in_words(FileNotFoundError(2, 'No such file or directory', 'that')) == (
        'that: No such file or directory'
    )
    assert in_words(ValueError()) == 'ValueError'


def test_a_line_names_some_of_many():
    assert some('abc') == 'a, b, c'
    assert some('abcde') == 'a, b, c and 2 more'
    assert some('abcde', named=4) == 'a, b, c, d and 1 more'
