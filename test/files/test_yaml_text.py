# SPDX-License-Identifier: Apache-2.0
"""YAML is read as PyYAML reads it, or refused before it takes time or memory."""

from pathlib import Path

from bounded import run_code
from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.files import NotYamlError, parse_yaml, read_yaml
from kbnitp_ros.files.yaml_text import DEEPEST, LONGEST, MOST_BYTES, MOST_VALUES
from laws import for_each
import pytest
import yaml

ROOT = Path(__file__).parents[2]

scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
contents = st.recursive(
    scalars, lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(), inner)
)

LAUGHS = 'a0: &a0 [x, x]\n' + ''.join(
    f'a{n}: &a{n} [{", ".join([f"*a{n - 1}"] * 10)}]\n' for n in range(1, 40)
)
MERGED = 'a0: &a0 {k: x}\n' + ''.join(
    f'a{n}: &a{n}\n  <<: [{", ".join([f"*a{n - 1}"] * 10)}]\n' for n in range(1, 40)
)

# What takes more than the bounds allow, and why it is refused.
HOSTILE = {
    'aliases of aliases': (LAUGHS, 'stands for more than 250000 values'),
    'merged aliases of aliases': (MERGED, 'stands for more than 250000 values'),
    'many values': ('- \n' * 5_000_000, 'stands for more than 250000 values'),
    'nested lists': ('[' * 10**7, 'line 1 is nested more than 100 deep'),
    'nested mappings': ('{a: ' * 10**6, 'line 1 is nested more than 100 deep'),
    'nested blocks': ('- ' * 10**6, 'line 1 is nested more than 100 deep'),
    'nested keys': ('? ' * 10**6, 'line 1 is nested more than 100 deep'),
    'sexagesimal number': ('1' + ':10' * 10**6, 'line 1 has a value of more than 10000'),
    'tagged number': (f'!!int "1{":10" * 10**6}"', 'line 1 has a value of more than 10000'),
}


@pytest.mark.slow
@given(contents)
@settings(max_examples=100 if FULL else 40)
def test_what_pyyaml_writes_is_read_back(content):
    assert parse_yaml(yaml.safe_dump(content)) == content


@for_each('path', sorted(ROOT.glob('*/*.yaml')))
def test_every_file_of_the_project_is_read_as_by_pyyaml(path):
    assert read_yaml(path) == yaml.safe_load(path.read_text())


def test_aliases_and_merges_mean_what_they_mean():
    text = 'base: &base {a: 1, b: [&two 2]}\nmine: {<<: *base, a: *two}\n'
    assert parse_yaml(text) == {'base': {'a': 1, 'b': [2]}, 'mine': {'a': 2, 'b': [2]}}


@for_each(
    'text, complaint',
    [
        ('a: 1\nb: 2\na: 3\n', "the key 'a' stands in line 3 and in line 1"),
        ('x:\n  - {a: 1, a: 1}\n', "the key 'a' stands in line 2 and in line 2"),
        ('x:\n  "a": 1\n  a: 2\n', "the key 'a' stands in line 3 and in line 2"),
        ('? [a]\n: 1\na:\n  b:\n    c: 1\n    c: 2\n', "the key 'c' stands in line 6"),
        ('a: &a 1\nb: *a\nc: *a\nb: *a\n', "the key 'b' stands in line 4 and in line 2"),
    ],
)
def test_a_key_that_stands_twice_is_refused(text, complaint):
    with pytest.raises(ValueError, match=complaint) as refusal:
        parse_yaml(text)
    assert not isinstance(refusal.value, NotYamlError)


def test_a_key_may_stand_in_several_mappings():
    assert parse_yaml('[{a: {a: 1}, b: 1}, {a: a}]') == [{'a': {'a': 1}, 'b': 1}, {'a': 'a'}]


@for_each(
    'text',
    [
        'a: [1, 2',
        b'\xff\xfe\x00',
        'a\0b',
        '&a [*a]',
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
    ],
)
def test_what_is_not_yaml_is_refused_in_one_sentence(text):
    with pytest.raises(NotYamlError, match='^it is not YAML: .') as refusal:
        parse_yaml(text)
    assert '\n' not in str(refusal.value)


@pytest.mark.slow
def test_what_is_just_within_bounds_is_read():
    assert len(parse_yaml('- 1\n' * (MOST_VALUES - 1))) == MOST_VALUES - 1
    assert parse_yaml('[' * (DEEPEST - 1) + ']' * (DEEPEST - 1)) is not None
    assert parse_yaml('x' * LONGEST) == 'x' * LONGEST
    assert parse_yaml(f'"{"1" * 20 * LONGEST}"') == '1' * 20 * LONGEST


@pytest.mark.processes
@for_each('kind', HOSTILE)
def test_a_hostile_file_is_refused_in_little_time_and_memory(kind, tmp_path):
    text, complaint = HOSTILE[kind]
    path = tmp_path / 'hostile.yaml'
    path.write_text(text)
    check_refused(path, complaint)


@pytest.mark.processes
def test_a_file_without_an_end_is_refused(tmp_path):
    path = tmp_path / 'large.yaml'
    with path.open('wb') as file:
        file.truncate(2**40)
    check_refused(path, f'it has more than {MOST_BYTES} bytes')


def check_refused(path, complaint):
    ended = run_code(f'from kbnitp_ros.files import read_yaml; read_yaml({str(path)!r})')
    assert ended.code == 1
    assert complaint in ended.said.splitlines()[-1]
    assert ended.megabytes < 100
