# SPDX-License-Identifier: Apache-2.0
"""Base and robots on networks of their own, joined by links that can be taken down."""

from contextlib import contextmanager, ExitStack
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from fleet import FIELD, GRID, SIMULATOR, TARGETS
from kbnitp_ros.log.read import LogError, read_log
from kbnitp_ros.log.roles import REPORT
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.robot import NEW_LINKS
from networks import ENVIRONMENT, networks, NoNetworksError
import pytest

ROOT = Path(__file__).parents[2]

PATIENCE = 120.0


class Apart:
    """A mission of one agent, whose base is on another network than robot and simulator."""

    def __init__(self, folder, networks, robots, discovery, planner):
        base, own = networks.base, networks.robots
        self._networks = networks
        self._folder = folder
        self._started = []
        self.log = folder / 'log' / 'mission.mcap'
        self.log.parent.mkdir()
        base_parameters = {**FIELD, 'max_steps': 6}
        self._environment = {
            **os.environ,
            'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}',
            **ENVIRONMENT,
            'ROS_LOG_DIR': str(folder / 'ros_log'),
            **discovery,
        }
        if 'ROS_DISCOVERY_SERVER' in discovery:
            address, port = discovery['ROS_DISCOVERY_SERVER'].split(':')
            server = ['fast-discovery-server', '-i', '0', '-l', address, '-p', port]
            self._started.append(subprocess.Popen(['ip', 'netns', 'exec', base, *server]))
        # Each robot has targets elsewhere, so that reports tell which it was.
        others = sorted(set(range(GRID.cells)) - set(TARGETS))
        self._simulators = []
        self._robots = []
        self._robots_said = []
        for number, (network, targets) in enumerate(zip(own, (TARGETS, others)), 1):
            simulation = str(self._simulation(number, targets))
            self._start_simulator(network, simulation)
        for number, network in enumerate(own, 1):
            self._start_robot(number, network, base_parameters)
        for name, parameters in (
            ('recorder', {'file': str(self.log)}),
            ('estimator', base_parameters),
            ('planner', {**base_parameters, 'robots': robots, 'recorded': True, **planner}),
        ):
            self._planner_said = self._start_node(base, name, parameters, '__ns:=/m')

    def _start_simulator(self, network, simulation):
        self._start(network, str(SIMULATOR), simulation)
        self._simulators.append((self._started[-1], network, simulation))

    def _start_robot(self, number, network, parameters):
        said = self._start_node(
            network,
            'robot',
            {
                **parameters,
                'nav_namespace': 'scout_1',
                'journal': str(self._folder / f'{number}.journal'),
                'await_nodes': ['planner', 'estimator', 'recorder'],
            },
            '__ns:=/m/scout_1',
            '/tf:=/scout_1/tf',
            '/tf_static:=/scout_1/tf_static',
            'detections:=/scout_1/detections',
        )
        self._robots_said.append(said)
        self._robots.append((self._started[-1], number, network, parameters))

    def _start_again(self):
        """Start robots again whose computers have new links, as launch does."""
        for each in self._robots.copy():
            process, *robot = each
            if process.poll() == NEW_LINKS:
                self._robots.remove(each)
                self._start_robot(*robot)

    def switch(self, state):
        """Take the links of the robots 'up' or 'down'."""
        for number in range(1, len(self._networks.robots) + 1):
            self._networks.switch(number, state)

    def readdress(self):
        """Give the first robot another address."""
        self._networks.readdress()

    def reboot(self):
        """Cut the power of the robots' computers, and switch them on again."""
        for process in self._robots_computers():
            process.kill()
            process.wait()
        simulators, self._simulators = self._simulators, []
        robots, self._robots = self._robots, []
        for _, *simulator in simulators:
            self._start_simulator(*simulator)
        for _, *robot in robots:
            self._start_robot(*robot)

    def _robots_computers(self):
        return [*(each[0] for each in self._simulators), *(each[0] for each in self._robots)]

    def _simulation(self, number, targets):
        """Write what a simulator needs to know, and return its file."""
        folder = self._folder / str(number)
        folder.mkdir()
        file = folder / 'simulation.json'
        file.write_text(
            json.dumps(
                {
                    'width': GRID.width,
                    'height': GRID.height,
                    'blocked': sorted(GRID.blocked),
                    'robots': {'/scout_1': [0.5, 0.5]},
                    'targets': targets,
                    'placed': [0.0, 0.0, 0.0],
                    'datum': [],
                    'detection_type': 'bool',
                    'lifecycle': True,
                    'track': str(folder / 'track.jsonl'),
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
            self._start_again()
            told = [said.read_text() for said in (*self._robots_said, self._planner_said)]
            assert time.monotonic() < end, (what, *told)
            time.sleep(0.02)

    def count(self, words):
        """Return how often the robots have said something."""
        return sum(said.read_text().count(words) for said in self._robots_said)

    def reports(self):
        """Return the stamps of the deployments of all reports on record."""
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
def apart(folder, robots, namesakes=1, discovery=None, **planner):
    """Have a mission run whose base is apart from its robots; it is over when this is left."""
    with ExitStack() as stack:
        try:
            made = stack.enter_context(networks(namesakes, multicast=not discovery))
        except NoNetworksError as error:
            pytest.skip(f'no networks can be made: {error}')
        mission = Apart(folder, made, robots, discovery or {}, planner)
        stack.callback(mission.end)
        yield mission
