# SPDX-License-Identifier: Apache-2.0
"""YAML is read as PyYAML reads it, with the numbers of ROS, or refused."""

from pathlib import Path

from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.files import NotYamlError, parse_yaml, read_yaml
from laws import for_each
import pytest
import yaml

ROOT = Path(__file__).parents[2]

scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
contents = st.recursive(
    scalars, lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(), inner)
)


@pytest.mark.slow
@given(contents)
@settings(max_examples=100 if FULL else 40)
def test_what_pyyaml_writes_is_read_back(content):
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


def test_aliases_and_merges_mean_what_they_mean():
    text = 'base: &base {a: 1, b: [&two 2]}\nmine: {<<: *base, a: *two}\n'
    assert parse_yaml(text) == {'base': {'a': 1, 'b': [2]}, 'mine': {'a': 2, 'b': [2]}}


@for_each('text, complaint', [
    ('a: 1\nb: 2\na: 3\n', "the key 'a' stands in line 3 and in line 1"),
    ('x:\n  - {a: 1, a: 1}\n', "the key 'a' stands in line 2 and in line 2"),
    ('x:\n  "a": 1\n  a: 2\n', "the key 'a' stands in line 3 and in line 2"),
    ('? [a]\n: 1\na:\n  b:\n    c: 1\n    c: 2\n', "the key 'c' stands in line 6"),
    ('a: &a 1\nb: *a\nc: *a\nb: *a\n', "the key 'b' stands in line 4 and in line 2"),
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
def test_what_is_not_yaml_is_refused_in_one_sentence(text):
    with pytest.raises(NotYamlError, match='^it is not YAML: .') as refusal:
        parse_yaml(text)
    assert '\n' not in str(refusal.value)
