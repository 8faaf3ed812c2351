# SPDX-License-Identifier: Apache-2.0
"""
Parameters that users give, in files and on the command line, checked against the table.

ROS passes only values to a node; it ignores misspelt names and parameters of other nodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import chain, pairwise
from pathlib import Path
import re
from typing import Any

from kbnitp_ros.configuration import find_parameter, NODES
from kbnitp_ros.configuration.known import check_known, CLOCK, foreign_note
from kbnitp_ros.configuration.ros_yaml import parse_parameters, read_parameter_file
from kbnitp_ros.files import nearest

# Sections of a file for several nodes at once.
WILDCARDS = ('*', '**')

# ROS flags for parameters and names, each with its spellings.
REMAP, RULE, FILE = ('-r', '--remap'), ('-p', '--param'), ('--params-file',)

# Values by parameter name, by section of a file.
Sections = dict[str, dict[str, Any]]


def read_sections(path: str | Path, names: Mapping[str, str] | None = None) -> Sections:
    """Read and check a parameter file."""
    try:
        return check_sections(read_parameter_file(path), names or {})
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ValueError(f'parameter file {path}: {reason}') from error


def check_sections(config: Any, names: Mapping[str, str]) -> Sections:
    """Check the sections of a parameter file that YAML has loaded."""
    if not isinstance(config, Mapping):
        raise ValueError(f'it holds {config!r}: it must hold sections, such as /**')
    sections = {}
    for section, values in _sections(config, ''):
        nodes = _nodes_in(section, names)
        if not nodes:
            # The section is for another program, unless it has parameters of a node with a
            # similar name.
            for node in get_close_matches(section.rpartition('/')[2], NODES, n=1, cutoff=0.8):
                if any(find_parameter(node, name) for name in values):
                    raise ValueError(f'section {section!r} names no node: did you mean {node}?')
            continue
        sections[section] = values
        try:
            for name, value in values.items():
                check_known(name, nodes)
                for node in nodes:
                    if parameter := find_parameter(node, name):
                        parameter.check(value)
        except ValueError as error:
            raise ValueError(f'section {section!r}: {error}') from error
    return sections


def _sections(tree: Mapping[str, Any], above: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the sections below a namespace, with their values."""
    for key, content in tree.items():
        name = f'{above}{key}'
        if not isinstance(content, Mapping) or ('ros__parameters' in content and len(content) > 1):
            raise ValueError(f'section {name!r} must hold ros__parameters and nothing else')
        if 'ros__parameters' in content:
            yield name, dict(_leaves(content['ros__parameters'], name))
        else:
            yield from _sections(content, f'{name}/')


def _leaves(tree: Any, section: str, above: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings by their dotted names."""
    if tree is not None and not isinstance(tree, Mapping):
        raise ValueError(f'section {section!r} holds {tree!r}: it must hold parameters by name')
    for key, value in (tree or {}).items():
        if isinstance(value, Mapping):
            yield from _leaves(value, section, f'{above}{key}.')
        else:
            yield f'{above}{key}', value


def _nodes_in(section: str, names: Mapping[str, str]) -> Sequence[str]:
    """Return the executables to which a section, or a rule with a node name, applies."""
    name = section.rpartition('/')[2]
    if name in WILDCARDS:
        return NODES
    return [names.get(name, name)] if name in (*NODES, *names) else []


def values_for(sections: Sections, node: str) -> dict[str, Any]:
    """Return the values that ROS gives a node: a later section overrides an earlier one."""
    values = {}
    for section, given in sections.items():
        if _fits(section, node):
            values.update(given)
    return values


def _fits(section: str, node: str) -> bool:
    """Return whether a section's name, with wildcards as in rclpy, matches a node's full name."""
    return bool(re.fullmatch(f'/{section.removeprefix("/")}'.replace('/*', r'(/\w+)'), node))


def check_given(name: str, arguments: Sequence[str]) -> None:
    """Check the parameters on a node's command line."""
    given = [each for _, *each in _ros_flags(arguments)]
    remaps = dict(rule.split(':=', 1) for flag, rule in given if flag in REMAP and ':=' in rule)
    called = remaps.get('__node', name)
    full_name = f'{remaps.get("__ns", "").rstrip("/")}/{called}'
    sections: Sections = {}
    for path in (path for flag, path in given if flag in FILE):
        for section, values in read_sections(path, {called: name}).items():
            sections.setdefault(section, {}).update(values)
    for rule in (rule for flag, rule in given if flag in RULE):
        target, _, text = rule.partition(':=')
        node, _, parameter = target.rpartition(':')
        if node:
            if not (nodes := _nodes_in(node, {called: name})):
                meant = nearest(node, [called])
                raise ValueError(f'-p {rule}: this node is not {node!r}: {meant}it is {called}')
            check_known(parameter, nodes)
        elif parameter == CLOCK or find_parameter(name, parameter):
            # ROS treats the rule like a line of section /**.
            check_counts(sections, '/**', full_name, {parameter: parse_parameters(text)}, '-p ')
        else:
            # Launch gives each node the parameters of all nodes.
            foreign_note(parameter, [name])


def check_counts(
    sections: Sections, section: str, node: str, given: Mapping[str, Any], flag: str = ''
) -> None:
    """Check that no later section overrides these values of a node."""
    merged = {name: dict(values) for name, values in sections.items()}
    merged.setdefault(section, {}).update(given)
    for name, value in given.items():
        *_, last = (each for each in merged if name in merged[each] and _fits(each, node))
        if last != section and merged[last][name] != value:
            raise ValueError(
                f'{flag}{name}:={value} has no effect: in ROS, section {last!r} of the parameter '
                f'file takes precedence; change {name} there'
            )


def rules_last(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with the -p rules last: they count, and not a file's section /**."""
    flags = [at for at, flag, _ in _ros_flags(arguments) if flag in RULE]
    moved = [at for flag in flags for at in (flag, flag + 1)]
    rest = [word for at, word in enumerate(arguments) if at not in moved]
    return [*rest, '--ros-args', *(arguments[at] for at in moved)] if moved else rest


def names_given(arguments: Sequence[str]) -> list[str]:
    """Return the arguments that name the node and remap its topics."""
    renamed = [each for _, *each in _ros_flags(arguments) if each[0] in REMAP]
    return ['--ros-args', *chain.from_iterable(renamed)]


def _ros_flags(arguments: Sequence[str]) -> Iterator[tuple[int, str, str]]:
    """Yield the positions of the ROS flags, with each flag and the word that follows it."""
    is_for_ros = False
    for at, (word, following) in enumerate(pairwise([*arguments, ''])):
        if word in ('--ros-args', '--'):
            is_for_ros = word == '--ros-args'
        elif is_for_ros and word.startswith('-'):
            yield at, word, following
