# SPDX-License-Identifier: Apache-2.0
"""No fault loses or duplicates a deployment, and no forged message corrupts a belief."""

from collections import Counter
from functools import partial

from campaign import run_forged_missions, run_mission, run_missions
from extent import some
from fickle_robot import CRASHED
from forger import FORGERIES, run_forged
import gated
from kbnitp_msgs.msg import AgentState, DeploymentReport
from kbnitp_ros.configuration import make_grid
from kbnitp_ros.core import Observation
from kbnitp_ros.core.planning.planners import PLANNERS
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import report_message
from kbnitp_ros.messages.states import Readiness, state_message
from kbnitp_ros.nodes.runtime import qos
from mission import NAMESPACE
import numpy as np
from onlooker import AGENT
import pytest
from unbroken import folded, NODES, STRUCK, with_defaults


def check(outcomes):
    """Check that missions ended as undisturbed ones, and that every fault was injected."""
    assert not [str(outcome) for outcome in outcomes if outcome.findings]
    faults = sum((outcome.faults for outcome in outcomes), start=Counter())
    assert faults.keys() == {*STRUCK, 'held'}
    struck = {node for outcome in outcomes for _, node in outcome.strikes}
    assert struck == set(NODES)


# Seeds of missions with faults of every kind: of one agent, and of three until it is ended.
@pytest.mark.processes
@pytest.mark.parametrize('seed', some([9, 321], 2))
def test_missions_under_faults_end_as_if_unbroken(tmp_path, processes, seed):
    check([run_mission((seed, 'mixed', tmp_path), processes)])


@pytest.mark.processes
@pytest.mark.full
def test_many_missions_under_faults_end_as_if_unbroken(tmp_path):
    jobs = [(seed, 'mixed', tmp_path) for seed in range(100, 106)]
    jobs += [(1, kind, tmp_path) for kind in STRUCK]
    outcomes = run_missions(jobs)
    assert len(outcomes) == len(jobs)
    check(outcomes)


@pytest.mark.processes
@pytest.mark.full
def test_robots_that_stay_are_not_lost_and_departed_ones_not_forgotten(tmp_path):
    jobs = [(seed, 'mixed', tmp_path) for seed in (1, 2)]
    outcomes = run_missions(jobs, run=partial(run_mission, has_robots=True))
    assert not [str(outcome) for outcome in outcomes if outcome.findings]
    assert any(outcome.crashes[CRASHED] for outcome in outcomes)


# Forgeries of the campaign but its flood, which takes 20 s.
SCALE = 0.1
FORGED = sorted(FORGERIES, key='random'.__ne__)


@pytest.mark.processes
@pytest.mark.parametrize('kind', some(FORGED, len(FORGED)))
def test_forged_messages_are_refused_and_change_nothing(tmp_path, processes, kind):
    outcome = run_forged(tmp_path, [kind], SCALE, processes=processes)
    assert not outcome.findings, outcome


@pytest.mark.processes
@pytest.mark.full
def test_all_forgeries_together_change_nothing(tmp_path):
    assert run_forged_missions(missions=1, seed=1, scale=SCALE, folder=tmp_path) == 0


@pytest.mark.processes
@pytest.mark.full
@pytest.mark.campaign
def test_a_mission_goes_on_among_ten_thousand_topics(tmp_path):
    outcome = run_forged(tmp_path, ['topics'], 10.0)
    assert not outcome.findings, outcome


GATED = {
    'grid.width': 5, 'grid.height': 5, 'max_steps': 8, 'robots': 4, 'planner': 'gated:search',
    'seed': 13,
}  # fmt: skip


def test_a_path_that_only_the_agent_has_is_not_accepted(set_out, gate, monkeypatch):
    mission = set_out(GATED)
    mission.start(*NODES)
    topic = f'{NAMESPACE}/{AGENT}/path'

    def readers():
        return {each.node_name for each in mission.node.get_subscriptions_info_by_topic(topic)}

    mission.until(
        lambda: mission.onlooker.held == 0 and readers() >= {'agent', 'recorder'}, 'prior'
    )
    # The search ends when the recorder can no longer receive its path.
    mission.halt('recorder')
    gate.touch()
    mission.until(lambda: mission.onlooker.evidence.paths, 'path')
    for name in ('recorder', 'estimator', 'planner'):
        mission.kill(name)
    # The prior of another estimator has another stamp, and so has this planner's first path.
    mission.start('estimator', 'planner', 'recorder')
    mission.until_over()
    assert mission.unused == 1
    # The mission in the core searches as the planner does.
    monkeypatch.setitem(PLANNERS._entries, 'gated:search', gated.search)
    assert not mission.findings()


PARAMETERS = {
    'grid.width': 5, 'grid.height': 5, 'max_steps': 10, 'robots': 8, 'planner': 'relaxed',
}  # fmt: skip


class Agent:
    """An agent whose robots have the fates given by the test."""

    def __init__(self, mission, parameters):
        self._mission = mission
        self._parameters = parameters
        self._rng = np.random.default_rng(1)
        self._publisher = mission.node.create_publisher(
            DeploymentReport, f'{NAMESPACE}/{AGENT}/report', qos.EVIDENCE
        )
        self._states = mission.node.create_publisher(
            AgentState, f'{NAMESPACE}/{AGENT}/state', qos.LATCHED
        )
        grid = make_grid(with_defaults(parameters))
        self._states.publish(state_message(grid, AGENT, Readiness.READY, '', True, 1))

    def report(self, number, survived):
        mission, evidence = self._mission, self._mission.onlooker.evidence
        mission.until(lambda: len(evidence.paths) > number, f'path {number}')
        key, (positions,) = sorted(evidence.paths.items())[number]
        cells = make_grid(with_defaults(self._parameters)).cells_at(positions)
        readings = self._rng.random(len(cells) - 1) < 0.3 if survived else None
        now = mission.node.get_clock().now().nanoseconds
        self._publisher.publish(report_message(key, Observation(cells, survived, readings), now))
        mission.until(
            lambda: survived in {report.survived for report in evidence.reports.get(key, ())},
            f'report {number}',
        )
        self.until_believed()

    def until_believed(self):
        onlooker = self._mission.onlooker
        expected = folded(self._parameters, onlooker.evidence).joint.tobytes()
        self._mission.until(
            lambda: onlooker.belief and np.asarray(onlooker.belief.joint).tobytes() == expected,
            'belief of all reports',
        )


@pytest.mark.parametrize('method', some(['kappa_bnitp', 'kappa_bnitp_published'], 2))
def test_a_late_return_beats_the_loss_that_was_assumed(set_out, method):
    parameters = PARAMETERS | {'method': method}
    mission = set_out(parameters, awaited={'planner': ['estimator', 'recorder', 'onlooker']})
    agent = Agent(mission, parameters)
    mission.start('recorder', 'estimator', 'planner')
    for number in range(5):
        agent.report(number, survived=number in (0, 3))
    agent.report(1, survived=True)
    assert mission.onlooker.held == 5
    # A restarted agent that missed the return reports the loss again.
    agent.report(1, survived=False)
    for number in range(5, 8):
        agent.report(number, survived=number == 6)
    agent.report(7, survived=True)

    mission.restart('estimator')
    agent.until_believed()
    mission.restart('planner')
    mission.restart('recorder')
    mission.until_over()
    assert set(mission.processes.stop().values()) == {0}
    assert mission.logged() == mission.onlooker.evidence
    assert replay(mission.log).reproduced
