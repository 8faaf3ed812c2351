# SPDX-License-Identifier: Apache-2.0
"""Maps and progress are shown of the last belief, and not of each of many that come at once."""

from kbnitp_msgs.msg import Progress
from kbnitp_ros.core import Belief, Estimator, Ledger, SensorModel
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime.node import FieldNode
from kbnitp_ros.nodes.views import Views
from nav_msgs.msg import OccupancyGrid
import pytest
import rclpy
from samples import FIELD, GRID, HOME, key, lost

MAPS = ('hazard', 'target', 'kappa')


@pytest.fixture
def estimator(field):
    """Yield a node with the estimator's parameters, which the test spins with its own."""
    arguments = [
        argument
        for name, value in FIELD.items()
        for argument in ('-p', f'{name}:={value}'.replace(' ', ''))
    ]
    rclpy.init(args=['--ros-args', *arguments])
    node = FieldNode('estimator')
    yield node
    node.destroy_node()
    rclpy.shutdown()


def test_of_beliefs_that_come_at_once_the_first_and_the_last_are_shown(field, estimator):
    views = Views(estimator, ['scout_1'])
    shown = {name: field.listen(OccupancyGrid, f'/belief/{name}') for name in MAPS}
    shown['progress'] = field.listen(Progress, '/progress')
    topics = ['/progress', *(f'/belief/{name}' for name in MAPS)]
    field.until(lambda: all(map(field.node.count_publishers, topics)), 'publishers')
    field.until(lambda: all(map(estimator.count_subscribers, topics)), 'viewers')
    ledger = Ledger(GRID, 6, Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), SensorModel(0.5)))
    views.show(ledger, 1)
    for number in range(1, 6):
        ledger.record_path(key(number), HOME)
        ledger.record_report(*read_report(lost(number)))
        views.show(ledger, 1 + number)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(estimator)

    def are_last_shown():
        executor.spin_once(timeout_sec=0.0)
        return all(each and each[-1].header.stamp.nanosec == 6 for each in shown.values())

    field.until(are_last_shown, 'views of the last belief')
    executor.shutdown()
    for name, messages in shown.items():
        assert [from_stamp(each.header.stamp) for each in messages] == [1, 6], name
    last = shown['progress'][-1]
    assert (last.deployments, last.lost) == (5, 5)
    # That of the last report alone, although the belief before it was not shown.
    assert 0.0 < last.information_expected < 1.0
