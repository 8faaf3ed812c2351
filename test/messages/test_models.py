# SPDX-License-Identifier: Apache-2.0
"""What the message of the numbers that are learnt means."""

from array import array
from math import inf

from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Report,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.messages.progress import model_belief, QUANTILES, read_model_belief
from laws import for_each
import pytest
from samples import over_the_wire
from std_msgs.msg import Header

SOME = Unknowns(lethality=(0.2, 1.0), false_positive=(0.0, 0.5))
ALL = Unknowns(*[(0.0, 1.0)] * 7)


def ledger_of(unknowns=SOME):
    """Return a ledger that learns."""
    grid = Grid(3, 2)
    prior = Belief.prior(grid, 0.3, 0.4, 0.7)
    estimator = Estimator(prior, SensorModel(0.5), 'kappa_bnitp_sampled', unknowns)
    return Ledger(grid, 6, estimator)


def test_what_is_learnt_comes_back_bit_for_bit():
    ledger = ledger_of()
    before = read_model_belief(over_the_wire(model_belief(ledger, 3_000_000_001))).numbers
    for number in range(1, 4):
        key = DeploymentKey('scout_1', number)
        ledger.record_path(key, [0, 1, 2, 1, 0])
        ledger.record_report(key, Report(False, stamp=7))
    message = over_the_wire(model_belief(ledger, 3_000_000_001))
    assert (message.header.frame_id, message.header.stamp.sec) == ('map', 3)
    assert message.deployments == 3
    known = read_model_belief(message).numbers
    assert list(known) == ['lethality', 'false_positive']
    for name, number in ledger.estimator.parameters.items():
        assert (known[name].mean, known[name].sd) == (number.mean, number.sd)
        assert known[name].effective_samples == number.effective_samples
        for quantile, percent in zip(known[name].quantiles, QUANTILES):
            assert quantile == number.quantile(percent / 100)
    assert known['lethality'].effective_samples < inf
    # Three robots were lost on one path.
    assert known['lethality'].mean > before['lethality'].mean
    assert before['lethality'].mean == pytest.approx(0.6, abs=1e-3)
    assert before['lethality'].quantiles == pytest.approx((0.24, 0.4, 0.6, 0.8, 0.96), abs=1e-3)
    assert before['lethality'].effective_samples == inf


@for_each('field, value, error', [
    ('mean', array('d', [0.5]), 'mean has 1 values: it must have one for each of the 2 names'),
    ('quantile_95', array('d'), 'quantile_95 has 0 values'),
    ('header', Header(frame_id='odom'), "header.frame_id is 'odom'"),
    ('name', ['lethality'], 'mean has 2 values: it must have one for each of the 1 names'),
])  # fmt: skip
def test_a_bad_message_is_refused(field, value, error):
    message = model_belief(ledger_of(), 0)
    setattr(message, field, value)
    with pytest.raises(ValueError, match=error):
        read_model_belief(message)
