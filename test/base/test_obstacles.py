# SPDX-License-Identifier: Apache-2.0
"""Conditions that block the next deployment, the reach of paths, and beliefs that count."""

from dataclasses import replace
from itertools import combinations

from kbnitp_ros.base.agent_states import AgentStates
from kbnitp_ros.base.mission_tracker import MissionTracker
from kbnitp_ros.base.obstacles import describe_obstacle
from kbnitp_ros.base.protocol import PlannerState
from kbnitp_ros.base.state import BaseState, EvidenceName
from kbnitp_ros.configuration import node_parameters, with_defaults
from kbnitp_ros.configuration.checks import (
    check_changes,
    check_reach,
    check_robots,
    cut_off_note,
    failure_note,
    ignored_note,
    reach_note,
)
from kbnitp_ros.core import Belief, Estimator, Grid, Ledger, Report, SensorModel, Unknowns
from kbnitp_ros.core.inference.record import OrderState, Standing, Verdict
from kbnitp_ros.messages.beliefs import belief_maps, read_belief_maps
from kbnitp_ros.messages.deployments import AgentStatus, read_report
from kbnitp_ros.messages.headers import next_name
from kbnitp_ros.messages.operator_actions import Action, OperatorAction
from kbnitp_ros.messages.progress import Helper, MissionState, Obstacle
from kbnitp_ros.messages.standings import Standings
from kbnitp_ros.messages.states import read_state, Readiness, state_message
from kbnitp_ros.nodes.rounds import Rounds
from laws import for_each
import numpy as np
import pytest
from samples import GRID, HOME, key, lost

VALUES = {
    'robots': 3, 'rolling': False, 'recorded': False, 'silent_loss': True,
    'presume_departure': False, 'return_deadline': 10.0, 'step_period': 1.0,
}  # fmt: skip


ENDED = Standing(Verdict.RETURN, 1, judged=frozenset({1}))
HEARD = EvidenceName(1, 1)


def base(*out, actions=(), values=VALUES):
    """Return a base that heard of one return, with robots in flight, after its operator's acts."""
    state = BaseState(GRID, 10, values=values)
    state.follow(Standings(1, '/estimator', 0, 1, 7, 1, 1, 0, {key(0): ENDED}))
    for content, each in enumerate(out):
        state.take_path(each, HOME, content)
    for stamp, action in enumerate(actions):
        state.take_action(OperatorAction(stamp, action, 0))
    return state


def states(**said):
    known = AgentStates({'scout_1': GRID}, VALUES)
    stated = {'readiness': Readiness.READY, 'reason': '', 'is_at_base': True, 'stamp': 1, **said}
    known.take('scout_1', read_state(state_message(GRID, 'scout_1', **stated), 'scout_1'))
    return known


# One robot was deployed, two are left, and nothing blocks the next deployment.
CLEAR = PlannerState(
    agents=['scout_1'],
    base=base(),
    states=states(),
    unrecorded_action=None,
    newest=HEARD,
    why_unfollowed=None,
    estimators=1,
    is_decided=True,
    why_over=lambda: None,
    missing_listeners=lambda: None,
    topic=lambda name: f'/a/{name}',
    service=lambda name: f'/b/{name}',
)


def made(out=(), reported=(), actions=(), values=VALUES, **changes):
    known = base(*out, *reported, actions=actions, values=values)
    for deployment in reported:
        known.record_report(deployment, Report(False, content=1))
    return replace(CLEAR, base=known, **changes)


MADE_BY = {
    Obstacle.ACTION_UNRECORDED: {'unrecorded_action': 'the recorder'},
    Obstacle.GOAL_LOST: {'actions': [Action.GOAL_LOST]},
    Obstacle.UNFOLLOWED: {'why_unfollowed': 'resume'},
    Obstacle.NO_BELIEF: {'newest': None},
    Obstacle.UNREPORTED: {'out': [key(1)]},
    Obstacle.UNJUDGED: {'reported': [key(2)]},
    Obstacle.BELIEF_BEHIND: {'newest': EvidenceName(1, 0)},
    Obstacle.ALL_DEPLOYED: {'values': {**VALUES, 'robots': 0}},
    Obstacle.DECIDING: {'is_decided': False},
    Obstacle.OVER: {'why_over': lambda: 'the lane is free'},
    Obstacle.NO_SUBSCRIBER: {'missing_listeners': lambda: 'the estimator'},
    Obstacle.PAUSED: {'actions': [Action.PAUSE]},
    Obstacle.NO_FREE_AGENT: {'absent': ['scout_1']},
}


def test_robots_leave_where_nothing_blocks_them():
    assert CLEAR.obstacle is Obstacle.NONE
    assert CLEAR.free_agents == ['scout_1']


@for_each('obstacle', list(MADE_BY))
def test_each_obstacle_alone_blocks_departures(obstacle):
    assert made(**MADE_BY[obstacle]).obstacle is obstacle


@for_each('first, second', list(combinations(MADE_BY, 2)))
def test_the_first_of_two_obstacles_is_stated(first, second):
    both = made(**MADE_BY[second] | MADE_BY[first])
    if (first, second) == (Obstacle.UNREPORTED, Obstacle.NO_FREE_AGENT):
        # Nobody waits for the report of an agent that has left the graph.
        first = second
    assert both.obstacle is first


def test_the_goal_is_looked_at_only_when_robots_could_leave():
    def fail():
        raise AssertionError

    for obstacle in list(MADE_BY)[: list(MADE_BY).index(Obstacle.OVER)]:
        changes = MADE_BY[obstacle] | {'why_over': fail}
        assert made(**changes).obstacle is obstacle


def test_where_robots_leave_one_by_one_only_the_free_ones_do():
    values = {**VALUES, 'rolling': True}
    rolling = made(
        values=values,
        agents=['scout_1', 'scout_2'],
        out=[key(1)],
    )
    assert rolling.obstacle is Obstacle.NONE
    assert rolling.free_agents == ['scout_2']
    assert replace(rolling, why_over=lambda: 'enough').obstacle is Obstacle.UNREPORTED
    values['robots'] = 2
    assert rolling.obstacle is Obstacle.ALL_LEFT


@for_each('ended_by, obstacle', [
    (Action.RESUME, Obstacle.NONE),
    (Action.REACHED, Obstacle.NONE),
    (Action.END, Obstacle.ALL_DEPLOYED),
    (Action.PAUSE, Obstacle.GOAL_LOST),
])  # fmt: skip
def test_a_goal_that_no_longer_holds_stops_robots_until_a_person_resumes(ended_by, obstacle):
    assert made(actions=[Action.GOAL_LOST, ended_by]).obstacle is obstacle


def test_a_mission_is_over_by_its_last_robot_once_its_goal_is_decided():
    over = made(values={**VALUES, 'robots': 0}, is_decided=False)
    assert over.obstacle is Obstacle.ALL_DEPLOYED
    action = OperatorAction(1, Action.REACHED, 1, parameters={'goal.kind': 'lane'})
    over.base.take_action(action)
    assert over.obstacle is Obstacle.DECIDING
    assert replace(over, is_decided=True).obstacle is Obstacle.ALL_DEPLOYED


@for_each('change, free', [
    ({'left_alone': ['scout_1']}, False),
    ({'silent': ['scout_1']}, False),
    ({'absent': ['scout_1']}, False),
    ({}, True),
])  # fmt: skip
def test_agents_that_answer_and_take_orders_are_free(change, free):
    assert bool(made(**change).free_agents) is free


@for_each('change', [{'silent_loss': False}, {'presume_departure': True}])
def test_silent_agents_are_sent_where_silence_does_not_count(change):
    silent = made(silent=['scout_1'], values=VALUES | change)
    assert silent.free_agents == ['scout_1']


def test_an_ended_mission_waits_for_departed_robots_only():
    ended = made(
        actions=[Action.END],
        agents=['scout_1', 'scout_2'],
        out=[key(1), key(2, 'scout_2')],
    )
    assert ended.unreported == []
    assert ended.robots == 1
    assert ended.obstacle is Obstacle.ALL_DEPLOYED
    ended.base.take_status(key(1), AgentStatus(OrderState.DEPARTED, 0))
    assert ended.unreported == [key(1)]
    assert ended.robots == 2
    assert ended.obstacle is Obstacle.UNREPORTED


@for_each('actions, obstacle, state', [
    ([], Obstacle.UNREPORTED, MissionState.RUNNING),
    ([], Obstacle.OVER, MissionState.DONE),
    ([], Obstacle.ALL_DEPLOYED, MissionState.DONE),
    ([Action.PAUSE], Obstacle.UNREPORTED, MissionState.PAUSED),
    ([Action.PAUSE], Obstacle.ALL_DEPLOYED, MissionState.DONE),
    ([Action.PAUSE, Action.END], Obstacle.UNREPORTED, MissionState.ENDED),
    ([Action.GOAL_LOST], Obstacle.GOAL_LOST, MissionState.PAUSED),
])  # fmt: skip
def test_the_state_of_the_mission(actions, obstacle, state):
    assert made(actions=actions).mission_state(obstacle) is state


@for_each('obstacle, change, words', [
    (Obstacle.NO_BELIEF, {'estimators': 0}, 'the belief on /a/belief, which nobody publishes'),
    (Obstacle.NO_BELIEF, {}, 'the nodes in its parameter await_nodes'),
    (Obstacle.UNREPORTED, {}, 'departure of scout_1 at 1.000000000, which its agent reports on'),
    (
        Obstacle.UNREPORTED,
        {'silent': ['scout_1']},
        'on /a/scout_1/report: without a report the robot is given up 10.0 s after its expected '
        'return',
    ),
    (Obstacle.UNREPORTED, {'values': {**VALUES, 'recorded': True}}, '/a/scout_1/recorded'),
    (Obstacle.UNFOLLOWED, {}, 'standings on /a/standings, which are not followed: resume'),
    (Obstacle.UNJUDGED, {}, 'the estimator to judge the report of scout_1 at 2.000000000'),
    (Obstacle.BELIEF_BEHIND, {}, 'a belief that holds all that counts on /a/belief'),
    (Obstacle.DECIDING, {}, 'the decision on /a/decision'),
    (Obstacle.PAUSED, {}, 'by the service /b/pause'),
    (Obstacle.GOAL_LOST, {}, 'no longer holds: call /b/pause with false'),
    (Obstacle.ALL_DEPLOYED, {}, '1 of 0 robots deployed'),
    (Obstacle.ALL_DEPLOYED, {'actions': [Action.END]}, 'robots deployed, ended by the'),
    (Obstacle.OVER, {}, '1 of 3 robots deployed: the lane is free'),
    (Obstacle.NO_FREE_AGENT, {}, 'nobody publishes /a/scout_1/report (parameter agents)'),
    (
        Obstacle.NO_FREE_AGENT,
        {'absent': [], 'silent': ['scout_1']},
        'nobody publishes /a/scout_1/status, so a robot that never left',
    ),
])  # fmt: skip
def test_an_obstacle_is_stated_with_its_remedy(obstacle, change, words):
    now = made(**MADE_BY[obstacle] | change)
    assert words in describe_obstacle(now, obstacle)


@for_each('obstacle, change, helper', [
    (Obstacle.ACTION_UNRECORDED, {}, Helper.RECORDER),
    (Obstacle.NO_BELIEF, {}, Helper.ESTIMATOR),
    (Obstacle.UNREPORTED, {}, Helper.ROBOT),
    (Obstacle.UNREPORTED, {'values': {**VALUES, 'recorded': True}}, Helper.RECORDER),
    (Obstacle.UNFOLLOWED, {}, Helper.OPERATOR),
    (Obstacle.UNJUDGED, {}, Helper.ESTIMATOR),
    (Obstacle.DECIDING, {}, Helper.ESTIMATOR),
    (Obstacle.PAUSED, {}, Helper.OPERATOR),
    (Obstacle.GOAL_LOST, {}, Helper.OPERATOR),
    (Obstacle.OVER, {}, Helper.NOBODY),
    (Obstacle.NO_FREE_AGENT, {}, Helper.ROBOT),
])  # fmt: skip
def test_each_obstacle_names_who_can_end_it(obstacle, change, helper):
    now = made(**MADE_BY[obstacle] | change)
    assert now.ends_by(now.obstacle) is helper


def test_proposals_and_searches_are_stated_with_their_agents():
    now = replace(CLEAR, searched=['scout_1'], why_worthless='too far', proposed=[key(1)])
    told = {
        obstacle: describe_obstacle(now, obstacle)
        for obstacle in (Obstacle.SEARCHING, Obstacle.WORTHLESS, Obstacle.UNAPPROVED)
    }
    assert told[Obstacle.SEARCHING] == 'the search for the paths of scout_1 to end'
    assert 'worth a robot: too far; ' in told[Obstacle.WORTHLESS]
    assert 'approve /a/scout_1/proposal by the service /b/approve' in told[Obstacle.UNAPPROVED]


FIELD = Grid(9, 9)
GIVEN = {name: each.default for name, each in node_parameters('planner').items()}


@for_each('changes', [{'robots': 4}, {'robots': 9}, {'beam_width': 8}, {'use_sim_time': 'odd'}])
def test_allowed_parameter_changes_are_taken(changes):
    check_changes(changes, GIVEN, FIELD, {}, sent=4)


@for_each('changes, why', [
    ({'robots': 3}, '^parameter robots is 3: it must be at least 4'),
    ({'beam_width': 0}, 'beam_width'),
    ({'beam_width': 10**6}, 'beam_width'),
    ({'planner': 'beem'}, 'beam'),
])  # fmt: skip
def test_parameter_changes_that_contradict_the_mission_are_refused(changes, why):
    with pytest.raises(ValueError, match=why):
        check_changes(changes, GIVEN, FIELD, {}, sent=4)


def test_a_log_with_more_robots_is_refused():
    check_robots(5, 5)
    with pytest.raises(ValueError, match='5 ends the mission'):
        check_robots(4, 5)


def limits(max_steps, max_distance=0.0):
    return {'agents': ['scout_1'], 'max_steps': max_steps, 'max_distance': max_distance}


@for_each('grid, max_steps, told', [
    (
        Grid(30, 30),
        18,
        'paths of 18 steps reach 100 of the 900 cells connected to the base (a box of 10x10 of '
        '30x30 cells): to reach all, set max_steps to 58',
    ),
    (
        Grid(5, 4, base=2, blocked=(10, 11, 12, 13, 14)),
        2,
        'paths of 2 steps reach 6 of the 10 cells connected to the base (a box of 3x2 of 5x4 '
        'cells): to reach all, set max_steps to 4',
    ),
    (Grid(9, 9), 18, ''),
    (Grid(9, 9), 16, ''),
    (Grid(3, 1, blocked=(1,)), 4, ''),
])  # fmt: skip
def test_the_share_of_the_field_in_reach_is_stated(grid, max_steps, told):
    assert reach_note(grid, limits(max_steps)) == told
    assert reach_note(grid, limits(max_steps), 0.0) == ''


def test_the_share_of_the_field_within_a_distance_is_stated():
    grid = Grid(9, 9, resolution=0.5)
    told = (
        'paths of 18 steps and 4 m reach 17 of the 81 cells connected to the base (a box of 5x5 '
        'of 9x9 cells): to reach all, set max_steps to 16 and max_distance to 11.4'
    )
    assert reach_note(grid, limits(18, 4.0)) == told
    assert reach_note(grid, limits(18, 11.4)) == ''


@for_each('changes, is_refused', [
    ({}, True),
    ({'minimum_reach': 0.1}, False),
    ({'resume': 'mission.mcap'}, False),
    ({'goal.kind': 'lane'}, False),
])  # fmt: skip
def test_a_mission_that_reaches_few_cells_is_refused_unless_it_is_confirmed(changes, is_refused):
    values = {**limits(18), 'minimum_reach': 0.5, 'resume': '', 'goal.kind': 'map', **changes}
    asked = []
    check_reach(Grid(30, 30), values, lambda question: not asked.append(question))
    assert [question.partition(' to reach all, ')[2] for question in asked] == [
        'set max_steps to 58. Send robots all the same?'
    ] * is_refused
    if is_refused:
        with pytest.raises(ValueError, match='set max_steps to 58, or minimum_reach to 0 for'):
            check_reach(Grid(30, 30), values)


@for_each('malfunction, steps, share', [(0.001, 18, '1.8'), (0.05, 18, '60'), (0.0, 5, '0')])
def test_a_mission_states_how_many_robots_fail_without_hazards(malfunction, steps, share):
    given = {'sensor.malfunction': malfunction, 'max_steps': steps, 'defaults': 'field'}
    note = failure_note({**with_defaults('estimator', given)})
    assert note.startswith(f'without hazards {share} % of robots fail on the longest path')
    assert note.endswith('defaults: field)')


def test_cells_that_are_cut_off_are_stated():
    assert (
        cut_off_note(Grid(3, 2, blocked=(1, 4))) == '2 of 4 free cells are cut off from the base'
    )
    assert cut_off_note(Grid(3, 2, blocked=(1,))) == ''


ROUND_GRID = Grid(4, 4)
AGENTS = ['scout_1', 'scout_2', 'scout_3']
MISSION = 1_000_000_000


def planned_on():
    prior = Belief.prior(ROUND_GRID, 0.15, 0.2, 0.8)
    return read_belief_maps(
        belief_maps(Ledger(ROUND_GRID, 6, Estimator(prior, SensorModel(0.5))), MISSION, MISSION)
    )


@for_each('planner', ['coverage', 'relaxed'])
@for_each('recorded', [0, 1, 2])
@for_each('is_refused', [False, True])
def test_the_rest_of_a_round_is_sent_as_planned(planner, recorded, is_refused):
    """Also if the recorded robots stay at the base."""
    values = {name: each.default for name, each in node_parameters('planner').items()}
    values |= {'planner': planner, 'max_steps': 6, 'loss_cost': 0.0}

    def rounds():
        return Rounds(ROUND_GRID, values, warn=print)

    plans = rounds().search(planned_on(), AGENTS, {}, next_name(MISSION, MISSION))().plans
    on_record = dict([(key, plan.path) for key, plan in plans.items()][:recorded])
    at_base = set(on_record) if is_refused else set()
    resumed = rounds()
    for left in set(on_record) - at_base:
        resumed.count_path(on_record[left])
    missing = resumed.missing(planned_on(), AGENTS, on_record, at_base=at_base)
    assert list(missing) == list(plans)[recorded:]
    for sent, plan in missing.items():
        np.testing.assert_array_equal(plan.path, plans[sent].path)


INTERVAL = (0.1, 1.0)


def snapshots(interval=INTERVAL, seed=3, malfunction=0.05, losses=3):
    """Return beliefs of an estimator that learns the lethality."""
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


def test_learnt_numbers_do_not_make_another_estimator():
    tracker = MissionTracker()
    told = snapshots()
    assert len({snapshot.model for snapshot in told}) == len(told)
    for snapshot in told:
        tracker.check_belief(snapshot, authors=2)
        tracker.accept_belief(snapshot)


@for_each('other, told', [
    ({'interval': (0.2, 1.0)}, '^unknowns changed from .*low=0.2.*: 2 nodes publish beliefs'),
    ({'seed': 4}, "^seed changed from '3' to '4': "),
    ({'malfunction': 0.04}, '^model changed from .*0.04'),
])  # fmt: skip
def test_another_estimator_is_recognised_by_its_start(other, told):
    tracker = MissionTracker()
    tracker.accept_belief(snapshots()[2])
    with pytest.raises(ValueError, match=told):
        tracker.check_belief(snapshots(**other)[3], authors=2)


def test_a_belief_of_more_robots_than_a_mission_can_have_is_refused():
    tracker, told = MissionTracker(), snapshots()
    with pytest.raises(ValueError, match='deployments is 20001: a mission has at most 20000'):
        tracker.check_belief(replace(told[-1], deployments=20_001), authors=1)


def test_paths_of_other_missions_before_the_first_robot_leaves_do_not_matter():
    tracker = MissionTracker()
    tracker.accept_belief(snapshots(losses=0)[0])
    for foreign in range(2, 202):
        with pytest.raises(ValueError, match='but no belief of that mission was received'):
            tracker.check_path(foreign)
    tracker.check_path(1)
    assert tracker.begin(1) == 1
    with pytest.raises(ValueError, match='and not to the mission begun at 0.000000001'):
        tracker.check_path(2)


def test_the_mission_of_a_belief_with_deployments_is_that_of_an_earlier_prior():
    tracker, (prior, belief) = MissionTracker(), snapshots(losses=1)
    tracker.accept_belief(prior)
    foreign = replace(belief, mission=0)
    with pytest.raises(ValueError, match='and not to the mission begun at 0.000000001'):
        tracker.check_belief(foreign, authors=2)
    # A restarted estimator states a later mission before it receives the paths.
    tracker.accept_belief(replace(prior, mission=7))
    tracker.check_belief(belief, authors=2)


@for_each('given, learnt, words', [
    ({}, ['lethality', 'hazard_density', 'target_background', 'reach'], []),
    ({'defaults': 'field'}, ['malfunction'], []),
    ({'sensor.lethality': 0.8}, [], []),
    (
        {'sensor.lethality': 0.8, 'prior.hazard': 0.2},
        ['lethality', 'hazard_density', 'malfunction'],
        ['sensor.lethality is 0.8 and prior.hazard is 0.2, and not used', 'learn.lethality and'],
    ),
    ({'sensor.reach': 0.1}, ['reach'], ['sensor.reach is 0.1', 'set learn.reach to a prior']),
])  # fmt: skip
def test_given_values_that_are_learnt_are_named(given, learnt, words):
    note = ignored_note(with_defaults('estimator', given), learnt)
    assert bool(note) == bool(words)
    assert all(each in note for each in words)
