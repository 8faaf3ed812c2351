# SPDX-License-Identifier: Apache-2.0
"""Findings and annotations in a ledger: the fold of all that is known, in any order of arrival."""

from contextlib import suppress
from dataclasses import replace

from kbnitp_ros.core import (
    Annotation,
    AnnotationKind,
    Belief,
    DeploymentKey,
    Dynamics,
    Estimator,
    Finding,
    Grid,
    Ledger,
    Observation,
    OrderState,
    Report,
    SensorModel,
    Unknowns,
    Verdict,
)
from laws import for_each
import numpy as np
import pytest

GRID = Grid(3, 3, base=0)
PATHS = (
    [0, 1, 2, 5, 4, 3, 0],
    [0, 3, 6, 7, 4, 0],
    [0, 4, 8, 4, 0],
    [0, 1, 4, 1, 0],
)
PRIOR = Belief.prior(GRID, 0.2, 0.3, 0.6)
MODEL = SensorModel(0.6, 0.05)
ESTIMATORS = {
    'known': {},
    'learnt': {'unknowns': Unknowns(lethality=(0.2, 0.9), malfunction=(0.01, 0.3))},
    'changing': {'dynamics': Dynamics('changing', 0.05, 0.1)},
    'used_up': {'dynamics': Dynamics('used_up')},
    'relaxed': {'method': 'relaxed_itp'},
}
K = AnnotationKind


def estimator(kind):
    return Estimator(PRIOR, MODEL, **{'method': 'kappa_bnitp', **ESTIMATORS[kind]})


def deployments(rng):
    """Draw deployments: key, path, and report; times in tens, so that changes fall between."""
    made = {}
    for number in range(5):
        key = DeploymentKey(f'scout_{number % 2}', 100 * (number + 1))
        path = PATHS[rng.integers(len(PATHS))]
        stamp = key.stamp + int(rng.choice([50, 250]))
        if rng.random() < 0.5:
            report = Report(False, stamp=stamp, content=1000 + number)
        else:
            readings = tuple((cell, int(rng.integers(-1, 2))) for cell in path[1:])
            report = Report(True, readings, stamp=stamp, content=1000 + number)
        made[key] = path, report
    return made


def findings(rng):
    """Draw findings, plain ones and changes, by their hashes."""
    found = {}
    for number in range(3):
        cells = rng.choice(np.arange(1, GRID.cells), 2, replace=False)
        since = 10 * int(rng.integers(1, 70)) + 1
        changed = bool(rng.random() < 0.5)
        hazard = False if changed else [None, False, True][rng.integers(3)]
        walked = 0.0 if changed or hazard else 0.4
        found[2000 + number] = Finding(cells, hazard, None, 0.9, walked, since, changed)
    return found


def annotations(rng, made):
    """Draw annotations that fit their reports, by their hashes."""
    drawn = {}
    for number, (key, (path, report)) in enumerate(made.items()):
        steps = len(path) - 1
        where = tuple(int(each) for each in np.flatnonzero(rng.random(steps) < 0.5) + 1)
        kinds = [K.RECOVERED, K.WITHDRAW, None]
        if not report.survived:
            kinds += [K.LOCATED, K.NO_HAZARD, K.LOCATED]
        kind = kinds[rng.integers(len(kinds))]
        if kind is None:
            continue
        told = {'steps': where}
        if kind is K.NO_HAZARD:
            told = {'steps': (int(rng.integers(steps)),)}
        elif kind is K.LOCATED:
            told = {'steps': where[:1], 'by_hazard': [None, False, True][rng.integers(3)]}
        elif kind is K.WITHDRAW:
            told = {}
        drawn[3000 + number] = key, Annotation(kind, report.content, **told)
    return drawn


def expected_outcome(key, path, report, said):
    """Return the outcome of a deployment by its report and the annotation of it."""
    steps = len(path) - 1
    unread = np.full(steps, -1)
    if said is not None and said.kind is K.WITHDRAW:
        return Observation(path, True, unread, entered=[False] * steps)
    entered = [said is None or step + 1 in said.steps for step in range(steps)]
    if report.survived:
        readings = [reading for _, reading in report.readings]
        return Observation(path, True, readings, entered=entered)
    if said is None:
        return Observation(path, False)
    if said.kind is K.RECOVERED:
        return Observation(path, True, unread, entered=entered)
    if said.kind is K.NO_HAZARD:
        lost_at = [step == said.steps[0] for step in range(steps)]
        return Observation(path, False, None, 0, np.array(lost_at, float), by_hazard=False)
    lost_at = np.array(entered, float) if said.steps else None
    return Observation(path, False, None, 0, lost_at, by_hazard=said.by_hazard)


def expected(kind, made, found, said):
    """Fold all that is known in order; return the belief, and deployments that are held."""
    events, held = [], []
    for key, (path, report) in made.items():
        annotation = next((each for other, each in said.values() if other == key), None)
        outcome = expected_outcome(key, path, report, annotation)
        around = [
            each
            for each in found.values()
            if each.changed
            and key.stamp < each.since < report.stamp
            and {*path} & {*each.cells.tolist()}
        ]
        if around and not outcome.survived:
            held.append(key)
            continue
        for change in around:
            entered = outcome.is_entered & ~np.isin(path[1:], change.cells)
            outcome = replace(outcome, entered=entered)
        events.append((key.stamp, 0, outcome))
    events += [(each.since, 1, each) for each in found.values()]
    fold = estimator(kind)
    for *_, event in sorted(events, key=lambda event: event[:2]):
        fold.assimilate(event)
    return fold, held


def told(ledger, made, found, said, rng):
    """Tell a ledger all, in an order in which each annotation follows its report."""
    waiting = [('report', key) for key in made] + [('finding', each) for each in found]
    waiting = [waiting[place] for place in rng.permutation(len(waiting))]
    for name, (key, _) in said.items():
        place = waiting.index(('report', key))
        waiting.insert(int(rng.integers(place + 1, len(waiting) + 1)), ('annotation', name))
    for what, name in waiting:
        if what == 'report':
            path, report = made[name]
            ledger.record_path(name, path)
            ledger.record_status(name, OrderState.DEPARTED)
            # A loss during a change is refused, which the law asks of `held`.
            with suppress(ValueError):
                ledger.record_report(name, report)
        elif what == 'finding':
            ledger.record_finding(name, found[name])
        else:
            ledger.record_annotation(said[name][0], name, said[name][1])


def case(seed, kind):
    """Draw a mission whose annotations count and that is possible."""
    rng = np.random.default_rng([seed, 72])
    made, found = deployments(rng), findings(rng)
    if kind == 'used_up':
        found = {name: each for name, each in found.items() if not each.walked}
    said = annotations(rng, made)
    _, held = expected(kind, made, found, said)
    said = {name: each for name, each in said.items() if each[0] not in held}
    return made, found, said, rng


@pytest.mark.slow
@pytest.mark.parametrize('kind', ESTIMATORS)
@for_each('seed', range(60), every=10)
def test_a_ledger_is_the_fold_of_all_that_is_known(kind, seed):
    made, found, said, rng = case(seed, kind)
    fold, held = expected(kind, made, found, said)
    for _ in range(2):
        ledger = Ledger(GRID, 8, estimator(kind))
        told(ledger, made, found, said, rng)
        assert ledger.belief.joint.tobytes() == fold.belief.joint.tobytes()
        assert sorted(ledger.held) == sorted(held)
        assert ledger.findings.keys() == found.keys()
        withdrawn = [key for key, each in said.values() if each.kind is K.WITHDRAW]
        for key in withdrawn:
            assert ledger.standings[key].verdict is Verdict.WITHDRAWN
        assert len(ledger.deployments) == len(made) - len(held)


@pytest.mark.slow
@pytest.mark.parametrize('kind', ESTIMATORS)
@for_each('seed', range(60), every=10)
def test_what_is_revoked_was_never_said(kind, seed):
    made, found, said, rng = case(seed, kind)
    ledger = Ledger(GRID, 8, estimator(kind))
    told(ledger, made, found, said, rng)
    fold, held = expected(kind, made, {}, {})
    for number, name in enumerate(rng.permutation([*found, *said])):
        ledger.revoke(5000 + number, int(name))
    assert ledger.belief.joint.tobytes() == fold.belief.joint.tobytes()
    assert (sorted(ledger.held), ledger.findings, ledger.annotations) == (held, {}, {})
    fresh = Ledger(GRID, 8, estimator(kind))
    told(fresh, made, {}, {}, rng)
    assert fresh.standings == ledger.standings
    for name in (*found, *said):
        with pytest.raises(ValueError, match='was revoked before'):
            ledger.revoke(9000, name)
    with pytest.raises(ValueError, match='was never said'):
        ledger.revoke(9000, 1)


@pytest.fixture
def lost():
    """Provide a ledger with a loss between two returns, and its key."""
    ledger = Ledger(GRID, 8, estimator('learnt'))
    for number, survived in enumerate((True, False, True)):
        key = DeploymentKey('scout_1', 100 * (number + 1))
        readings = tuple((cell, 0) for cell in PATHS[0][1:]) if survived else ()
        ledger.record_path(key, PATHS[0])
        ledger.record_status(key, OrderState.DEPARTED)
        ledger.record_report(key, Report(survived, readings, key.stamp + 90, content=number + 1))
    return ledger, DeploymentKey('scout_1', 200)


@pytest.mark.parametrize(
    'kind, after', [(K.BEFORE, False), (K.AFTER, True)], ids=['before', 'after']
)
def test_a_loss_during_a_change_is_held_until_its_order_is_told(lost, kind, after):
    ledger, key = lost
    change = Finding([2, 5], hazard=False, since=250, changed=True, confidence=0.9)
    ledger.record_finding(7, change, stamp=900)
    assert ledger.spanned(change) == [key]
    assert ledger.standings[key].verdict is Verdict.HELD
    assert 'before or after' in ledger.held[key]
    assert ledger.newest_stamp == 900
    ledger.record_annotation(key, 8, Annotation(kind, 2))
    assert ledger.standings[key].verdict is Verdict.LOSS
    first, loss, last = (ledger.outcomes[each] for each in ledger.deployments)
    fold = estimator('learnt')
    for event in (first, *((change, loss) if after else (loss, change)), last):
        fold.assimilate(event)
    assert ledger.belief.joint.tobytes() == fold.belief.joint.tobytes()


def test_a_flat_battery_is_a_failure(lost):
    """Annotated failures raise the malfunction that is learnt; lost robots stay lost."""
    ledger, key = lost
    before = ledger.estimator.parameters['malfunction'].mean
    hazard = ledger.belief.hazard
    ledger.record_annotation(key, 8, Annotation(K.NO_HAZARD, 2, (3,)))
    assert ledger.estimator.parameters['malfunction'].mean > before
    assert (ledger.belief.hazard[[1, 2, 5, 4, 3]] < hazard[[1, 2, 5, 4, 3]]).all()
    assert (ledger.lost, ledger.standings[key].annotation) == (1, 8)
    ledger.record_annotation(key, 9, Annotation(K.WITHDRAW, 2))
    assert (ledger.lost, ledger.standings[key].verdict) == (0, Verdict.WITHDRAWN)
    assert len(ledger.deployments) == 3


def test_another_report_makes_an_annotation_lapse(lost):
    ledger, key = lost
    ledger.record_annotation(key, 8, Annotation(K.WITHDRAW, 2))
    readings = tuple((cell, 1) for cell in PATHS[0][1:])
    ledger.record_report(key, Report(True, readings, 500, content=33))
    standing = ledger.standings[key]
    assert (standing.verdict, standing.report, standing.annotation) == (Verdict.RETURN, 33, 0)


def test_a_held_robot_may_be_carried_home(lost):
    ledger, _ = lost
    key = DeploymentKey('scout_1', 400)
    ledger.record_path(key, PATHS[2])
    ledger.record_status(key, OrderState.DEPARTED)
    with pytest.raises(ValueError, match='another field'):
        ledger.record_report(key, Report(True, field_id='f' * 16, content=44))
    assert ledger.standings[key].verdict is Verdict.HELD
    ledger.record_annotation(key, 8, Annotation(K.RECOVERED, 44, (1, 2)))
    standing = ledger.standings[key]
    assert (standing.verdict, standing.annotation) == (Verdict.RETURN, 8)
    assert ledger.outcomes[key].is_entered.tolist() == [True, True, False, False]


@pytest.mark.parametrize('annotation, match', [
    (Annotation(K.LOCATED, 5), 'no such report'),
    (Annotation(K.LOCATED, 2, (9,)), r'steps has 9: the robot has the steps 1 to 6'),
    (Annotation(K.NO_HAZARD, 2, (6,)), 'steps is 6: the robot survived at least 0 of its 6'),
])  # fmt: skip
def test_annotations_that_do_not_fit_change_nothing(lost, annotation, match):
    ledger, key = lost
    before = ledger.belief.joint.tobytes(), ledger.standings.copy(), ledger.changes
    with pytest.raises(ValueError, match=match):
        ledger.record_annotation(key, 8, annotation)
    assert before == (ledger.belief.joint.tobytes(), ledger.standings, ledger.changes)


def test_what_cannot_count_leaves_no_trace(lost):
    ledger, _ = lost
    returned = DeploymentKey('scout_1', 100)
    before = ledger.belief.joint.tobytes(), ledger.standings.copy(), ledger.remarks.copy()
    with pytest.raises(ValueError, match='is not reported lost'):
        ledger.record_annotation(returned, 8, Annotation(K.BEFORE, 1))
    with pytest.raises(ValueError, match='which is the base or an obstacle|whose probability'):
        ledger.record_finding(9, Finding([0], hazard=True, since=50, changed=True))
    with pytest.raises(ValueError, match='since is None'):
        ledger.record_finding(9, Finding([1], hazard=False))
    assert before == (ledger.belief.joint.tobytes(), ledger.standings, ledger.remarks)
