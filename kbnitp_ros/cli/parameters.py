# SPDX-License-Identifier: Apache-2.0
"""The parameters of a command's nodes, from a file, from --set, or from a log."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any

from kbnitp_ros.configuration import find_parameter, make_goal, node_parameters
from kbnitp_ros.configuration.given import Sections, values_for
from kbnitp_ros.configuration.known import check_known
from kbnitp_ros.configuration.mission import settled_goal
from kbnitp_ros.configuration.parameter import own_name
from kbnitp_ros.files import nearest
from kbnitp_ros.log.record import required_belief
from kbnitp_ros.log.replayed_decisions import RecordedGoal
from kbnitp_ros.log.roles import MissionLog


def node_values(sections: Sections, nodes: Collection[str]) -> dict[str, dict[str, Any]]:
    """Return the values that the sections of a file give each node."""
    values: dict[str, dict[str, Any]] = {node: {} for node in nodes}
    for node in nodes:
        for name, value in values_for(sections, f'/{node}').items():
            assign(values[node], node, name, value)
    return values


def assign(
    values: dict[str, Any], node: str, name: str, given: Any, *, is_text: bool = False
) -> None:
    """Set a parameter if the node has it."""
    if parameter := find_parameter(node, name):
        values[name] = parameter.read(given) if is_text else parameter.check(given)


def set_parameter(
    values: Mapping[str, dict[str, Any]], rule: str, command: str, fixed: Collection[str] = ()
) -> None:
    """Apply a rule [NODE:]NAME=VALUE to all nodes that have the parameter, or to NODE."""
    target, is_rule, text = rule.partition('=')
    node, of_one, name = target.rpartition(':')
    try:
        if not (is_rule and name):
            raise ValueError('it must be NAME=VALUE or NODE:NAME=VALUE')
        if of_one and node not in values:
            raise ValueError(
                f'{node!r} is no node of the {command}: {nearest(node, values)}its nodes are '
                f'{", ".join(values)}'
            )
        if name in fixed:
            raise ValueError(f'the {command} sets {name} itself')
        nodes = [node] if of_one else [*values]
        check_known(name, nodes)
        for owner in nodes:
            assign(values[owner], owner, name, text, is_text=True)
    except ValueError as error:
        raise ValueError(f'--set {rule}: {error}') from error


def recorded_values(recorded: Mapping[str, Any], node: str) -> dict[str, Any]:
    """Return the recorded values of a node, with defaults for parameters not recorded."""
    # The default of a parameter added later gives the behaviour of earlier versions.
    values = {
        name: parameter.default if recorded.get(name) is None else recorded[name]
        for name, parameter in node_parameters(node).items()
    }
    return values | {name: value for name, value in recorded.items() if own_name(name)}


def recorded_planner(log: MissionLog) -> dict[str, Any]:
    """Return the recorded values of the planner, with the cells of a mask by number."""
    recorded = log.parameters
    names = [name for name in recorded if name.rpartition('/')[2] == 'planner']
    if len(names) != 1:
        raise ValueError(f'{log.path} does not record the parameters of exactly one planner')
    planner = recorded_values(recorded[names[0]], 'planner')
    for name, parameter in node_parameters('planner').items():
        planner[name] = parameter.check_recorded(planner[name])
    if planner['goal.mask']:
        # Decisions have the cells since 1.9; the file may have changed.
        decisions = (logged.message for _, logged in log.read('decision'))
        cells = next((getattr(each, 'goal_cells', ()) for each in decisions), ())
        if len(cells):
            planner |= {'goal.cells': [*map(int, cells)], 'goal.mask': ''}
    return planner


def asked_on_record(log: MissionLog) -> RecordedGoal | None:
    """Return the goal on record; None if it is not recorded, or not valid."""
    with suppress(ValueError):
        first, planner = required_belief(log), recorded_planner(log)
        planner |= settled_goal(planner, first.grid)
        if goal := make_goal(planner, first.grid):
            goal.check(first.grid, planner['max_steps'])
            return RecordedGoal(goal, planner['max_steps'], planner['goal.cells'])
    return None
