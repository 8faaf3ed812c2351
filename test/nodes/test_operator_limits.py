# SPDX-License-Identifier: Apache-2.0
"""What an operator, or whoever calls the services in its place, can do any number of times."""

from __future__ import annotations

from kbnitp_ros.base.deployments_in_flight import DeploymentsInFlight
from kbnitp_ros.core import Grid
from kbnitp_ros.log.operator_state import MOST_TIMES
from kbnitp_ros.nodes.operator_services import Operator
from std_srvs.srv import SetBool, Trigger


class Node:
    """In place of the planner, without a recorder: keeps its services, and what it publishes."""

    def __init__(self):
        self.values = {'recorded': False}
        self.services = {}
        self.published = []

    def create_publisher(self, *_):
        return self

    def publish(self, message):
        self.published.append(message)

    def create_service(self, kind, name, callback):
        self.services[name] = callback

    def now(self):
        return 1

    def get_logger(self):
        return self

    def info(self, _):
        pass

    def call(self, name, kind, **request):
        return self.services[name](kind.Request(**request), kind.Response())


def test_a_pause_that_is_begun_and_ended_for_ever_stays_and_fills_no_log():
    node = Node()
    operator = Operator(
        node, Grid(3, 3), DeploymentsInFlight({}, 1), None, lambda _: None, lambda _: None
    )
    for _ in range(MOST_TIMES):
        assert node.call('pause', SetBool, data=True).success
        assert node.call('pause', SetBool, data=False).success
    assert node.call('pause', SetBool, data=True).success
    for _ in range(10):
        told = node.call('pause', SetBool, data=False)
        assert not told.success
        assert f'RESUME was taken {MOST_TIMES} times' in told.message
        assert operator.state.is_paused
    assert len(node.published) == len(operator.state.actions) == 2 * MOST_TIMES + 1
    assert node.call('end_mission', Trigger).success
