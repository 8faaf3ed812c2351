# SPDX-License-Identifier: Apache-2.0
"""A mission whose nodes are killed, stopped and restarted, and what must hold at its end."""

from collections import Counter
from contextlib import ExitStack
from math import inf
from pathlib import Path
import signal
import time

from kbnitp_ros.cli.processes import Processes
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.configuration.starts import awaited_nodes
from kbnitp_ros.log.read import LogError
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.deployments import OrderState, read_status
import numpy as np
from onlooker import Evidence, Onlooker
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger
from unbroken import core_mission, folded, NODES, true_values, with_defaults

# Timeout in seconds: nothing takes a fifth of it unless it is stuck.
PATIENCE = 180.0

# Seconds before an unanswered call is repeated: the planner may have been killed.
ANSWERED = 1.0

# The recorder runs without topics outside the mission.
NAMESPACE = '/mission'


class StuckError(Exception):
    """The mission is stuck, or a node ended without being killed."""


class Mission:
    """Four nodes and an onlooker on their own domain, set in the environment."""

    def __init__(
        self,
        domain,
        folder,
        parameters,
        *,
        awaited=None,
        remaps=None,
        namespace=NAMESPACE,
        processes=Processes,
    ):
        self._namespace = namespace
        folder = folder.joinpath(*namespace.split('/'))
        self.log = folder / 'log' / 'mission.mcap'
        self.log.parent.mkdir(parents=True)
        self._folder = folder
        self._parameters = parameters | {'recorded': True, 'file': str(self.log)}
        self._awaited = awaited or {}
        self._remaps = remaps or {}
        self._struck = set()
        self._clients = {}
        self._is_ended = False
        # Number of robots' exits, by exit code.
        self.ended = Counter()
        with ExitStack() as stack:
            context = rclpy.Context()
            rclpy.init(
                context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
            )
            stack.callback(context.try_shutdown)
            self.node = rclpy.create_node('onlooker', context=context)
            stack.callback(self.node.destroy_node)
            agents = with_defaults(parameters)['agents']
            self.onlooker = Onlooker(self.node, namespace.rstrip('/'), agents)
            self._executor = SingleThreadedExecutor(context=context)
            self._executor.add_node(self.node)
            self.processes = stack.enter_context(processes(domain))
            self._stack = stack.pop_all()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for name in self._struck:
            self._signal(name, signal.SIGCONT)
        self._stack.close()

    def start(self, *names):
        """Start nodes; they resume from the log if they can."""
        for name in names:
            self._struck.discard(name)
            self.onlooker.forget(full_name(name, self._namespace))
            parameters = self._parameters | {
                'await_nodes': self._awaited.get(name, awaited_nodes(name, is_recorded=True)),
                'resume': str(self.log) if self.log.exists() else '',
            }
            if name.startswith('agent'):
                parameters |= true_values(parameters)
            with (self._folder / f'{name}.txt').open('ab') as output:
                self.processes.start(
                    name,
                    parameters,
                    namespace=self._namespace,
                    remaps=self._remaps.get(name),
                    output=output,
                )

    def said(self, name):
        return (self._folder / f'{name}.txt').read_text()

    def memory(self):
        """Return the memory of each node in megabytes, by its full name."""
        memory = {}
        for name, process in self.processes.started.items():
            status = Path(f'/proc/{process.pid}/status').read_text()
            (resident,) = (line for line in status.splitlines() if line.startswith('VmRSS'))
            memory[name] = int(resident.split()[1]) / 1024
        return memory

    def _signal(self, name, number):
        self.processes.started[full_name(name, self._namespace)].send_signal(number)

    def halt(self, name):
        self._struck.add(name)
        self._signal(name, signal.SIGSTOP)

    def kill(self, name):
        self._struck.add(name)
        self._signal(name, signal.SIGKILL)
        self.processes.started[full_name(name, self._namespace)].wait()

    def forget_remaps(self):
        self._remaps = {}

    def restart(self, name):
        self.kill(name)
        self.start(name)

    def live(self, faults, *, is_ended=False):
        """Run the mission under these faults, perhaps until its operator ends it; return them."""
        self.start(*NODES)
        for fault in faults:
            self.suffer(fault)
        if is_ended:
            self.end()
        self.until_over()
        return faults

    def end(self):
        """End the mission as its operator while its agent is killed; wait for robots in flight."""
        self._ask('end_mission')
        self.restart('agent')
        self._have_done('end_mission')
        planner = full_name('planner', self._namespace)
        self.until(lambda: self.onlooker.states.get(planner, '').startswith('done'), 'end')
        self._is_ended = True
        self._parameters['robots'] = len(self.onlooker.evidence.reports)

    def _ask(self, service, **request):
        kind = {'pause': SetBool, 'end_mission': Trigger}[service]
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, f'{self._namespace}/{service}')
        if not self._clients[service].service_is_ready():
            return Future()
        return self._clients[service].call_async(kind.Request(**request))

    def _have_done(self, service, **request):
        """Call a service of the planner until it succeeds."""
        answer, asked_at = Future(), -inf

        def is_done():
            nonlocal answer, asked_at
            if answer.done():
                if answer.result().success or 'already' in answer.result().message:
                    return True
                answer = Future()
            if time.monotonic() > asked_at + ANSWERED:
                answer, asked_at = self._ask(service, **request), time.monotonic()
            return False

        self.until(is_done, f'answer of {service}')

    def suffer(self, fault):
        reports = self.onlooker.evidence.reports
        self.until(lambda: len(reports) >= fault.reports, f'report {fault.reports}')
        self.wait(fault.delay)
        if fault.is_held:
            self._ask('pause', data=True)
        self._struck.update(fault.pauses)
        for name in fault.pauses:
            self._signal(name, fault.signal)
        struck = time.monotonic()
        for name, pause in sorted(fault.pauses.items(), key=lambda item: item[1]):
            self.wait(struck + pause - time.monotonic())
            if fault.signal == signal.SIGSTOP:
                self._struck.discard(name)
                self._signal(name, signal.SIGCONT)
            else:
                self.restart(name)
        if fault.is_held:
            self._have_done('pause', data=False)

    def wait(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, 0.02))
            self._check_alive()

    def until(self, condition, what):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > deadline:
                heard = self.onlooker
                raise StuckError(
                    f'no {what} within {PATIENCE} s: {len(heard.evidence.paths)} paths, '
                    f'{len(heard.evidence.reports)} reports, {heard.held} in the belief, '
                    f'{heard.states}'
                )
            self._executor.spin_once(timeout_sec=0.02)
            self._check_alive()

    def _check_alive(self):
        for name in NODES:
            code = self.processes.ended().get(full_name(name, self._namespace))
            if code is not None and name not in self._struck:
                raise StuckError(f'{name} ended with {code}: {self.said(name)}')

    def until_over(self):
        """Wait until all robots are deployed and every node knows it, also restarted ones."""
        robots, states, heard = self._parameters['robots'], self.onlooker.states, self.onlooker
        self.until(lambda: heard.held == robots, 'belief in all deployments')
        self.until(lambda: len(heard.evidence.reports) >= robots, 'word of them all')
        self.until(lambda: states.keys() >= self.processes.started.keys(), 'word of every node')
        self.until(
            lambda: states[full_name('planner', self._namespace)].startswith('done'),
            'done planner',
        )
        if with_defaults(self._parameters)['silent_loss']:
            # Robots that were given up may be under way, and a restarted agent knows it.
            self.wait(1.0)
        # A restarted recorder catches up with messages sent meanwhile.
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline and missing(self.onlooker.evidence, self.logged()):
            self.wait(0.2)

    def logged(self):
        evidence = Evidence()
        for role, logged in MissionLog(self.log).read('path', 'report'):
            if role.name == 'report':
                evidence.take_report(logged.message)
            else:
                key, _ = logged.said
                evidence.take_path(key, logged.message)
        return evidence

    def departed(self):
        said = (
            read_status(logged.message, role.agent)
            for role, logged in MissionLog(self.log).read('status')
        )
        return {key for key, status in said if status.state is OrderState.DEPARTED}

    @property
    def unused(self):
        """Return the number of unused paths: a path that was not on disk is sent anew."""
        return len(self.onlooker.evidence.paths.keys() - self.onlooker.evidence.reports.keys())

    def findings(self):
        robots = self._parameters['robots']
        codes = self.processes.stop()
        found = [('exit', f'{name} ended with {code}') for name, code in codes.items() if code]
        found += [('exit', f'{n}: {self.said(n)}') for n in NODES if 'Traceback' in self.said(n)]
        try:
            logged = self.logged()
            replayed = replay(self.log)
        except LogError as error:
            return [*found, ('log', str(error))]
        heard = self.onlooker.evidence
        found += [('lost', f'{key} departed') for key in self.departed() - logged.reports.keys()]
        found += [('lost', f'{key} was reported: {why}') for key, why in missing(heard, logged)]
        found += [
            ('double', f'{len(said)} {what} are {where}: {robots} robots were sent')
            for what, where, said in (
                # At the end some may not have departed.
                ('paths', 'logged', logged.reports if self._is_ended else logged.paths),
                ('reports', 'logged', logged.reports),
                ('reports', 'heard', heard.reports),
            )
            if len(said) != robots
        ]
        # A silent robot that was given up may have returned.
        late = with_defaults(self._parameters)['silent_loss']
        found += contradictions('heard', heard, late) + contradictions('logged', logged, late)
        if not replayed.reproduced:
            found.append(('replay', '\n'.join(lines(replayed))))
        if logged.reports.keys() <= logged.paths.keys():
            given = folded(self._parameters, logged).joint.tobytes()
            if np.asarray(self.onlooker.belief.joint).tobytes() != given:
                found.append(('belief', 'the belief published last is not that of the log'))
            if self._is_ended:
                return found
            unbroken = core_mission(self._parameters)[-1].belief.joint.tobytes()
            # Plans depend on timing if the team is rolling (which robot returns first) or silent
            # (which robots are given up but return late).
            if given != unbroken and not (late or with_defaults(self._parameters)['rolling']):
                found.append(('belief', 'the belief given by the log is not that of core'))
        return found


def full_name(name, namespace=NAMESPACE):
    return f'{namespace.rstrip("/")}/{name}'


def missing(heard, logged):
    lacking = []
    for key, reports in heard.reports.items():
        if not heard.paths.get(key, set()) <= logged.paths.get(key, set()):
            lacking.append((key, 'its path is not in the log'))
        elif not reports <= logged.reports.get(key, set()):
            lacking.append((key, 'its report is not in the log'))
    return lacking


def contradictions(where, evidence, late):
    """Return deployments with contradicting reports; if `late`, only a loss before a return."""
    returns = {
        key: {report for report in versions if report.survived}
        for key, versions in evidence.reports.items()
    }
    return [
        ('double', f'{what} of {key} contradict each other as {where}: {versions}')
        for what, said in (
            ('paths', evidence.paths),
            ('reports', returns if late else evidence.reports),
        )
        for key, versions in said.items()
        if len(versions) > 1
    ]
