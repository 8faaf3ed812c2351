# SPDX-License-Identifier: Apache-2.0
"""A log with gaps says so, and what is left of it is reproduced."""

from __future__ import annotations

from base import Base
from kbnitp_ros.bag import read_log
from kbnitp_ros.log.evidence import BELIEF
from kbnitp_ros.log.replay_report import Grade
import pytest


def held_on_record(base):
    """Return how many deployments each belief on record holds."""
    return [logged.message.deployments for logged in read_log(base.log, (BELIEF,))]


def fly(base, number, *, is_recorded=True):
    """Have robot `number` leave and come back, and wait for the belief in it."""
    base.until_sent(number)
    base.come_back()
    base.until_held(number)
    if is_recorded:
        until_on_record(base, number)


def until_on_record(base, number):
    """Wait for a belief on record: what is not dies with the node that keeps it."""
    base.field.until(lambda: number in held_on_record(base), f'belief {number} on record')


def restart(base, node):
    """Kill a node, and start it with what is on disk."""
    base.field.kill(f'/{node}')
    base.field.start(node, {**base.parameters, 'resume': str(base.log)})


@pytest.mark.full
def test_a_gap_is_not_compared_and_the_rest_is_identical(field):
    """The recorder is away for two beliefs; then each of the other nodes is killed as well."""
    base = Base(field, recorded=False, robots=7)
    fly(base, 1)
    field.kill('/recorder')
    fly(base, 2, is_recorded=False)
    fly(base, 3, is_recorded=False)
    field.start('recorder', {**base.parameters, 'resume': str(base.log)})
    # The belief that its publisher keeps adds to one that is missing.
    until_on_record(base, 3)
    assert 2 not in held_on_record(base)
    fly(base, 4)
    base.beliefs.clear()
    restart(base, 'estimator')
    base.until_held(4)
    fly(base, 5)
    restart(base, 'planner')
    fly(base, 6)
    restart(base, 'recorder')
    fly(base, 7)
    held = held_on_record(base)
    report = base.replayed()
    assert report.grade == Grade.IDENTICAL
    gap = report.not_compared
    assert [held[each.index] for each in gap] == [3]
    assert 'the belief of 2 deployments that it adds to is missing' in gap[0].reason
    assert {*held} == {0, 1, 3, 4, 5, 6, 7}
    assert report.compared['/belief'] == len(held) - len(gap) - len(report.repeated)
    assert (report.passed_over, report.not_yet_held) == ([], [])
