# SPDX-License-Identifier: Apache-2.0
"""What a parameter is: its name, its default, what its values must be."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
import json
import re
from typing import Any

from kbnitp_ros.files import parse_yaml
from kbnitp_ros.plugins import Registry

NAME = '[A-Za-z][A-Za-z0-9_]*'


def own_name(name: str) -> tuple[str, str] | None:
    """Return the agent and the parameter that ``team.AGENT.NAME`` names; None of other names."""
    own = re.fullmatch(rf'team\.({NAME})\.(.+)', name)
    return (own[1], own[2]) if own else None


def nearest(name: str, known: Iterable[str]) -> str:
    """Return which of the names known may have been meant, as a question; empty when none."""
    # A name within groups, such as lethality, is further from the whole ones than it looks.
    meant = [each for each in sorted(known) if each.rpartition('.')[2] == name]
    meant = meant or get_close_matches(name, sorted(known), n=1, cutoff=0.5)
    return f'did you mean {" or ".join(meant)}? ' if meant else ''


KINDS = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}


@dataclass(frozen=True)
class Parameter:
    """One row of the table."""

    # As in ROS, the dot a level.
    name: str
    # Its type is the parameter's type.
    default: Any
    # One sentence, with the unit.
    description: str
    nodes: tuple[str, ...]
    # The type of a list's elements.
    element: type | None = None
    # Lowest and highest value allowed.
    limits: tuple[float, float] | None = None
    # A value below the limits that stands for none, such as 0 for no limit of a size.
    off: float | None = None
    # The values allowed; empty when any is. Those of a registry grow by what other packages add.
    choices: Collection[str] = ()
    # A text that a number may be in place of a value; empty for none.
    word: str = ''
    # What a text must match, as a regular expression; empty when it need not.
    pattern: str = ''
    # Whether it is fixed once the node runs.
    read_only: bool = True
    # Whether one agent may have another value than the others, as ``team.AGENT.NAME``; NAME is
    # `of_agent`.
    per_agent: bool = False

    @property
    def of_agent(self) -> str:
        """Return its name as what one agent has: a base is of no grid then."""
        return self.name.removeprefix('grid.')

    @property
    def kind(self) -> str:
        """Return what a value must be, in words."""
        if self.element is None:
            return KINDS[type(self.default)] + (self.word and f' or {self.word}')
        return f'a list, each {KINDS[self.element]}'

    @property
    def allowed(self) -> str:
        """Return what a value of the right type must also be, in words; empty when nothing."""
        if self.limits is not None:
            return f'{self._off_or}from {self.limits[0]} to {self.limits[1]}'
        if self.choices != ():
            return f'one of {", ".join(self.choices)}'
        return f'of the form {self.pattern}' if self.pattern else ''

    @property
    def _off_or(self) -> str:
        return '' if self.off is None else f'{self.off} or '

    @property
    def must_be(self) -> str:
        """Return what a value must be, in words."""
        return ', '.join(filter(None, (self.kind, self.allowed)))

    @property
    def changeable(self) -> str:
        """Return whether it can be changed, in words; empty when it cannot."""
        return '' if self.read_only else ' Can be changed while the node runs.'

    @property
    def summary(self) -> str:
        """Return what it is, its default and what it must be."""
        return f'{self.description} Default {json.dumps(self.default)}; {self.must_be}.'

    def read(self, text: str) -> Any:
        """Return the value that a text typed on a command line stands for, as `check` does."""
        if self.element is None and isinstance(self.default, str):
            return self.check(text)
        try:
            value = parse_yaml(text)
        except ValueError:
            value = text
        return self.check(value)

    def check(self, value: Any) -> Any:
        """Return `value` as this parameter's type; whole numbers are taken for numbers."""
        if self.element is None:
            return self._check_one(value, type(self.default))
        # rclpy hands an empty YAML list over as None.
        values = () if value is None else value
        if isinstance(values, (str, bytes, Mapping)) or not hasattr(values, '__iter__'):
            raise ValueError(f'parameter {self.name} is {value!r}: it must be {self.kind}')
        return tuple(self._check_one(one, self.element) for one in values)

    def _check_one(self, value: Any, wanted: type[Any]) -> Any:
        if self.word and value == self.word:
            return value
        if wanted is float and type(value) is int:
            value = float(value)
        if type(value) is not wanted:
            raise ValueError(f'parameter {self.name} is {value!r}: it must be {self.kind}')
        if (
            (self.limits and value != self.off and not self.limits[0] <= value <= self.limits[1])
            or (self.choices != () and value not in self.choices)
            or (self.pattern and not re.fullmatch(self.pattern, value))
        ):
            meant = nearest(value, self.choices) if self.choices else ''
            if isinstance(self.choices, Registry) and value in self.choices.refused:
                meant = f'{self.choices.refused[value]}; '
            raise ValueError(
                f'parameter {self.name} is {value!r}: {meant}it must be {self.allowed}'
            )
        return value
