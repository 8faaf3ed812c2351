# SPDX-License-Identifier: Apache-2.0
"""A day in the field: from preflight to the end, with all that a person has to say on the way."""

import signal

from fleet import FIELD, Fleet, GRID
from kbnitp_msgs.msg import (
    AgentState,
    Annotation,
    BeliefMaps,
    Decision,
    Finding,
    MissionStatus,
    Standings,
)
from kbnitp_msgs.srv import AddFinding, Annotate, GiveUp, NoGo
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.configuration.starts import awaited_nodes
from kbnitp_ros.core import Verdict
from kbnitp_ros.log.record import read_ledger
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_path
from kbnitp_ros.messages.headers import to_stamp
from kbnitp_ros.messages.progress import read_decision
from kbnitp_ros.messages.standings import read_standings
from nav_msgs.msg import Path as PathMessage
import pytest
from sensor_msgs.msg import BatteryState
from std_srvs.srv import SetBool, Trigger
from test_preflight_command import preflight

MISSION = '/mission'
NODES = ('recorder', 'estimator', 'planner')
AGENTS = ('scout_1', 'scout_2', 'scout_3')

# Where each robot stands, in the cell of their base.
PARKING = dict(zip(AGENTS, [(0.2, 0.2), (0.8, 0.2), (0.5, 0.8)]))

SERVICES = {
    'add_finding': AddFinding,
    'annotate': Annotate,
    'approve': SetBool,
    'end_mission': Trigger,
    'give_up': GiveUp,
    'no_go': NoGo,
}


class Day:
    """A base, three robots that park in one cell, and a person beside them."""

    def __init__(self, field):
        self.field = field
        self.log = field.folder / 'log' / 'mission.mcap'
        self.fleet = Fleet(field, AGENTS, mission=MISSION, speed=3.0)
        hear = field.listen
        self.paths = {each: hear(PathMessage, f'{MISSION}/{each}/path') for each in AGENTS}
        self.proposals = {each: hear(PathMessage, f'{MISSION}/{each}/proposal') for each in AGENTS}
        self.states = {each: hear(AgentState, f'{MISSION}/{each}/state') for each in AGENTS}
        self.beliefs = hear(BeliefMaps, f'{MISSION}/belief')
        self.decisions = hear(Decision, f'{MISSION}/decision')
        self.told = hear(MissionStatus, f'{MISSION}/mission')
        self.standings = hear(Standings, f'{MISSION}/standings')
        self.clients = {
            name: field.node.create_client(kind, f'{MISSION}/{name}')
            for name, kind in SERVICES.items()
        }
        self.charge = dict.fromkeys(AGENTS, 0.9)
        self._batteries = {
            each: field.node.create_publisher(BatteryState, f'/{each}/battery', 5)
            for each in AGENTS
        }
        field.node.create_timer(0.2, self._charge)

    def _charge(self):
        for agent, battery in self._batteries.items():
            battery.publish(BatteryState(percentage=self.charge[agent]))

    def start_base(self):
        for name in NODES:
            self.start_node(name, file=str(self.log))

    def start_node(self, name, **own):
        """Start a node of the base."""
        parameters = {
            **FIELD, 'agents': list(AGENTS), 'robots': 20, 'recorded': True, 'approval': True,
            'goal.kind': 'lane', 'goal.cells': [87], 'stop.confidence': 0.0,
            'separation': 0.4, 'rolling': True, 'min_battery': 0.3, 'max_steps': 20,
            'silent_loss': True, 'return_deadline': 1000.0, 'step_period': 1.0,
            'prior.hazard': 0.1, 'sensor.malfunction': 0.01, 'learn.numbers': ['lethality'],
            'await_nodes': awaited_nodes(name, is_recorded=True), **own,
        }  # fmt: skip
        self.field.start(name, parameters, MISSION)

    def start_robot(self, agent, **own):
        self.fleet.start(
            agent,
            arrival_tolerance=0.2,
            await_nodes=list(NODES),
            battery_topic=f'/{agent}/battery',
            **{f'team.{agent}.parking': list(PARKING[agent])},
            **own,
        )

    def call(self, service, **request):
        client = self.clients[service]
        self.field.until(client.service_is_ready, f'service {service}')
        answer = client.call_async(SERVICES[service].Request(**request))
        self.field.until(answer.done, f'answer of {service}')
        return answer.result()

    def ask(self, service, **request):
        answer = self.call(service, **request)
        assert answer.success, answer.message
        return answer

    def say(self, service, **request):
        """Say something after its preview, again if evidence came between."""
        while True:
            effect = self.ask(service, preview=True, **request).effect
            answer = self.call(service, epoch=effect.epoch, events=effect.events, **request)
            if answer.success:
                return answer
            assert 'ask for the preview again' in answer.message

    def annotate(self, key, kind, **values):
        said = Annotation(agent=key.agent, deployment=to_stamp(key.stamp), kind=kind, **values)
        return self.say('annotate', annotation=said)

    def sent(self, agent):
        """Return the keys and paths of an agent's robots, in order."""
        return sorted(dict(read_path(GRID, agent, path) for path in self.paths[agent]).items())

    def unsent(self, agents):
        """Return a function of the agents among these without another path so far."""
        before = {agent: len(self.sent(agent)) for agent in agents}
        return lambda: {each for each in agents if len(self.sent(each)) == before[each]}

    def send(self, *agents):
        """Approve what is proposed until a robot of each agent is out; return keys and paths."""
        left, shown = self.unsent(agents), self.proposals

        def proposed():
            return [each for each in left() if shown[each] and shown[each][-1].poses]

        def is_decided():
            return agent not in left() or shown[agent][-1] is not decided

        while left():
            self.field.until(lambda: proposed() or not left(), f'proposal for {left()}')
            for agent in proposed()[:1]:
                decided = shown[agent][-1]
                # A newer belief may replace what is proposed, also once it is approved, and then
                # perhaps by a path of another agent.
                if self.call('approve', data=True).success:
                    self.field.until(is_decided, f'robot of {agent}')
        return [self.sent(agent)[-1] for agent in agents]

    def until_away(self, agent):
        """Wait until a robot that gets stuck has left the cell of its base, and says so."""

        def is_away():
            said = self.states[agent]
            is_out = said and said[-1].state == AgentState.OUT
            return is_out and self.fleet.is_away(agent)

        self.field.until(is_away, f'{agent} out')

    def lose(self, agent):
        """Let a robot be heard of no more, and give it up."""
        self.field.kill(f'{MISSION}/{agent}/robot')
        # The planner may not know so far that it has left.
        self.field.until(lambda: self.call('give_up', agent=agent).success, f'loss of {agent}')

    def replace(self, agent):
        """Put another robot in the place of a lost one."""
        self.fleet.journal(agent).unlink()
        self.fleet.end_simulator()
        self.fleet.simulate(**{agent: PARKING[agent]})
        self.start_robot(agent)

    def verdicts(self):
        told = {}
        for message in self.standings:
            told |= {key: each.verdict for key, each in read_standings(message).standings.items()}
        return told

    def until_judged(self, key, verdict=Verdict.RETURN):
        self.field.until(lambda: self.verdicts().get(key) is verdict, f'{verdict} of {key}', 120)

    def until_told(self, words, node='planner'):
        self.field.until(lambda: words in self.field.said(f'{MISSION}/{node}'), words)

    def red(self):
        """Return the names of the red checks, sorted."""
        code, told = preflight(self.field, 6.0, '--namespace', MISSION)
        found = [line.split(':')[0] for line in told.splitlines() if line.startswith('RED')]
        assert code == bool(found), told
        return sorted(each.split(maxsplit=1)[1] for each in found)


@pytest.mark.full
def test_a_day_in_the_field(field):
    day = Day(field)
    day.start_base()
    see_that_preflight_becomes_green(day)
    # A robot whose battery is flat stops in the field, and another one takes its place.
    day.fleet.inject('stuck!', 'scout_1')
    (first, _), *_ = day.send(*AGENTS)
    day.until_away('scout_1')
    day.lose('scout_1')
    day.until_judged(first, Verdict.LOSS)
    day.annotate(first, Annotation.NO_HAZARD, steps=[1], author='Ann', note='battery flat')
    day.charge['scout_1'] = 0.18
    day.replace('scout_1')
    for agent in AGENTS[1:]:
        day.until_judged(day.sent(agent)[-1][0])
    day.until_told('scout_1 waits: battery 18 % of 30 % (parameter min_battery)')
    # A lane was walked. One of two robots is lost to a hazard: its wreck is found and closed off.
    lane = read_decision(GRID, day.decisions[-1]).path
    walked = Finding(cells=lane[1:].tolist(), walked=0.9, author='Ann')
    foreseen = day.say('add_finding', finding=walked).effect
    assert foreseen.p_free[1] > foreseen.p_free[0]
    day.fleet.inject('stuck!', 'scout_2')
    (wrecked, path), (other, _) = day.send('scout_2', 'scout_3')
    day.until_away('scout_2')
    day.lose('scout_2')
    day.until_judged(wrecked, Verdict.LOSS)
    wreck = int(path[4])
    found = {'cell': wreck, 'cause': Annotation.HAZARD, 'author': 'Ann'}
    foreseen = day.annotate(wrecked, Annotation.LOCATED, **found).effect
    assert foreseen.hazards[1] != foreseen.hazards[0]
    day.until_judged(other)
    answer = day.ask('no_go', cells=[wreck], reason='wreck', author='Ann', preview=True)
    assert not answer.agents
    day.ask('no_go', cells=[wreck], reason='wreck', author='Ann')
    field.until(lambda: [*day.told[-1].no_go] == [wreck], 'no-go area')
    # A hazard is dug out at noon while two are out, and it is told when they are back.
    day.charge['scout_1'] = 0.9
    sent = day.send('scout_1', 'scout_3')
    noon = field.now()
    for key, path in sent:
        assert wreck not in path
        day.until_judged(key)
    dug = int(sent[0][1][len(sent[0][1]) // 2])
    cleared = Finding(cells=[dug], hazard=Finding.ABSENT, changed=True, since=to_stamp(noon))
    cleared.author = 'Ben'
    day.say('add_finding', finding=cleared)
    # The wrong robot leaves while the others are charged: its deployment counts for nothing.
    day.charge.update(scout_1=0.18, scout_3=0.18)
    day.replace('scout_2')
    field.until(lambda: {*day.told[-1].waiting} >= {'scout_1', 'scout_3'}, 'flat batteries')
    ((wrong, _),) = day.send('scout_2')
    day.until_judged(wrong)
    day.annotate(wrong, Annotation.WITHDRAW, author='Ann', note='wrong payload')
    day.until_judged(wrong, Verdict.WITHDRAWN)
    day.ask('end_mission')
    over = 'done: 8 of 20 robots deployed, ended by the operator'
    field.until(lambda: field.state(f'{MISSION}/planner') == over, over)
    see_that_the_log_says_all(day, first, wrecked, wrong, dug)


def see_that_preflight_becomes_green(day):
    """Six faults, mended one by one, and nothing else is red."""
    day.charge['scout_1'] = 0.18
    day.fleet.simulate(**{**PARKING, 'scout_1': (3.5, 0.5)})
    day.start_robot('scout_1')
    day.start_robot('scout_3', **{'grid.width': 11})
    day.fleet.inject('die', 'scout_2')
    day.fleet.inject('blind', 'scout_3')
    field, fleet = day.field, day.fleet
    field.until(lambda: day.beliefs, 'prior')
    # A robot without a pose does not know whether it is at its base.
    blind = ['scout_3 at its base', 'scout_3 pose']
    red = {'scout_1 at its base', 'scout_1 battery', 'scout_2 heard', 'scout_3 field', *blind}

    def see(*mended, more=()):
        red.difference_update(mended)
        red.update(more)
        field.until(lambda: day.red() == sorted(red), f'{sorted(red)} alone')

    see()
    # Robots of another simulator are whole.
    fleet.end_simulator(signal.SIGTERM)
    fleet.simulate(scout_1=PARKING['scout_1'])
    fleet.inject('die', 'scout_2')
    fleet.inject('blind', 'scout_3')
    see('scout_1 at its base')
    day.charge['scout_1'] = 0.9
    see('scout_1 battery')
    day.start_robot('scout_2')
    see('scout_2 heard', more=['scout_2 action server'])
    field.kill(f'{MISSION}/scout_3/robot')
    day.start_robot('scout_3')
    see('scout_3 field')
    fleet.inject('live', 'scout_2')
    see('scout_2 action server')
    assert not any(day.paths.values())
    fleet.inject('live', 'scout_3')
    see(*blind)


def see_that_the_log_says_all(day, first, wrecked, wrong, dug):
    day.field.processes.stop()
    told = replay(day.log)
    assert told.reproduced
    (field,) = {*told.evidence.refused}
    assert field == f'{MISSION}/scout_3/state: parameter grid.width is 11 there and 12 here'
    verdicts = [told.evidence.standings[key].verdict for key in sorted(told.evidence.standings)]
    assert len(verdicts) == 8
    assert verdicts.count(Verdict.LOSS) == 2
    assert verdicts.count(Verdict.WITHDRAWN) == 1
    ledger = read_ledger(MissionLog(day.log))
    last = read_belief_maps(day.beliefs[-1]).belief
    assert ledger.belief.joint.tobytes() == last.joint.tobytes()
    said = [line.split(', at')[0] for line in lines(told) if ' said of ' in line]
    assert len(said) == 5
    # What is known of the cell that was dug out and of the first robot is as it was said.
    assert ledger.belief.hazard[dug] < 0.02
    assert {key for key, _ in ledger.annotations.values()} == {first, wrecked, wrong}
