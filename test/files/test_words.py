# SPDX-License-Identifier: Apache-2.0
"""Errors are sentences, and YAML is read as PyYAML reads it."""

from pathlib import Path
import re

from disk import mounted, room_for
from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.files import in_words, naming, NotYamlError, parse_yaml, read_yaml, some
from laws import for_each
import pytest
import yaml


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
    # The first page of a process's memory cannot be read.
    with pytest.raises(OSError) as refusal:
        read_yaml('/proc/self/mem')
    assert in_words(refusal.value) == '/proc/self/mem: Input/output error (check the disk)'


def test_other_errors_keep_their_text():
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


ROOT = Path(__file__).parents[2]

# PyYAML writes a text such as 0E0 without quotes, which is a number for ROS.
texts = st.text().filter(lambda text: not re.fullmatch(r'[-+.\d]+[eE][-+]?\d+', text))
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | texts
contents = st.recursive(
    scalars, lambda inner: st.lists(inner) | st.dictionaries(texts | st.integers(), inner)
)


@pytest.mark.slow
@given(contents)
@settings(max_examples=100 if FULL else 20)
def test_yaml_by_pyyaml_is_read_back(content):
    assert parse_yaml(yaml.safe_dump(content)) == content


@for_each('path', sorted(ROOT.glob('*/*.yaml')))
def test_every_file_of_the_project_is_read_as_by_pyyaml(path):
    assert read_yaml(path) == yaml.safe_load(path.read_text())


@for_each('text, number', [
    ('1e-3', 1e-3),
    ('-1E+2', -100.0),
    ('1.e4', 1e4),
    ('.5e1', 5.0),
    ('1.', 1.0),
    ('5e-2', 0.05),
    ('1e', '1e'),
    ('e-3', 'e-3'),
    ('"1e-3"', '1e-3'),
])  # fmt: skip
def test_numbers_are_written_as_for_ros(text, number):
    value = parse_yaml(f'[{text}]')[0]
    assert (value, type(value)) == (number, type(number))


def test_aliases_and_merges_are_resolved():
    text = 'base: &base {a: 1, b: [&two 2]}\nmine: {<<: *base, a: *two}\n'
    assert parse_yaml(text) == {'base': {'a': 1, 'b': [2]}, 'mine': {'a': 2, 'b': [2]}}


@for_each('text, complaint', [
    ('a: 1\nb: 2\na: 3\n', "the key 'a' appears in line 3 and in line 1"),
    ('x:\n  - {a: 1, a: 1}\n', "the key 'a' appears in line 2 and in line 2"),
    ('x:\n  "a": 1\n  a: 2\n', "the key 'a' appears in line 3 and in line 2"),
    ('? [a]\n: 1\na:\n  b:\n    c: 1\n    c: 2\n', "the key 'c' appears in line 6"),
    ('a: &a 1\nb: *a\nc: *a\nb: *a\n', "the key 'b' appears in line 4 and in line 2"),
])  # fmt: skip
def test_a_key_that_stands_twice_is_refused(text, complaint):
    with pytest.raises(ValueError, match=complaint) as refusal:
        parse_yaml(text)
    assert not isinstance(refusal.value, NotYamlError)


def test_a_key_may_stand_in_several_mappings():
    assert parse_yaml('[{a: {a: 1}, b: 1}, {a: a}]') == [{'a': {'a': 1}, 'b': 1}, {'a': 'a'}]


@for_each('text', [
    'a: [1, 2',
    b'\xff\xfe\x00',
    'a\0b',
    '*nothing',
    '!!python/object:os.system x',
    '2001-99-99',
    '!!int x',
    '!!bool x',
    '!!float x',
    '!!timestamp x',
    '1' * 5000,
    f'1{":59" * 3000}.5',
    '{[a]: 1}',
    'a: 1\n---\na: 2',
])  # fmt: skip
def test_bad_yaml_is_refused_in_one_sentence(text):
    with pytest.raises(NotYamlError, match='^it is not YAML: .') as refusal:
        parse_yaml(text)
    assert '\n' not in str(refusal.value)
