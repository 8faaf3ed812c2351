# SPDX-License-Identifier: Apache-2.0
"""Scenario files, and the scenarios of the package."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, MISSING
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints, Union

from kbnitp_ros.core import Beta, Unknowns
from kbnitp_ros.files import read_yaml, share
from kbnitp_ros.plugins import Registry
from kbnitp_ros.study.scenario import NUMBERS, Probability, Scenario
import numpy as np

KINDS = {int: 'a whole number', float: 'a number'}


# Types of the fields of `Unknowns` and `Beta` in a scenario.
PRIORS: dict[type, dict[str, Any]] = {
    Unknowns: dict.fromkeys(NUMBERS, Beta | None),
    Beta: {
        **dict.fromkeys('ab', Annotated[float, (0.01, 1000.0)]),
        **dict.fromkeys(('low', 'high'), Probability),
    },
}


def read_scenario(path: Path) -> Scenario:
    """Read a scenario file."""
    try:
        return parse_scenario(read_yaml(path))
    except ValueError as error:
        raise ValueError(f'scenario {path}: {error}') from error


def parse_scenario(content: Any) -> Scenario:
    """Return the scenario of YAML content or a Python mapping."""
    scenario: Scenario = _read(Scenario, content, '')
    for key, check in (
        ('grid', scenario.field),
        ('learn', scenario.check_learning),
        ('prior', scenario.check_belief),
        ('teams', scenario.check_teams),
        ('hazards', scenario.check_hazards),
        ('planning', scenario.check_search),
        ('asked', scenario.check_asked),
    ):
        try:
            check()
        except ValueError as error:
            raise ValueError(f'{key}: {error}') from error
    return scenario


def _read(annotation: Any, value: Any, key: str) -> Any:
    """Parse the YAML content of `key` by its annotation: a section, a list or a value."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if is_dataclass(annotation):
        return _read_section(annotation, value, key)
    if get_origin(annotation) in (Union, UnionType):
        return None if value is None else _read(get_args(annotation)[0], value, key)
    if get_origin(annotation) is tuple:
        if not isinstance(value, list | tuple) or not value:
            raise ValueError(f'{key} is {value!r}: it must be a list of at least one value')
        values = tuple(_read(get_args(annotation)[0], one, key) for one in value)
        if len(set(values)) < len(values):
            raise ValueError(f'{key} is {value}: each entry may occur only once')
        return values
    wanted, allowed, *besides = get_args(annotation)
    if wanted is str:
        if isinstance(allowed, Registry):
            allowed.load(value)
        if value not in allowed and value not in besides:
            named = tuple(filter(None, besides))
            if isinstance(allowed, tuple):
                why = f'it must be one of {", ".join(allowed + named)}'
            else:
                why = allowed.why_not(value, *named)
            raise ValueError(f'{key} is {value!r}: {why}')
        return value
    lowest, highest = allowed
    of_kind = type(value) is wanted or (wanted is float and type(value) is int)
    if not (of_kind and lowest <= value <= highest):
        raise ValueError(
            f'{key} is {value!r}: it must be {KINDS[wanted]} from {lowest} to {highest}'
        )
    return wanted(value)


def _read_section(annotation: Any, content: Any, key: str) -> Any:
    """Parse a section as a dataclass; an empty key means the whole scenario."""
    known = [field.name for field in fields(annotation)]
    name, inside = (key, f'{key}.') if key else ('it', '')
    if not isinstance(content, dict):
        raise ValueError(f'{name} is {content!r}: it must have the keys {", ".join(known)}')
    unknown = [str(given) for given in content if given not in known]
    if unknown:
        raise ValueError(f'{inside}{unknown[0]} is unknown: {name} has {", ".join(known)}')
    missing = [
        f.name for f in fields(annotation) if f.default is MISSING and f.name not in content
    ]
    if missing:
        raise ValueError(f'{inside}{missing[0]} is missing: {name} has {", ".join(known)}')
    annotations = PRIORS.get(annotation) or get_type_hints(annotation, include_extras=True)
    values = {k: _read(annotations[k], value, f'{inside}{k}') for k, value in content.items()}
    try:
        return annotation(**values)
    except ValueError as error:
        raise ValueError(f'{key}: {error}') from error


def shipped() -> list[str]:
    """Return the names of the scenarios of the package."""
    return sorted(path.stem for path in share('config/scenarios').glob('*.yaml'))


def scenario_file(name: str) -> Path:
    """Return the path of a scenario of the package, or of a file."""
    if name in shipped():
        return share('config/scenarios') / f'{name}.yaml'
    if not Path(name).is_file():
        raise ValueError(f'scenario {name} is neither a file nor one of {", ".join(shipped())}')
    return Path(name)
