# SPDX-License-Identifier: Apache-2.0
"""`python3 -m kbnitp_ros NAME` finds the command; a signal ends it well, also while it starts."""

from importlib import metadata
from itertools import product
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

from ament_index_python.packages import get_package_prefix
import kbnitp_ros
from kbnitp_ros import __main__ as commands
from kbnitp_ros.configuration import find_parameter, node_parameters, NODES
from kbnitp_ros.nodes.runtime.command_line import node_parser
from kbnitp_ros.starting import EXECUTABLES, EXTRAS
from laws import for_each
import pytest

FREE = ('--params', '--set', '--resume', '--scheduler', '--out', '--page')


def test_the_rest_of_the_line_goes_to_the_command(monkeypatch, tmp_path):
    tmp_path.joinpath('echo_command.py').write_text('def main(argv=None):\n    return argv\n')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(EXECUTABLES, 'echo', 'echo_command')
    assert commands.main(['echo', '--help', 'b']) == ['--help', 'b']


@pytest.mark.processes
@for_each('arguments, status', [([], 2), (['fly'], 2), (['--help'], 0), (['-h'], 0)])
def test_the_names_are_listed(arguments, status):
    done = subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', *arguments], capture_output=True, text=True
    )
    assert done.returncode == status
    told = done.stderr if status else done.stdout
    assert all(name in told for name in EXECUTABLES)
    assert ("'fly'" in told) == ('fly' in arguments)


@pytest.mark.processes
@for_each('name', ['', *EXECUTABLES], every=12)
def test_every_command_has_a_version_and_a_help(name):
    def run(option):
        command = [sys.executable, '-m', 'kbnitp_ros', *filter(None, [name]), option]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    here = Path(kbnitp_ros.__file__).parent
    said = f'kbnitp_ros {metadata.version("kbnitp_ros")} in {here}'
    assert run('--version') == (f'{name} of {said}\n' if name else f'{said}\n')
    told = run('--help')
    sentence = told.split('\n\n')[1]
    assert sentence[0].isupper() or not name
    assert sentence.endswith('.')
    assert 'example' in told
    options = help_options(told)
    assert all('efault' in text or flag in FREE for flag, text in options.items()), options


def help_options(told):
    options = re.findall(r'(?m)^  (--[\w-]+) (.*\n(?: {19,}.*\n)*)', told)
    return {flag: ' '.join(text.split()) for flag, text in options if flag != '--version'}


@for_each(
    'name', ['demo', 'study', 'replay', 'report', 'watch', 'forecast', 'preflight', 'layout']
)
def test_the_help_of_a_command_has_ranges_and_valid_examples(name, capsys):
    with pytest.raises(SystemExit):
        commands.main([name, '--help'])
    told, examples = capsys.readouterr().out.split('\nexamples:\n')
    options = help_options(told)
    numbers = {flag: text for flag, text in options.items() if text[:2] in ('N ', 'X ')}
    ranges = re.compile('from .* to |one of |at least ')
    assert all(ranges.search(text) for text in numbers.values()), numbers
    for line in examples.splitlines():
        assert line.startswith(f'  python3 -m kbnitp_ros {name} ')
        assert set(re.findall(r'--[\w-]+', line)) <= options.keys()


@for_each('name', NODES)
def test_the_help_of_a_node_has_its_parameters_with_defaults_and_limits(name):
    parser = node_parser(name, 'Does it.')
    told = ' '.join(parser.format_help().split())
    for parameter in node_parameters(name).values():
        default = ' '.join(json.dumps(parameter.default).split()) + parameter.differs
        assert f' {parameter.name} {parameter.description} Default {default}; ' in told
        assert parameter.must_be in told
    (example,) = re.findall(r'-p ([a-z][\w.]*):=', told)
    assert find_parameter(name, example)


@pytest.mark.processes
def test_nothing_is_imported_before_its_name_is_known():
    program = 'import sys, kbnitp_ros.__main__; sys.exit("rclpy" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', program]).returncode == 0


@pytest.mark.processes
def test_a_module_in_the_working_folder_hides_no_other(tmp_path):
    for name in ('yaml', 'numpy', 'numbers'):
        tmp_path.joinpath(f'{name}.py').write_text('raise ImportError("of the user")\n')
    command = [sys.executable, '-m', 'kbnitp_ros', 'planner', '--help']
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, '')


# In an empty home matplotlib starts fc-list.
@pytest.mark.processes
def test_a_user_without_home_has_a_folder_for_files(monkeypatch, tmp_path):
    monkeypatch.setenv('HOME', '/nowhere')
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    with pytest.raises(SystemExit):
        commands.main(['report', '--help'])
    assert os.environ['HOME'] == str(tmp_path)


def test_a_robot_without_home_is_refused_since_its_journal_must_be_kept(monkeypatch, capsys):
    monkeypatch.setenv('HOME', '/nowhere')
    monkeypatch.delenv('ROS_HOME', raising=False)
    assert commands.main(['robot']) == 2
    assert (
        'the home /nowhere cannot be written to: set HOME or ROS_HOME' in capsys.readouterr().err
    )


# Replaces a library that is slow to import and used by all. A signal just before a sleep does not
# end it, so the sleeps are short.
SLOW = """
import time
print('importing', flush=True)
for _ in range(6000):
    time.sleep(0.01)
"""

INSTALLED = Path(get_package_prefix('kbnitp_ros'), 'lib', 'kbnitp_ros')


@pytest.mark.processes
@for_each('name', sorted({*EXECUTABLES} - {*EXTRAS}), every=4)
def test_a_middleware_that_is_not_installed_is_named(name):
    env = {**os.environ, 'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}
    command = [sys.executable, '-m', 'kbnitp_ros', name]
    ended = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout) == (2, '')
    assert ended.stderr == (
        f"{name}: RMW_IMPLEMENTATION is 'rmw_cyclonedds_cpp', which is not installed: install "
        'it, or set it to one of rmw_fastrtps_cpp\n'
    )


@pytest.mark.processes
@for_each(
    'number, name, is_installed',
    product([signal.SIGINT, signal.SIGTERM], EXECUTABLES, [False, True]),
    every=5,
)
def test_a_signal_while_it_imports_ends_it_without_a_traceback(
    tmp_path, number, name, is_installed
):
    tmp_path.joinpath('numpy.py').write_text(SLOW)
    command = [INSTALLED / name] if is_installed else [sys.executable, '-m', 'kbnitp_ros', name]
    path = os.pathsep.join([str(tmp_path), os.environ['PYTHONPATH']])
    started = subprocess.Popen(
        command,
        env={**os.environ, 'PYTHONPATH': path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert started.stdout.readline() == 'importing\n'
    started.send_signal(number)
    said, complained = started.communicate(timeout=60)
    assert started.returncode == (0 if name in NODES else 128 + number)
    assert said + complained == ''
