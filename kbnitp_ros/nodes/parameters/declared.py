# SPDX-License-Identifier: Apache-2.0
"""How a node declares its parameters and keeps their values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.nodes.parameters.known import check_known, parameter_of, parameters_of
from kbnitp_ros.nodes.parameters.names import nearest, own_name
from kbnitp_ros.nodes.parameters.table import NODES
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
import rclpy.parameter


def declare(node: Node, name: str) -> dict[str, Any]:
    """
    Declare the parameters of the node called `name` and return their values.

    The values are kept up to date while the node runs.

    Raises
    ------
    ValueError
        If a value given at start-up has the wrong type, is not allowed, or is for no parameter of
        any node. Those of other nodes are passed over, since nodes often share a section of a
        file.

    """
    mine = parameters_of(name)
    values = {parameter.name: parameter.default for parameter in mine.values()}
    # rclpy has no other way to see what was given for names that are not declared.
    for given, override in node._parameter_overrides.items():
        if parameter := parameter_of(name, given):
            mine[given] = parameter
            values[given] = parameter.check(override.value)
        else:
            check_known(given, NODES)
    # A real robot knows of no other agents.
    if 'agents' in values:
        check_own(values)
    for parameter in mine.values():
        value = values[parameter.name]
        node.declare_parameter(
            parameter.name,
            value if parameter.element is None else list(value),
            parameter.descriptor,
            ignore_override=True,
        )

    def check(changes: list[rclpy.parameter.Parameter]) -> SetParametersResult:
        try:
            for change in changes:
                if change.name in mine:
                    mine[change.name].check(change.value)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def keep(changes: list[rclpy.parameter.Parameter]) -> None:
        values.update({change.name: change.value for change in changes if change.name in mine})

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(keep)
    return values


def check_own(values: Mapping[str, Any]) -> None:
    """
    Check that what agents have of their own is for agents that there are.

    Raises
    ------
    ValueError
        If not; names the agent meant.

    """
    for name in values:
        own = own_name(name)
        if own and own[0] not in values['agents']:
            agents = values['agents']
            raise ValueError(
                f'parameter {name} is for {own[0]}: {nearest(own[0], agents)}the parameter agents '
                f'names {", ".join(agents)}'
            )
