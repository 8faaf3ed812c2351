# SPDX-License-Identifier: Apache-2.0
"""
Read YAML that may be corrupt or hostile.

A few hundred bytes of YAML can stand for any number of values, by aliases of aliases, and deep
nesting exhausts the stack of libyaml. So a text is read twice: first event by event, which keeps
nothing, and as a whole only if it is within bounds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kbnitp_ros.files.regular import open_file
from kbnitp_ros.files.words import naming
import yaml

# Bytes of a file. Two pictures of a world of 1000x1000 cells have 2 million.
MOST_BYTES = 2**24

# Values, an alias counted as what it stands for. The QoS of 5000 publishers have 100,000.
MOST_VALUES = 250_000

# Lists and mappings in each other.
DEEPEST = 100

# Characters of a value without quotes: the time that a number takes grows with their square.
LONGEST = 10_000


class Loader(yaml.CSafeLoader):
    """Makes the types of YAML 1.1, and lists of the tuples in the parameter files of launch."""


def as_list(loader: Loader, node: yaml.SequenceNode) -> list[Any]:
    """Return what a sequence holds."""
    return loader.construct_sequence(node, deep=True)


Loader.add_constructor('tag:yaml.org,2002:python/tuple', as_list)


class NotYamlError(ValueError):
    """A text that is no YAML, such as one that was cut off."""


class KeyTwiceError(ValueError):
    """A key that stands twice in a mapping."""

    def __init__(self, key: str, line: int, before: int) -> None:
        super().__init__(f'the key {key!r} stands in line {line} and in line {before}')
        self.key = key


def read_yaml(path: str | Path) -> Any:
    """
    Return what stands in a YAML file, as `parse_yaml`.

    Raises
    ------
    OSError
        If it cannot be read, or is no file.
    ValueError
        As `parse_yaml`; also if it is too large.

    """
    with naming(path), open_file(path) as file:
        text = file.read(MOST_BYTES + 1)
    if len(text) > MOST_BYTES:
        raise ValueError(f'it has more than {MOST_BYTES} bytes')
    return parse_yaml(text)


def parse_yaml(text: str | bytes) -> Any:
    """
    Return what a YAML text says, in the types of YAML 1.1.

    Raises
    ------
    NotYamlError
        If it is not YAML.
    KeyTwiceError
        If a key stands twice in a mapping; names the lines.
    ValueError
        If the text stands for too much; names the line.

    """
    try:
        check(text)
    except yaml.YAMLError as error:
        raise not_yaml(error) from error
    try:
        return yaml.load(text, Loader=Loader)
    except Exception as error:
        # PyYAML fails in many ways on a value that does not fit its tag.
        raise not_yaml(error) from error


def not_yaml(error: object) -> NotYamlError:
    """Return the error for a text that PyYAML refuses."""
    return NotYamlError(f'it is not YAML: {" ".join(str(error).split())}')


@dataclass
class Collection:
    """A list or mapping that has not ended yet."""

    # What aliases call it.
    anchor: str | None = None
    # How many values the text has up to it.
    before: int = 0
    # Whether it has keys.
    is_mapping: bool = False
    # How many of its elements, or keys and values, have begun.
    parts: int = 0
    # The lines of its keys, those which are collections or aliases left out.
    keys: dict[str, int] = field(default_factory=dict)

    def begin(self, event: yaml.NodeEvent, line: int) -> None:
        """Begin another part; refuse a key that was there already."""
        if self.is_mapping and self.parts % 2 == 0 and isinstance(event, yaml.ScalarEvent):
            key = event.value
            if key in self.keys:
                raise KeyTwiceError(key, line, self.keys[key])
            self.keys[key] = line
        self.parts += 1


def check(text: str | bytes) -> None:
    """Refuse a text that has a key twice or stands for too much."""
    values = 0
    # By anchor; what has none is never asked for.
    sizes: dict[str | None, int] = {}
    opened = [Collection()]
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, yaml.CollectionEndEvent):
            ended = opened.pop()
            sizes[ended.anchor] = values - ended.before
        elif isinstance(event, yaml.NodeEvent):
            opened[-1].begin(event, line)
            if isinstance(event, yaml.AliasEvent):
                if event.anchor not in sizes:
                    raise not_yaml(f'line {line} has an alias of nothing before it')
                values += sizes[event.anchor]
            elif isinstance(event, yaml.ScalarEvent):
                values += 1
                sizes[event.anchor] = 1
                is_text = event.implicit[1]
                if not is_text and len(event.value) > LONGEST:
                    raise ValueError(f'line {line} has a value of more than {LONGEST} characters')
            else:
                is_mapping = isinstance(event, yaml.MappingStartEvent)
                opened.append(Collection(event.anchor, values, is_mapping))
                values += 1
        if values > MOST_VALUES:
            raise ValueError(f'it stands for more than {MOST_VALUES} values, aliases written out')
        if len(opened) > DEEPEST:
            raise ValueError(f'line {line} is nested more than {DEEPEST} deep')
