# SPDX-License-Identifier: Apache-2.0
"""Standings are a pure function of all that was heard, in any order."""

from dataclasses import replace
from itertools import permutations

from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    Report,
    SensorModel,
)
from kbnitp_ros.core.inference.record import Cause, OrderState, Verdict
from laws import for_each
import pytest

GRID = Grid(3, 3, base=4)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
# Detectors and hazards of 0 and 1, which make evidence impossible.
MODELS = {
    'uncertain': SensorModel(0.5),
    'right': SensorModel(0.5, true_positive=1.0, false_positive=0.0),
    'deadly': SensorModel(1.0, malfunction=0.0, false_negative=0.0),
}
KEYS = [DeploymentKey('a', 1), DeploymentKey('b', 1), DeploymentKey('a', 2)]
A = KEYS[0]
PATH = [4, 0, 4]
OTHER = '0123456789abcdef'

# Reports of one deployment, by name; their hashes differ.
REPORTS = {
    'back': Report(True, ((0, 1), (4, 0))),
    'unseen': Report(True, ((0, 0), (4, 0))),
    'unmoved': Report(True, ((4, -1),)),
    'jump': Report(True, ((0, 1), (8, 1), (4, 0))),
    'foreign': Report(True, ((0, 1), (4, 0)), field_id=OTHER),
    'foreign loss': Report(False, field_id=OTHER),
    'unreadable': Report(True, unreadable='its frame is odom'),
    'lost': Report(False),
    'contact': Report(False, steps_survived=1),
    'long': Report(False, steps_survived=9),
    'given up': Report(False, settled=()),
}
REPORTS = {
    name: replace(report, content=number, stamp=10 * number)
    for number, (name, report) in enumerate(REPORTS.items(), 1)
}
BACK = {'unmoved', 'back', 'unseen', 'jump', 'foreign', 'foreign loss', 'unreadable'}


def settled(*names):
    """Return a give-up with knowledge of these reports."""
    known = tuple(REPORTS[name].content for name in names)
    return Report(False, settled=known, stamp=500, content=50 + sum(known))


def tell(ledger, event):
    """Tell a ledger of a path, a report or a status; what it refuses it says in its standings."""
    key, said = event
    try:
        if isinstance(said, Report):
            ledger.record_report(key, said)
        elif isinstance(said, OrderState):
            ledger.record_status(key, said, 7)
        else:
            ledger.record_path(key, said)
    except ValueError:
        return


def judged(events, model, method='kappa_bnitp'):
    """Return the ledger that heard these events."""
    ledger = Ledger(GRID, 4, Estimator(PRIOR, MODELS[model], method))
    for event in events:
        tell(ledger, event)
    return ledger


def state(ledger):
    return ledger.standings, ledger.deployments, ledger.lost, ledger.belief.joint.tobytes()


def rank(name):
    """Return the place of a report among those of its deployment, the best first."""
    order = ['back', 'unseen', 'unmoved', 'contact']
    return order.index(name) if name in order else len(order)


def expected(heard, statuses, model, before):
    """Judge a deployment by the sentences of the issue, one after another."""
    is_void = OrderState.REFUSED in statuses and OrderState.DEPARTED not in statuses
    is_at_base = bool(statuses) and OrderState.DEPARTED not in statuses
    signs = {name for name in heard if name in BACK}
    for name in sorted(heard & {'back', 'unseen', 'unmoved'}, key=rank):
        readings = [reading for _, reading in REPORTS[name].readings]
        walk = [4, *(cell for cell, _ in REPORTS[name].readings)]
        seen = Observation(walk, True, readings)
        if is_possible([*before, seen], model):
            return (Verdict.UNMOVED if name == 'unmoved' else Verdict.RETURN), seen
    if is_void:
        return Verdict.VOID, None
    rest = Verdict.HELD if heard & ({'long'} | BACK) else Verdict.OPEN
    is_closed = False
    for name in sorted(heard & {'contact', 'lost', 'given up', 'settled'}, key=rank):
        is_operator = name in ('given up', 'settled')
        if is_at_base and not is_operator:
            continue
        if signs and name != 'settled':
            rest = Verdict.HELD
            continue
        seen = Observation(PATH, False, steps_survived=int(name == 'contact'))
        if is_possible([*before, seen], model):
            return Verdict.LOSS, seen
        rest, is_closed = Verdict.HELD, is_closed or is_operator
    return (Verdict.CLOSED if is_closed else rest), None


def is_possible(outcomes, model):
    estimator = Estimator(PRIOR, MODELS[model])
    try:
        for outcome in outcomes:
            estimator.assimilate(outcome)
    except ValueError:
        return False
    return True


@st.composite
def missions(draw):
    """Return what was heard of each deployment: names of reports, and states of its order."""
    heard = {}
    for key in KEYS[: draw(st.integers(1, 3))]:
        names = draw(st.sets(st.sampled_from([*REPORTS, 'settled']), max_size=4))
        heard[key] = names, draw(st.sets(st.sampled_from(list(OrderState))))
    return heard


def all_events(heard):
    events = []
    for key, (names, statuses) in heard.items():
        events.append((key, PATH))
        events += [(key, each) for each in sorted(statuses)]
        events += [(key, REPORTS[name]) for name in sorted(names) if name != 'settled']
        if 'settled' in names:
            events.append((key, settled(*sorted(names & BACK))))
    return events


@pytest.mark.slow
@settings(max_examples=3000 if FULL else 150, deadline=None)
@given(missions(), st.sampled_from([*MODELS]), st.data())
def test_any_order_of_arrival_ends_with_the_standings_of_the_sentences(heard, model, data):
    events = all_events(heard)
    ledger = judged(data.draw(st.permutations(events + events[:2])), model)
    before = []
    for key in sorted(heard, key=lambda key: (key.stamp, key.agent)):
        verdict, outcome = expected(*heard[key], model, before)
        before += [outcome] * (outcome is not None)
        standing = ledger.standings.get(key)
        assert (standing.verdict if standing else Verdict.OPEN) is verdict
    assert [ledger.outcomes[key] for key in ledger.deployments] == before
    assert state(ledger) == state(judged(events, model))
    # What was taken back left no trace.
    fresh = Estimator(PRIOR, MODELS[model])
    for outcome in before:
        fresh.assimilate(outcome)
    assert ledger.belief.joint.tobytes() == fresh.belief.joint.tobytes()


@for_each('method', ['kappa_bnitp', 'relaxed_itp', 'relaxed_bnitp', 'kappa_bnitp_sampled'])
def test_who_was_heard_to_be_back_is_not_lost(method):
    """In every order of a loss, a refused return and a give-up without knowledge of it."""
    names = ['lost', 'foreign', 'given up']
    for order in permutations(names):
        events = [(A, PATH), *((A, REPORTS[name]) for name in order)]
        ledger = judged(events, 'uncertain', method)
        assert ledger.standings[A].verdict is Verdict.HELD
        assert ledger.standings[A].refusals[0].cause is Cause.FIELD
        assert ledger.lost == 0
        fresh = Estimator(PRIOR, MODELS['uncertain'], method)
        assert ledger.belief.joint.tobytes() == fresh.belief.joint.tobytes()
        tell(ledger, (A, settled('foreign')))
        assert ledger.standings[A].verdict is Verdict.LOSS
        # Another sign of life that nobody knew of.
        tell(ledger, (A, REPORTS['jump']))
        assert ledger.standings[A].verdict is Verdict.HELD
        tell(ledger, (A, REPORTS['back']))
        assert ledger.standings[A].verdict is Verdict.RETURN


def test_a_loss_that_the_model_rules_out_is_closed_by_the_operator():
    events = [(KEYS[0], PATH), (KEYS[0], REPORTS['back']), (KEYS[2], PATH)]
    ledger = judged([*events, (KEYS[2], REPORTS['lost'])], 'deadly')
    assert ledger.standings[KEYS[2]].verdict is Verdict.HELD
    assert ledger.standings[KEYS[2]].refusals[0].cause is Cause.IMPOSSIBLE
    tell(ledger, (KEYS[2], settled()))
    standing = ledger.standings[KEYS[2]]
    assert (standing.verdict, ledger.lost) == (Verdict.CLOSED, 1)
    assert standing.report == settled().content
    assert ledger.deployments == [KEYS[0]]


@for_each('order', permutations(['foreign', 'back', 'path']))
def test_a_valid_report_is_no_duplicate_of_a_foreign_one(order):
    said = {'foreign': REPORTS['foreign'], 'back': REPORTS['back'], 'path': PATH}
    ledger = judged([(A, said[name]) for name in order], 'uncertain')
    assert ledger.standings[A].verdict is Verdict.RETURN
    assert ledger.standings[A].report == REPORTS['back'].content
    assert [each.cause for each in ledger.standings[A].refusals] == [Cause.FIELD]
    assert ledger.duplicates == 0


def test_a_loss_waits_for_its_departure():
    ledger = judged([(A, PATH), (A, OrderState.ACCEPTED), (A, REPORTS['lost'])], 'uncertain')
    assert A not in ledger.standings
    assert ledger.record_status(A, OrderState.DEPARTED)
    standing = ledger.standings[A]
    assert (standing.verdict, standing.judged) == (Verdict.LOSS, {REPORTS['lost'].content})


def test_equal_reports_are_named_by_the_newest():
    newer = replace(REPORTS['back'], stamp=900, content=900)
    for order in ([REPORTS['back'], newer], [newer, REPORTS['back']]):
        ledger = judged([(A, PATH), *((A, each) for each in order)], 'uncertain')
        assert ledger.standings[A].report == 900
        assert (ledger.changes, ledger.duplicates) == (1, 1)


def test_changes_count_evidence_and_events_count_standings():
    ledger = judged([(A, PATH), (A, REPORTS['back'])], 'uncertain')
    assert (ledger.events, ledger.changes, ledger.take_changed()) == (1, 1, [A])
    tell(ledger, (A, REPORTS['foreign']))
    assert (ledger.events, ledger.changes, ledger.take_changed()) == (2, 1, [A])
    tell(ledger, (A, REPORTS['foreign']))
    assert (ledger.events, ledger.changes, ledger.take_changed()) == (2, 1, [])


def test_refused_reports_are_bounded_and_leave_room_for_what_counts():
    ledger = judged([(A, PATH)], 'uncertain')
    for number in range(100, 120):
        tell(ledger, (A, Report(True, ((number, 1),), content=number)))
    assert ledger.standings[A].verdict is Verdict.HELD
    with pytest.raises(ValueError, match='20 different reports of its kind were heard'):
        ledger.record_report(A, REPORTS['jump'])
    settled = tuple(each.content for each in ledger.heard[A])
    assert ledger.record_report(A, Report(False, settled=settled, content=700))
    assert ledger.standings[A].verdict is Verdict.LOSS
    assert ledger.record_report(A, REPORTS['back'])
    assert ledger.standings[A].verdict is Verdict.RETURN
