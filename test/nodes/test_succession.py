# SPDX-License-Identifier: Apache-2.0
"""Which beliefs a node takes to be of the estimator of its mission."""

from __future__ import annotations

from kbnitp_ros.core import Belief, Estimator, Ledger, SensorModel, Unknowns
from kbnitp_ros.messages.beliefs import belief_maps, read_belief_maps
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.nodes.succession import Succession
import pytest
from samples import GRID, HOME, key, lost

INTERVAL = (0.1, 1.0)


def snapshots(interval=INTERVAL, seed=3, malfunction=0.05, losses=3):
    """Return the beliefs of an estimator that learns the lethality."""
    model = SensorModel(0.5, malfunction)
    prior = Belief.prior(GRID, 0.5, 0.45, 0.8)
    estimator = Estimator(prior, model, 'kappa_bnitp_sampled', Unknowns(interval), seed)
    ledger = Ledger(GRID, 6, estimator)
    told = [read_belief_maps(belief_maps(ledger, 1, 1))]
    for number in range(1, 1 + losses):
        ledger.record_path(key(number), HOME)
        ledger.record_report(*read_report(lost(number)))
        told.append(read_belief_maps(belief_maps(ledger, 1, 1)))
    return told


def test_what_is_learnt_on_the_way_is_no_other_estimators():
    succession = Succession()
    told = snapshots()
    assert len({snapshot.model for snapshot in told}) == len(told)
    for snapshot in told:
        succession.check(snapshot, authors=2)
        assert succession.take(snapshot)


@pytest.mark.parametrize(
    'other, told',
    [
        ({'interval': (0.2, 1.0)}, '^unknowns is .*low=0.2.* and 2 nodes publish beliefs'),
        ({'seed': 4}, "^seed is '4': it was '3' before"),
        ({'malfunction': 0.04}, '^model is .*0.04'),
    ],
)
def test_another_estimator_is_told_by_what_it_was_started_with(other, told):
    succession = Succession()
    succession.take(snapshots()[2])
    with pytest.raises(ValueError, match=told):
        succession.check(snapshots(**other)[3], authors=2)
