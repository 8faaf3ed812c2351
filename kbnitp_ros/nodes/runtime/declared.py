# SPDX-License-Identifier: Apache-2.0
"""Declaration of a node's parameters, and their values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.configuration import find_parameter, node_parameters, Parameter, with_defaults
from kbnitp_ros.configuration.known import check_own, CLOCK, foreign_note, TOPICS
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
import rclpy.parameter


def declare(node: Node, name: str) -> dict[str, Any]:
    """Declare the parameters of the node called `name` and return their values."""
    mine = node_parameters(name)
    overrides = {}
    # A private attribute: rclpy does not list given parameters before they are declared.
    for given, override in node._parameter_overrides.items():
        if parameter := find_parameter(name, given):
            mine[given] = parameter
            overrides[given] = parameter.check(override.value)
        elif note := foreign_note(given):
            node.get_logger().warning(note)
    values = with_defaults(name, overrides)
    # A real robot has no parameter agents.
    if 'agents' in values:
        check_own(values)
    for parameter in mine.values():
        value = values[parameter.name]
        node.declare_parameter(
            parameter.name,
            value if parameter.element is None else list(value),
            parameter_descriptor(parameter),
            ignore_override=True,
        )

    def check(changes: list[rclpy.parameter.Parameter]) -> SetParametersResult:
        try:
            for change in changes:
                if change.name == CLOCK and change.value != node.get_parameter(CLOCK).value:
                    raise ValueError(f'{CLOCK} cannot change: restart the node with the new value')
                if change.name in mine:
                    mine[change.name].check_change(change.value)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def keep(changes: list[rclpy.parameter.Parameter]) -> None:
        for change in changes:
            if change.name in mine and values[change.name] != change.value:
                node.get_logger().info(
                    f'parameter {change.name} is {change.value} now, and was {values[change.name]}'
                )
                values[change.name] = change.value

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(keep)
    return values


def state(node: Node, names: Mapping[str, str]) -> None:
    """Declare a read-only parameter with the node's topics by role."""
    stated = [f'{role}={topic}' for role, topic in names.items()]
    given = node._parameter_overrides.get(TOPICS)
    if given is not None and list(given.value) != stated:
        # A dump of the node has it.
        node.get_logger().warning(
            f'parameter {TOPICS} is ignored: it states the topics of the node; remap them with -r'
        )
    descriptor = ParameterDescriptor(
        description="Names of the node's topics in the mission, by role.", read_only=True
    )
    node.declare_parameter(TOPICS, stated, descriptor, ignore_override=True)


def parameter_descriptor(parameter: Parameter) -> ParameterDescriptor:
    """Return the descriptor that `ros2 param describe` shows."""
    is_in_range = parameter.limits is not None and parameter.off is None
    descriptor = ParameterDescriptor(
        description=parameter.description,
        read_only=parameter.read_only,
        additional_constraints='' if is_in_range else parameter.allowed,
        # rclpy infers a list of bytes from any empty list.
        dynamic_typing=parameter.element is not None,
    )
    if parameter.limits is not None:
        low, high = parameter.limits
        low = low if parameter.off is None else parameter.off
        if isinstance(parameter.default, int):
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor
