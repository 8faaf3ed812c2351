# SPDX-License-Identifier: Apache-2.0
"""The parameters of a command's nodes, from a file, from --set, or from a log."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any

from kbnitp_ros.cli.output import complain
from kbnitp_ros.configuration import find_parameter, make_goal, node_parameters
from kbnitp_ros.configuration.given import Sections, values_for
from kbnitp_ros.configuration.known import check_known, gone_note
from kbnitp_ros.configuration.parameter import own_name
from kbnitp_ros.configuration.table import LEARNT
from kbnitp_ros.files import nearest
from kbnitp_ros.log.record import first_belief
from kbnitp_ros.log.replay import RecordedGoal
from kbnitp_ros.log.roles import MissionLog

# The nodes of the demo.
NODES = ('recorder', 'estimator', 'agent', 'planner')

# Seconds after its expected return at which a silent robot is given up. Robots of the demo take no
# time, but processes on a busy machine do.
RETURN_DEADLINE = 1.0

# Defaults of the demo.
DEFAULTS = {'return_deadline': RETURN_DEADLINE, 'learn.numbers': LEARNT}

# Options, each with the parameter that it sets in every node that has this parameter.
OPTIONS = {
    'robots': 'robots',
    'map': 'map',
    'lethality': 'sensor.lethality',
    'max_steps': 'max_steps',
    'method': 'method',
    'planner': 'planner',
    'allocation': 'allocation',
    'silent_loss': 'silent_loss',
    'seed': 'seed',
}

# Settings of every demo, to resume it and to know the truth; and all parameters it sets itself.
HELD = {'publish_truth': True, 'recorded': True, 'keep_running': True}
OWN = (*HELD, 'await_nodes', 'file', 'resume', 'agent')


def node_values(
    sections: Sections,
    nodes: Collection[str],
) -> dict[str, dict[str, Any]]:
    """Return the values that the sections of a file give each node."""
    parameters = {}
    for node in nodes:
        values = {}
        for name, value in values_for(sections, f'/{node}').items():
            if parameter := find_parameter(node, name):
                values[name] = parameter.check(value)
            elif note := gone_note(node, name):
                complain('warning', note)
        parameters[node] = values
    return parameters


def set_parameter(
    parameters: Mapping[str, dict[str, Any]], rule: str, command: str, own: Collection[str] = ()
) -> None:
    """Apply a rule [NODE:]NAME=VALUE to all nodes that have the parameter, or to NODE."""
    target, is_rule, text = rule.partition('=')
    node, of_one, name = target.rpartition(':')
    if not is_rule:
        raise ValueError(f'--set {rule}: it must be NAME=VALUE or NODE:NAME=VALUE')
    if of_one and node not in parameters:
        raise ValueError(
            f'--set {rule}: {node!r} is no node of the {command}: {nearest(node, parameters)}'
            f'its nodes are {", ".join(parameters)}'
        )
    if name in own:
        raise ValueError(f'--set {rule}: the {command} sets {name} itself')
    nodes = [node] if of_one else [*parameters]
    try:
        check_known(name, nodes)
        for owner in nodes:
            if parameter := find_parameter(owner, name):
                parameters[owner][name] = parameter.read(text)
            elif note := gone_note(owner, name):
                complain('warning', note)
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
    """Return the recorded values of the planner."""
    recorded = log.parameters
    names = [name for name in recorded if name.rpartition('/')[2] == 'planner']
    if len(names) != 1:
        raise ValueError(f'{log.path} does not record the parameters of exactly one planner')
    return recorded_values(recorded[names[0]], 'planner')


def asked_on_record(log: MissionLog) -> RecordedGoal | None:
    """Return the goal on record; None if it is not recorded."""
    with suppress(ValueError):
        first, planner = first_belief(log), recorded_planner(log)
        if planner['goal.mask']:
            # Decisions have the cells since 1.9; the file may have changed.
            decisions = (logged.message for _, logged in log.read('decision'))
            cells = next((getattr(each, 'goal_cells', ()) for each in decisions), ())
            if len(cells):
                planner |= {'goal.cells': [*map(int, cells)], 'goal.mask': ''}
        goal = make_goal(planner, first.grid) if first else None
        return (goal, planner['max_steps']) if goal else None
    return None
