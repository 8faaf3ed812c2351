# SPDX-License-Identifier: Apache-2.0
"""Base and robot on two networks, joined by a link that can be taken down."""

from __future__ import annotations

from contextlib import contextmanager
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from fleet import FIELD, GRID, SIMULATOR, TARGETS
from kbnitp_ros.log.bag.reader import LogError, read_log
from kbnitp_ros.log.evidence import REPORT
from kbnitp_ros.messages.headers import from_stamp
import pytest

ROOT = Path(__file__).parents[2]

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


class Apart:
    """
    A mission of one robot, whose base is on another network than the robot and its simulator.

    Parameters
    ----------
    folder : Path
        Where everything is kept.
    networks : tuple
        What `two_networks` yields.
    robots : int
        How many robots leave, one after another.

    Attributes
    ----------
    log : Path
        Of the mission.
    switch : callable
        Takes the link 'up' or 'down'.

    """

    def __init__(self, folder, networks, robots):
        base, robot, self.switch = networks
        self._folder = folder
        self._started = []
        self.log = folder / 'log' / 'mission.mcap'
        self.log.parent.mkdir()
        base_parameters = {**FIELD, 'max_steps': 6}
        self._environment = {
            **os.environ,
            'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}',
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
            'FASTRTPS_DEFAULT_PROFILES_FILE': str(ROOT / 'config/fastdds.xml'),
            'RMW_FASTRTPS_USE_QOS_FROM_XML': '1',
            'ROS_LOG_DIR': str(folder / 'ros_log'),
        }
        self._start(robot, str(SIMULATOR), str(self._simulation()))
        self._robot_said = self._start_node(
            robot,
            'robot',
            {
                **base_parameters,
                'nav_namespace': 'scout_1',
                'journal': str(folder / 'scout_1.journal'),
                'await_nodes': ['planner', 'estimator', 'recorder'],
            },
            '__ns:=/m/scout_1',
            '/tf:=/scout_1/tf',
            '/tf_static:=/scout_1/tf_static',
            'detections:=/scout_1/detections',
        )
        for name, parameters in (
            ('recorder', {'file': str(self.log)}),
            ('estimator', base_parameters),
            ('planner', {**base_parameters, 'robots': robots, 'recorded': True}),
        ):
            self._planner_said = self._start_node(base, name, parameters, '__ns:=/m')

    def _simulation(self):
        """Write what the simulator needs to know, and return its file."""
        file = self._folder / 'simulation.json'
        file.write_text(
            json.dumps(
                {
                    'width': GRID.width,
                    'height': GRID.height,
                    'blocked': sorted(GRID.blocked),
                    'robots': {'/scout_1': [0.5, 0.5]},
                    'targets': TARGETS,
                    'detection_type': 'bool',
                    'track': str(self._folder / 'track.jsonl'),
                }
            )
        )
        return file

    def _start(self, network, *command):
        said = self._folder / f'{len(self._started)}.txt'
        with said.open('wb') as output:
            self._started.append(
                subprocess.Popen(
                    ['ip', 'netns', 'exec', network, sys.executable, *command],
                    stdout=output,
                    stderr=output,
                    env=self._environment,
                )
            )
        return said

    def _start_node(self, network, name, parameters, *remaps):
        given = [f'{each}:={json.dumps(value)}' for each, value in parameters.items()]
        options = [word for rule in given for word in ('-p', rule)]
        names = [word for rule in remaps for word in ('-r', rule)]
        return self._start(network, '-m', 'kbnitp_ros', name, '--ros-args', *options, *names)

    def until(self, condition, what, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not condition():
            told = self._robot_said.read_text(), self._planner_said.read_text()
            assert time.monotonic() < end, (what, *told)
            time.sleep(0.02)

    def count(self, words):
        """Return how often the robot has said something."""
        return self._robot_said.read_text().count(words)

    def reports(self):
        """Return the stamps of the deployments whose reports are on record, one for each."""
        try:
            return [from_stamp(each.message.deployment) for each in read_log(self.log, [REPORT])]
        except LogError:
            return []

    def end(self):
        """End all processes as Ctrl-C does."""
        for process in self._started:
            process.send_signal(signal.SIGINT)
        for process in self._started:
            process.wait(30)


@contextmanager
def apart(folder, robots):
    """Have a mission of so many robots run on two networks; it is over when this is left."""
    with two_networks() as networks:
        mission = Apart(folder, networks, robots)
        try:
            yield mission
        finally:
            mission.end()
