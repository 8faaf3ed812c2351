# SPDX-License-Identifier: Apache-2.0
"""Robots say how they are; a flat battery, or a switch, keeps one at its base and no other."""

from dataclasses import replace
from itertools import pairwise
from math import isnan, nan

from base import GRID
from fleet import Fleet
from kbnitp_msgs.msg import AgentHealth, MissionStatus
from kbnitp_ros.log.read import read_log
from kbnitp_ros.messages.deployments import OrderState
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.health import Health, health_message
from kbnitp_ros.nodes.runtime import qos
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool
from test_departures import StatedBase

HEALTH = 'kbnitp_msgs/msg/AgentHealth'


def listen(field, topic):
    heard = []
    field.node.create_subscription(AgentHealth, topic, heard.append, qos.READINGS)
    return heard


class Team(StatedBase):
    """A base and the health of the agents that the test plays."""

    def __init__(self, field, agents=('scout_1', 'scout_2'), **parameters):
        self.told = field.listen(MissionStatus, '/mission')
        self._healths = {
            agent: field.node.create_publisher(AgentHealth, f'/{agent}/health', qos.READINGS)
            for agent in agents
        }
        self.health = {}
        field.node.create_timer(0.1, self._repeat)
        super().__init__(field, agents, **parameters)

    def _repeat(self):
        for agent, values in self.health.items():
            health = Health(self.field.now(), '2.0.0', **values)
            self._healths[agent].publish(health_message(agent, health))

    def until_waiting(self, **waiting):
        def is_told():
            return self.told and waiting == dict(
                zip(self.told[-1].waiting, self.told[-1].waits_for)
            )

        self.field.until(is_told, f'wait of {waiting}')


def test_a_robot_with_a_flat_battery_stays_while_the_other_leaves(field):
    base = Team(field, robots=4, min_battery=0.3)

    def until_logged(words):
        field.until(lambda: f'scout_2 waits: {words}' in field.said('/planner'), words)

    base.health = {'scout_1': {'battery': 0.9}}
    base.until_sent(1)
    base.until_waiting(scout_2=MissionStatus.BATTERY)
    until_logged('battery not known, 30 % needed')
    base.health['scout_2'] = {'battery': 0.18}
    until_logged('battery 18 % of 30 % (parameter min_battery)')
    base.come_back()
    base.until_sent(2)
    assert not base.sent('scout_2')
    # With nobody else to send, the mission says what it waits for.
    assert field.set_parameter('/planner', 'min_battery', 0.95).successful
    base.come_back()
    base.until_held(2)
    base.until_state('scout_1 waits: battery 90 % of 95 %')
    field.until(lambda: base.told[-1].obstacle == MissionStatus.NO_FREE_AGENT, 'obstacle')
    assert base.told[-1].ends_by == MissionStatus.ROBOT
    base.until_waiting(scout_1=MissionStatus.BATTERY, scout_2=MissionStatus.BATTERY)
    # It is charged.
    base.health['scout_2']['battery'] = 0.95
    base.until_sent(1, 'scout_2')
    base.until_waiting(scout_1=MissionStatus.BATTERY)
    # What is not said any more is not known.
    assert field.set_parameter('/planner', 'min_battery', 0.99).successful
    base.health.clear()
    base.come_back('scout_2')
    base.until_state('scout_1 waits: battery not known, 99 % needed')


def test_an_operator_lowers_the_charge_that_is_needed(field):
    base = Team(field, ('scout_1',), robots=1, min_battery=0.3)
    base.health = {'scout_1': {'battery': 0.18}}
    base.until_waiting(scout_1=MissionStatus.BATTERY)
    assert not base.sent()
    assert field.set_parameter('/planner', 'min_battery', 0.1).successful
    base.until_sent(1)


def test_a_robot_leaves_once_its_agent_is_ready(field):
    base = Team(field, robots=2, ready_topic='dock/open')
    base.until_waiting(scout_1=MissionStatus.READY, scout_2=MissionStatus.READY)
    field.talk(Bool, '/scout_2/dock/open', qos.LATCHED).publish(Bool(data=True))
    field.talk(Bool, '/scout_1/dock/open', qos.LATCHED).publish(Bool(data=False))
    base.until_sent(1, 'scout_2')
    words = 'scout_1 waits: scout_1/dock/open says false (parameter ready_topic)'
    field.until(lambda: words in field.said('/planner'), words)
    assert not base.sent()


def test_robots_of_one_base_leave_one_after_another(field):
    agents = ('scout_1', 'scout_2', 'scout_3')
    apart = {'separation': 3.0, 'rolling': True, 'return_deadline': 1e3, 'team.scout_3.base': 24}
    other = replace(GRID, base=24, other_bases=[0])
    base = Team(field, agents, fields={'scout_3': other}, robots=4, **apart)
    # The robot at another base waits for nobody.
    base.health = {'scout_1': {'x': 0.5, 'y': 0.5}}
    base.until_sent(1)
    base.until_waiting(scout_2=MissionStatus.SEPARATION)
    base.until_sent(1, 'scout_3')
    base.until_state('scout_2 waits: scout_1 to depart (parameter separation)')
    base.until_named(base.say(OrderState.DEPARTED))
    base.until_state('scout_2 waits: scout_1 to be 3 m away: it was heard 0.0 m from its home')
    base.health['scout_1']['x'] = 3.4
    base.until_state('it was heard 2.9 m from its home')
    assert not base.sent('scout_2')
    base.health['scout_1']['x'] = 3.6
    base.until_sent(1, 'scout_2')


def test_robots_that_park_close_together_do_not_keep_each_other(field):
    """Only a robot that is out keeps another, by its distance from where that one parks."""
    parked = {'team.scout_1.parking': [0.3, 0.5], 'team.scout_2.parking': [0.9, 0.5, 1.57]}
    apart = {'separation': 3.0, 'rolling': True, 'return_deadline': 1e3}
    base = Team(field, robots=3, **apart, **parked)
    base.health = {'scout_1': {'x': 0.3, 'y': 0.5}, 'scout_2': {'x': 0.9, 'y': 0.5}}
    base.until_sent(1)
    base.until_named(base.say(OrderState.DEPARTED))
    base.until_state('scout_1 to be 3 m away: it was heard 0.6 m from its home')
    # Back home it may leave again, though the other one stands near it.
    base.come_back()
    base.until_sent(2)
    base.health['scout_1']['x'] = 4.0
    base.until_named(base.say(OrderState.DEPARTED))
    base.until_sent(1, 'scout_2')


def test_a_separation_of_the_robots_of_a_round_is_refused(field):
    field.start('planner', {'separation': 3.0})
    code, told = field.until_failed('/planner')
    assert code == 2
    assert 'separation is 3.0, and rolling is false' in told


def test_two_robots_that_would_park_at_one_place_are_refused(field):
    field.start('planner', {
        'agents': ['scout_1', 'scout_2'],
        'team.scout_1.parking': [0.3, 0.5],
        'team.scout_2.parking': [0.3, 0.5, 1.57],
    })  # fmt: skip
    code, told = field.until_failed('/planner')
    assert code == 2
    assert 'parameter parking of scout_1 and scout_2: the places are 0.00 m apart' in told


def test_health_that_is_not_valid_is_refused_by_name(field):
    base = StatedBase(field, robots=1)
    publisher = field.talk(AgentHealth, '/scout_1/health', qos.READINGS)
    for change, why in (
        ({'agent': 'scout_2'}, "agent is 'scout_2': on this topic it must be 'scout_1'"),
        ({'battery': 18.0}, 'battery is 18.0: it must be from 0 to 1, or NaN'),
        ({'pose_age': -1.0}, 'pose_age is -1.0: it must be 0 or more, or NaN'),
        ({'version': 'x' * 101}, 'version is '),
    ):
        message = health_message('scout_1', Health(1, '2.0.0'))
        for name, value in change.items():
            setattr(message, name, value)

        def is_refused(message=message, why=why):
            # Health is best effort.
            publisher.publish(message)
            return f'scout_1/health refused: {why}' in field.said('/planner')

        field.until(is_refused, why)
    base.until_sent(1)


def test_simulated_robots_say_that_their_battery_is_not_known(field):
    heard = listen(field, '/scout_1/health')
    field.start('agent', {'grid.width': 5, 'grid.height': 5})
    field.until(lambda: len(heard) > 1, 'health')
    assert isnan(heard[-1].battery)
    assert isnan(heard[-1].pose_age)
    assert heard[-1].journal
    assert heard[-1].server
    seconds = (from_stamp(heard[-1].header.stamp) - from_stamp(heard[-2].header.stamp)) / 1e9
    assert 0.5 < seconds < 5.0


def test_a_robot_says_how_it_is(field):
    fleet = Fleet(field)
    heard = listen(field, '/scout_1/health')
    fleet.start(battery_topic='battery')

    def until(what, condition):
        field.until(lambda: heard and condition(heard[-1]), what)

    until('an unknown place', lambda said: isnan(said.x) and isnan(said.pose_age))
    assert not heard[-1].server
    assert isnan(heard[-1].battery)
    fleet.simulate()
    until('its place', lambda said: abs(said.x - 0.5) < 0.1 and abs(said.y - 0.5) < 0.1)
    until('a fresh pose and Nav2', lambda said: said.pose_age < 2.0 and said.server)
    assert heard[-1].journal
    # TF by odometry states no deviation.
    assert isnan(heard[-1].deviation)
    battery = field.talk(BatteryState, '/scout_1/battery', qos.READINGS)

    def charge(percentage):
        battery.publish(BatteryState(percentage=percentage))

    def is_charged():
        charge(0.75)
        return heard[-1].battery == 0.75

    field.until(is_charged, 'its charge')
    for unknown in (nan, 18.0, -0.1):
        charge(unknown)
        until('an unknown charge', lambda said: isnan(said.battery))
        field.until(is_charged, 'its charge')
    fleet.inject('die')
    until('that Nav2 is gone', lambda said: not said.server)


def test_health_is_recorded_when_something_has_changed(field):
    base = Team(field, ('scout_1',), robots=1, min_battery=0.5)
    base.health = {'scout_1': {'battery': 0.2, 'x': 0.5, 'y': 0.5, 'pose_age': 0.1}}
    base.until_waiting(scout_1=MissionStatus.BATTERY)

    def recorded():
        logged = read_log(base.log, {HEALTH}, topics={'/scout_1/health'})
        return [(round(each.message.battery, 2), each.log_time) for each in logged]

    field.until(lambda: [battery for battery, _ in recorded()] == [0.2], 'first health')
    # Neither a move nor what is too soon is recorded.
    base.health['scout_1'] |= {'x': 3.5, 'pose_age': 0.3}
    base.health['scout_1']['battery'] = 0.7
    base.until_sent(1)
    base.health['scout_1']['battery'] = 0.6
    field.until(lambda: recorded()[-1][0] == 0.6, 'last health')
    batteries, times = zip(*recorded())
    # On a slow machine the robot leaves so late that its charge then is recorded as well.
    assert batteries in ((0.2, 0.6), (0.2, 0.7, 0.6))
    assert all(later > earlier + 8 * 10**9 for earlier, later in pairwise(times))
    base.come_back()
    base.until_state('done: 1 of 1')
    assert base.replayed().evidence.ended == 1
    assert base.beliefs[-1].deployments == 1
