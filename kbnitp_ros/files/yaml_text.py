# SPDX-License-Identifier: Apache-2.0
"""Read YAML with PyYAML, with the numbers of ROS, and refuse keys that stand twice."""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any

from kbnitp_ros.files.words import naming
import yaml


class Loader(yaml.CSafeLoader):
    """The types of YAML 1.1, numbers such as 1e-3, and lists for the tuples of launch files."""


Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$'),
    list('-+.0123456789'),
)
Loader.add_constructor(  # type: ignore[type-var]
    'tag:yaml.org,2002:python/tuple', Loader.construct_yaml_seq
)


class NotYamlError(ValueError):
    """A text that is no YAML, such as one that was cut off."""


class KeyTwiceError(ValueError):
    """A key that stands twice in a mapping."""


def read_yaml(path: str | Path) -> Any:
    """Return the content of a YAML file; raise OSError or as `parse_yaml`."""
    with naming(path):
        return parse_yaml(Path(path).read_bytes())


def parse_yaml(text: str | bytes) -> Any:
    """Return the content of a YAML text; raise NotYamlError or KeyTwiceError."""
    try:
        loader = Loader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            check_keys(node, set())
            return loader.construct_document(node)
        finally:
            loader.dispose()
    except KeyTwiceError:
        raise
    except Exception as error:
        # PyYAML fails in many ways on a value that does not fit its tag.
        raise NotYamlError(f'it is not YAML: {" ".join(str(error).split())}') from error


def check_keys(node: yaml.Node, seen: set[int]) -> None:
    """Raise KeyTwiceError for a mapping with a key twice; aliases lead to nodes seen before."""
    if id(node) in seen or isinstance(node, yaml.ScalarNode):
        return
    seen.add(id(node))
    lines: dict[str, int] = {}
    for child in node.value:
        if isinstance(node, yaml.MappingNode):
            key, value = child
            check_keys(key, seen)
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if key.value in lines:
                    raise KeyTwiceError(
                        f'the key {key.value!r} stands in line {line} and in line '
                        f'{lines[key.value]}'
                    )
                lines[key.value] = line
            child = value
        check_keys(child, seen)
