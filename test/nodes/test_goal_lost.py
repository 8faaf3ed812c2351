# SPDX-License-Identifier: Apache-2.0
"""A goal that was reached and no longer is: robots leave only after a person resumes."""

from base import Base, GRID
from kbnitp_msgs.msg import Decision, MissionStatus, Recorded
from kbnitp_ros.cli.parameters import recorded_planner
from kbnitp_ros.cli.replay import state_by_evidence
from kbnitp_ros.core import Observation
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.messages.headers import content_hash
from kbnitp_ros.messages.operator_actions import Action
from std_msgs.msg import Bool

# Reached by one return (0.989), and not by a loss after it (0.969).
GOAL = {'goal.kind': 'lane', 'goal.cells': [2], 'stop.confidence': 0.98}
AGENTS = ['scout_1', 'scout_2']


class Lane(Base):
    """A base with two robots out, the first of which reaches the goal when it returns."""

    def __init__(self, field, **parameters):
        self.decisions = field.listen(Decision, '/decision')
        self.told = field.listen(MissionStatus, '/mission')
        self.on_disk = field.listen(Recorded, '/operator/recorded')
        super().__init__(field, AGENTS, **{'rolling': True, 'robots': 6, **GOAL, **parameters})
        for agent in AGENTS:
            self.until_sent(1, agent)

    def until_reached(self, *, is_reached):
        self.field.until(
            lambda: self.decisions and self.decisions[-1].reached is is_reached,
            f'a decision that says {is_reached}',
        )

    def until_obstacle(self, obstacle):
        self.field.until(lambda: self.told and self.told[-1].obstacle == obstacle, str(obstacle))

    def until_done(self, action):
        def is_on_disk():
            known = {each.content for each in self.on_disk}
            return any(
                each.action == action and content_hash(each) in known for each in self.actions
            )

        self.field.until(is_on_disk, f'{action} on disk')

    def lose(self, agent):
        key, cells = read_path(GRID, agent, self.paths[agent][-1])
        lost = report_message(key, Observation(cells, False), key.stamp + 1)
        self.reports[agent].publish(lost)

    def restart_planner(self):
        self.told.clear()
        awaited = {'await_nodes': ['recorder', 'estimator']}
        self.field.start('planner', {**self.parameters, **awaited, 'resume': str(self.log)})


def test_robots_leave_only_after_a_person_resumes(field):
    base = Lane(field)
    held = field.listen(Bool, '/hold')
    base.come_back('scout_1')
    base.until_reached(is_reached=True)
    base.until_done(Action.REACHED)
    base.lose('scout_2')
    base.until_reached(is_reached=False)
    base.until_obstacle(MissionStatus.GOAL_LOST)
    assert base.told[-1].state == MissionStatus.PAUSED
    assert base.told[-1].ends_by == MissionStatus.OPERATOR
    base.until_state('since the goal was reached and no longer holds: call /pause with false')
    field.until(lambda: held and held[-1].data, 'hold')
    # Killed after it was said.
    base.told.clear()
    base.crash()
    base.until_obstacle(MissionStatus.GOAL_LOST)
    assert [len(base.sent(agent)) for agent in AGENTS] == [1, 1]
    assert base.do('pause', data=False) == 'the operator ended the pause'
    for agent in AGENTS:
        base.until_sent(2, agent)
    assert base.do('end_mission').startswith('the operator ended the mission')
    for agent in AGENTS:
        base.come_back(agent)
    base.until_obstacle(MissionStatus.ALL_DEPLOYED)
    report = base.replayed()
    assert [each.action for each in report.evidence.actions] == [
        Action.REACHED, Action.GOAL_LOST, Action.RESUME, Action.END,
    ]  # fmt: skip


def test_a_planner_that_was_away_says_that_the_goal_no_longer_holds(field):
    base = Lane(field)
    base.come_back('scout_1')
    base.until_done(Action.REACHED)
    field.kill('/planner')
    base.lose('scout_2')
    base.until_reached(is_reached=False)
    base.restart_planner()
    base.until_obstacle(MissionStatus.GOAL_LOST)
    assert [len(base.sent(agent)) for agent in AGENTS] == [1, 1]
    # Whoever asks for another confidence asks for another goal, but nobody has resumed.
    assert field.set_parameter('/planner', 'stop.confidence', 0.99).successful
    base.until_done(Action.SET)
    base.until_obstacle(MissionStatus.GOAL_LOST)
    report = base.replayed()
    planner = recorded_planner(MissionLog(base.log))
    assert report.standing.state is state_by_evidence(report, planner)
    assert report.standing.state == MissionStatus.PAUSED


def test_another_confidence_sends_robots_again_without_a_resumption(field):
    base = Lane(field)
    base.come_back('scout_1')
    base.until_done(Action.REACHED)
    assert field.set_parameter('/planner', 'stop.confidence', 0.999).successful
    base.until_sent(2, 'scout_1')
    assert Action.GOAL_LOST not in [each.action for each in base.actions]
