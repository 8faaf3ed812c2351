# SPDX-License-Identifier: Apache-2.0
"""A robot takes the newest order that has not ended, also under the name of a lost robot."""

from contextlib import closing

from kbnitp_ros.core import Grid
from kbnitp_ros.robot.journal import Journal, JournaledDeployment
from kbnitp_ros.robot.orders import Orders
from laws import for_each
import pytest


@pytest.fixture
def journal(tmp_path):
    with closing(Journal(tmp_path / 'journal', 'scout_1', Grid(4, 3))) as opened:
        yield opened


def order(stamp):
    return JournaledDeployment(stamp, 7, (0, 1, 0), stamp + 1)


def ordered(journal, *stamps):
    orders = Orders(journal)
    for stamp in stamps:
        orders.take(order(stamp))
    return orders


def stamps(deployments):
    return [each.stamp for each in deployments]


# The messages of deployments on record, and the orders of 10, 20 and 30 that are still open.
@for_each('departed, ended, still_open', [
    ([], [], [10, 20, 30]),
    ([10], [], [20, 30]),
    ([20], [], [30]),
    ([], [20], [30]),
    ([10], [10, 20], [30]),
    ([30], [], []),
    ([30, 10], [10], []),
    ([], [30], []),
])  # fmt: skip
def test_an_order_is_open_until_anything_is_recorded_of_it_or_of_a_later_one(
    journal, departed, ended, still_open
):
    orders = ordered(journal, 10, 20, 30)
    for stamp in departed:
        orders.note_departure(stamp)
    for stamp in ended:
        orders.note_end(stamp)
    assert stamps(orders.open_orders) == still_open
    # An order may arrive after what was recorded of it.
    late = Orders(journal)
    for stamp in departed:
        late.note_departure(stamp)
    for stamp in ended:
        late.note_end(stamp)
    for stamp in (30, 10, 20):
        late.take(order(stamp))
    assert stamps(late.open_orders) == still_open


def test_a_robot_with_a_new_journal_refuses_nothing(journal):
    assert ordered(journal, 10, 20).superseded == []
    journal.depart(order(10))
    orders = ordered(journal, 5, 20, 30, 40)
    assert stamps(orders.superseded) == [20, 30]
    orders.note_departure(20)
    assert stamps(orders.superseded) == [30]


def test_the_deployment_of_an_earlier_robot_is_forgotten_until_it_ends(journal):
    orders = ordered(journal, 10, 20)
    assert orders.forgotten is None
    orders.note_departure(10)
    assert orders.forgotten == order(10)
    orders.note_end(10)
    assert orders.forgotten is None
    # Its own departures are in the journal.
    journal.depart(order(20))
    orders.close(order(20))
    orders.note_departure(20)
    assert orders.forgotten is None
    assert orders.find(20) == order(20)
    assert orders.find(10) is None
