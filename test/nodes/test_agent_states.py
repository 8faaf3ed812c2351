# SPDX-License-Identifier: Apache-2.0
"""A base compares fields before any order, believes no return lost, and shows what robots say."""

import os

from bare_dds import BareParticipant
from base import GRID
from kbnitp_msgs.msg import AgentState
from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.messages.deployments import OrderState, read_path, report_message
from kbnitp_ros.messages.states import read_state, Readiness, state_message
from kbnitp_ros.nodes.runtime import qos
from test_departures import StatedBase

OUT = Readiness.OUT

# Type hash of the reports of 1.0.
OLD = 'RIHS01_f5d751ee8901f72c58ab465be516bbc3c46d113071f3456479332bb1fbcb429c'


class Base(StatedBase):
    """A base; the test plays agents that state their fields, departures and reports."""

    def __init__(self, field, agents=('scout_1',), fields=None, **parameters):
        # No robot is overdue before the test says so.
        field.start_clock()
        super().__init__(field, agents, fields, use_sim_time=True, **parameters)

    def depart(self, agent='scout_1'):
        departed = self.say(OrderState.DEPARTED, agent=agent, stamp=self.field.now())
        self.until_named(departed, agent)

    def report(self, cells, agent='scout_1', grid=GRID, readings=None):
        """Report that the robot of the newest order is back from a walk."""
        key = max(read_path(GRID, agent, path)[0] for path in self.paths[agent])
        home = Observation(cells, True, readings or [False] * (len(cells) - 1))
        message = report_message(key, home, self.field.now(), field_id=grid.id)
        self.reports[agent].publish(message)
        return key

    def until_told(self, words):
        self.field.until(lambda: words in self.field.said('/planner'), words)

    def wait_past_deadline(self):
        """Wait until a robot that departed before is twice overdue, and the planner sees it."""
        # The planner counts from the first time at which it knows of the departure.
        for _ in range(2):
            self.field.advance(2)

    @property
    def lost(self):
        return [each for heard in self.heard.values() for each in heard if not each.survived]


def test_no_robot_leaves_and_no_report_counts_with_a_foreign_field(field):
    base = Base(field, robots=2, fields={'scout_1': Grid(6, 5)})
    words = 'its field differs: parameter grid.width is 6 there and 5 here'
    base.until_state(f'scout_1 says: {words}')
    base.until_told(f'scout_1 says: {words}')
    assert field.told('/planner', 'agent scout_1') == words
    assert not base.paths['scout_1']
    states = field.listen(AgentState, '/state')
    field.until(lambda: states, 'the field of the base')
    assert read_state(states[0], '').field_id == GRID.id
    field.stand('scout_1', GRID)
    base.until_sent(1)
    base.depart()
    # The robot is given another field on the way: neither its report nor silence is evidence.
    key = base.report([0, 1, 0], grid=Grid(5, 5, yaw=0.1))
    base.until_told(f'{key} is held, and counts for nothing')
    base.wait_past_deadline()
    assert not base.lost
    assert base.beliefs[-1].deployments == 0
    base.crash()
    base.until_state('the operator to decide on')
    # The robot repeats its report in the field of the base.
    base.report([0, 1, 0])
    base.until_held(1)
    base.until_sent(2)
    assert base.replayed(has_refused=True).evidence.survived == 1


def test_a_refused_return_stops_no_other_robot_and_is_never_a_loss(field):
    base = Base(field, ('scout_1', 'scout_2'), robots=4)
    base.until_sent(1)
    base.until_sent(1, 'scout_2')
    for agent in ('scout_1', 'scout_2'):
        base.depart(agent)
    # A walk with a jump from cell 1 to cell 13.
    key = base.report([0, 1, 13, 1, 0])
    base.until_told(f'{key} is held, and counts for nothing')
    base.report([0, 1, 0], 'scout_2')
    base.until_sent(2, 'scout_2')
    base.depart('scout_2')
    base.report([0, 1, 0], 'scout_2')
    base.until_sent(3, 'scout_2')
    base.depart('scout_2')
    base.report([0, 1, 0], 'scout_2')
    base.until_held(3)
    base.until_state(f'the operator to decide on {key}: readings of')
    base.wait_past_deadline()
    assert len(base.sent()) == 1
    assert not base.lost
    base.crash()
    base.until_state(f'the operator to decide on {key}')
    assert not base.lost
    # Only the operator makes it a loss, and is told what that says.
    told = base.do('give_up', agent='scout_1', steps_survived=0)
    assert f'{key} was held, since readings of' in told
    assert told.endswith('it counts as lost from now on')
    base.until_state('done: 4 of 4')
    assert [each.survived for each in base.lost] == [False]
    assert not base.replayed(has_refused=True).evidence.held


def test_a_robot_that_stands_at_its_base_is_no_loss(field):
    base = Base(field, robots=2)
    base.until_sent(1)
    base.depart()
    field.stand('scout_1', GRID, 'the last transform is older than 2 s', state=OUT)
    base.wait_past_deadline()
    assert not base.lost
    base.until_state('its robot stands at its base (the last transform is older than 2 s)')
    # It leaves after all, and is lost.
    field.stand('scout_1', GRID, is_at_base=False, state=OUT)
    base.wait_past_deadline()
    field.until(lambda: base.lost, 'loss')
    base.until_held(1)
    # What an agent says before its robot leaves says nothing about the robot afterwards.
    base.until_sent(2)
    field.stand('scout_1', GRID)
    base.depart()
    base.wait_past_deadline()
    base.until_state('done: 2 of 2')
    assert len(base.replayed().evidence.standings) == 2


def test_robots_that_do_not_move_do_not_count_and_their_agent_waits(field):
    base = Base(field, robots=1)
    reason = 'Nav2 rejects the goal'
    for number in (1, 2):
        base.until_sent(number)
        base.depart()
        field.stand('scout_1', GRID, state=OUT)
        field.stand('scout_1', GRID, reason)
        base.report([0, 0])
        base.until_held(number)
    base.until_state('scout_1 came back without a step 2 times in a row')
    base.until_state(f'scout_1 says: {reason}')
    field.until(lambda: base.progress[-1].deployments == 2, 'progress')
    base.crash()
    base.until_state('scout_1 came back without a step')
    # The operator sends it again.
    assert base.do('pause', data=False) == 'the operator ended the pause'
    for number in (3, 4):
        base.until_sent(number)
        base.depart()
        base.report([0, 0])
        base.until_held(number)
    base.until_state('scout_1 came back without a step')
    base.crash()
    base.until_state('scout_1 came back without a step')
    # The robot withdraws its reason.
    field.stand('scout_1', GRID)
    base.until_sent(5)
    base.depart()
    base.report([0, 1, 0])
    base.until_state('done: 1 of 1 robots deployed')
    field.until(lambda: base.beliefs[-1].deployments == 5, 'last belief')
    assert base.replayed().evidence.survived == 5


def test_a_return_that_the_estimator_refuses_is_held(field):
    """Two perfect readings of a cell contradict each other."""
    base = Base(field, robots=2, **{'sensor.true_positive': 1.0, 'sensor.false_positive': 0.0})
    base.until_sent(1)
    base.depart()
    key = base.report([0, 1, 1, 0], readings=[True, False, False])
    base.until_told(f'{key} is held, and counts for nothing')
    base.wait_past_deadline()
    assert not base.lost
    base.until_state(f'the operator to decide on {key}')
    base.report([0, 1, 1, 0])
    base.until_held(1)
    base.until_sent(2)
    assert not base.lost
    assert base.replayed(has_refused=True).evidence.survived == 1


def test_an_agent_of_an_earlier_version_is_named(field):
    strangers = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
    base = Base(field, ('scout_1', 'scout_2'), robots=2)
    strangers.announce(
        'rt/scout_2/report', 'kbnitp_msgs::msg::dds_::DeploymentReport_', type_hash=OLD
    )
    field.until(
        lambda: 'has messages of another version of kbnitp_msgs' in field.said('/planner'),
        'refusal',
    )
    assert 'must both be of version 2.0 or later' in field.said('/planner')
    base.until_sent(1)
    strangers.leave()


def test_states_that_are_not_valid_are_refused_by_name(field):
    base = Base(field, robots=1)
    publisher = field.node.create_publisher(AgentState, '/scout_1/state', qos.LATCHED)
    base.until_sent(1)
    for change, why in (
        ({'agent': 'scout_2'}, "agent is 'scout_2': on this topic it must be 'scout_1'"),
        ({'state': 9}, 'state is 9: it must be from 1 to 4'),
        ({'field_id': 'xyz'}, "field_id is 'xyz': it must be 16 hex digits"),
        ({'state': 2}, "reason is '' and state is WAITING"),
        ({'connectivity': 5}, 'connectivity is 5: it must be 4 or 8'),
    ):
        message = state_message(GRID, 'scout_1', Readiness.READY, '', True, 1)
        for name, value in change.items():
            setattr(message, name, value)
        publisher.publish(message)
        base.until_told(f'scout_1/state refused: {why}')
