# SPDX-License-Identifier: Apache-2.0
"""Base and robot on two networks, with no way from one to the other while the robot is out."""

from __future__ import annotations

from contextlib import contextmanager, ExitStack
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from extent import FULL
from fleet import FIELD, GRID, SIMULATOR, TARGETS
from kbnitp_ros.log.bag.reader import LogError, read_log
from kbnitp_ros.log.evidence import REPORT
from kbnitp_ros.log.replay import replay
from kbnitp_ros.messages.headers import from_stamp
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]

# How many robots leave, and how long the link is down at least, in seconds.
ROBOTS, LONGEST = (20, 90.0) if FULL else (2, 1.5)

PATIENCE = 120.0


def ip(*arguments):
    return subprocess.run(['ip', *arguments], capture_output=True, text=True)


@contextmanager
def two_networks():
    """Make two networks on one bridge; yield their names, and what switches the link."""
    mark = f'k{os.getpid() % 10_000}'
    base, robot, bridge = f'{mark}base', f'{mark}robot', f'{mark}br'
    try:
        steps = [['link', 'add', bridge, 'type', 'bridge'], ['link', 'set', bridge, 'up']]
        for number, name in enumerate((base, robot), start=1):
            inner, outer = f'{mark}i{number}', f'{mark}o{number}'
            steps += [
                ['netns', 'add', name],
                ['link', 'add', inner, 'type', 'veth', 'peer', 'name', outer],
                ['link', 'set', inner, 'netns', name],
                ['link', 'set', outer, 'master', bridge],
                ['link', 'set', outer, 'up'],
                ['-n', name, 'link', 'set', 'lo', 'up'],
                ['-n', name, 'link', 'set', inner, 'up'],
                ['-n', name, 'address', 'add', f'10.77.0.{number}/24', 'dev', inner],
                ['-n', name, 'route', 'add', '224.0.0.0/4', 'dev', inner],
            ]
        for step in steps:
            made = ip(*step)
            if made.returncode:
                pytest.skip(f'no networks can be made: ip {" ".join(step)}: {made.stderr.strip()}')
        yield base, robot, lambda state: ip('link', 'set', f'{mark}o2', state)
    finally:
        ip('link', 'delete', bridge)
        for name in (base, robot):
            ip('netns', 'delete', name)


def test_each_robot_that_was_out_of_reach_is_reported_once(tmp_path):
    rng = np.random.default_rng(9)
    log = tmp_path / 'log' / 'mission.mcap'
    log.parent.mkdir()
    simulation = tmp_path / 'simulation.json'
    simulation.write_text(
        json.dumps(
            {
                'width': GRID.width,
                'height': GRID.height,
                'blocked': sorted(GRID.blocked),
                'robots': {'/scout_1': [0.5, 0.5]},
                'targets': TARGETS,
                'track': str(tmp_path / 'track.jsonl'),
            }
        )
    )
    environment = {
        **os.environ,
        'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}',
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(ROOT / 'config/fastdds.xml'),
        'RMW_FASTRTPS_USE_QOS_FROM_XML': '1',
        'ROS_LOG_DIR': str(tmp_path / 'ros_log'),
    }
    base_parameters = {**FIELD, 'max_steps': 6}
    nodes = {
        'recorder': {'file': str(log)},
        'estimator': base_parameters,
        'planner': {**base_parameters, 'robots': ROBOTS, 'recorded': True},
        'robot': {
            **base_parameters,
            'nav_namespace': 'scout_1',
            'journal': str(tmp_path / 'scout_1.journal'),
            'await_nodes': ['planner', 'estimator', 'recorder'],
        },
    }
    started = []

    def start(network, *command):
        said = tmp_path / f'{len(started)}.txt'
        with said.open('wb') as output:
            started.append(
                subprocess.Popen(
                    ['ip', 'netns', 'exec', network, sys.executable, *command],
                    stdout=output,
                    stderr=output,
                    env=environment,
                )
            )
        return said

    def start_node(network, name, *remaps):
        given = [f'{each}:={json.dumps(value)}' for each, value in nodes[name].items()]
        options = [word for rule in given for word in ('-p', rule)]
        names = [word for rule in remaps for word in ('-r', rule)]
        return start(network, '-m', 'kbnitp_ros', name, '--ros-args', *options, *names)

    def until(condition, what, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (what, robot_said.read_text(), planner_said.read_text())
            time.sleep(0.02)

    def reports():
        try:
            return [from_stamp(each.message.deployment) for each in read_log(log, [REPORT])]
        except LogError:
            return []

    with ExitStack() as stack:
        base, robot, switch = stack.enter_context(two_networks())
        try:
            start(robot, str(SIMULATOR), str(simulation))
            robot_said = start_node(
                robot,
                'robot',
                '__ns:=/m/scout_1',
                '/tf:=/scout_1/tf',
                '/tf_static:=/scout_1/tf_static',
                'detections:=/scout_1/detections',
            )
            for name in ('recorder', 'estimator'):
                start_node(base, name, '__ns:=/m')
            planner_said = start_node(base, 'planner', '__ns:=/m')
            cuts = []
            for number in range(1, ROBOTS + 1):
                until(
                    lambda n=number: robot_said.read_text().count('leaving on') == n, 'departure'
                )
                switch('down')
                gone = time.monotonic()
                cut = rng.uniform(1.0, LONGEST)
                until(lambda n=number: robot_said.read_text().count('home from') == n, 'return')
                time.sleep(max(0.0, gone + cut - time.monotonic()))
                assert len(reports()) == number - 1
                switch('up')
                cuts.append(time.monotonic() - gone)
                until(lambda n=number: len(reports()) == n, 'report')
            print('cuts', [round(cut, 1) for cut in cuts])
        finally:
            for process in started:
                process.send_signal(signal.SIGINT)
            for process in started:
                process.wait(30)
    assert len(set(reports())) == len(reports()) == ROBOTS
    told = replay(log)
    assert told.reproduced
    assert len(told.evidence.reports) == ROBOTS
