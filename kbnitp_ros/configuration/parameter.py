# SPDX-License-Identifier: Apache-2.0
"""A parameter: its name, default and allowed values."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
import json
import os
import re
from typing import Any

from kbnitp_ros.configuration.ros_yaml import parse_parameters
from kbnitp_ros.files import nearest
from kbnitp_ros.plugins import Registry

NAME = '[A-Za-z][A-Za-z0-9_]*'


def own_name(name: str) -> tuple[str, str] | None:
    """Split ``team.AGENT.NAME`` into agent and parameter; None for other names."""
    own = re.fullmatch(rf'team\.({NAME})\.(.+)', name)
    return (own[1], own[2]) if own else None


KINDS = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}


@dataclass(frozen=True)
class Parameter:
    """One row of the table."""

    # Name in ROS, with a dot for each level.
    name: str
    # Default value, which has the type of the parameter.
    default: Any
    nodes: tuple[str, ...]
    # One sentence, with the unit.
    description: str = ''
    # Default value in the field; None if it is the same.
    in_field: Any = None
    # The type of a list's elements.
    element: type | None = None
    # Lowest and highest value allowed.
    limits: tuple[float, float] | None = None
    # A value outside the limits that switches the parameter off, such as 0 for no maximum.
    off: float | None = None
    # The values allowed; empty for any. A registry also has the names of plug-ins.
    choices: Collection[str] = ()
    # A text allowed in place of a number; empty for none.
    word: str = ''
    # A regular expression that a text must match; empty for any text.
    pattern: str = ''
    # Whether a text names a file or folder, so that ~/ stands for the home folder.
    is_file: bool = False
    # Whether the value is fixed once the node runs.
    read_only: bool = True
    # Whether an agent may have its own value, in ``team.AGENT.NAME`` with NAME as in `of_agent`.
    per_agent: bool = False

    @property
    def differs(self) -> str:
        """Describe the default in the field; empty if it does not differ."""
        return '' if self.in_field is None else f', in the field {json.dumps(self.in_field)}'

    @property
    def of_agent(self) -> str:
        """Return the name below ``team.AGENT``, which lacks the group `grid`."""
        return self.name.removeprefix('grid.')

    @property
    def kind(self) -> str:
        """Describe the type of the value."""
        if self.element is None:
            return KINDS[type(self.default)] + (self.word and f' or {self.word}')
        return f'a list, each {KINDS[self.element]}'

    @property
    def allowed(self) -> str:
        """Describe the limits of the value besides the type; empty if there are none."""
        if self.limits is not None:
            off_or = '' if self.off is None else f'{self.off} or '
            return f'{off_or}from {self.limits[0]} to {self.limits[1]}'
        if self.choices != ():
            return f'one of {", ".join(self.choices)}'
        return f'of the form {self.pattern}' if self.pattern else ''

    @property
    def must_be(self) -> str:
        """Describe the type and the limits of the value."""
        return ', '.join(filter(None, (self.kind, self.allowed)))

    @property
    def changeable(self) -> str:
        """Describe whether the value can change while the node runs; empty if it cannot."""
        return '' if self.read_only else ' Can be changed while the node runs.'

    @property
    def summary(self) -> str:
        """Describe the parameter with its default, type and limits."""
        default = json.dumps(self.default) + self.differs
        return f'{self.description} Default {default}; {self.must_be}.'

    def read(self, text: str) -> Any:
        """Parse a text from the command line, and check it."""
        if self.element is None and isinstance(self.default, str):
            return self.check(text)
        try:
            value = parse_parameters(text)
        except ValueError:
            value = text
        if isinstance(value, str) and isinstance(self.default, float):
            # As options read them, such as nan, which is no number in YAML.
            with suppress(ValueError):
                value = float(value)
        return self.check(value)

    def check(self, value: Any) -> Any:
        """Check a value and return it in this parameter's type; whole numbers become floats."""
        if self.element is None:
            return self._check_one(value, type(self.default))
        # rclpy turns an empty YAML list into None.
        values = () if value is None else value
        if isinstance(values, (str, bytes, Mapping)) or not hasattr(values, '__iter__'):
            raise ValueError(f'parameter {self.name} is {value!r}: it must be {self.kind}')
        return tuple(self._check_one(one, self.element) for one in values)

    def check_change(self, value: Any) -> None:
        """Check a value for a running node, which imports no module: anyone may set values."""
        choices = self.choices
        if isinstance(choices, Registry) and ':' in str(value) and value not in choices:
            raise ValueError(
                f'parameter {self.name} is {value!r}: a module is imported at the start only; '
                'start the node with it'
            )
        self.check(value)

    def check_recorded(self, value: Any) -> Any:
        """Check a value in a log and return it as `check` does; its names import no module."""
        return value if isinstance(self.choices, Registry) else self.check(value)

    def _check_one(self, value: Any, wanted: type[Any]) -> Any:
        if self.word and value == self.word:
            return value
        if isinstance(self.choices, Registry):
            self.choices.load(value)
        if wanted is float and type(value) is int:
            value = float(value)
        if type(value) is not wanted:
            raise ValueError(f'parameter {self.name} is {value!r}: it must be {self.must_be}')
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
        if self.is_file and value.startswith('~/'):
            # Path.expanduser raises where there is no home folder.
            return os.path.expanduser(value)  # noqa: PTH111
        return value
