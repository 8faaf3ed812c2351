# SPDX-License-Identifier: Apache-2.0
"""The mission of the demo: its parameters, its nodes, and its results."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from itertools import combinations
from math import inf
import os
from pathlib import Path
import re
import shlex
import shutil
import time
from typing import Any

from kbnitp_msgs.msg import MissionStatus as StatusMessage
from kbnitp_msgs.msg import Progress
from kbnitp_ros.cli.layout import write_views
from kbnitp_ros.cli.output import complain, confirmed, end_on_signals, say
from kbnitp_ros.cli.parameters import assign, node_values, recorded_values, set_parameter
from kbnitp_ros.cli.processes import environment, given_domain, Processes
from kbnitp_ros.cli.replay import lines, replayed
from kbnitp_ros.cli.report import report
from kbnitp_ros.cli.server import Address
from kbnitp_ros.cli.watch import serving
from kbnitp_ros.configuration import (
    agent_names,
    make_estimator,
    make_grid,
    value_for,
    with_defaults,
)
from kbnitp_ros.configuration.agents import (
    learnt_numbers,
    make_execution,
    make_robot_types,
    true_dynamics,
)
from kbnitp_ros.configuration.checks import check_reach, reach_note
from kbnitp_ros.configuration.field import read_world
from kbnitp_ros.configuration.given import read_sections, values_for
from kbnitp_ros.configuration.known import check_own, CLOCK
from kbnitp_ros.configuration.mission import check_search
from kbnitp_ros.configuration.parameter import own_name
from kbnitp_ros.configuration.starts import awaited_nodes, DEFAULTS, FIXED, OPTIONS, parameters_for
from kbnitp_ros.core import METHODS
from kbnitp_ros.files import in_words
from kbnitp_ros.log.files import check_is_new, log_parts, LogError, LogLock, NAME, new_log
from kbnitp_ros.log.read import read_parameters
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages import orders
from kbnitp_ros.messages.progress import Helper, MissionStatus, Obstacle, read_mission_status
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import DEPLOYMENTS
from kbnitp_ros.report.folder import check_is_free
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from tqdm import tqdm

# The nodes of the demo.
NODES = ('recorder', 'estimator', 'agent', 'planner')

# Seconds per step with `silent_loss`, which needs a step_period above 0.
SILENT_STEP = 0.01

# Seconds of waiting for an operator, after which the demo ends.
OPERATOR_WAIT = 3.0

# Maximum seconds from the end of a mission to the progress of its last robot, which the estimator
# publishes at most twice a second.
LAST_PROGRESS = 1.0

# The option that is the truth, which an estimator that learns it is not told.
LETHALITY = 'sensor.lethality'

# Parameters that may differ between nodes: true and believed sensors and hazards, awaited nodes.
MAY_DIFFER = ('sensor.', 'hazards.', 'targets.', 'await_nodes')


def prepare(options: argparse.Namespace) -> tuple[Path, dict[str, dict[str, Any]]]:
    """Return the log of the mission, and the parameters of its nodes."""
    if options.resume:
        log = log_parts(options.resume)[0]
        # Refuse a running mission: resumed nodes would send its robots again.
        LogLock(log).release()
        return log, recorded_parameters(log)
    parameters = chosen_parameters(options)
    log = new_log(options.out)
    if log.exists():
        raise ValueError(
            f'--out {log.parent} holds a mission already: name another folder, or resume that '
            'mission with --resume'
        )
    check_is_new(log)
    check_is_free(report_folder(log))
    parameters['recorder']['file'] = str(log)
    return log, parameters


def run(log: Path, parameters: Mapping[str, Mapping[str, Any]], *, has_page: bool) -> int:
    """Run the mission, replay and report it; return the exit code."""
    planner = parameters['planner']
    if reach := reach_note(make_grid(planner), planner):
        say(f'{reach}.')
    arrived = end_on_signals()
    try:
        with serving(log, None, Address(port=0)) if has_page else nullcontext():
            deploy(log, parameters)
            return conclude(log)
    except KeyboardInterrupt:
        pass
    except (RuntimeError, LogError, OSError) as error:
        if not arrived:
            complain('demo', f'{in_words(error)}; {how_to_go_on(log)}')
            return 1
    complain('demo', f'interrupted; {how_to_go_on(log)}')
    return 128 + arrived[0]


def chosen_parameters(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node of a new mission."""
    sections = read_sections(options.params) if options.params else {}
    if any(values_for(sections, f'/{node}').get(CLOCK) for node in NODES):
        raise ValueError('use_sim_time is true: the demo has no simulated clock')
    given = node_values(sections, NODES)
    for name, value in given_by_options(options):
        for node in NODES:
            assign(given[node], node, name, value)
    for rule in options.set:
        set_parameter(given, rule, 'demo', FIXED)
    parameters = {
        node: with_defaults(node, values, DEFAULTS['demo']) for node, values in given.items()
    }
    estimator, told = parameters['estimator'], getattr(options, LETHALITY)
    if 'lethality' in learnt_numbers(estimator) and estimator[LETHALITY] == told:
        estimator[LETHALITY] = with_defaults('estimator', {})[LETHALITY]
    for node, values in parameters.items():
        if values.get('silent_loss'):
            values['step_period'] = values['step_period'] or SILENT_STEP
        values |= parameters_for(node, FIXED)
    check_mission(parameters)
    return parameters


def given_by_options(options: argparse.Namespace) -> Iterator[tuple[str, Any]]:
    """Yield the parameters set by options other than --set."""
    for name in OPTIONS['demo']:
        if (value := getattr(options, name)) is not None:
            yield name, value
    if options.size is not None:
        sides = re.fullmatch(r'(\d+)(?:x(\d+))?', options.size)
        if sides is None:
            raise ValueError(f'--size is {options.size!r}: it must be N or WIDTHxHEIGHT')
        yield 'grid.width', int(sides[1])
        yield 'grid.height', int(sides[2] or sides[1])
    if options.agents is not None:
        if options.agents < 1:
            raise ValueError(f'--agents is {options.agents}: it must be at least 1')
        yield 'agents', [f'scout_{number + 1}' for number in range(options.agents)]


def check_mission(parameters: Mapping[str, dict[str, Any]]) -> None:
    """Check that the nodes accept their parameters, and agree on the mission."""
    for one, other in combinations(('estimator', 'agent', 'planner'), 2):
        ours, theirs = parameters[one], parameters[other]
        check_own(theirs)
        for name in sorted({*ours, *theirs}):
            agent, common = own_name(name) or ('', name)
            if common.startswith(MAY_DIFFER) or not {common} <= ours.keys() & theirs.keys():
                continue
            value, another = (value_for(values, common, agent) for values in (ours, theirs))
            if value != another:
                raise ValueError(
                    f'{name} is {value} in {one} and {another} in {other}: nodes of one mission '
                    'must agree'
                )
    simulated, estimator = parameters['agent'], parameters['estimator']
    if simulated['map_topic']:
        raise ValueError(
            f'map_topic is {simulated["map_topic"]}: the demo subscribes to no map; '
            'set the parameter map instead'
        )
    grid = make_grid(simulated)
    agent_names(simulated, grid)
    check_search(parameters['planner'], grid, make_robot_types(estimator, grid))
    make_execution(simulated)
    true_dynamics(simulated)
    if simulated['world.file']:
        read_world(simulated['world.file'], grid)
    make_estimator(estimator, grid)
    check_reach(grid, parameters['planner'], confirmed)
    # The planner must not refuse cells that were confirmed.
    parameters['planner']['minimum_reach'] = 0.0


def how_to_go_on(log: Path) -> str:
    """Return the command that resumes a mission, or the reason why it cannot be resumed."""
    try:
        recorded_parameters(log)
    except (ValueError, OSError):
        return (
            'no robot had left, or the log cannot be read, so there is nothing to resume: begin a '
            f'new mission, with --out other than {log.parent}'
        )
    return f'resume it with: python3 -m kbnitp_ros demo --resume {shlex.quote(str(log))}'


def recorded_parameters(log: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node that resumes the mission of a log."""
    recorded = read_parameters(log)
    parameters = {}
    for node in NODES:
        if f'/{node}' not in recorded:
            if not any(True for _ in MissionLog(log).read('path')):
                raise ValueError(
                    f'{log} ends before the first robot left, so there is nothing to resume: '
                    'begin a new mission in another folder'
                )
            raise ValueError(
                f'{log} does not record the parameters of /{node}: resume its mission with the '
                'launch file, which reads parameters from params_file'
            )
        parameters[node] = recorded_values(recorded[f'/{node}'], node) | {'resume': str(log)}
    METHODS.load(parameters['estimator']['method'])
    # The report compares the belief with the truth, which the log may lack so far.
    parameters['agent']['publish_truth'] = True
    return parameters


def deploy(log: Path, parameters: Mapping[str, Mapping[str, Any]]) -> None:
    """Start the nodes, watch until the mission is over, and stop the nodes."""
    log.parent.mkdir(parents=True, exist_ok=True)
    view, _ = write_views(log.with_suffix(''), '', parameters['planner']['agents'])
    with given_domain() as domain, Processes(domain) as processes:
        say(
            f'starting {", ".join(NODES)}; to watch them: ROS_DOMAIN_ID={domain} rviz2 -d '
            f'{shlex.quote(str(view))}, or foxglove_bridge in that domain with the layout '
            f'{shlex.quote(str(view.with_suffix(".json")))}'
        )
        for node in NODES:
            awaited = {'await_nodes': awaited_nodes(node, is_recorded=True)}
            # The progress bar shows deployments.
            levels = {f'{node}.{DEPLOYMENTS}': 'warn'}
            processes.start(node, {**parameters[node], **awaited}, levels=levels)
        with observed(domain) as (observer, received):
            watch(observer, received, parameters['planner']['robots'], processes)
        failed = {name: code for name, code in processes.stop().items() if code}
    if failed:
        raise RuntimeError(f'nodes failed, with these exit codes: {failed}')


@dataclass
class Observed:
    """The last messages of a mission."""

    progress: Progress | None = None
    # None before the planner says how the mission stands.
    status: MissionStatus | None = None

    def take(self, message: Any) -> None:
        """Keep how the mission stands; an invalid message is not the planner's."""
        with suppress(ValueError):
            self.status = read_mission_status(message)

    def show(self, message: Progress) -> None:
        """Keep the progress."""
        self.progress = message


@contextmanager
def observed(domain: int) -> Iterator[tuple[Node, Observed]]:
    """Yield a node on the domain, and the last messages that it received."""
    os.environ.update(environment(domain))
    rclpy.init(
        args=['--ros-args', '--enclave', '/observer'],
        signal_handler_options=SignalHandlerOptions.NO,
    )
    observer, received = Node('observer'), Observed()
    observer.create_subscription(Progress, 'progress', received.show, qos.LATCHED)
    observer.create_subscription(StatusMessage, 'mission', received.take, qos.LATCHED)
    try:
        yield observer, received
    finally:
        observer.destroy_node()
        try_shutdown()


def most_left(received: Observed, has_board: bool) -> float:
    """Return the maximum wait for the next change, in seconds."""
    status, progress = received.status, received.progress
    if status is None or status.out:
        return inf
    if status.obstacle.is_end:
        shown = progress.deployments if progress else 0
        return 0.0 if shown >= status.ordered - status.held else LAST_PROGRESS
    # Without a board nobody calls the planner's services, but it may search again by itself.
    return OPERATOR_WAIT if status.ends_by is Helper.OPERATOR and not has_board else inf


def watch(observer: Node, received: Observed, robots: int, processes: Processes) -> None:
    """Show the progress of a mission until it is over, or waits for an operator."""
    executor = SingleThreadedExecutor()
    executor.add_node(observer)
    known: tuple[object, ...] = ()
    since, has_board = time.monotonic(), False
    with tqdm(total=robots, unit='robot', desc='starting', disable=None) as bar:
        while time.monotonic() <= since + most_left(received, has_board):
            executor.spin_once(timeout_sec=0.2)
            if processes.ended():
                raise RuntimeError(
                    f'nodes ended during the mission, with these exit codes: {processes.ended()}'
                )
            present = observer.get_node_names()
            has_board = orders.NAME in present
            now, status = received.progress, received.status
            if now is None:
                absent = [name for name in NODES if name not in present]
                bar.set_postfix_str(f'waiting for {", ".join(absent) or "the first belief"}')
                continue
            bar.set_description('deploying', refresh=False)
            entropy = f'{now.hazard_entropy + now.target_entropy:.1f} nats'
            bar.set_postfix(entropy=entropy, lost=now.lost, refresh=False)
            bar.update(now.deployments - bar.n)
            stands = (status.obstacle, status.ordered, status.out) if status else ()
            if known != (known := (now.deployments, has_board, *stands)):
                since = time.monotonic()
    if received.status is not None and received.status.obstacle is not Obstacle.NONE:
        say(received.status.reason)


def conclude(log: Path) -> int:
    """Replay and report the log, and print what was learnt; return the exit code."""
    say('replaying the log and writing the report')
    reproduction, folder = replayed(log), report_folder(log)
    # A resumed mission may already have a report.
    shutil.rmtree(folder, ignore_errors=True)
    say(*lines(reproduction))
    say(f'wrote {log}')
    mission = report(log, folder)
    first, last = mission.moments[0], mission.moments[-1]
    say(f'entropy {first.belief.entropy():.1f} -> {last.belief.entropy():.1f} nats')
    for name, known in last.state.numbers.items():
        low, _, middle, _, high = known.quantiles
        is_known = f'; true: {mission.numbers[name]:.3g}' if name in mission.numbers else ''
        say(f'{name} learnt: {middle:.2g}, 90 % interval {low:.2g} to {high:.2g}{is_known}')
    return 1 if reproduction.grade == Grade.DIFFERENT else 0


def report_folder(log: Path) -> Path:
    """Return the folder of a log's report, beside the log."""
    return log.with_name('report' if log.name == NAME else f'{log.stem}_report')
