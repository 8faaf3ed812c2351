# SPDX-License-Identifier: Apache-2.0
"""Findings of people: by enumeration of all states, in all fields, and by their laws."""

import brute_force
import fields_in_full
import hazards_in_time
from kbnitp_ros.core import (
    Belief,
    Clustering,
    Dynamics,
    Estimator,
    Finding,
    Grid,
    KnownModel,
    METHODS,
    Observation,
    RobotType,
    SensorModel,
    Unknowns,
    update,
)
from kbnitp_ros.core.inference.filter import Evidence
from kbnitp_ros.core.inference.particles import Filters, log_sum
from laws import for_each
import numpy as np
import pytest

ONE_PASS = [name for name in METHODS if name != 'kappa_bnitp_sampled']
CELLS = 6


def random_finding(rng, cells=CELLS, changed=None):
    """Draw a finding of cells other than the base, 0."""
    while True:
        hazard, target = (rng.choice([None, False, True]) for _ in range(2))
        changed_now = bool(rng.random() < 0.4) if changed is None else changed
        walked = 0.0 if changed_now else float(rng.choice([0.0, rng.random()]))
        if hazard is None and target is None and (changed_now or not walked):
            continue
        some = rng.choice(np.arange(1, cells), rng.integers(1, cells // 2 + 1), replace=False)
        confidence = float(rng.choice([0.0, 0.99, rng.random()]))
        return Finding(some, hazard, target, confidence, walked, changed=changed_now)


def random_outcome(rng, cells=CELLS):
    path = brute_force.random_path(rng, cells // 2, 2, 0, int(rng.integers(1, 6)))
    steps = len(path) - 1
    if rng.random() < 0.5:
        return Observation(path, True, rng.integers(-1, 2, steps))
    lost_at = rng.random(steps) + 0.01 if rng.random() < 0.5 else None
    return Observation(path, False, None, int(rng.integers(steps)), lost_at)


def random_events(rng, cells=CELLS):
    """Draw findings and outcomes, in any order."""
    draw = random_finding, random_outcome
    return [draw[rng.integers(2)](rng, cells) for _ in range(5)]


def folded(events, *arguments, **options):
    estimator = Estimator(*arguments, **options)
    for event in events:
        estimator.assimilate(event)
    return estimator


def without_duds(three):
    """Return the joints of no hazard and any hazard."""
    return np.stack([three[:, 0], three[:, 1:].sum(axis=1)], axis=1)


KINDS = (
    {},
    {'hazards': Dynamics('changing', 0.1, 0.2)},
    {'targets': Dynamics('changing', 0.05, 0.3)},
    {'hazards': Dynamics('changing', 0.3, 0.1), 'targets': Dynamics('changing', 0.2, 0.1)},
    {'duds': 0.4},
    {'reach': 0.3},
)


@for_each('seed', range(60), every=5)
@for_each('kind', range(len(KINDS)))
def test_beliefs_are_the_enumeration_of_all_states(seed, kind):
    rng = np.random.default_rng([seed, kind, 62])
    fields = dict(KINDS[kind])
    reach, duds = fields.pop('reach', 0.0), fields.pop('duds', 0.0)
    # Of three states of a hazard there are too many in more cells.
    grid = Grid(2 if duds else 3, 2)
    around = [[near for near in each if near >= 0] for each in grid.around.tolist()]
    model = SensorModel(**brute_force.random_sensors(rng), reach=reach, duds=duds)
    joint, events = brute_force.random_joint(rng, grid.cells, 0), random_events(rng, grid.cells)
    options = {
        'dynamics': fields.get('hazards', Dynamics()),
        'target_dynamics': fields.get('targets', Dynamics()),
    }
    estimator, again = Estimator(Belief(joint, grid), model, **options), Belief(joint, grid)
    for number, event in enumerate(events, 1):
        expected, chance = fields_in_full.posterior(
            joint, model, events[:number], **fields, duds=duds, around=around if reach else None
        )
        if not chance > 1e-6:
            break
        estimator.assimilate(event)
        beliefs = [estimator.belief]
        if not fields:
            again = update(again, model, event)
            beliefs.append(again)
        for belief in beliefs:
            whole = without_duds(expected)
            np.testing.assert_allclose(belief.joint, whole, rtol=0, atol=1e-12)
            if duds:
                np.testing.assert_allclose(belief.duds, expected[:, 2], rtol=0, atol=1e-12)


@for_each('seed', range(60), every=6)
def test_hazards_that_are_used_up_are_found_as_they_are_now(seed):
    rng = np.random.default_rng([seed, 63])
    model, used_up = SensorModel(**brute_force.random_sensors(rng)), Dynamics('used_up')
    joint = brute_force.random_joint(rng, CELLS, 0)
    possible = joint[:, 1].sum(axis=1) > 0.0
    estimator = Estimator(Belief(joint), model, dynamics=used_up)
    for event in random_events(rng):
        if isinstance(event, Finding):
            joint, chance = fields_in_full.posterior(joint, model, [event])
        else:
            lost_at = event.lost_at
            if lost_at is None:
                lost_at = np.arange(event.steps) >= event.steps_survived
            robot = model, event.path.tolist(), event.readings, lost_at
            joint = hazards_in_time.posterior(joint, used_up, robot, possible=possible)
            chance = 0.0 if joint is None else 1.0
        if not chance > 1e-6:
            break
        estimator.assimilate(event)
        np.testing.assert_allclose(estimator.belief.joint, joint, rtol=0, atol=1e-12)


@for_each('seed', range(40), every=4)
@for_each('duds', [False, True])
def test_hypotheses_are_weighed_and_moved_with_findings(monkeypatch, seed, duds):
    rng = np.random.default_rng([seed, 64])
    joint, events = brute_force.random_joint(rng, 4, 0), random_events(rng, 4)
    unknowns = Unknowns(lethality=(0.1, 0.9), duds=(0.0, 1.0) if duds else None)
    model = SensorModel(0.5, 0.1, 0.1, 0.9, 0.15)
    resample = Filters._resample
    monkeypatch.setattr(Filters, '_resample', lambda *_: None)
    bank = Filters(Belief(joint), model, unknowns, 0, Dynamics(), count=5)

    def enumerated():
        """Return the joints of all particles and the probabilities of all evidence."""
        joints, chances = [], []
        for numbers in bank.numbers.tolist():
            own = SensorModel(0.0, 0.1, 0.1, 0.9, 0.15)
            vars(own).update(zip(bank.names, numbers))
            three, chance = fields_in_full.posterior(joint, own, events, duds=own.duds or 1e-300)
            joints.append(three)
            chances.append(chance)
        return np.array(joints), np.array(chances)

    for event in events:
        bank.take(event if isinstance(event, Finding) else Evidence.of(event))
    for _ in range(2):
        joints, chances = enumerated()
        np.testing.assert_allclose(np.exp(bank._log_likelihood), chances, rtol=1e-9)
        np.testing.assert_allclose(bank.live(), joints[:, :, 1].sum(axis=2), rtol=0, atol=1e-10)
        every = joints[:, :, 1:].sum(axis=(2, 3))
        np.testing.assert_allclose(bank.hazard(), every, rtol=0, atol=1e-10)
        before = bank.numbers
        resample(bank, rng)
    assert not np.array_equal(before, bank.numbers)


@for_each('seed', range(20), every=4)
def test_kinds_and_alternatives_are_weighed_by_findings(seed):
    """Of static and of used up hazards: the ratio of their evidence."""
    rng = np.random.default_rng([seed, 65])
    grid, model = Grid(3, 2), SensorModel(0.6, 0.1)
    prior = Belief.prior(grid, 0.3, 0.3, 0.6)
    events = [
        Observation([0, 1, 4, 0], True, rng.integers(0, 2, 3)),
        Finding([1, 4], hazard=True, confidence=0.8),
        Finding([2], hazard=False, changed=True),
        Observation([0, 1, 2, 1, 0], bool(seed % 2), [0] * 4 if seed % 2 else None),
        Finding([2, 4], target=True, walked=0.5),
    ]
    static, used_up = prior.joint, prior.joint
    log_ratio, possible = 0.0, prior.hazard > 0.0
    for event in events:
        if isinstance(event, Finding):
            static, chance = fields_in_full.posterior(static, model, [event])
            used_up, other = fields_in_full.posterior(used_up, model, [event])
        else:
            lost_at = np.ones(event.steps)
            robot = event.path.tolist(), event.readings, lost_at
            chance, other = (
                hazards_in_time.chance(joint, Dynamics(kind), model, *robot)
                for joint, kind in ((static, 'static'), (used_up, 'used_up'))
            )
            robot = model, *robot
            static, used_up = (
                hazards_in_time.posterior(joint, Dynamics(kind), robot, possible=possible)
                for joint, kind in ((static, 'static'), (used_up, 'used_up'))
            )
        log_ratio += np.log(other) - np.log(chance)
    check = folded(events, prior, model).model_check
    assert check.alternatives['used_up'] == pytest.approx(np.exp(log_ratio), rel=1e-9)
    kinds = folded(events, prior, model, dynamics=Dynamics('learn', move=0.01, vanish=0.01)).kinds
    ratio = kinds['used_up'] / kinds['static'] * (1 / 2) / (1 / 3)
    assert ratio == pytest.approx(np.exp(log_ratio), rel=1e-9)


def test_a_check_in_between_gives_the_check_of_all():
    prior, model = Belief.prior(Grid(3, 2), 0.3, 0.3, 0.6), SensorModel(0.6, 0.1)
    estimator, rng = Estimator(prior, model), np.random.default_rng(3)
    for event in (random_outcome(rng), random_finding(rng), random_outcome(rng)):
        before = estimator.model_check
        estimator.assimilate(event)
        if isinstance(event, Finding):
            shifted = ('more returns', 'more positive readings')
            after = estimator.model_check.alternatives
            assert [after[k] for k in shifted] == [before.alternatives[k] for k in shifted]
    assert (
        estimator.model_check
        == folded([e for e, _ in estimator._evidence], prior, model).model_check
    )


@for_each('seed', range(6), every=3)
def test_sampling_is_the_enumeration_of_all_states(seed):
    """Cells stay dependent: no step takes them apart."""
    rng = np.random.default_rng([seed, 66])
    joint, model = Belief.prior(Grid(3, 2), 0.3, 0.3, 0.6).joint, SensorModel(0.7, 0.1)
    events = [random_outcome(rng), random_finding(rng, changed=False)]
    events += [random_outcome(rng), random_finding(rng, changed=False)]
    states = fields_in_full.enumerate_states(CELLS, 2)
    weight = fields_in_full.independent_weights(joint, states)
    for event in events:
        if isinstance(event, Finding):
            weight = fields_in_full.found(weight, states, event)
        else:
            weight = weight * fields_in_full.likelihood(model, states, event, [()] * CELLS)
    weight = weight / weight.sum()
    expected = np.array([
        [[weight[(states[:, c] == (z, x)).all(axis=1)].sum() for x in (0, 1)] for z in (0, 1)]
        for c in range(CELLS)
    ])  # fmt: skip
    belief = folded(events, Belief(joint), model, 'kappa_bnitp_sampled').belief
    np.testing.assert_allclose(belief.joint, expected, rtol=0, atol=0.02)


@pytest.mark.parametrize('clustering', [None, 'ties'])
def test_sampling_learns_the_density_from_findings(clustering):
    grid = Grid(4, 4)
    prior = Belief.prior(grid, 0.3, 0.3, 0.6)
    unknowns = Unknowns(hazard_density=(0.05, 0.95), target_background=(0.05, 0.95))
    events = [Finding(range(1, 10), True, False, 0.9), Observation([0, 1, 0], True, [0, 0])]
    exact = folded(events, prior, SensorModel(0.5), unknowns=unknowns)
    ties = Clustering(grid, 0.0) if clustering else None
    sampled = folded(
        events, prior, SensorModel(0.5), 'kappa_bnitp_sampled', unknowns, clustering=ties
    )
    for name, learnt in exact.parameters.items():
        assert sampled.parameters[name].mean == pytest.approx(learnt.mean, abs=0.03)
    np.testing.assert_allclose(sampled.belief.joint, exact.belief.joint, rtol=0, atol=0.03)


SETTINGS = [({'method': name}, 0.0) for name in ONE_PASS] + [
    ({'dynamics': Dynamics('used_up')}, 0.0),
    ({'dynamics': Dynamics('moving', move=0.2)}, 0.0),
    ({'dynamics': Dynamics('learn'), 'target_dynamics': Dynamics('learn')}, 0.0),
    ({'unknowns': Unknowns(lethality=(0.1, 0.9), reach=(0.0, 0.9))}, 0.0),
    ({}, 0.5),
]
PRIOR = Belief.prior(Grid(3, 2), 0.3, 0.3, 0.6)
RETURN = Observation([0, 1, 4, 3, 0], True, [0, 1, -1, 0])
LOSS = Observation([0, 1, 2, 5, 4, 0], False)


@for_each('options, duds', SETTINGS)
def test_findings_keep_their_laws(options, duds):
    model = SensorModel(0.6, 0.1, duds=duds)
    start = folded([RETURN, LOSS, RETURN], PRIOR, model, **options)

    def after(*findings):
        estimator = start.copy()
        for finding in findings:
            estimator.assimilate(finding)
        return estimator.belief

    def assert_same(one, other, cells=slice(None)):
        np.testing.assert_allclose(one.joint[cells], other.joint[cells], rtol=0, atol=1e-12)

    one, other = Finding([1, 2], False, walked=0.3, confidence=0.6), Finding([2, 4], None, True)
    # In any order, both count; what contradicts as surely takes it back.
    assert_same(after(one, other), after(other, one))
    no, yes = (Finding([1, 4], each, each, confidence=0.9) for each in (False, True))
    assert_same(after(no, yes), start.belief)
    # Nothing is said without confidence.
    for changed in (False, True):
        nothing = Finding([1, 2, 4], True, False, confidence=0.0, changed=changed)
        assert_same(after(nothing), start.belief)
    # A base stays free, and where numbers are known, cells that are not named stay to the bit.
    assert after(Finding([0], hazard=True)).hazard[0] == 0.0
    if not start.parameters and len(start.kinds) == 1:
        rest = [0, 3, 5]
        assert np.array_equal(after(one, other).joint[rest], start.belief.joint[rest])
    # A change moves the share that is told, whatever else is not known.
    placed = after(Finding([2], True, confidence=0.75, changed=True))
    removed = after(Finding([2], False, confidence=0.75, changed=True))
    assert placed.hazard[2] == pytest.approx(1.0 - 0.25 * (1.0 - start.belief.hazard[2]))
    assert removed.hazard[2] == pytest.approx(0.25 * start.belief.hazard[2])
    assert_same(placed, start.belief, [0, 1, 3, 4, 5])
    np.testing.assert_allclose(removed.target, start.belief.target, rtol=0, atol=1e-12)


@for_each('options, duds', SETTINGS)
def test_a_change_is_no_evidence(options, duds):
    model = SensorModel(0.6, 0.1, duds=duds)
    start = folded([LOSS, RETURN, LOSS], PRIOR, model, **options)
    changed = start.copy()
    changed.assimilate(Finding([1, 2], True, False, changed=True))
    assert changed.parameters == start.parameters
    assert changed.kinds == pytest.approx(start.kinds, abs=1e-15)
    if start._checker is not None:
        for name, ratio in changed.model_check.alternatives.items():
            assert ratio == pytest.approx(start.model_check.alternatives[name], rel=1e-12)


@for_each('options, duds', SETTINGS)
def test_a_finding_before_the_first_robot_is_a_prior(options, duds):
    if duds or options.get('unknowns') or 'target_dynamics' in options:
        return
    model, finding = SensorModel(0.6, 0.1), Finding([2, 4], False, True, 0.7, 0.2)
    told = folded([finding, RETURN, LOSS], PRIOR, model, **options)
    method = options.get('method', 'kappa_bnitp')
    prior = update(PRIOR, model, finding, method)
    expected = folded([RETURN, LOSS], prior, model, **options).belief
    np.testing.assert_allclose(told.belief.joint, expected.joint, rtol=0, atol=1e-12)


@for_each('options, duds', SETTINGS)
def test_a_walk_is_the_return_of_a_robot_that_sees_nothing(options, duds):
    """Of a robot that goes into the cell once, but takes no time and is not used up by it."""
    if 'dynamics' in options or 'unknowns' in options:
        return
    model = SensorModel(0.6, 0.1, duds=duds)
    robot_type = RobotType(lethality=0.35, malfunction=0.0, false_negative=0.0)
    walk, robot = Finding([4], walked=0.35), Observation([4, 4], True, [-1])
    walked, sent = (folded([LOSS], PRIOR, model, **options) for _ in range(2))
    walked.assimilate(walk)
    sent.assimilate(robot, robot_type)
    np.testing.assert_allclose(walked.belief.joint, sent.belief.joint, rtol=0, atol=1e-15)


def test_a_particle_that_a_finding_excludes_has_no_weight():
    joint = PRIOR.joint.copy()
    joint[4] = [[0.0, 0.0], [0.5, 0.5]]
    for method in METHODS:
        estimator = Estimator(Belief(joint, PRIOR.grid), SensorModel(0.5), method)
        with pytest.raises(ValueError, match='is impossible under this'):
            estimator.assimilate(Finding([4], walked=1.0))
        assert estimator.belief == Estimator(estimator.prior, SensorModel(0.5), method).belief
    with pytest.raises(ValueError, match='is impossible under this'):
        update(Belief(joint), SensorModel(0.5), Finding([4], walked=1.0))
    unknowns = Unknowns(lethality=(0.1, 0.9), duds=(0.0, 0.9))
    learning = Estimator(Belief(joint), SensorModel(0.5), unknowns=unknowns)
    learning.assimilate(Finding([4], walked=1.0))
    assert learning.parameters['duds'].zero == 0.0
    assert learning.belief.hazard[4] == pytest.approx(1.0, abs=1e-12)


@for_each('unknowns', [Unknowns(), Unknowns(lethality=(0.1, 0.9), hazard_density=(0.1, 0.6))])
def test_an_estimator_that_is_told_otherwise_has_the_same_findings(unknowns):
    events = [RETURN, Finding([1, 2], True, confidence=0.8), LOSS, Finding([4], False, walked=0.2)]
    events += [Finding([2], hazard=False, changed=True), LOSS]
    model, other = SensorModel(0.6, 0.1), SensorModel(0.6, 0.15)
    again = folded(events, PRIOR, model, unknowns=unknowns).retold('malfunction', 1.5)
    bank = again._inference._filters['static']
    own, chances = [], []
    for numbers in bank.numbers:
        known = dict(zip(bank.names, numbers.tolist()))
        density = known.get('hazard_density', 0.3)
        # The target's map follows from kappa and the background, which stay.
        background = (0.3 - 0.6 * 0.3) / 0.7
        target = 0.6 * density + background * (1.0 - density)
        joint = Belief.prior(PRIOR.grid, density, target, 0.6).joint
        each = SensorModel(known.get('lethality', 0.6), other.malfunction)
        joint, chance = fields_in_full.posterior(joint, each, events)
        own.append(joint[:, 1].sum(axis=1))
        chances.append(np.log(chance))
    np.testing.assert_allclose(bank.hazard(), own, rtol=0, atol=1e-10)
    np.testing.assert_allclose(bank._log_likelihood, chances, rtol=0, atol=1e-9)
    assert np.isfinite(log_sum(bank._log_weights))


class Silent(KnownModel):
    """A method of another package that knows no findings."""

    def assimilate(self, observation, robot_type):
        self.belief = update(self.belief, self.model, observation)


class Vain(Silent):
    """A method that claims to take findings, and does not."""

    takes_findings = True


class Told(Silent):
    """A method that takes findings, but no changes."""

    takes_findings = True

    def assimilate_finding(self, finding):
        self.belief = update(self.belief, self.model, finding)


def test_methods_of_other_packages_say_what_they_take():
    model, finding = SensorModel(0.5), Finding([1], False)
    change = Finding([1], False, changed=True)
    with pytest.raises(ValueError, match='Silent takes no findings: use relaxed_itp or .*bnitp'):
        Estimator(PRIOR, model, Silent).assimilate(finding)
    with pytest.raises(ValueError, match='Vain.*has no assimilate_finding'):
        Estimator(PRIOR, model, Vain)
    told = folded([finding], PRIOR, model, Told)
    assert told.belief == update(PRIOR, model, finding)
    with pytest.raises(ValueError, match='changed is True, and .*Told takes no field that people'):
        told.assimilate(change)
    sampled = Estimator(PRIOR, model, 'kappa_bnitp_sampled')
    with pytest.raises(ValueError, match='kappa_bnitp_sampled takes no field .*use relaxed_itp'):
        sampled.assimilate(change)
    clustered = Estimator(
        PRIOR, model, 'kappa_bnitp_sampled', clustering=Clustering(PRIOR.grid, 0.3)
    )
    before = clustered.belief
    with pytest.raises(ValueError, match='changed is True, and hazards are clustered'):
        clustered.assimilate(change)
    assert clustered.belief == before


@for_each('arguments, why', [
    (([],), 'cells is .*: it must list at least one cell'),
    ((3, True), 'cells is 3: it must list at least one cell'),
    (([-1], True), 'has the cell -1: cells are numbered from 0'),
    (([1.5], True), 'it must be of cells, whole numbers; of a mask'),
    (([True, False], True), 'of a mask give np.flatnonzero'),
    (([1], True, None, 1.0), 'confidence is 1.0: it must be at least 0 and below 1, so that'),
    (([1], True, None, float('nan')), 'confidence is nan'),
    (([1], 2), 'hazard is 2: it must be True or False'),
    (([1], None, 'yes'), 'target is yes: it must be True or False'),
    (([1],), 'hazard and target are None, and walked is 0: say one of them'),
    (([1], None, None, 0.9, 1.2), 'walked is 1.2: it must be a probability'),
    (([1], True, None, 0.9, 0.0, -3), 'since is -3: it must be a whole number at least 0'),
    (([1], None, None, 0.9, 0.0, None, True), 'hazard and target are None, and walked is 0'),
    (([1], True, None, 0.9, 0.1, None, True), 'make two findings, of the walk and of the change'),
    (([1], True, None, 0.9, 0.0, None, 3), 'changed is 3: it must be True or False'),
])  # fmt: skip
def test_bad_findings_are_refused(arguments, why):
    with pytest.raises((ValueError, TypeError), match=why) as refused:
        Finding(*arguments)
    assert '\n' not in str(refused.value)


@for_each('finding, why', [
    (Finding([1, 6], True), 'cells has the cell 6: the field has the cells 0 to 5'),
    (Finding([0, 1], True, changed=True), 'a hazard was placed in cell 0, whose probability'),
    ('far', 'observation is .far.: it must be Observation.* or Finding'),
])  # fmt: skip
@for_each('method', METHODS)
def test_findings_that_do_not_fit_a_belief_change_nothing(finding, why, method):
    estimator = Estimator(PRIOR, SensorModel(0.5), method)
    if getattr(finding, 'changed', False) and method not in ONE_PASS:
        why = 'takes no field'
    with pytest.raises((ValueError, TypeError), match=why):
        estimator.assimilate(finding)
    assert estimator.belief == Estimator(PRIOR, SensorModel(0.5), method).belief
    with pytest.raises(ValueError, match='robot_type is RobotType'):
        estimator.assimilate(Finding([1], True), RobotType(lethality=0.3))


def test_a_finding_is_a_value():
    finding = Finding([4, 2, 4], hazard=np.True_, since=np.int64(5))
    assert finding.cells.tolist() == [2, 4]
    assert finding.hazard is True
    assert finding == Finding(np.array([2, 4]), True, since=5) != Finding([2, 4], True)
    assert type(finding.since) is int
    with pytest.raises(ValueError, match='read-only'):
        finding.cells[0] = 1
    with pytest.raises(AttributeError):
        finding.hazard = False
