# SPDX-License-Identifier: Apache-2.0
"""Scenario files with choices, and the scenarios of the package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, fields, is_dataclass, MISSING
from itertools import product
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints, Union

from kbnitp_ros.core import Beta, Unknowns
from kbnitp_ros.core.field.check import in_short
from kbnitp_ros.files import as_file, nearest, parse_yaml, read_yaml, share
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


@dataclass(frozen=True)
class Study:
    """The scenarios of a study, one for each combination of its choices."""

    # Scenario as a mapping; a list in place of a value or a section is an axis of choices.
    content: dict[str, Any]
    # Names of the chosen values.
    axes: tuple[str, ...]
    # Scenario of each combination of values, in the order of `axes`.
    scenarios: dict[tuple[Any, ...], Scenario]

    @property
    def first(self) -> Scenario:
        """Return the scenario of the first combination."""
        return next(iter(self.scenarios.values()))


def read_study(path: Path, changes: Mapping[str, Any] | None = None) -> Study:
    """Read a scenario file; `changes` are values by their names."""
    path = as_file('path', path)
    try:
        return parse_study(read_yaml(path), changes)
    except ValueError as error:
        given = ', '.join(f'{name}={value}' for name, value in (changes or {}).items())
        given = given and f' with {given}'
        raise ValueError(f'scenario {path}{given}: {error}') from error


def parse_study(given: Any, changes: Mapping[str, Any] | None = None) -> Study:
    """Return the study of YAML content or a Python mapping."""
    content = deepcopy(given)
    if not isinstance(content, dict):
        parse_scenario(content)
    changes = {} if changes is None else changes
    if not isinstance(changes, Mapping):
        raise TypeError(f'changes is {in_short(changes)}: it must be a mapping of names to values')
    for name, value in changes.items():
        set_value(content, full_name(name), value)
    if isinstance(teams := content.get('teams'), list):
        content['teams'] = [each for team in teams for each in list_strategies(team)]
    choices = dict(list_choices(Scenario, content))
    scenarios: dict[tuple[Any, ...], Scenario] = {}
    for combination in product(*choices.values()):
        values: dict[str, Any] = {}
        for key, value in zip(choices, combination):
            set_value(content, key, value)
            inside = value if isinstance(value, Mapping) else {}
            values |= {f'{key}.{name}': each for name, each in inside.items()} or {key: value}
        scenarios[tuple(values.values())] = parse_scenario(content)
    if len({len(each) for each in scenarios}) > 1:
        raise ValueError(f'{", ".join(choices)}: all entries must have the same keys')
    whole = asdict(next(iter(scenarios.values())))
    for key, points in choices.items():
        set_value(whole, key, points)
    return Study(whole, tuple(map(short_name, values)), scenarios)


def list_strategies(team: Any) -> Iterator[Any]:
    """Yield a team for each combination of the values that it lists."""
    if not isinstance(team, dict):
        yield team
        return
    lists = [each if isinstance(each, list) else [each] for each in team.values()]
    for values in product(*lists):
        yield dict(zip(team, values))


def list_choices(
    annotation: Any, content: Any, inside: str = ''
) -> Iterator[tuple[str, list[Any]]]:
    """Yield the names of values and sections that are lists of choices, with the lists."""
    for name, kind in get_type_hints(annotation, include_extras=True).items():
        key, value, kind = f'{inside}{name}', content.get(name), not_none(kind)
        if get_origin(kind) is tuple or kind is Unknowns or key == 'trials':
            continue
        if isinstance(value, list):
            if not value or any(value.count(each) > 1 for each in value):
                raise ValueError(f'{key} is {value}: it must be a list of different choices')
            yield key, value
        elif is_dataclass(kind) and isinstance(value, dict):
            yield from list_choices(kind, value, f'{key}.')


def set_value(content: dict[str, Any], key: str, value: Any) -> None:
    """Set a value of a scenario by its full name; a name in teams is set in each of them."""
    section, _, name = key.rpartition('.')
    kind = not_none(get_type_hints(Scenario, include_extras=True)[section or name])
    if section == 'teams':
        content['teams'] = [{**team, name: value} for team in content.get('teams') or [{}]]
    elif section:
        own = content.get(section) or {}
        if not isinstance(own, dict):
            raise ValueError(f'{section} is {own}: set {key} in each of them')
        content[section] = {**own, name: value}
    else:
        is_one = get_origin(kind) is tuple and not isinstance(value, list | tuple)
        content[name] = [value] if is_one else value


def not_none(kind: Any) -> Any:
    """Return a type without None."""
    is_union = get_origin(kind) in (Union, UnionType)
    return next(e for e in get_args(kind) if e is not NoneType) if is_union else kind


def list_names(annotation: Any = Scenario, inside: str = '') -> Iterator[str]:
    """Yield the full names of the values of a scenario."""
    for name, kind in get_type_hints(annotation, include_extras=True).items():
        kind = not_none(kind)
        yield f'{inside}{name}'
        if get_origin(kind) is tuple:
            kind = get_args(kind)[0]
        if is_dataclass(kind) and kind is not Unknowns:
            yield from list_names(kind, f'{inside}{name}.')


def full_name(name: str) -> str:
    """Return a name with its section; raise a ValueError if there is no such name or several."""
    known = list(list_names())
    meant = [name] if name in known else [each for each in known if each.endswith(f'.{name}')]
    if not meant:
        raise ValueError(f'{name} is unknown: {nearest(name, known)}see docs/files.md')
    if len(meant) > 1:
        raise ValueError(f'{name} may be {" or ".join(meant)}: give one of these names')
    return meant[0]


def short_name(key: str) -> str:
    """Return the shortest name of a value."""
    name = key.rpartition('.')[2]
    same = [each for each in list_names() if each.rpartition('.')[2] == name]
    return name if len(same) == 1 else key


def read_changes(texts: Iterable[str]) -> dict[str, Any]:
    """Return changes by their names, from texts such as max_visits=1,3."""
    changes = {}
    for text in texts:
        name, is_given, value = text.partition('=')
        if not is_given:
            raise ValueError(f'{text} has no value: write {text}=VALUE, or several with commas')
        found = parse_yaml(value)
        if isinstance(found, str) and ',' in found:
            found = [parse_yaml(each) for each in found.split(',')]
        changes[name] = found
    return changes


def parse_scenario(content: Any) -> Scenario:
    """Return the scenario of YAML content or a Python mapping without choices."""
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
    file = as_file('scenario', name)
    if name in shipped():
        return share('config/scenarios') / f'{name}.yaml'
    if not file.is_file():
        raise ValueError(f'scenario {name} is neither a file nor one of {", ".join(shipped())}')
    return file
