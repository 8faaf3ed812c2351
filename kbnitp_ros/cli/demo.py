# SPDX-License-Identifier: Apache-2.0
"""Run a whole mission, or go on with a dead one: four nodes, four processes, over DDS."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
import os
from pathlib import Path
import re
import signal
import sys
from typing import Any

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.cli.output import command, complain, say
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.core import Belief, DeploymentKey, Grid, team_size
from kbnitp_ros.log.bag import check_is_new, LogError, LogLock, parts_of, read_log
from kbnitp_ros.log.configuration import read_parameters
from kbnitp_ros.log.evidence import PATH
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import parameters_of
from kbnitp_ros.study.figures import mission_maps, mission_progress
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

NODES = ('recorder', 'estimator', 'team', 'planner')

# Nothing is published for good before all of these hear it.
AWAITED = {
    'estimator': ['planner', 'recorder', 'observer'],
    'team': ['planner', 'estimator', 'recorder', 'observer'],
    'planner': ['team', 'estimator', 'recorder'],
}

# How long after its expected return a silent robot is given up, in seconds: those of the demo
# need no time for their way, but their processes may be kept waiting by others.
RETURN_DEADLINE = 1.0

# Options that set one parameter of that name in every node that has it.
OPTIONS = {
    'robots': 'robots',
    'lethality': 'sensor.lethality',
    'max_steps': 'max_steps',
    'method': 'method',
    'planner': 'planner',
    'allocation': 'allocation',
    'silent_loss': 'silent_loss',
    'seed': 'seed',
}


@command('demo')
def main(argv: Sequence[str] | None = None) -> int:
    """
    Run the command.

    Returns
    -------
    int
        0 if all robots were deployed and the log replays to the same beliefs, else 1; 2 for
        unusable options.

    """
    try:
        options = parse(argv)
        if options.resume:
            log = parts_of(options.resume)[0]
            # Nodes that went on with a mission which still lives would send its robots again.
            LogLock(log).release()
            parameters = recorded_parameters(log)
        else:
            parameters = chosen_parameters(options)
            log = new_log(options.out)
            check_is_new(log)
            parameters['recorder'] = {'file': str(log)}
    except (ValueError, OSError) as error:
        complain('demo', error)
        return 2
    # Shells start background jobs deaf to SIGINT; and SIGTERM, too, must end the nodes.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        deploy(parameters)
        return conclude(log)
    except KeyboardInterrupt:
        complain('demo', f'interrupted; {log} holds the mission so far')
        return 130
    except (RuntimeError, LogError, OSError) as error:
        complain('demo', error)
        return 1


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """
    Return the options.

    Raises
    ------
    ValueError
        If there are others beside --resume, which says everything.

    """
    table = {**parameters_of('team'), **parameters_of('estimator'), **parameters_of('planner')}
    parser = argparse.ArgumentParser(prog='demo', description=__doc__)
    for option, name in OPTIONS.items():
        parameter = table[name]
        words = f'{parameter.description} {parameter.allowed}; default {parameter.default}'
        flag = f'--{option.replace("_", "-")}'
        if parameter.default is False:
            parser.add_argument(flag, action='store_true', help=parameter.description)
        else:
            parser.add_argument(
                flag, type=type(parameter.default), default=parameter.default, help=words
            )
    parser.add_argument('--size', default='9', help='cells a side, N or WIDTHxHEIGHT; default 9')
    parser.add_argument(
        '--agents', type=int, default=1, help='agents whose robots leave together; default 1'
    )
    parser.add_argument('--out', type=Path, help='folder for the results; default runs/<time>')
    parser.add_argument(
        '--resume',
        type=Path,
        metavar='FILE',
        help='log of a dead mission, or its folder, to go on with; goes alone',
    )
    options = parser.parse_args(argv)
    if options.resume and vars(options) != vars(
        parser.parse_args(['--resume', str(options.resume)])
    ):
        raise ValueError('--resume goes alone: the log says how its mission was configured')
    return options


def chosen_parameters(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """
    Return the parameters of each node of a new mission, the recorder's apart.

    Raises
    ------
    ValueError
        If an option's value is not allowed.

    """
    sides = re.fullmatch(r'(\d+)(?:x(\d+))?', options.size)
    if sides is None:
        raise ValueError(f'--size is {options.size!r}: it must be N or WIDTHxHEIGHT')
    size = {'grid.width': int(sides[1]), 'grid.height': int(sides[2] or sides[1])}
    given = {name: getattr(options, option) for option, name in OPTIONS.items()} | size
    own: dict[str, dict[str, Any]] = {
        'estimator': {},
        'team': {'publish_truth': True, 'recorded': True},
        'planner': {'return_deadline': RETURN_DEADLINE, 'recorded': True},
    }
    for node, values in own.items():
        table = parameters_of(node)
        values.update(
            {name: table[name].check(value) for name, value in given.items() if name in table}
        )
    agents = team_size(Grid(size['grid.width'], size['grid.height']), options.agents)
    for values in own.values():
        values['agents'] = [f'scout_{number + 1}' for number in range(agents)]
    return own


def new_log(out: Path | None) -> Path:
    """
    Return where the log of a new mission goes; its folder is there.

    Raises
    ------
    ValueError
        If there is a log already.
    OSError
        If the folder cannot be made.

    """
    folder = out or Path('runs', datetime.now().strftime('%Y-%m-%d-%H-%M-%S'))
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / 'mission.mcap'
    if log.exists():
        raise ValueError(f'--out {folder} holds a mission already: name another folder')
    return log


def recorded_parameters(log: Path) -> dict[str, dict[str, Any]]:
    """
    Return the parameters of each node that goes on with the mission of a log.

    Raises
    ------
    ValueError
        If the log cannot be read, or does not say how each of the nodes was configured.

    """
    recorded = read_parameters(log)
    parameters = {}
    for node in NODES:
        if f'/{node}' not in recorded:
            if not any(True for _ in read_log(log, (PATH,))):
                raise ValueError(
                    f'{log} ends before the first robot left: begin anew in another folder'
                )
            raise ValueError(
                f'{log} does not have the parameters of /{node} on record: '
                'resume its mission with the launch file, which takes them from params_file'
            )
        known = parameters_of(node)
        parameters[node] = {
            name: value for name, value in recorded[f'/{node}'].items() if name in known
        }
        if 'resume' in known:
            parameters[node]['resume'] = str(log)
    # What the mission came to is shown beside the truth, which the log may lack so far.
    parameters['team']['publish_truth'] = True
    return parameters


def deploy(parameters: Mapping[str, Mapping[str, Any]]) -> None:
    """
    Start the nodes, watch until all robots are deployed, and stop the nodes.

    Parameters
    ----------
    parameters : mapping
        Of each node, by its name.

    Raises
    ------
    RuntimeError
        If a node ended before that, or badly after it.

    """
    with free_domain() as domain, Processes(domain) as processes:
        for node in NODES:
            awaited = {'await_nodes': AWAITED[node]} if node in AWAITED else {}
            processes.start(node, {**parameters[node], **awaited})
        with observed(domain, parameters['planner']['agents']) as observer:
            observer.watch(parameters['planner']['robots'], processes)
        failed = {name: code for name, code in processes.stop().items() if code}
    if failed:
        raise RuntimeError(f'nodes did not end well, by exit code: {failed}')


@contextmanager
def observed(domain: int, agents: Sequence[str]) -> Iterator[Observer]:
    """Yield an observer of these agents on the domain."""
    os.environ.update(environment(domain))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    observer = Observer(agents)
    try:
        yield observer
    finally:
        observer.destroy_node()
        rclpy.try_shutdown()


class Observer(Node):
    """Show a mission's progress."""

    def __init__(self, agents: Sequence[str]) -> None:
        super().__init__('observer')
        self._held = 0
        self._survived: dict[DeploymentKey, bool] = {}
        self._belief: Belief | None = None
        self.create_subscription(BeliefMaps, 'belief', self._on_belief, qos.LATCHED)
        for agent in agents:
            self.create_subscription(
                DeploymentReport, f'{agent}/report', self._on_report, qos.EVIDENCE
            )

    def _on_belief(self, message: BeliefMaps) -> None:
        snapshot = read_belief_maps(message)
        self._held, self._belief = snapshot.deployments, snapshot.belief

    def _on_report(self, message: DeploymentReport) -> None:
        key, report = read_report(message)
        self._survived[key] = report.survived or self._survived.get(key, False)

    def watch(self, robots: int, processes: Processes) -> None:
        """
        Return when the belief holds all robots.

        Raises
        ------
        RuntimeError
            If a node ends before that.

        """
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        with tqdm(total=robots, unit='robot', disable=None) as bar:
            while self._belief is None or self._held < robots:
                executor.spin_once(timeout_sec=0.2)
                if processes.ended():
                    raise RuntimeError(f'nodes ended early, by exit code: {processes.ended()}')
                if self._belief is not None:
                    entropy = f'{self._belief.entropy():.1f} nats'
                    lost = len(self._survived) - sum(self._survived.values())
                    bar.set_postfix(entropy=entropy, lost=lost, refresh=False)
                bar.update(self._held - bar.n)


def conclude(log: Path) -> int:
    """Replay the log, draw the figures, say where everything is; return the exit code."""
    report = replay(log)
    history = read_history(log)
    assert history.world is not None, 'the agent was told to publish the truth'
    maps, progress = log.with_name('maps.png'), log.with_name('progress.png')
    mission_maps(maps, history.grid, history.beliefs[-1], history.world, history.observations)
    mission_progress(progress, history.beliefs, history.world, history.observations)
    first, last = history.beliefs[0].entropy(), history.beliefs[-1].entropy()
    say(*lines(report))
    say(f'entropy {first:.1f} -> {last:.1f} nats')
    say(*(f'wrote {path}' for path in (log, maps, progress)))
    return 0 if report.reproduced else 1
