# SPDX-License-Identifier: Apache-2.0
"""Cells that are closed to robots during a mission, by real services and across crashes."""

from base import Base, GRID
from kbnitp_msgs.msg import Decision, MissionStatus
from kbnitp_ros.cli.parameters import asked_on_record
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.operator_actions import Action
from kbnitp_ros.messages.progress import read_decision
from nav_msgs.srv import GetPlan
import pytest

# The shortest lane to cell 4 leads along the row of the base.
LANE = {'goal.kind': 'lane', 'goal.cells': [4], 'stop.confidence': 0.999, 'max_steps': 16}


class Closing(Base):
    """A base whose operator closes cells."""

    def __init__(self, field, **parameters):
        self.decisions = field.listen(Decision, '/decision')
        self.told = field.listen(MissionStatus, '/mission')
        super().__init__(field, **{'robots': 9, **parameters})

    def until_closed(self, *cells):
        self.field.until(
            lambda: self.told and [*self.told[-1].no_go] == [*cells], f'{cells} on mission'
        )

    def until_decided(self, deployments, *cells):
        def is_decided():
            if not self.decisions:
                return False
            last = self.decisions[-1]
            return (last.deployments, [*last.no_go]) == (deployments, [*cells])

        self.field.until(is_decided, f'decision on {deployments} without {cells}')
        return {*read_decision(GRID, self.decisions[-1]).path.tolist()}

    def safest_path(self, to):
        client = self.field.node.create_client(GetPlan, '/safest_path')
        self.field.until(client.service_is_ready, 'service')
        request = GetPlan.Request()
        for at, cell in ((request.start, 0), (request.goal, to)):
            at.header.frame_id = 'map'
            at.pose.position.x, at.pose.position.y = GRID.centers([cell])[0].tolist()
        future = client.call_async(request)
        self.field.until(future.done, 'answer')
        places = [(p.pose.position.x, p.pose.position.y) for p in future.result().plan.poses]
        return {*GRID.cells_at(places).tolist()} if places else set()


def test_no_plan_lane_or_way_leads_through_closed_cells(field):
    base = Closing(field, **LANE)
    base.until_sent(1)
    assert 2 in base.until_decided(0)
    assert 2 in base.safest_path(4)
    previewed = base.call('no_go', cells=[2], preview=True)
    crosses = 2 in base.sent()[0]
    assert previewed.success
    assert previewed.message.startswith('possible')
    assert [*previewed.agents] == ['scout_1'] * crosses
    assert base.actions == []
    told = base.call('no_go', cells=[2, 7], reason='wreck', author='Ann')
    assert told.success
    assert told.message.startswith("the operator closed cells 2, 7 ('wreck', 'Ann')")
    assert ('scout_1 at' in told.message) == bool(told.agents) == bool({2, 7} & {*base.sent()[0]})
    base.until_closed(2, 7)
    assert not {2, 7} & base.until_decided(0, 2, 7)
    assert not {2, 7} & base.safest_path(4)
    base.come_back()
    base.until_sent(2)
    assert not {2, 7} & {*base.sent()[1]}
    # Killed after they were closed: planner and estimator have them.
    base.told.clear()
    base.decisions.clear()
    base.crash()
    base.until_closed(2, 7)
    assert not {2, 7} & base.until_decided(1, 2, 7)
    assert all({*each.no_go} <= {2, 7} for each in base.decisions)
    assert not {2, 7} & base.safest_path(4)
    base.come_back()
    base.until_sent(3)
    assert not {2, 7} & {*base.sent()[2]}
    for request, why in (
        ({'cells': [25]}, 'cells has 25, off the map: allowed are 0 to 24'),
        ({'cells': [0]}, 'cells has 0, a base'),
        ({'cells': [2]}, 'all cells are in a no-go area already'),
        ({'cells': [4]}, 'goal is cell 4, an obstacle'),
        ({'cells': [3], 'lift': True}, 'cells has 3, which is in no no-go area'),
        ({'cells': [3], 'reason': 'x' * 201}, 'reason has 201 characters, at most 200 fit'),
    ):
        assert base.refused('no_go', **request).startswith(why)
        assert base.refused('no_go', preview=True, **request).startswith(why)
    assert base.do('no_go', cells=[2], lift=True) == 'the operator opened cells 2'
    base.until_closed(7)
    assert 2 in base.until_decided(2, 7)
    report = base.replayed()
    assert [each.action for each in report.evidence.actions] == [Action.NO_GO, Action.LIFT]
    asked = replay(base.log, asked=asked_on_record(MissionLog(base.log)))
    assert asked.reproduced
    assert asked.compared['/decision'] >= 3


def test_a_proposal_through_closed_cells_is_withdrawn(field):
    base = Closing(field, approval=True)
    before = base.proposed()
    through = next(cell for cell in before if cell != 0)
    base.do('no_go', cells=[through])
    base.field.until(lambda: through not in base.proposed(), 'another proposal')
    base.do('approve', data=True)
    base.until_sent(1)
    assert through not in base.sent()[0]
    assert len(base.replayed().evidence.actions) == 2


@pytest.mark.full
def test_cells_that_are_closed_without_a_recorder_count_at_once(field):
    base = Closing(field, recorded=False)
    base.until_sent(1)
    base.do('no_go', cells=[1])
    base.until_closed(1)
    base.come_back()
    base.until_sent(2)
    assert 1 not in base.sent()[1]
