# SPDX-License-Identifier: Apache-2.0
"""YAML of parameters, with the types and limits of rcl's parser, which nodes use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
import re
from typing import Any

from kbnitp_ros.files import NotYamlError, repeated_key
import yaml

BOOLEANS = {
    **dict.fromkeys(
        ('y', 'Y', 'yes', 'Yes', 'YES', 'true', 'True', 'TRUE', 'on', 'On', 'ON'), True
    ),
    **dict.fromkeys(('n', 'N', 'no', 'No', 'NO', 'false', 'False', 'FALSE'), False),
    **dict.fromkeys(('off', 'Off', 'OFF'), False),
}
INTEGER = re.compile(r'[-+]?(0[xX][0-9a-fA-F]+|[0-9]+)')
FLOAT = re.compile(r'[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?')
SPECIAL = {'.nan': 'nan', '.inf': 'inf', '+.inf': 'inf', '-.inf': '-inf'}

TYPES = {bool: 'truth value', int: 'whole number', float: 'number', str: 'text'}


class Loader(yaml.SafeLoader):
    """A YAML loader that resolves no plain scalar: only those tagged as texts have that tag."""

    def compose_scalar_node(self, anchor: dict[Any, yaml.Node]) -> yaml.ScalarNode:
        """Return a scalar, tagged only if its text is."""
        tag = self.peek_event().tag  # type: ignore[no-untyped-call]
        node = super().compose_scalar_node(anchor)
        node.tag = tag or ''
        return node


def read_parameter_file(path: str | Path) -> Any:
    """Return the content of a parameter file; ValueError for what rcl's parser refuses."""
    return parse_parameters(Path(path).read_bytes())


def parse_parameters(text: str | bytes) -> Any:
    """Return the content of a YAML text; ValueError names line, key and remedy."""
    try:
        for event in yaml.parse(text, yaml.SafeLoader):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError(
                    f'line {_line(event)} has the alias *{event.anchor}, which ROS '
                    'does not take: write the values out'
                )
        node = yaml.compose(text, Loader)
    except yaml.YAMLError as error:
        raise NotYamlError(f'it is not YAML: {" ".join(str(error).split())}') from error
    if node is None:
        return None
    if repeated := repeated_key(node, set()):
        raise ValueError(repeated)
    return _value(node, '')


def _line(found: yaml.Node | yaml.Event) -> int:
    """Return the number of a line, from 1."""
    return 1 + (found.start_mark.line if found.start_mark else 0)


def _value(node: yaml.Node, key: str) -> Any:
    """Return the value of a node, of this key, as rcl reads it."""
    line = _line(node)
    if isinstance(node, yaml.MappingNode):
        return dict(_pairs(node))
    if isinstance(node, yaml.SequenceNode):
        values = [_value(each, key) for each in node.value]
        kinds = list(dict.fromkeys(type(each) for each in values))
        if not {*kinds} <= TYPES.keys():
            raise ValueError(f'line {line}: {key} is a list of lists or sections: ROS takes none')
        if len(kinds) > 1:
            first, second = (TYPES[kind] for kind in kinds[:2])
            raise ValueError(
                f'line {line}: {key} is {values}, a {first} and a {second}: in a list of ROS all '
                'values are of one type; write whole numbers with .0 among others'
            )
        return values
    assert isinstance(node, yaml.ScalarNode)
    return _scalar(node)


def _pairs(node: yaml.MappingNode) -> Iterator[tuple[Any, Any]]:
    """Yield the keys and values of a mapping."""
    for name, value in node.value:
        key = str(name.value)
        if key == 'ros__parameters' and isinstance(value, yaml.ScalarNode) and not value.value:
            raise ValueError(
                f'line {_line(name)}: ros__parameters is empty, which ROS does not '
                'take: leave the section out, or give it parameters'
            )
        yield key, _value(value, key)


def _scalar(node: yaml.ScalarNode) -> Any:
    """Return a single value: a text if it is quoted, or if nothing else fits."""
    text = str(node.value)
    if node.style is not None or node.tag == 'tag:yaml.org,2002:str':
        return text
    if text in ('', '~', 'null'):
        return None
    if text in BOOLEANS:
        return BOOLEANS[text]
    if INTEGER.fullmatch(text):
        # As strtol: a leading 0 means octal.
        with suppress(ValueError):
            digits = text.lstrip('+-')
            is_octal = len(digits) > 1 and digits[0] == '0' and digits[1] not in 'xX'
            number = int(digits, 8) if is_octal else int(digits, 0)
            return -number if text.startswith('-') else number
    if text in SPECIAL or FLOAT.fullmatch(text):
        return float(SPECIAL.get(text, text))
    return text
