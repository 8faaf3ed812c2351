# SPDX-License-Identifier: Apache-2.0
"""Standings on the wire: what is invalid is refused and named."""

import re

from kbnitp_ros.base.state import BaseState
from kbnitp_ros.core.inference.record import Cause, OrderState, Verdict
from kbnitp_ros.messages.deployments import Acknowledged, read_report
from kbnitp_ros.messages.headers import to_stamp
from kbnitp_ros.messages.standings import read_standings
from kbnitp_ros.messages.topics import OF_AGENT, OF_MISSION
from kbnitp_ros.nodes.recorded_topics import message_class
from laws import for_each
import pytest
from samples import changed, GRID, HOME, key, new_ledger, over_the_wire, returned, standings

# Fewer readings than the other report of this deployment.
OTHER = returned(2, [0, 1, 0])


def judged():
    """Return a ledger with a return, a contradicted return, and a refused order."""
    ledger = new_ledger()
    for number in (1, 2, 3):
        ledger.record_path(key(number), HOME, number)
    for message in (returned(1), returned(2)):
        ledger.record_report(*read_report(message))
    with pytest.raises(ValueError, match='differ'):
        ledger.record_report(*read_report(OTHER))
    ledger.record_status(key(3), OrderState.REFUSED, 4)
    return ledger


def of(number, **fields):
    """Return a change of one standing."""
    return lambda said: [
        changed(each, **fields) if place == number else each
        for place, each in enumerate(said.standings)
    ]


def test_standings_are_read_as_they_were_judged():
    ledger = judged()
    said = read_standings(over_the_wire(standings(ledger)))
    verdicts = [Verdict.RETURN, Verdict.RETURN, Verdict.VOID]
    assert [each.verdict for each in said.standings.values()] == verdicts
    for order, standing in said.standings.items():
        own = ledger.standings[order]
        assert (standing.report, standing.judged) == (own.report, own.judged)
        assert standing.refusals == own.refusals
    assert said.standings[key(2)].refusals[0].cause is Cause.CONTRADICTED


@for_each('change, told', [
    ({'author': ''}, "author is '': it must name the estimator"),
    ({'epoch': to_stamp(0)}, 'epoch is 0: it must be the start of the estimator'),
    ({'since': 99}, 'since is 99 and changes is 2: there are only 4 events'),
    ({'changes': 99}, 'since is 0 and changes is 99: there are only 4 events'),
    ({'standings': of(0, agent='')}, "standings[0].agent is '': it must name the agent"),
    ({'standings': of(1, deployment=to_stamp(10**9))}, 'standings[1] is of scout_1 at'),
    ({'standings': of(0, verdict=8)}, 'standings[0].verdict is 8: it must be from 0 to 7'),
    ({'standings': of(0, report=5)}, 'names the report with hash 5, which is not among'),
    ({'standings': of(1, judged=[])}, 'which is not among those judged'),
    ({'standings': of(1, refused=[5])}, 'names the report with hash 5, which is not among'),
    ({'standings': of(0, report=0)}, 'standings[0].report is 0, and its verdict is RETURN'),
    ({'standings': of(0, verdict=5)}, 'and its verdict is HELD'),
    ({'standings': of(1, cause=[])}, 'has 1 refused reports and 0 causes'),
    ({'standings': of(1, cause=[9])}, 'standings[1].cause is 9: it must be from 0 to 8'),
    ({'standings': of(1, reason='')}, "standings[1].reason is '': it must be the reason"),
    ({'standings': of(0, reason='why')}, "standings[0].reason is 'why': it must be the reason"),
    ({'standings': of(1, reason='x' * 501)}, 'reason has 501 characters'),
    ({'standings': of(2, order=[4])}, 'standings[2].order is 4: it must be from 1 to 3'),
])  # fmt: skip
def test_invalid_standings_are_refused_and_named(change, told):
    said = standings(judged())
    fields = {name: each(said) if callable(each) else each for name, each in change.items()}
    with pytest.raises(ValueError, match=re.escape(told)):
        read_standings(over_the_wire(changed(said, **fields)))


def test_standings_of_a_deployment_without_a_path_count_once_and_await_it():
    ledger = judged()
    state = BaseState(GRID, 6)
    assert state.follow(read_standings(standings(ledger)))
    assert state.robots_left == 2
    assert state.outcomes == state.in_flight == state.unjudged == {}
    for number in (1, 2, 3):
        state.take_path(key(number), HOME, number)
    assert state.robots_left == 2
    assert state.in_flight == {}


def test_a_report_that_nobody_heard_gives_no_outcome():
    ledger = judged()
    state = BaseState(GRID, 6)
    state.take_path(key(1), HOME, 1)
    state.follow(read_standings(standings(ledger, [key(1)])))
    assert state.report(key(1)) is None
    assert state.outcomes == {}
    assert state.lost == 0


def test_all_messages_of_a_mission_have_the_same_version():
    kinds = {topic.type_name for topic in [*OF_MISSION.values(), *OF_AGENT.values()]}
    own = [message_class(kind) for kind in kinds if kind.startswith('kbnitp_msgs/')]
    assert len(own) == 16
    assert {kind.VERSION for kind in own} == {2}


def test_the_kinds_of_acknowledged_messages_are_those_of_the_message():
    recorded = message_class('kbnitp_msgs/msg/Recorded')
    assert {each.name: each.value for each in Acknowledged} == {
        name: getattr(recorded, name) for name in Acknowledged.__members__
    }
