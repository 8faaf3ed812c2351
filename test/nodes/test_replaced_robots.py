# SPDX-License-Identifier: Apache-2.0
"""A robot that was lost is replaced under its name, or comes home without its journal."""

from fleet import FIELD, Fleet
from kbnitp_msgs.msg import AgentState, AgentStatus, BeliefMaps, DeploymentReport
from kbnitp_msgs.srv import GiveUp
from kbnitp_ros.core.inference.record import Verdict
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.headers import from_stamp
from nav_msgs.msg import Path
import pytest

MISSION = '/mission'
NODES = ('recorder', 'estimator', 'planner')
JOURNAL_LOST = 'does not know the departure of scout_1 at'


class LostRobot:
    """A mission of two robots; the node of the first one is killed in the field."""

    def __init__(self, field, return_deadline):
        self.field = field
        self.fleet = Fleet(field, mission=MISSION, speed=2.0)
        self.log = field.folder / 'log' / 'mission.mcap'
        self.log.parent.mkdir()
        self.parameters = {
            **FIELD, 'max_steps': 6, 'recorded': True, 'silent_loss': True, 'step_period': 1.0,
            'return_deadline': return_deadline, 'robots': 2, 'prior.hazard': 0.1,
        }  # fmt: skip
        self.states = field.listen(AgentState, f'{MISSION}/scout_1/state')
        self.statuses = field.listen(AgentStatus, f'{MISSION}/scout_1/status')
        self.reports = field.listen(DeploymentReport, f'{MISSION}/scout_1/report')
        self.paths = field.listen(Path, f'{MISSION}/scout_1/path')
        self.beliefs = field.listen(BeliefMaps, f'{MISSION}/belief')
        # Unless it is stuck, it may be home again before it is killed, or before all have heard of
        # its departure.
        self.fleet.simulate('stuck!')
        self.start_robot()
        self.start_base(file=str(self.log))
        field.until(self.is_away, 'robot in the field')
        self.until_told('leaves for')
        field.kill(f'{MISSION}/scout_1/robot')
        field.until(lambda: self.paths, 'path')
        self.key = self.fleet.key(0)._replace(stamp=from_stamp(self.paths[0].header.stamp))
        self.journal = self.fleet.journal('scout_1')

    def is_away(self):
        has_said = self.statuses and self.statuses[-1].state == AgentStatus.DEPARTED
        is_out = has_said and self.states and self.states[-1].state == AgentState.OUT
        return is_out and self.fleet.is_away()

    def start_base(self, **own):
        for name in NODES:
            awaited = {'await_nodes': ['planner', 'recorder']} if name == 'estimator' else {}
            self.field.start(name, {**self.parameters, **awaited, **own}, MISSION)

    def start_robot(self):
        self.fleet.start(await_nodes=['planner', 'estimator', 'recorder'])

    def place(self, x, y):
        """Put the robot, or another one, at a place."""
        self.fleet.end_simulator()
        self.fleet.simulate(scout_1=(x, y))

    def until_state(self, words):
        self.field.until(lambda: words in self.field.state(f'{MISSION}/planner'), words)

    def until_told(self, words, node='planner'):
        self.field.until(lambda: words in self.field.said(f'{MISSION}/{node}'), words)

    def until_stated(self, **values):
        def is_stated():
            return self.states and all(
                getattr(self.states[-1], name) == value for name, value in values.items()
            )

        self.field.until(is_stated, f'state {values}')

    def give_up(self):
        client = self.field.node.create_client(GiveUp, f'{MISSION}/give_up')
        self.field.until(client.service_is_ready, 'service to give up')
        answer = client.call_async(GiveUp.Request(agent='scout_1', steps_survived=0))
        self.field.until(answer.done, 'answer')
        assert answer.result().success, answer.result().message

    def until_lost(self):
        def is_believed():
            return self.beliefs and self.beliefs[-1].deployments == 1

        self.field.until(is_believed, 'belief in the loss')

    def refusals(self):
        """Return how often each node of the base refused a message."""
        return {name: self.field.said(f'{MISSION}/{name}').count(' refused: ') for name in NODES}

    def standings(self):
        """End all nodes, and return the verdicts in the order of the deployments."""
        self.until_state('done: 2 of 2 robots deployed')
        self.field.until_recorded(self.log, {f'{MISSION}/belief': self.beliefs})
        self.field.processes.stop()
        told = replay(self.log)
        assert told.reproduced
        assert not told.evidence.refused
        standings = told.evidence.standings
        return [standings[key].verdict for key in sorted(standings)]


@pytest.mark.parametrize('is_resumed', [pytest.param(False, marks=pytest.mark.full), True])
def test_a_robot_takes_the_place_of_a_lost_one(field, is_resumed):
    mission = LostRobot(field, return_deadline=3.0)
    mission.until_lost()
    # DDS lists the lost robot for some time, as the planner warns.
    mission.until_told('agent scout_1 has left the graph')
    if is_resumed:
        for name in NODES:
            mission.field.kill(f'{MISSION}/{name}')
        mission.start_base(resume=str(mission.log))
    before = mission.refusals()
    mission.journal.unlink()
    mission.place(0.5, 0.5)
    mission.start_robot()
    assert mission.standings() == [Verdict.LOSS, Verdict.RETURN]
    assert mission.refusals() == before
    # The second robot says nothing of the first one's order.
    said = {(each.state, from_stamp(each.deployment)) for each in mission.statuses}
    assert len(said) == 4
    assert len({str(each) for each in mission.statuses}) == 4
    assert len({each.journal for each in mission.states}) == 2


def test_a_robot_without_a_journal_is_held_until_the_operator_gives_up_the_lost_one(field):
    mission = LostRobot(field, return_deadline=12.0)
    mission.journal.unlink()
    mission.place(0.5, 0.5)
    mission.start_robot()
    mission.until_state('its robot stands at its base, with another journal than at the departure')
    assert mission.states[-1].state == AgentState.READY
    assert not mission.reports
    mission.give_up()
    mission.until_lost()
    before = mission.refusals()
    assert mission.standings() == [Verdict.LOSS, Verdict.RETURN]
    assert mission.refusals() == before


def test_a_robot_whose_journal_is_gone_in_the_field_is_never_lost(field):
    mission = LostRobot(field, return_deadline=12.0)
    mission.journal.unlink()
    mission.place(2.5, 0.5)
    mission.start_robot()
    mission.until_state(f'the operator to decide on {mission.key}: journal {mission.journal}')
    mission.until_stated(state=AgentState.NO_JOURNAL, at_base=False)
    assert JOURNAL_LOST in mission.states[-1].reason
    # Its place is unknown, and its node dies: that ends nothing.
    mission.fleet.end_simulator()
    mission.until_stated(state=AgentState.NO_JOURNAL)
    field.kill(f'{MISSION}/scout_1/robot')
    mission.until_told('agent scout_1 has left the graph')
    assert not mission.reports
    assert mission.beliefs[-1].deployments == 0
    mission.fleet.simulate(scout_1=(0.5, 0.5))
    mission.start_robot()
    mission.until_stated(state=AgentState.READY, at_base=True)
    mission.give_up()
    assert mission.standings() == [Verdict.LOSS, Verdict.RETURN]


def test_a_robot_with_a_damaged_journal_comes_home_and_vouches_for_no_step(field):
    mission = LostRobot(field, return_deadline=100.0)
    content = mission.journal.read_bytes()
    mission.journal.write_bytes(content.replace(b'"orders"', b'"0rders"'))
    mission.place(2.5, 0.5)
    mission.start_robot()
    mission.until_stated(state=AgentState.NO_JOURNAL, at_base=False)
    # It starts again on the way.
    field.kill(f'{MISSION}/scout_1/robot')
    mission.start_robot()
    mission.until_stated(state=AgentState.NO_JOURNAL, at_base=False)
    mission.place(0.5, 0.5)
    mission.until_told('which the journal lost: no step is vouched for', 'scout_1/robot')
    assert mission.standings() == [Verdict.RETURN, Verdict.RETURN]
    report = mission.reports[0]
    assert from_stamp(report.deployment) == mission.key.stamp
    assert report.survived
    assert all(each.not_entered for each in report.readings)
