# SPDX-License-Identifier: Apache-2.0
"""Run a whole mission: planner, agent, estimator and recorder, four processes over DDS."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
import os
from pathlib import Path
import re
import signal
import sys
from typing import Any

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.core import Belief
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import parameters_of
from kbnitp_ros.study.figures import mission_maps, mission_progress
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

NODES = ('recorder', 'estimator', 'agent', 'planner')
AGENT = 'scout_1'

# Options that set one parameter of that name in every node that has it.
OPTIONS = {
    'robots': 'robots',
    'lethality': 'sensor.lethality',
    'max_steps': 'max_steps',
    'method': 'method',
    'planner': 'planner',
    'seed': 'seed',
}


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
        values, out = parse(argv)
        out.mkdir(parents=True, exist_ok=True)
        log = out / 'mission.mcap'
        if log.exists():
            raise ValueError(f'--out {out} holds a mission already: name another folder')
    except (ValueError, OSError) as error:
        print(f'demo: {error}', file=sys.stderr)
        return 2
    # Shells start background jobs deaf to SIGINT; and SIGTERM, too, must end the nodes.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        deploy(values, log)
    except KeyboardInterrupt:
        print(f'demo: interrupted; {log} holds the mission so far', file=sys.stderr)
        return 130
    except (RuntimeError, OSError) as error:
        print(f'demo: {error}', file=sys.stderr)
        return 1
    return conclude(log)


def parse(argv: Sequence[str] | None) -> tuple[dict[str, Any], Path]:
    """
    Return the parameters that the options set and the folder to write to.

    Raises
    ------
    ValueError
        If an option's value is not allowed.

    """
    table = {**parameters_of('agent'), **parameters_of('estimator'), **parameters_of('planner')}
    parser = argparse.ArgumentParser(prog='demo', description=__doc__)
    for option, name in OPTIONS.items():
        parameter = table[name]
        parser.add_argument(
            f'--{option.replace("_", "-")}',
            type=type(parameter.default),
            default=parameter.default,
            help=f'{parameter.description} {parameter.allowed}; default {parameter.default}',
        )
    parser.add_argument('--size', default='9', help='cells a side, N or WIDTHxHEIGHT; default 9')
    parser.add_argument('--out', type=Path, help='folder for the results; default runs/<time>')
    options = parser.parse_args(argv)
    sides = re.fullmatch(r'(\d+)(?:x(\d+))?', options.size)
    if sides is None:
        raise ValueError(f'--size is {options.size!r}: it must be N or WIDTHxHEIGHT')
    size = {'grid.width': int(sides[1]), 'grid.height': int(sides[2] or sides[1])}
    given = {name: getattr(options, option) for option, name in OPTIONS.items()} | size
    values = {name: table[name].check(value) for name, value in given.items()}
    out = options.out or Path('runs', datetime.now().strftime('%Y-%m-%d-%H-%M-%S'))
    return values, out


def deploy(values: dict[str, Any], log: Path) -> None:
    """
    Start the nodes, watch until all robots are deployed, and stop the nodes.

    Raises
    ------
    RuntimeError
        If a node ended before that, or badly after it.

    """
    own = {
        'recorder': {'file': str(log)},
        'estimator': {'await_nodes': ['planner', 'recorder', 'observer'], 'agents': [AGENT]},
        'agent': {
            'await_nodes': ['planner', 'estimator', 'recorder', 'observer'],
            'publish_truth': True,
            'agent': AGENT,
        },
        'planner': {'await_nodes': ['agent', 'estimator', 'recorder'], 'agents': [AGENT]},
    }
    with free_domain() as domain, Processes(domain) as processes:
        for node in NODES:
            shared = {name: value for name, value in values.items() if name in parameters_of(node)}
            processes.start(node, shared | own[node])
        with observed(domain) as observer:
            observer.watch(values['robots'], processes)
        failed = {name: code for name, code in processes.stop().items() if code}
    if failed:
        raise RuntimeError(f'nodes did not end well, by exit code: {failed}')


@contextmanager
def observed(domain: int) -> Iterator[Observer]:
    """Yield an observer on the domain."""
    os.environ.update(environment(domain))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    observer = Observer()
    try:
        yield observer
    finally:
        observer.destroy_node()
        rclpy.try_shutdown()


class Observer(Node):
    """Show a mission's progress."""

    def __init__(self) -> None:
        super().__init__('observer')
        self._held = 0
        self._lost = 0
        self._belief: Belief | None = None
        self.create_subscription(BeliefMaps, 'belief', self._on_belief, qos.LATCHED)
        self.create_subscription(
            DeploymentReport, f'{AGENT}/report', self._on_report, qos.EVIDENCE
        )

    def _on_belief(self, message: BeliefMaps) -> None:
        snapshot = read_belief_maps(message)
        self._held, self._belief = snapshot.deployments, snapshot.belief

    def _on_report(self, message: DeploymentReport) -> None:
        self._lost += not message.survived

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
                    bar.set_postfix(entropy=entropy, lost=self._lost, refresh=False)
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
    print('\n'.join(lines(report)))
    print(f'entropy {first:.1f} -> {last:.1f} nats')
    print(*(f'wrote {path}' for path in (log, maps, progress)), sep='\n')
    return 0 if report.reproduced else 1
