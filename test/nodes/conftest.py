# SPDX-License-Identifier: Apache-2.0
"""Real nodes in separate processes, and a node in the test that talks to them over DDS."""

from contextlib import ExitStack
from pathlib import Path
import subprocess
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from forked import COVERED, ForkedProcesses
from kbnitp_msgs.msg import AgentState, AgentStatus, Recorded
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from kbnitp_ros.configuration.starts import awaited_nodes
from kbnitp_ros.log.read import read_log
from kbnitp_ros.messages.headers import from_stamp, to_stamp
from kbnitp_ros.messages.states import Readiness, state_message
from kbnitp_ros.nodes.runtime import qos
import pytest
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock as ClockMessage
from samples import on_disk
from std_msgs.msg import Bool

PATIENCE = 60.0  # seconds; on a quiet machine nothing takes a tenth of it unless it is broken


class Field:
    """A ROS domain with nodes as processes, and the test's own node."""

    def __init__(self, processes, node, folder):
        self.processes = processes
        self.node = node
        self.folder = folder
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self._outputs = {}
        self._states = {}
        self._diagnosed = {}
        self._diagnosed_at = {}
        # Simulated time in nanoseconds, once `start_clock` was called.
        self._now = None
        node.create_subscription(
            DiagnosticArray, '/diagnostics', self._keep_diagnostics, qos.DIAGNOSTICS
        )

    def start(self, name, parameters=None, namespace='/', remaps=None):
        """Start a node with those of the parameters that it has; return its process."""
        full_name = f'{namespace.rstrip("/")}/{name}'
        self._outputs[full_name] = self.folder / f'{full_name.replace("/", ".")}.txt'
        with self._outputs[full_name].open('ab') as output:
            return self.processes.start(
                name, parameters, namespace=namespace, remaps=remaps, output=output
            )

    def start_mission(self, parameters, namespace='/', log=None):
        """Start the nodes of a mission, with a recorder if there is a log."""
        if log is not None:
            parameters = {**parameters, 'file': str(log)}
        is_recorded = bool({'file', 'resume'} & parameters.keys())
        for name in (*(['recorder'] if is_recorded else []), 'estimator', 'agent', 'planner'):
            awaited = {'await_nodes': awaited_nodes(name, is_recorded=is_recorded)}
            self.start(name, {**parameters, **awaited}, namespace)

    def keep_fewer(self, depth):
        """Limit the paths and reports that nodes started from now on keep for late joiners."""
        if not isinstance(self.processes, ForkedProcesses):
            pytest.skip('only forked nodes can keep fewer')
        self.processes.depth = depth

    def kill(self, full_name):
        process = self.processes.started.pop(full_name)
        process.kill()
        process.wait()
        self._diagnosed.pop(full_name, None)

    def set_aside(self, full_name):
        """Keep a node aside, so that another of its name can be started."""
        number = sum(name.startswith(f'{full_name} ') for name in self._outputs) + 1
        aside = f'{full_name} {number}'
        self.processes.started[aside] = self.processes.started.pop(full_name)
        self._outputs[aside] = self._outputs[full_name]

    def said(self, full_name):
        return self._outputs[full_name].read_text()

    def _keep_diagnostics(self, array):
        for status in array.status:
            self._diagnosed[status.name] = status
            self._diagnosed_at[status.name] = from_stamp(array.header.stamp)

    def diagnosed(self, full_name):
        return self._diagnosed.get(full_name, DiagnosticStatus())

    def diagnosed_at(self, full_name):
        """Return the ROS time of the newest diagnostics of a node, in nanoseconds."""
        return self._diagnosed_at.get(full_name)

    def state(self, full_name):
        """Return a node's state; an empty text before the first diagnostics."""
        return self.told(full_name, 'state')

    def told(self, full_name, key):
        """Return a value from the newest diagnostics of a node; an empty text if there is none."""
        values = {value.key: value.value for value in self.diagnosed(full_name).values}
        return values.get(key, '')

    def count(self, full_name, key):
        """Return a number from the newest diagnostics of a node; -1 before the first."""
        return int(self.told(full_name, key) or -1)

    def listen(self, kind, topic, *, volatile=False):
        """Subscribe, and return the list that receives the messages."""
        messages = []
        durability = DurabilityPolicy.VOLATILE if volatile else DurabilityPolicy.TRANSIENT_LOCAL
        profile = QoSProfile(depth=1000, durability=durability)
        self.node.create_subscription(kind, topic, messages.append, profile)
        return messages

    def talk(self, kind, topic, profile=qos.EVIDENCE):
        """Return a publisher, once it has a subscriber."""
        publisher = self.node.create_publisher(kind, topic, profile)
        self.until(lambda: publisher.get_subscription_count() > 0, f'reader of {topic}')
        return publisher

    def stand(self, agent, grid, reason='', is_at_base=True, state=Readiness.READY, stamp=None):
        """Publish the state of an agent that the test plays."""
        topic = f'/{agent}/state'
        if topic not in self._states:
            self._states[topic] = self.node.create_publisher(AgentState, topic, qos.LATCHED)
        at = self.now() if stamp is None else stamp
        self._states[topic].publish(state_message(grid, agent, state, reason, is_at_base, at))

    def set_parameter(self, full_name, name, value):
        """Change a parameter of a node like `ros2 param set`; return the node's answer."""
        client = self.node.create_client(SetParameters, f'{full_name}/set_parameters')
        self.until(client.service_is_ready, f'services of {full_name}')
        wanted = Parameter(name, value=value).to_parameter_msg()
        answer = client.call_async(SetParameters.Request(parameters=[wanted]))
        self.until(answer.done, f'answer of {full_name}')
        return answer.result().results[0]

    def start_clock(self):
        """Publish a simulated clock that only `advance` moves."""
        self._now = 100 * 10**9
        publisher = self.node.create_publisher(ClockMessage, '/clock', 1)

        def tick():
            publisher.publish(ClockMessage(clock=to_stamp(self._now)))

        self.node.create_timer(0.02, tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def now(self):
        """Return a later ROS time than before, in nanoseconds."""
        if self._now is None:
            return self.node.get_clock().now().nanoseconds
        self._now += 1
        return self._now

    def advance(self, seconds, full_name='/planner'):
        """Move the simulated clock; wait until a node has seen the time and polled again."""
        self._now += int(seconds * 10**9)
        # Between two diagnostics there are many polls.
        for _ in range(2):
            now = self.now()
            self.until(lambda now=now: (self.diagnosed_at(full_name) or 0) >= now, f'{seconds} s')

    def let_depart(self, namespace=''):
        """Allow departures to the agents of a mission, in place of its planner."""
        publisher = self.node.create_publisher(Bool, f'{namespace}/hold', qos.LATCHED)
        publisher.publish(Bool(data=False))
        return publisher

    def record_departures(self, agent):
        told = []
        publisher = self.node.create_publisher(Recorded, f'/{agent}/recorded', qos.EVIDENCE)

        def hear(status):
            told.append(status)
            if status.state == AgentStatus.DEPARTED:
                publisher.publish(on_disk(status))

        self.node.create_subscription(AgentStatus, f'/{agent}/status', hear, qos.EVIDENCE)
        return told

    def until(self, condition, what, patience=PATIENCE, *, may_end=False):
        """Handle messages until a condition holds; no node may end meanwhile by default."""
        deadline = time.monotonic() + patience
        while not condition():
            states = {name: self.state(name) for name in self._diagnosed}
            assert time.monotonic() < deadline, f'no {what} within {patience} s: {states}'
            for name in () if may_end else self.processes.ended():
                pytest.fail(f'{name} ended while there was no {what}: {self.said(name)}')
            self.executor.spin_once(timeout_sec=0.02)

    def until_failed(self, full_name):
        """Handle messages until a node has ended; return its exit code and its last line."""
        process = self.processes.started[full_name]
        self.until(lambda: process.poll() is not None, f'end of {full_name}', may_end=True)
        return process.returncode, self.said(full_name).splitlines()[-1]

    def until_recorded(self, log, newest):
        """Wait until a log has a message with the stamp of the newest in each list, by topic."""
        # A message that the test has received may still be on its way to the recorder.
        wanted = {
            (topic, from_stamp(each[-1].header.stamp)) for topic, each in newest.items() if each
        }

        def is_recorded():
            messages = read_log(log, topics={topic for topic, _ in wanted})
            return wanted <= {
                (each.topic, from_stamp(each.message.header.stamp)) for each in messages
            }

        self.until(is_recorded, f'record of {sorted(newest)}')

    def until_refused(self, full_name, times):
        """Handle messages until a node has refused `count`; return its message on the last."""
        self.until(lambda: self.count(full_name, 'refused') >= times, f'refusal {times}')
        status = self.diagnosed(full_name)
        assert self.count(full_name, 'refused') == times
        assert status.level == DiagnosticStatus.WARN
        return status.message


@pytest.fixture
def system_clock(tmp_path, monkeypatch):
    """Return a file: while it exists, nodes that start have a system clock years back."""
    library, file = tmp_path / 'set_back.so', tmp_path / 'set_back'
    source = Path(__file__).with_name('set_back.c')
    subprocess.run(['cc', '-shared', '-fPIC', '-o', library, source, '-ldl'], check=True)
    monkeypatch.setenv('LD_PRELOAD', str(library))
    monkeypatch.setenv('SET_BACK', str(file))
    return file


@pytest.fixture
def field(request, server, tmp_path, monkeypatch):
    """Provide a domain that is not used otherwise; all processes on it must end well."""
    anew = request.node.get_closest_marker('interpreter') or COVERED
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        for name, value in environment(domain).items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros_log'))
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(context.try_shutdown)
        processes = Processes(domain) if anew else ForkedProcesses(domain)
        node = rclpy.create_node('test', context=context, namespace='/test')
        stack.callback(node.destroy_node)
        field = Field(stack.enter_context(processes), node, tmp_path)
        yield field
        ended_before = field.processes.ended()
        for name, code in field.processes.stop(PATIENCE).items():
            said = field.said(name)
            assert name in ended_before or code == 0, f'{name} ended with {code}: {said}'
            assert 'Traceback' not in said, said
