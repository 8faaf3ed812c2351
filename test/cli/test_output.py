# SPDX-License-Identifier: Apache-2.0
"""Commands end with a sentence, or silently, if their output cannot be written."""

import os
from pathlib import Path
import subprocess
import sys

from kbnitp_ros.__main__ import main
from kbnitp_ros.cli.output import command
from kbnitp_ros.starting import EXECUTABLES
from laws import for_each
from mission_log import mission, record
import pytest


@pytest.fixture(scope='module')
def log(tmp_path_factory):
    return record(tmp_path_factory.mktemp('run') / 'mission.mcap', mission(robots=2).sent)


@pytest.fixture
def arguments(log, tmp_path):
    """Return arguments that make each command print."""
    helps = {name: [name, '--help'] for name in EXECUTABLES}
    return {
        **helps,
        'help': ['--help'],
        'replayed': ['replay', log],
    }


KINDS = ['help', 'replayed', *EXECUTABLES]


# With LANG=C, names of files are printed that cannot be encoded.
STRICT = {**os.environ, 'PYTHONIOENCODING': 'utf-8:strict'}

STRICT.pop('PYTHONUNBUFFERED', None)


def run(arguments, **options):
    return subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', *arguments],
        stderr=subprocess.PIPE,
        env=STRICT,
        timeout=60,
        **options,
    )


@pytest.mark.processes
@for_each('kind', KINDS, every=7)
def test_a_closed_pipe_ends_a_command_silently(kind, arguments):
    read, write = os.pipe()
    os.close(read)
    done = run(arguments[kind], stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b'')


@pytest.mark.processes
def test_help_without_a_buffer_ends_silently_at_a_closed_pipe(monkeypatch):
    monkeypatch.setitem(STRICT, 'PYTHONUNBUFFERED', '1')
    read, write = os.pipe()
    os.close(read)
    done = run(['study', '--help'], stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b'')


@pytest.mark.processes
@for_each('kind', KINDS, every=7)
def test_a_full_disk_is_reported(kind, arguments):
    with Path('/dev/full').open('wb') as full:
        done = run(arguments[kind], stdout=full)
    (told,) = done.stderr.decode().splitlines()
    assert told.endswith(': nothing can be printed: No space left on device')
    assert done.returncode == os.EX_IOERR


@pytest.mark.processes
def test_a_closed_output_is_no_error(arguments):
    done = run(arguments['replayed'], preexec_fn=lambda: os.close(1))
    assert (done.returncode, done.stderr) == (0, b'')


@pytest.mark.processes
@for_each('unbuffered', ['', '1'])
def test_an_error_that_cannot_be_printed_has_its_exit_code(tmp_path, unbuffered):
    command = [sys.executable, '-m', 'kbnitp_ros', 'replay', tmp_path / 'nothing.mcap']
    environment = {**os.environ, 'PYTHONUNBUFFERED': unbuffered}
    with Path('/dev/full').open('wb') as full:
        done = subprocess.run(command, stderr=full, env=environment, timeout=60)
    assert done.returncode == 2


@pytest.mark.processes
def test_a_name_that_cannot_be_encoded_is_printed(tmp_path):
    strange = os.fsencode(tmp_path) + b'/\xff.mcap'
    done = run(['replay', strange], stdout=subprocess.PIPE)
    assert done.returncode == 2
    assert b'\\udcff.mcap cannot be read: No such file' in done.stderr


@pytest.mark.processes
def test_no_log_is_made_under_a_name_that_cannot_be_encoded(tmp_path):
    """The folder's metadata.yaml and a node's parameters are text."""
    done = run(['demo', '--out', os.fsencode(tmp_path) + b'/\xff.mcap'], stdout=subprocess.PIPE)
    (told,) = done.stderr.decode().splitlines()
    assert told.startswith('demo: ')
    assert told.endswith('cannot name a log: it must be UTF-8')
    assert done.returncode == 2


def test_too_little_memory_is_reported(capsys):
    @command('some')
    def main(argv=None):
        raise MemoryError('Unable to allocate 14.6 TiB')

    assert main() == 1
    assert (
        capsys.readouterr().err
        == 'some: there is not enough memory: Unable to allocate 14.6 TiB\n'
    )


def test_an_interrupted_command_ends_without_a_traceback():
    @command('walk')
    def interrupted(argv=None):
        raise KeyboardInterrupt

    assert interrupted() == 130


def check_words(code, told, said):
    assert code == 2
    assert said in told
    assert 'Errno' not in told
    assert 'Traceback' not in told


@for_each('command, said', [
    ('demo --out /proc/here', 'demo: folder /proc/here cannot be made (No such file or '),
    ('demo --resume nothere.mcap', 'demo: nothere.mcap cannot be resumed: No such file'),
    ('demo --params nothere.yaml', 'demo: parameter file nothere.yaml: No such file or '),
    ('demo --set world.file=nothere.yaml', 'demo: nothere.yaml: No such file or directory'),
    ('replay nothere.mcap', 'replay: nothere.mcap cannot be read: No such file or directory'),
    ('study nothere.yaml --out runs', 'study: scenario nothere.yaml is neither a file'),
    ('study paper --out /proc/here', 'study: /proc/here: No such file or directory'),
])  # fmt: skip
def test_no_command_prints_an_errno(tmp_path, monkeypatch, capsys, command, said):
    monkeypatch.chdir(tmp_path)
    check_words(main(command.split()), capsys.readouterr().err, said)
