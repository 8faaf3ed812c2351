# SPDX-License-Identifier: Apache-2.0
"""`python3 -m kbnitp_ros NAME` finds the command."""

from importlib import metadata
import json
from pathlib import Path
import re
import subprocess
import sys

import kbnitp_ros
from kbnitp_ros import __main__ as commands
from kbnitp_ros.configuration import NODES, parameter_of, parameters_of
from kbnitp_ros.nodes.runtime.command_line import node_parser
from kbnitp_ros.starting import EXECUTABLES
from laws import for_each
import pytest

# Options that stand for nothing when they are not given.
FREE = ('--params', '--set', '--resume', '--repair', '--scheduler', '--out')


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


@pytest.mark.processes
@for_each('name', ['', *EXECUTABLES], every=4)
def test_every_command_tells_its_version_and_how_to_use_it(name):
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
    options = options_of(told)
    assert all('efault' in text or flag in FREE for flag, text in options.items()), options


def options_of(told):
    """Return what a help says of each option of its command, by the option."""
    options = re.findall(r'(?m)^  (--[\w-]+) (.*\n(?: {19,}.*\n)*)', told)
    return {flag: ' '.join(text.split()) for flag, text in options if flag != '--version'}


@for_each('name', ['demo', 'study', 'replay', 'report', 'forecast'])
def test_the_help_of_a_command_has_ranges_and_examples_of_options_that_it_has(name, capsys):
    with pytest.raises(SystemExit):
        commands.main([name, '--help'])
    told, examples = capsys.readouterr().out.split('\nexamples:\n')
    options = options_of(told)
    numbers = {flag: text for flag, text in options.items() if text[:2] in ('N ', 'X ')}
    ranges = re.compile('from .* to |one of |at least ')
    assert all(ranges.search(text) for text in numbers.values()), numbers
    for line in examples.splitlines():
        assert line.startswith(f'  python3 -m kbnitp_ros {name} ')
        assert set(re.findall(r'--[\w-]+', line)) <= options.keys()


@for_each('name', NODES)
def test_the_help_of_a_node_has_its_parameters_with_defaults_and_what_they_must_be(name):
    parser = node_parser(name, 'Does it.')
    told = ' '.join(parser.format_help().split())
    for parameter in parameters_of(name).values():
        default = ' '.join(json.dumps(parameter.default).split())
        assert f' {parameter.name} {parameter.description} Default {default}; ' in told
        assert parameter.must_be in told
    (example,) = re.findall(r'-p ([a-z][\w.]*):=', told)
    assert parameter_of(name, example)


def test_an_unknown_name_is_named(capsys):
    assert commands.main(['fly']) == 2
    assert "'fly'" in capsys.readouterr().err


@pytest.mark.processes
def test_nothing_is_imported_before_its_name_is_known():
    program = 'import sys, kbnitp_ros.__main__; sys.exit("rclpy" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', program]).returncode == 0
