# SPDX-License-Identifier: Apache-2.0
"""The parameters of each node, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from kbnitp_ros.configuration.parameter import own_name, Parameter
from kbnitp_ros.configuration.table import NODES, TABLE
from kbnitp_ros.files import nearest

# Name of the parameter in which a node states its topics.
TOPICS = 'topics'

# Parameters that every node has besides those of the table, as in its `ros2 param dump`.
CLOCK = 'use_sim_time'
ROS_PARAMETERS = (CLOCK, 'start_type_description_service', 'qos_overrides', TOPICS)


def node_parameters(name: str) -> dict[str, Parameter]:
    """Return the parameters of a node by name."""
    return {parameter.name: parameter for parameter in TABLE if name in parameter.nodes}


def find_parameter(node: str, name: str) -> Parameter | None:
    """Return a node's parameter by name or by ``team.AGENT.NAME``; None if there is none."""
    known = node_parameters(node)
    own = own_name(name)
    if own is None:
        return known.get(name)
    of_agents = {each.of_agent: each for each in known.values() if each.per_agent}
    common = of_agents.get(own[1])
    return replace(common, name=name) if common else None


def check_known(name: str, nodes: Sequence[str]) -> None:
    """Check that a name is a parameter of one of these nodes."""
    if name.split('.')[0] in ROS_PARAMETERS or any(find_parameter(node, name) for node in nodes):
        return
    whose = f'the {nodes[0]}' if len(nodes) == 1 else 'every node'
    if others := [node for node in NODES if find_parameter(node, name)]:
        raise ValueError(
            f'parameter {name} is unknown to {whose}: it is a parameter of {", ".join(others)}'
        )
    table = [parameter for node in nodes for parameter in node_parameters(node).values()]
    known = {parameter.name for parameter in table}
    if own := own_name(name):
        agent, meant = own
        known = {f'team.{agent}.{each.of_agent}' for each in table if each.per_agent}
        if meant in {parameter.name for parameter in table if not parameter.per_agent}:
            raise ValueError(f'parameter {name}: all agents have the same {meant}')
    raise ValueError(
        f'parameter {name} is unknown to {whose}: {nearest(name, known)}'
        f'see {" --help, ".join(nodes)} --help'
    )


def foreign_note(name: str, nodes: Sequence[str] = NODES) -> str:
    """Return a note on a parameter that is no node's; ValueError if it is misspelt."""
    try:
        check_known(name, NODES)
    except ValueError as error:
        # A name that is near to one of these nodes' is refused in their words.
        for near in (nodes, NODES):
            if any(_is_misspelt(name, known) for node in near for known in node_parameters(node)):
                check_known(name, near)
        if own_name(name):
            raise
        return f'{error} (ignored, since a launch file may set it for other nodes)'
    return ''


def _is_misspelt(name: str, known: str) -> bool:
    """Detect a single typing error: a letter missing, added, changed, or swapped."""
    if abs(len(name) - len(known)) > 1:
        return False
    pairs = list(zip(name, known))
    same = next((at for at, (one, other) in enumerate(pairs) if one != other), len(pairs))
    one, other = name[same:], known[same:]
    is_swapped = one[:2] == other[1::-1] and one[2:] == other[2:]
    return is_swapped or one[1:] in (other, other[1:]) or one == other[1:]


def check_own(values: Mapping[str, Any]) -> None:
    """Check that every agent with parameters of its own is in the team."""
    for name in values:
        own = own_name(name)
        if own and own[0] not in values['agents']:
            agents = values['agents']
            raise ValueError(
                f'parameter {name} is of agent {own[0]}, which is not in the team: '
                f'{nearest(own[0], agents)}the parameter agents is {", ".join(agents)}'
            )
