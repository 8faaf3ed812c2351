# SPDX-License-Identifier: Apache-2.0
"""Check the robots and the base of a mission before its first departure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from math import isnan, nan
from pathlib import Path
import shutil
import time
from typing import Any

from kbnitp_msgs.msg import (
    AgentHealth,
    AgentState,
    Decision,
    MissionStatus,
    ModelBelief,
    RecorderState,
    Standings,
)
from kbnitp_ros.base.preflight import (
    Check,
    disk_check,
    Heard,
    judged,
    Light,
    OPTIONAL,
    robot_checks,
)
from kbnitp_ros.cli.output import command, complain, end_on_signals, say
from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.agents import learnt_numbers
from kbnitp_ros.configuration.checks import failure_note, ignored_note
from kbnitp_ros.files import installed, nearest
from kbnitp_ros.messages.headers import SECOND
from kbnitp_ros.messages.health import read_health
from kbnitp_ros.messages.states import read_state
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.command_line import command_parser
from kbnitp_ros.nodes.runtime.graph import full_name
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

DESCRIPTION = """
Check the robots and the base of a mission before its first departure. The nodes of the base and
the agents must run. A line for each check says what was found and, where it is red, the remedy.
The command ends as soon as nothing is red, or after --wait seconds; it publishes nothing. What
--skip names is added to the planner's parameter preflight_skip, which is on record.

The exit code is 0 if nothing is red, 1 if a check is red, and 2 if the base is not heard.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros preflight --wait 3',
    'python3 -m kbnitp_ros preflight --namespace /mission --wait 30',
    'python3 -m kbnitp_ros preflight --skip clock --skip battery',
)

# Seconds of a look for messages, and until agents without an answer do without a round trip.
SPIN = 0.1
MAX_TRIP = 5.0


@command('preflight')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = command_parser('preflight', DESCRIPTION, *EXAMPLES)
    parser.add_argument('--namespace', default='/', help='namespace of the mission; default /')
    parser.add_argument(
        '--wait',
        metavar='S',
        type=float,
        default=10.0,
        help='seconds to wait for what is missing or red, at least 0; default 10',
    )
    parser.add_argument(
        '--skip',
        metavar='NAME',
        action='append',
        default=[],
        help=f'a check whose red does not count from now on: {", ".join(OPTIONAL)}. Can be '
        'repeated; default none',
    )
    options = parser.parse_args(argv)
    end_on_signals()
    try:
        check_skipped(options.skip)
        with listening(options.namespace, options.skip) as (heard, look):
            end = time.monotonic() + options.wait
            while not heard.is_green and time.monotonic() < end:
                look()
            checks = [*heard.checks()]
    except (ValueError, RuntimeError) as error:
        complain('preflight', error)
        return 2
    say(*(f'{each.light.name:5} {each.name}: {each.text}' for each in checks))
    return int(any(each.light is Light.RED for each in checks))


def check_skipped(names: Sequence[str]) -> None:
    """Check that the checks of these names may be skipped."""
    for name in names:
        if name not in OPTIONAL:
            raise ValueError(
                f'--skip {name}: there is no such check that may be skipped; '
                f'{nearest(name, OPTIONAL)}they are {", ".join(OPTIONAL)}'
            )


@contextmanager
def listening(
    namespace: str, skipped: Sequence[str]
) -> Iterator[tuple[MissionListener, Callable[[], None]]]:
    """Yield a mission, and the function that hears what is new."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node('preflight', namespace=namespace)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        yield MissionListener(node, skipped), partial(executor.spin_once, timeout_sec=SPIN)
    finally:
        try_shutdown()


class MissionListener:
    """The last words of the base and the agents of a mission."""

    def __init__(self, node: Node, skipped: Sequence[str]) -> None:
        self._node = node
        self._begun = time.monotonic()
        # Checks to skip that the planner was not asked to skip yet.
        self._skipped = skipped
        # By topic.
        self._said: dict[str, Any] = {}
        # Parameters of a node that it has stated, by its full name.
        self._values: dict[str, dict[str, Any]] = {}
        self._clients: dict[str, AsyncParameterClient] = {}
        # Times of the first requests and of the first answers, seconds.
        self._asked: dict[str, float] = {}
        self._answered: dict[str, float] = {}
        self._agents: dict[str, Heard] = {}
        for kind, topic, profile in (
            (AgentState, 'state', qos.LATCHED),
            (MissionStatus, 'mission', qos.LATCHED),
            (Standings, 'standings', qos.STANDINGS),
            (ModelBelief, 'model', qos.LATCHED),
            (Decision, 'decision', qos.LATCHED),
            (RecorderState, 'recorders', qos.ALIVE),
        ):
            self._subscribe(kind, topic, profile, partial(self._said.__setitem__, topic))

    def _subscribe(
        self, kind: type, topic: str, profile: QoSProfile, take: Callable[[Any], None]
    ) -> None:
        self._node.create_subscription(kind, topic, take, profile)

    def values(self, topic: str) -> dict[str, Any]:
        """Return the parameters of the author of a topic; empty until they are known."""
        author = self._said[topic].author if topic in self._said else ''
        if author:
            self._ask(author)
        return self._values.get(author, {})

    def _ask(self, author: str) -> None:
        """Ask a node for its parameters, once."""
        if author not in self._clients:
            self._clients[author] = AsyncParameterClient(self._node, author)
        if author not in self._asked and self._clients[author].services_are_ready():
            self._asked[author] = time.monotonic()
            self._clients[author].list_parameters(callback=partial(self._on_names, author))

    def _round_trip(self, agent: str) -> float:
        """Return the time of a call to the node of an agent, seconds; NaN until it is known."""
        for publisher in self._node.get_publishers_info_by_topic(f'{agent}/state'):
            author = full_name(publisher.node_namespace, publisher.node_name)
            self._ask(author)
            return self._answered.get(author, nan) - self._asked.get(author, nan)
        return nan

    def _on_names(self, author: str, answer: Any) -> None:
        self._answered[author] = time.monotonic()
        names = answer.result().result.names

        def keep(values: Any) -> None:
            read = map(parameter_value_to_python, values.result().values)
            self._values[author] = dict(zip(names, read))

        self._clients[author].get_parameters(names, callback=keep)

    def _listen_to(self, agent: str) -> None:
        self._agents[agent] = Heard()

        def keep_state(message: AgentState) -> None:
            heard = self._agents[agent]
            self._agents[agent] = heard._replace(state=read_state(message, agent))

        def keep_health(message: AgentHealth) -> None:
            health, now = read_health(message, agent), self._node.get_clock().now().nanoseconds
            self._agents[agent] = self._agents[agent]._replace(
                health=health, offset=(health.stamp - now) / SECOND
            )

        self._subscribe(AgentState, f'{agent}/state', qos.LATCHED, keep_state)
        self._subscribe(AgentHealth, f'{agent}/health', qos.READINGS, keep_health)

    def _skip(self, planner: dict[str, Any]) -> None:
        """Add checks to those that the planner has on record as skipped."""
        names = sorted({*(planner['preflight_skip'] or ()), *self._skipped})
        self._skipped = ()

        def keep(answer: Any) -> None:
            if answer.result().results[0].successful:
                planner['preflight_skip'] = names

        client = self._clients[self._said['mission'].author]
        client.set_parameters([Parameter('preflight_skip', value=names)], callback=keep)

    @property
    def is_green(self) -> bool:
        """Return whether all was heard, and no check is red."""
        values = self.values('mission'), self.values('standings')
        for agent in values[0].get('agents', ()):
            if agent not in self._agents:
                self._listen_to(agent)
        if values[0] and self._skipped:
            self._skip(values[0])
        is_heard = all(values) and {'state', 'recorders'} <= self._said.keys()
        if time.monotonic() < self._begun + MAX_TRIP:
            is_heard &= not any(isnan(self._round_trip(agent)) for agent in self._agents)
        return is_heard and not any(each.light is Light.RED for each in self.checks())

    def checks(self) -> Iterator[Check]:
        """Yield the checks of the base and of each robot; ValueError if there is no base."""
        skipped = tuple(self.values('mission').get('preflight_skip') or ())
        for check in self._checks():
            is_skipped = check.light is Light.RED and check.name.endswith(skipped)
            yield check._replace(light=Light.SKIP) if is_skipped else check

    def _checks(self) -> Iterator[Check]:
        """Yield the checks, with nothing skipped."""
        planner, estimator = self.values('mission'), self.values('standings')
        if not planner or 'state' not in self._said:
            topic = self._node.resolve_topic_name('mission')
            raise ValueError(
                f'no planner is heard on {topic}: start the base, name another --namespace, or '
                'set ROS_DOMAIN_ID to the number that the base was started with'
            )
        base = read_state(self._said['state'], '')
        for agent, heard in self._agents.items():
            needed = value_for(planner, 'min_battery', agent)
            heard = heard._replace(round_trip=self._round_trip(agent))
            for check in robot_checks(agent, heard, base, installed().split()[1], needed):
                yield check._replace(name=f'{agent} {check.name}')
        yield judged('estimator', bool(estimator), 'parameters', 'start an estimator')
        log = self._said['recorders'].log if 'recorders' in self._said else ''
        if log:
            folder = Path(log).parent
            yield disk_check(log, shutil.disk_usage(folder).free if folder.exists() else None)
        else:
            yield judged(
                'disk', not planner['recorded'], 'nothing is recorded', 'start a recorder'
            )
        yield from self._notes(planner, estimator)

    def _notes(self, planner: dict[str, Any], estimator: dict[str, Any]) -> Iterator[Check]:
        """Yield what the operator should know of the parameters."""
        if not estimator:
            return
        unused = ignored_note(estimator, learnt_numbers(estimator))
        light = Light.RED if unused else Light.GREEN
        yield Check('parameters', light, unused or 'all that are given are read')
        if not (estimator['sensor.duds'] or 'duds' in learnt_numbers(estimator)):
            question = 'can a hazard be dead, or a decoy? If so, add duds to learn.numbers'
            yield Check('duds', Light.INFO, question)
        model, decision = self._said.get('model'), self._said.get('decision')
        learnt = zip(model.name, model.mean, model.sd) if model else ()
        words = [f'{name} {mean:.3g} ± {sd:.2g}' for name, mean, sd in learnt]
        yield Check('learnt', Light.INFO, ', '.join(words) or 'no number is learnt')
        trusted = ', '.join(decision.told) if decision else ''
        yield Check('trusted', Light.INFO, trusted or 'no told number moves a decision')
        longest = max(
            value_for(planner, 'max_steps', agent) * value_for(planner, 'step_period', agent)
            for agent in planner['agents']
        )
        rounds = -(-planner['robots'] // len(planner['agents']))
        yield Check('duration', Light.INFO, f'at most {rounds * longest / 60:.0f} min of walks')
        yield Check('losses', Light.INFO, failure_note({**planner, **estimator}))
