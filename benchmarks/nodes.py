# SPDX-License-Identifier: Apache-2.0
"""
Measure the memory and the speed of the four nodes in a long mission.

    python3 benchmarks/nodes.py --deployments 5000

Memory is the mean over the first and over the last fifth of the deployments. The rate stands
beside that of bare rclpy processes that pass the same messages round on the same machine.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

from cases import Benchmark
from kbnitp_msgs.msg import BeliefMaps
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from kbnitp_ros.configuration.starts import awaited_nodes
from kbnitp_ros.nodes.runtime import qos
import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

ORDER = ('recorder', 'estimator', 'agent', 'planner')  # of starts
DEPLOYMENTS = 2000  # unless told otherwise
PERIOD = 0.5  # seconds between two looks
PATIENCE = 60.0  # seconds that a deployment may take
MEBIBYTE = 2**20


@dataclass(frozen=True)
class Sample:
    """
    The nodes at a moment.

    Attributes
    ----------
    time : float
        In seconds.
    deployments : int
        How many the belief held.
    memory : dict of str to dict of str to int
        Of each node's process in bytes: 'Rss' is all that is resident, and in 'Pss' what it shares
        with other processes is divided among them.

    """

    time: float
    deployments: int
    memory: dict[str, dict[str, int]]


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument(
        '--deployments', type=int, default=DEPLOYMENTS, help=f'default {DEPLOYMENTS}'
    )
    deployments = parser.parse_args().deployments
    samples = run_nodes(deployments)
    bare = run_bare(deployments)
    print(table(samples, deployments))
    rate = deployment_rate(samples)
    print(f'\n{deployments} deployments on 9x9 cells, {rate:.1f} a second; bare rclpy passes the')
    print(f'same messages round {bare:.1f} times a second.')


def run_nodes(deployments: int, **common: Any) -> list[Sample]:
    """
    Run a mission of 9x9 cells, or with other parameters in common, and look at its nodes.

    Raises
    ------
    RuntimeError
        If a node ends or nothing happens any more.

    """
    samples: list[Sample] = []
    with TemporaryDirectory() as folder, free_domain() as domain, Processes(domain) as processes:
        parameters = {
            'file': str(Path(folder, 'mission.mcap')),
            'robots': deployments,
            'recorded': True,
            'keep_running': True,
            'planner': 'relaxed',
            **common,
        }
        for name in ORDER:
            awaited = {'await_nodes': awaited_nodes(name, is_recorded=True)}
            processes.start(name, parameters | awaited)
        os.environ |= environment(domain)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node('onlooker')
        beliefs: list[BeliefMaps] = []
        node.create_subscription(BeliefMaps, 'belief', beliefs.append, qos.LATCHED)
        running = processes.started.items()
        held = 0
        heard = time.monotonic()
        with tqdm(total=deployments, unit='deployment', disable=None) as bar:
            while held < deployments:
                # Take the newest belief only: each would slow the nodes down.
                time.sleep(PERIOD)
                rclpy.spin_once(node, timeout_sec=0.0)
                now = time.monotonic()
                if beliefs:
                    heard = now
                    bar.update(beliefs[-1].deployments - held)
                    held = beliefs.pop().deployments
                if 0 < held < deployments:
                    memories = {name: memory(process.pid) for name, process in running}
                    samples.append(Sample(now, held, memories))
                if processes.ended() or now > heard + PATIENCE:
                    raise RuntimeError(f'no belief after {held}; ended are {processes.ended()}')
        node.destroy_node()
        rclpy.shutdown()
    return samples


def deployment_rate(samples: list[Sample]) -> float:
    """Return deployments per second."""
    first, last = samples[0], samples[-1]
    return (last.deployments - first.deployments) / (last.time - first.time)


def memory(pid: int) -> dict[str, int]:
    """Return the Rss and the Pss of a process in bytes."""
    lines = Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines()
    kibibytes = dict(line.split()[:2] for line in lines)
    return {kind: int(kibibytes[f'{kind}:']) * 1024 for kind in ('Rss', 'Pss')}


def run_bare(rounds: int) -> float:
    """Return rounds per second of bare rclpy."""
    program = str(Path(__file__).with_name('ping_pong.py'))
    with free_domain() as domain:
        processes = [
            subprocess.Popen(
                [sys.executable, program, role, str(rounds)],
                env=environment(domain),
                stdout=subprocess.PIPE,
            )
            for role in ('path', 'report', 'belief')
        ]
        printed, _ = processes[0].communicate()
        for process in processes:
            process.kill()
            process.wait()
    return float(printed)


def table(samples: list[Sample], deployments: int) -> str:
    """Return the memory of each node early and late, in Markdown."""
    fifth = deployments // 5
    early = [sample for sample in samples if sample.deployments <= fifth]
    late = [sample for sample in samples if sample.deployments > deployments - fifth]
    lines = [
        f'| node | | 1 to {fifth} | {deployments - fifth + 1} to {deployments} | growth |',
        '|---|---|---|---|---|',
    ]
    for name in samples[0].memory:
        for kind in ('Rss', 'Pss'):
            before, after = (
                np.mean([sample.memory[name][kind] for sample in part]) / MEBIBYTE
                for part in (early, late)
            )
            lines.append(
                f'| {name.strip("/")} | {kind.upper()} | {before:.1f} MiB | {after:.1f} MiB '
                f'| {after / before - 1.0:+.1%} |'
            )
    return '\n'.join(lines)


BENCHMARKS = (
    Benchmark(
        'A deployment over DDS',
        f'Mean time of {DEPLOYMENTS:,} deployments on 9x9 cells with the planner `relaxed`, each '
        'on disk before its robot leaves.\nBare rclpy sends the same messages between three '
        'processes, without planning, learning or recording.',
        {
            'bare rclpy': lambda: 1.0 / run_bare(DEPLOYMENTS),
            'planner, agent, estimator and recorder': lambda: (
                1.0 / deployment_rate(run_nodes(DEPLOYMENTS))
            ),
        },
    ),
)

if __name__ == '__main__':
    main()
