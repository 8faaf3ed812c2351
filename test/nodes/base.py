# SPDX-License-Identifier: Apache-2.0
"""The nodes of a base; the test plays its agents and its operator."""

from math import inf
import time

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, OperatorAction, Recorded
from kbnitp_msgs.srv import GiveUp, NoGo, TakeBack
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.configuration.starts import awaited_nodes
from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
from std_srvs.srv import SetBool, Trigger

GRID = Grid(5, 5)
PARAMETERS = {
    'grid.width': 5,
    'grid.height': 5,
    'max_steps': 8,
    'prior.hazard': 0.1,
    'robots': 4,
    'recorded': True,
    # Agents played by the test do not state departures.
    'presume_departure': True,
}
NODES = ('recorder', 'estimator', 'planner')

# Seconds after which an unanswered call without an action is repeated: DDS may take a killed
# planner for alive for another 20.
HEARD = 5.0

SERVICES = {
    'pause': SetBool,
    'approve': SetBool,
    'give_up': GiveUp,
    'no_go': NoGo,
    'take_back': TakeBack,
    'end_mission': Trigger,
}


class Base:
    """Planner, estimator and recorder; the test plays agents and operator."""

    def __init__(self, field, agents=('scout_1',), **parameters):
        self.field = field
        # In a folder that the recorder makes.
        self.log = field.folder / 'log' / 'mission.mcap'
        self.parameters = {**PARAMETERS, 'agents': list(agents), **parameters}
        self.paths = {agent: field.listen(Path, f'/{agent}/path') for agent in agents}
        self.proposals = {each: field.listen(Path, f'/{each}/proposal') for each in agents}
        self.heard = {each: field.listen(DeploymentReport, f'/{each}/report') for each in agents}
        self.acknowledged = {each: field.listen(Recorded, f'/{each}/recorded') for each in agents}
        # Without the starts of planners.
        self.actions = []
        field.node.create_subscription(OperatorAction, '/operator', self.hear, qos.EVIDENCE)
        self.beliefs = field.listen(BeliefMaps, '/belief')
        self.reports = {
            each: field.node.create_publisher(DeploymentReport, f'/{each}/report', qos.EVIDENCE)
            for each in agents
        }
        # Nodes known to a planner that starts: a new one would find the killed ones.
        self.clients = {
            name: field.node.create_client(kind, f'/{name}') for name, kind in SERVICES.items()
        }
        self.lost_calls = []
        self.start(file=str(self.log))

    def hear(self, action):
        if action.action != OperatorAction.START:
            self.actions.append(action)

    def start(self, **own):
        for node in NODES:
            awaited = {'await_nodes': awaited_nodes(node, is_recorded=True)}
            self.field.start(node, {**self.parameters, **awaited, **own})

    def crash(self):
        """Kill all nodes at once, and restart them from the disk."""
        for node in NODES:
            self.field.processes.started[f'/{node}'].kill()
        for node in NODES:
            self.field.kill(f'/{node}')
        # DDS lists the old service for some time: calls to it go nowhere.
        client = self.clients['end_mission']
        assert client.service_is_ready()
        self.lost_calls.append(client.call_async(Trigger.Request()))
        # The old subscriptions may hold unread proposals of the killed planner.
        self.proposals = {
            each: self.field.listen(Path, f'/{each}/proposal') for each in self.proposals
        }
        self.start(resume=str(self.log))

    def call(self, service, **request):
        client = self.clients[service]
        self.field.until(client.service_is_ready, f'service {service}')
        decided, calls, called_at = self.decided(), [], -inf

        def is_answered():
            nonlocal called_at
            if time.monotonic() > called_at + HEARD and self.decided() == decided:
                called_at = time.monotonic()
                calls.append(client.call_async(SERVICES[service].Request(**request)))
            return any(call.done() for call in calls)

        self.field.until(is_answered, f'answer of {service}')
        return next(call.result() for call in calls if call.done())

    def decided(self):
        return {(action.header.stamp.sec, action.header.stamp.nanosec) for action in self.actions}

    def do(self, service, **request):
        answer = self.call(service, **request)
        assert answer.success, answer.message
        return answer.message

    def refused(self, service, **request):
        answer = self.call(service, **request)
        assert not answer.success
        return answer.message

    def proposed(self, agent='scout_1'):
        shown = self.proposals[agent]
        self.field.until(lambda: shown and shown[-1].poses, f'proposal for {agent}')
        return read_path(GRID, agent, shown[-1])[1].tolist()

    def sent(self, agent='scout_1'):
        """Return the paths of an agent's robots that have departed."""
        ways = dict(read_path(GRID, agent, path) for path in self.paths[agent])
        return [ways[key].tolist() for key in sorted(ways)]

    def recorded(self, number, agent='scout_1'):
        """Return whether `count` paths of an agent are confirmed to be on disk."""
        return len({each.content for each in self.acknowledged[agent]}) >= number

    def until_sent(self, number, agent='scout_1'):
        self.field.until(lambda: len(self.sent(agent)) == number, f'path {number}')

    def until_state(self, words):
        self.field.until(lambda: words in self.field.state('/planner'), words)

    def until_held(self, number):
        self.field.until(
            lambda: self.beliefs and self.beliefs[-1].deployments == number, f'belief in {number}'
        )

    def come_back(self, agent='scout_1'):
        # A planner that was restarted publishes all paths again, the newest one last.
        sent = dict(read_path(GRID, agent, path) for path in self.paths[agent])
        key, cells = max(sent), sent[max(sent)]
        home = Observation(cells, True, [False] * (len(cells) - 1))
        self.reports[agent].publish(report_message(key, home, key.stamp + 1))

    def replayed(self, *, has_refused=False):
        """End all nodes and return the replay of the log, which must be bit-exact."""
        newest = {f'/{agent}/report': reports for agent, reports in self.heard.items()}
        self.field.until_recorded(self.log, {'/belief': self.beliefs, **newest})
        for name, code in self.field.processes.stop(60).items():
            assert code == 0, self.field.said(name)
        report = replay(self.log)
        assert report.reproduced, '\n'.join(lines(report))
        assert bool(report.evidence.refused) == has_refused
        return report
