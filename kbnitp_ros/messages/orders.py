# SPDX-License-Identifier: Apache-2.0
"""The orders of a person: services of a mission, and parameters of its planner."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

# Name of the node by which people give orders, and of its enclave.
NAME = 'operator'

NOTHING: Mapping[str, Any] = MappingProxyType({})


class Order(NamedTuple):
    """An order: a service of a role, with the fields of its request that the order sets."""

    name: str
    service: str
    type_name: str
    role: str
    fixed: Mapping[str, Any] = NOTHING


SET_BOOL, TRIGGER = 'std_srvs/srv/SetBool', 'std_srvs/srv/Trigger'

ORDERS = {
    order.name: order
    for order in (
        Order('pause', 'pause', SET_BOOL, 'planner', {'data': True}),
        Order('hold', 'pause', SET_BOOL, 'planner', {'data': True}),
        Order('resume', 'pause', SET_BOOL, 'planner', {'data': False}),
        Order('approve', 'approve', SET_BOOL, 'planner', {'data': True}),
        Order('refuse', 'approve', SET_BOOL, 'planner', {'data': False}),
        Order('give_up', 'give_up', 'kbnitp_msgs/srv/GiveUp', 'planner'),
        Order('take_back', 'take_back', 'kbnitp_msgs/srv/TakeBack', 'planner'),
        Order('no_go', 'no_go', 'kbnitp_msgs/srv/NoGo', 'planner'),
        Order('end_mission', 'end_mission', TRIGGER, 'planner'),
        Order('add_finding', 'add_finding', 'kbnitp_msgs/srv/AddFinding', 'estimator'),
        Order('annotate', 'annotate', 'kbnitp_msgs/srv/Annotate', 'estimator'),
        Order('revoke', 'revoke', 'kbnitp_msgs/srv/Revoke', 'estimator'),
    )
}

# The order that sets a parameter of the planner, and the parameters that it may set.
SET = 'set'
PARAMETERS = (
    'approval',
    'loss_cost',
    'minimum_survival',
    'robots',
    'stop.confidence',
    'stop.gain',
    'stop.losses',
)

# Confidence above which a finding of no hazard needs a confirmation.
CLEARED = 0.9


def describe_orders() -> str:
    """Return a sentence on all that may be ordered."""
    return f'may order {", ".join(ORDERS)}, and {SET} {", ".join(PARAMETERS)} of the planner'
