# SPDX-License-Identifier: Apache-2.0
"""Beliefs and learnt numbers are read from their messages bit for bit."""

from array import array
from math import inf, nan

from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_msgs.msg import BeliefMaps, OwnNumber, UnknownNumber
from kbnitp_msgs.srv import Draws
from kbnitp_ros.core import (
    Belief,
    Beta,
    DeploymentKey,
    Dynamics,
    Estimator,
    Grid,
    HazardDraws,
    Ledger,
    METHODS,
    Report,
    RobotType,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.messages.beliefs import belief_maps, read_belief_maps
from kbnitp_ros.messages.progress import (
    fill_draws,
    model_belief,
    NOT_CHECKED,
    QUANTILES,
    read_draws,
    read_model_belief,
)
from laws import for_each
import numpy as np
import pytest
from samples import over_the_wire
from std_msgs.msg import Header

KNOWN = Unknowns()
LEARNT = Unknowns(lethality=(0.1, 0.9), kappa=Beta(3, 2), true_positive=Beta(9, 1, low=0.5))
MODEL = SensorModel(0.3, 0.02, 0.07, 0.9, 0.04)
KEY = DeploymentKey('scout_3', 5_000_000_007)


def new_ledger(seed=0, grid=None, method='kappa_bnitp', model=MODEL, unknowns=KNOWN):
    grid = grid or Grid(4, 3, base=1, resolution=0.1, origin=(-3.3, 0.7), blocked=(10, 5))
    joint = np.random.default_rng(seed).dirichlet(np.ones(4), grid.cells)
    estimator = Estimator(Belief(joint.reshape(-1, 2, 2)), model, method, unknowns, seed)
    return Ledger(grid, 6, estimator)


@for_each('targets', [
    Dynamics('learn'), Dynamics('changing', 0.02, 0.1), Dynamics('changing', vanish=(0.01, 0.2)),
    Dynamics('changing', 0.01, Beta(2, 9, 0.0, 0.5, zero=0.3)),
])  # fmt: skip
def test_the_dynamics_of_targets_are_read_as_they_were(targets):
    joint = np.random.default_rng(3).dirichlet(np.ones(4), 12).reshape(-1, 2, 2)
    estimator = Estimator(Belief(joint), MODEL, unknowns=LEARNT, target_dynamics=targets)
    message = over_the_wire(belief_maps(Ledger(Grid(4, 3), 6, estimator), started=1))
    assert read_belief_maps(message).target_dynamics == targets
    again = read_belief_maps(message).ledger()
    assert again.belief == estimator.belief
    assert again.estimator.target_dynamics == targets


@for_each('model, unknowns', [
    (SensorModel(0.3, reach=0.2), KNOWN),
    (SensorModel(0.3), Unknowns(reach=Beta(2, 3, 0.1, 0.7, zero=0.8))),
])  # fmt: skip
def test_the_reach_is_read_as_it_was(model, unknowns):
    grid = Grid(4, 3)
    prior = Belief.prior(grid, 0.2, 0.3, 0.8)
    estimator = Estimator(prior, model, unknowns=unknowns)
    message = over_the_wire(belief_maps(Ledger(grid, 6, estimator), started=1))
    read = read_belief_maps(message)
    assert (read.model, read.unknowns) == (estimator.model, unknowns)
    assert read.ledger().belief == estimator.belief


@for_each('model, unknowns', [
    (SensorModel(0.3, duds=0.2), KNOWN),
    (SensorModel(0.3), Unknowns(duds=Beta(2, 3, 0.1, 0.7, zero=0.8))),
])  # fmt: skip
def test_hazards_that_are_duds_are_read_as_they_were(model, unknowns):
    grid = Grid(4, 3)
    estimator = Estimator(Belief.prior(grid, 0.2, 0.3, 0.8), model, unknowns=unknowns)
    ledger = Ledger(grid, 6, estimator)
    ledger.record_path(KEY, [0, 1, 2, 1, 0])
    ledger.record_report(KEY, Report(True, ((1, 1), (2, 0), (1, 1), (0, 0)), 9))
    message = over_the_wire(belief_maps(ledger, started=1))
    read, belief = read_belief_maps(message), ledger.belief
    assert (read.model, read.unknowns) == (ledger.estimator.model, unknowns)
    assert read.belief == belief
    np.testing.assert_array_equal(read.belief.duds, belief.duds)
    # The return speaks against live hazards, and not against duds.
    share = belief.duds.sum(axis=1)[1:] / belief.hazard[1:]
    assert share[0] > share[5]
    for values, why in (
        ([0.1], 'dud_joint has 1 values'),
        (belief.joint[:, 1].ravel() + 1e-6, 'not within joint'),
        (-belief.duds.ravel(), 'not within joint'),
        (belief.duds.ravel() * np.nan, 'not within joint'),
    ):
        message.dud_joint = array('d', values)
        with pytest.raises(ValueError, match=why):
            read_belief_maps(message)


def test_a_prior_says_how_the_mission_starts():
    ledger = new_ledger()
    message = belief_maps(ledger, started=3_000_000_001)
    assert (message.header.frame_id, message.header.stamp.sec) == ('map', 3)
    assert (message.info.width, message.info.height, message.base) == (4, 3, 1)
    assert list(message.blocked) == [5, 10]
    assert (message.max_steps, message.method, message.lethality) == (6, 'kappa_bnitp', 0.3)
    assert (message.malfunction, message.false_negative) == (0.02, 0.07)
    assert (message.true_positive, message.false_positive) == (0.9, 0.04)
    assert (message.deployments, message.agent) == (0, '')
    assert (message.deployment.sec, message.deployment.nanosec) == (0, 0)
    assert read_belief_maps(message).newest is None


def test_the_joint_is_laid_out_cell_by_cell():
    joint = np.array([[[0.5, 0.25], [0.125, 0.125]], [[1.0, 0.0], [0.0, 0.0]]])
    ledger = Ledger(Grid(2, 1), 6, Estimator(Belief(joint), MODEL))
    message = belief_maps(ledger, started=0)
    # P(Z=0,X=0) P(Z=0,X=1) P(Z=1,X=0) P(Z=1,X=1), then the next cell
    assert list(message.joint) == [0.5, 0.25, 0.125, 0.125, 1.0, 0.0, 0.0, 0.0]
    assert list(message.hazard) == [0.25, 0.0]
    assert list(message.target) == [0.375, 0.0]
    assert list(message.kappa) == [0.5, 0.0]


def test_the_newest_deployment_is_named():
    ledger = new_ledger()
    ledger.record_path(KEY, [1, 2, 1])
    ledger.record_report(KEY, Report(False, stamp=9_000_000_001))
    message = over_the_wire(belief_maps(ledger, started=3_000_000_001))
    assert (message.deployments, message.agent) == (1, 'scout_3')
    assert (message.deployment.sec, message.deployment.nanosec) == (5, 7)
    snapshot = read_belief_maps(message)
    assert (snapshot.newest, snapshot.stamp) == (KEY, 9_000_000_001)


def test_the_same_evidence_gives_the_same_message():
    """Even with late evidence, and after a restart of the estimator."""
    first, second = DeploymentKey('scout_1', 1), DeploymentKey('scout_2', 1)
    ledgers = new_ledger(), new_ledger()
    for ledger, keys in zip(ledgers, ((first, second), (second, first, second))):
        for key in keys:
            ledger.record_path(key, [1, 2, 1])
            ledger.record_report(key, Report(False, stamp=7))
    message, other = (belief_maps(ledger, started) for started, ledger in enumerate(ledgers))
    assert (message.agent, other.agent) == ('scout_2', 'scout_2')
    other.agent = message.agent
    assert message == other


@for_each('method', METHODS)
@given(
    seed=st.integers(0, 2**32 - 1),
    numbers=st.lists(st.floats(0, 1), min_size=5, max_size=5),
    connectivity=st.sampled_from([4, 8]),
    through_corners=st.booleans(),
)
@settings(max_examples=100 if FULL else 20)
def test_a_belief_comes_back_bit_for_bit(method, seed, numbers, connectivity, through_corners):
    model = SensorModel(*numbers)
    grid = Grid(4, 3, blocked=(5,), connectivity=connectivity, through_corners=through_corners)
    ledger = new_ledger(seed, grid, method, model)
    snapshot = read_belief_maps(over_the_wire(belief_maps(ledger, started=9)))
    assert snapshot.belief.joint.tobytes() == ledger.belief.joint.tobytes()
    assert snapshot.grid == ledger.grid
    assert (snapshot.max_steps, snapshot.model, snapshot.method) == (6, model, method)
    assert (snapshot.deployments, snapshot.newest) == (0, None)


def test_defaults_of_new_fields_keep_their_former_meaning():
    assert (BeliefMaps().connectivity, BeliefMaps().through_corners) == (8, True)


def test_learnt_numbers_come_back_bit_for_bit():
    ledger = new_ledger(seed=4, method='kappa_bnitp_sampled', unknowns=LEARNT)
    first = read_belief_maps(over_the_wire(belief_maps(ledger, started=9)))
    assert first.unknowns == LEARNT
    assert first.seed == 4
    assert first.prior.joint.tobytes() == ledger.estimator.prior.joint.tobytes()
    assert first.belief.joint.tobytes() == ledger.belief.joint.tobytes()
    assert first.belief.joint.tobytes() != first.prior.joint.tobytes()
    # So it can be recomputed from that message alone.
    again = Estimator(first.prior, first.model, first.method, first.unknowns, first.seed)
    assert again.belief.joint.tobytes() == ledger.belief.joint.tobytes()
    assert again.model == ledger.estimator.model

    ledger.record_path(KEY, [1, 2, 1])
    ledger.record_report(KEY, Report(False, stamp=9))
    message = over_the_wire(belief_maps(ledger, started=9))
    later = read_belief_maps(message)
    assert later.model == ledger.estimator.model != first.model
    assert later.rules() == first.rules()
    assert not message.prior


def test_rules_are_the_estimators_options_at_the_start():
    def rules(**options):
        options = {'method': 'kappa_bnitp_sampled', 'unknowns': LEARNT, **options}
        return read_belief_maps(belief_maps(new_ledger(**options), started=0)).rules()

    assert rules(model=SensorModel(0.8, 0.02, 0.07, 0.6, 0.04)) == rules()
    for other in (
        {'model': SensorModel(0.3, 0.03, 0.07, 0.9, 0.04)},
        {'seed': 1},
        {'unknowns': Unknowns(lethality=(0.1, 0.9))},
        {'unknowns': KNOWN},
        {'unknowns': KNOWN, 'method': 'kappa_bnitp'},
    ):
        assert rules(**other) != rules()


def test_without_unknowns_the_prior_is_not_repeated():
    for method in METHODS:
        assert not belief_maps(new_ledger(method=method), started=0).prior


def unknown(name='kappa', a=1.0, b=1.0, low=0.0, high=1.0):
    """Return the message of a learnt number."""
    return UnknownNumber(name=name, a=a, b=b, low=low, high=high)


def own(agent, name, value=0.5):
    """Return the message of a number that an agent overrides."""
    return OwnNumber(agent=agent, name=name, value=value)


def test_parameters_of_single_agents_are_included():
    robot_types = {
        'b': RobotType(lethality=0.1, max_steps=4),
        'a': RobotType(true_positive=0.75, loss_cost=2.0),
    }
    plain = new_ledger()
    ledger = Ledger(plain.grid, plain.max_steps, plain.estimator, robot_types)
    message = over_the_wire(belief_maps(ledger, started=0))
    assert [(own.agent, own.name) for own in message.own] == [
        ('a', 'true_positive'),
        ('a', 'loss_cost'),
        ('b', 'lethality'),
        ('b', 'max_steps'),
    ]
    assert read_belief_maps(message).robot_types == robot_types
    assert read_belief_maps(message).rules() != read_belief_maps(belief_maps(plain, 0)).rules()


def test_only_the_joint_counts():
    message = belief_maps(new_ledger(), started=0)
    joint = read_belief_maps(message).belief.joint
    message.hazard = array('d', [1.0] * 12)
    assert (read_belief_maps(message).belief.joint == joint).all()


@for_each('field, value, error', [
    ('header', Header(frame_id='odom'), "header.frame_id is 'odom'"),
    ('prior', array('d', [0.25] * 44), 'prior has 44 values'),
    ('unknowns', [unknown('kapa')], "unknowns has 'kapa': it must name numbers of lethal"),
    ('unknowns', [unknown('x' * 5000)], r"unknowns has 'x{100}'... \(5000 characters\)"),
    ('unknowns', [unknown(), unknown()], "unknowns has 'kappa': it must name .* each once"),
    ('unknowns', [unknown(low=0.5, high=0.5)], 'interval is from 0.5 to 0.5'),
    ('own', [own('', 'lethality')], "own has 'lethality' of agent ''"),
    ('own', [own('a', 'lethalty')], "own has 'lethalty' of agent 'a': it must name .* each once"),
    ('own', [own('a', 'lethality')] * 2, "own has 'lethality' of agent 'a': it must name"),
    ('own', [own('a', 'lethality', nan)], 'own: lethality is nan: it must be a probability'),
    ('own', [own('a', 'max_steps', 2.5)], 'max_steps is 2.5: it must be a whole number'),
    ('joint', array('d', [0.25] * 44), r'joint has 44 values: .* 4 \* width \* height = 48'),
    ('joint', array('d', [0.3] * 48), 'joint of cell 0 .* sum to 1'),
    ('joint', array('d', [0.25] * 47 + [nan]), 'joint of cell 11 '),
    ('lethality', nan, 'lethality is nan'),
    ('base', 12, 'base is 12'),
    ('base', 5, 'base is 5: it must be a free cell'),
    ('connectivity', 5, 'connectivity is 5'),
    ('deployments', 3, "agent is '' with 3 deployments"),
])  # fmt: skip
def test_a_bad_belief_is_refused(field, value, error):
    message = belief_maps(new_ledger(), started=0)
    setattr(message, field, value)
    with pytest.raises(ValueError, match=error):
        read_belief_maps(over_the_wire(message))


SOME = Unknowns(lethality=(0.2, 1.0), false_positive=(0.0, 0.5))


def learning_ledger(unknowns=SOME):
    """Return a ledger that learns."""
    grid = Grid(3, 2)
    prior = Belief.prior(grid, 0.3, 0.4, 0.7)
    estimator = Estimator(prior, SensorModel(0.5), 'kappa_bnitp_sampled', unknowns)
    return Ledger(grid, 6, estimator)


def test_a_model_comes_back_bit_for_bit():
    ledger = learning_ledger()
    before = read_model_belief(
        over_the_wire(model_belief(ledger, 3_000_000_001, NOT_CHECKED))
    ).numbers
    for number in range(1, 4):
        key = DeploymentKey('scout_1', number)
        ledger.record_path(key, [0, 1, 2, 1, 0])
        ledger.record_report(key, Report(False, stamp=7))
    message = over_the_wire(model_belief(ledger, 3_000_000_001, NOT_CHECKED))
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
    message = model_belief(learning_ledger(), 0, NOT_CHECKED)
    setattr(message, field, value)
    with pytest.raises(ValueError, match=error):
        read_model_belief(message)


def draws_response():
    response = Draws.Response()
    fill_draws(response, HazardDraws(np.eye(5, 3, dtype=bool), 4.0))
    return response


def test_draws_arrive_as_they_were_drawn():
    read = read_draws(over_the_wire(draws_response()), 3)
    np.testing.assert_array_equal(read.hazardous, np.eye(5, 3, dtype=bool))
    assert read.independent == 4.0
    assert read.weight.tolist() == [0.2] * 5
    assert read.live is None
    live = np.eye(5, 3, 1, dtype=bool)
    fill_draws(response := Draws.Response(), HazardDraws(np.ones((5, 3), bool), 4.0, live=live))
    np.testing.assert_array_equal(read_draws(over_the_wire(response), 3).live, live)


@for_each('name, value, why', [
    ('hazardous', [0], 'hazardous has 1 values: 5 draws of 3 cells have 2'),
    ('live', [0], 'live has 1 values: 5 draws of 3 cells have 2'),
    ('weight', [1.0], 'weight has 1 values'),
    ('weight', [float('nan')] * 5, 'weight has the sum nan'),
    ('weight', [0.5] * 5, 'weight has the sum 2.5'),
    ('independent_draws', 0.0, 'independent_draws is 0.0'),
    ('count', 0, 'there must be at least one draw'),
])  # fmt: skip
def test_draws_that_cannot_be_are_refused(name, value, why):
    response = draws_response()
    setattr(response, name, value)
    with pytest.raises(ValueError, match=why):
        read_draws(response, 3)
