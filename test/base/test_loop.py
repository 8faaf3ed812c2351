# SPDX-License-Identifier: Apache-2.0
"""Laws of planner, estimator and recorder as one loop: crashes, refused reports, new robots."""

from kbnitp_ros.base.state import BaseState, EvidenceName
from kbnitp_ros.core import Ledger
from kbnitp_ros.core.inference import ledger as ledger_module
from kbnitp_ros.core.inference.record import MissionRecord, Verdict
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.messages.deployments import Source
from kbnitp_ros.messages.operator_actions import Action
from kbnitp_ros.robot.orders import Orders
from laws import for_each
from loop import check, Loop, made, run
from mission_log import record, Sent
import pytest


@pytest.mark.slow
@for_each('seed', range(500))
def test_a_base_agrees_on_what_counts(seed):
    check(run(seed))


@pytest.mark.slow
@pytest.mark.full
@pytest.mark.parametrize('first', range(500, 20_500, 2_500))
def test_a_base_agrees_on_what_counts_in_many_missions(first):
    check_many(range(first, first + 2_500))


@pytest.mark.slow
@for_each('seed', range(0, 60, 4))
def test_replay_judges_the_same(seed, tmp_path):
    loop = run(seed)
    loop.settle()
    sent = [
        Sent(f'/{topic}', message, 10**12 + 1000 * number)
        for number, (topic, message) in enumerate(loop.log)
    ]
    found = replay(record(tmp_path / 'mission.mcap', sent))
    assert found.grade is Grade.IDENTICAL, found.mismatches
    assert found.evidence.standings.keys() == loop.ledger.standings.keys()


def test_a_robot_that_was_given_up_twice_is_given_up_by_a_resumed_planner():
    loop = Loop(0)
    loop.settle()
    loop.send()
    loop.settle()
    key, (cells, _) = next(iter(loop.plans.items()))
    _, departed = made(key, cells, 'departed')
    loop.publish('agent a', f'{key.agent}/status', departed)
    loop.settle()
    loop.lose(key, Source.SILENCE)
    loop.settle()
    _, elsewhere = made(key, cells, 'elsewhere')
    loop.publish('agent a', f'{key.agent}/report', elsewhere)
    loop.settle()
    assert loop.ledger.standings[key].verdict is Verdict.HELD
    # The planner ends before it publishes the loss.
    loop.act(Action.GIVE_UP, key)
    loop.recorder_hears('operator', loop.kept['planner', 'operator'][-1])
    loop.crash('planner')
    loop.settle()
    assert loop.ledger.standings[key].verdict is Verdict.LOSS
    check(loop)


# Faults of one of the nodes, each of which breaks a law.


def forget_what_is_taken_back(patch):
    """Leave a robot out of those in flight when its outcome is taken back."""

    def stand(state, key, standing):
        state._over.pop(key, None)
        original(state, key, standing)

    original = BaseState.stand
    patch.setattr(BaseState, 'stand', stand)


def believe_lost_who_is_back(patch):
    """Ignore that a refused report shows that its robot is back."""
    patch.setattr(ledger_module, 'is_back', lambda *_: False)


def ignore_refusals_of_orders(patch):
    """Judge orders as if no agent refused any."""
    patch.setattr(MissionRecord, 'is_refused', lambda *_: False)


def judge_in_order_of_arrival(patch):
    """Judge no later deployment again when an earlier one changes."""

    def judge(ledger, key):
        if ledger._judged and key in ledger._judged[:-1]:
            return {}
        return original(ledger, key)

    original = Ledger._judge
    patch.setattr(Ledger, '_judge', judge)


def follow_stale_standings(patch):
    """Follow standings whatever their number."""

    def follow(state, said):
        state.evidence, state.events = EvidenceName(said.epoch, said.changes), said.events
        for key, standing in said.standings.items():
            state.stand(key, standing)
        return True

    patch.setattr(BaseState, 'follow', follow)


def send_before_judgement(patch):
    """Take every report for judged."""
    patch.setattr(BaseState, '_note_unjudged', lambda *_: None)


def judge_what_is_not_on_record(patch):
    """Judge reports without the recorder's acknowledgement."""

    def hears(loop, topic, message):
        loop.judge(topic, message) if topic.endswith('/report') else original(loop, topic, message)

    original = Loop.estimator_hears
    patch.setattr(Loop, 'estimator_hears', hears)


def read_no_log_again(patch):
    """Never read what was recorded after the start of a planner."""
    patch.setattr(Loop, 'read_again', lambda _: False)


def take_the_order_of_a_lost_robot(patch):
    """Let a robot take orders of which the departure is on record."""
    patch.setattr(Orders, 'note_departure', lambda *_: None)


def ignore_what_is_taken_back(patch):
    """Let agents hear no action of the operator."""
    patch.setattr(Loop, 'agents_hears', lambda *_: None)


@pytest.mark.slow
@for_each('plant', [
    forget_what_is_taken_back,
    believe_lost_who_is_back,
    ignore_refusals_of_orders,
    judge_in_order_of_arrival,
    follow_stale_standings,
    send_before_judgement,
    judge_what_is_not_on_record,
    read_no_log_again,
    take_the_order_of_a_lost_robot,
    ignore_what_is_taken_back,
])  # fmt: skip
def test_each_planted_fault_is_found(plant, monkeypatch):
    plant(monkeypatch)
    with pytest.raises((AssertionError, LookupError, ValueError)):
        check_many(range(300))


def check_many(seeds):
    for seed in seeds:
        check(run(seed))
