# SPDX-License-Identifier: Apache-2.0
"""A mission whose base is on another network than its robots, and these networks."""

from contextlib import contextmanager, ExitStack
import ctypes
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from fleet import FIELD, GRID, SIMULATOR, TARGETS
from kbnitp_ros.configuration.starts import awaited_nodes
from kbnitp_ros.files import share
from kbnitp_ros.log.read import LogError, read_log
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.topics import REPORT
from kbnitp_ros.nodes.robot import NEW_LINKS
from kbnitp_ros.nodes.runtime.graph import udp_only
import pytest

SUBNET = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}

# Environment of nodes that discover each other across networks.
ENVIRONMENT = {**SUBNET, **udp_only(SUBNET, share('config'))}

# From linux/sched.h.
CLONE_NEWNET = 0x40000000


class NoNetworksError(Exception):
    """This machine cannot make networks."""


def ip(*arguments):
    """Run `ip` and return its output; raise NoNetworksError if it fails."""
    try:
        made = subprocess.run(['ip', *arguments], capture_output=True, text=True)
    except FileNotFoundError as error:
        raise NoNetworksError('ip is not installed') from error
    if made.returncode:
        raise NoNetworksError(f'ip {" ".join(arguments)}: {made.stderr.strip()}')
    return made.stdout


class Networks:
    """A network for the base and one for each robot, joined by a bridge."""

    def __init__(self, robots, multicast=True):
        mark = f'k{os.getpid() % 10_000}'
        self.base = f'{mark}base'
        self.robots = [f'{mark}robot{number}' for number in range(1, robots + 1)]
        self._bridge = f'{mark}bridge'
        self._multicast = multicast

    def make(self):
        bridge = self._bridge
        ip('netns', 'add', bridge)
        ip('-n', bridge, 'link', 'add', 'bridge', 'type', 'bridge')
        ip('-n', bridge, 'link', 'set', 'bridge', 'up')
        for number, name in enumerate([self.base, *self.robots]):
            outer = f'outer{number}'
            pair = ['type', 'veth', 'peer', 'name', outer]
            ip('netns', 'add', name)
            ip('-n', bridge, 'link', 'add', 'inner', *pair)
            ip('-n', bridge, 'link', 'set', 'inner', 'netns', name)
            ip('-n', bridge, 'link', 'set', outer, 'master', 'bridge')
            ip('-n', bridge, 'link', 'set', outer, 'up')
            ip('-n', name, 'link', 'set', 'lo', 'up')
            ip('-n', name, 'link', 'set', 'inner', 'up')
            self._address(name, number + 1)
            slave = ['-n', bridge, 'link', 'set', outer, 'type', 'bridge_slave']
            if number:
                ip(*slave, 'isolated', 'on')
            if not self._multicast:
                ip(*slave, 'mcast_flood', 'off')
        if not self._multicast:
            snooping = ['type', 'bridge', 'mcast_snooping', '0']
            ip('-n', bridge, 'link', 'set', 'bridge', *snooping)

    @staticmethod
    def _address(name, number):
        ip('-n', name, 'address', 'add', f'10.77.0.{number}/24', 'dev', 'inner')
        ip('-n', name, 'route', 'add', '224.0.0.0/4', 'dev', 'inner')

    def delete(self):
        for name in (self._bridge, self.base, *self.robots):
            subprocess.run(['ip', 'netns', 'delete', name], capture_output=True)

    def switch(self, robot, state):
        ip('-n', self._bridge, 'link', 'set', f'outer{robot}', state)
        # The kernel takes up to a second to notify the other end.
        while (' state UP ' in ip('-n', self.robots[robot - 1], 'link', 'show', 'inner')) != (
            state == 'up'
        ):
            time.sleep(0.02)

    def readdress(self):
        ip('-n', self.robots[0], 'address', 'flush', 'dev', 'inner')
        self._address(self.robots[0], 77)

    def join(self):
        """Move this process, and all that it starts, to the network of the base."""
        with Path('/run/netns', self.base).open() as network:
            if ctypes.CDLL(None, use_errno=True).setns(network.fileno(), CLONE_NEWNET):
                raise NoNetworksError(f'{self.base}: {os.strerror(ctypes.get_errno())}')


@contextmanager
def networks(robots, multicast=True):
    made = Networks(robots, multicast)
    try:
        made.make()
        yield made
    finally:
        made.delete()


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
        # The targets of each robot identify its reports.
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
                'await_nodes': awaited_nodes('robot', is_recorded=True),
            },
            '__ns:=/m/scout_1',
            '/tf:=/scout_1/tf',
            '/tf_static:=/scout_1/tf_static',
            'detections:=/scout_1/detections',
        )
        self._robots_said.append(said)
        self._robots.append((self._started[-1], number, network, parameters))

    def _start_again(self):
        """Restart robots whose computers have new links, as launch does."""
        for started in self._robots.copy():
            process, *robot = started
            if process.poll() == NEW_LINKS:
                self._robots.remove(started)
                self._start_robot(*robot)

    def switch(self, state):
        """Set the links of all robots 'up' or 'down'."""
        for number in range(1, len(self._networks.robots) + 1):
            self._networks.switch(number, state)

    def readdress(self):
        """Change the address of the first robot."""
        self._networks.readdress()

    def reboot(self):
        """Cut the power of the robots' computers and switch them on again."""
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
        return [*(each[0] for each in self._simulators), *(robot[0] for robot in self._robots)]

    def _simulation(self, number, targets):
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
        """Return how often the robots have published a message."""
        return sum(said.read_text().count(words) for said in self._robots_said)

    def reports(self):
        try:
            return [from_stamp(each.message.deployment) for each in read_log(self.log, [REPORT])]
        except LogError:
            return []

    def end(self):
        for process in self._started:
            process.send_signal(signal.SIGINT)
        for process in self._started:
            process.wait(30)


@contextmanager
def apart(folder, robots, namesakes=1, discovery=None, **planner):
    with ExitStack() as stack:
        try:
            made = stack.enter_context(networks(namesakes, multicast=not discovery))
        except NoNetworksError as error:
            pytest.skip(f'no networks can be made: {error}')
        mission = Apart(folder, made, robots, discovery or {}, planner)
        stack.callback(mission.end)
        yield mission
