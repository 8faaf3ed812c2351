# SPDX-License-Identifier: Apache-2.0
"""Networks of their own for a base and its robots, on one machine; whoever makes them is root."""

from contextlib import contextmanager
import ctypes
import os
from pathlib import Path
import subprocess
import time

from kbnitp_ros.files import share
from kbnitp_ros.nodes.runtime.graph import udp_only

SUBNET = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}

# By which nodes on different networks find each other.
ENVIRONMENT = {**SUBNET, **udp_only(SUBNET, share('config'))}

# From linux/sched.h.
CLONE_NEWNET = 0x40000000


class NoNetworksError(Exception):
    """Networks cannot be made here."""


def ip(*arguments):
    """Run `ip` and return what it says; raise NoNetworksError if it cannot do it."""
    try:
        made = subprocess.run(['ip', *arguments], capture_output=True, text=True)
    except FileNotFoundError as error:
        raise NoNetworksError('ip is not installed') from error
    if made.returncode:
        raise NoNetworksError(f'ip {" ".join(arguments)}: {made.stderr.strip()}')
    return made.stdout


class Networks:
    """A network for the base and one for each robot, on one bridge."""

    def __init__(self, robots, multicast=True):
        mark = f'k{os.getpid() % 10_000}'
        self.base = f'{mark}base'
        self.robots = [f'{mark}robot{number}' for number in range(1, robots + 1)]
        self._bridge = f'{mark}bridge'
        self._multicast = multicast

    def make(self):
        """Make them; raise NoNetworksError if that is impossible."""
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
        """Delete those that were made."""
        for name in (self._bridge, self.base, *self.robots):
            subprocess.run(['ip', 'netns', 'delete', name], capture_output=True)

    def switch(self, robot, state):
        """Take the link of a robot, counted from 1, 'up' or 'down'."""
        ip('-n', self._bridge, 'link', 'set', f'outer{robot}', state)
        # The kernel takes up to a second to tell the other end.
        while (' state UP ' in ip('-n', self.robots[robot - 1], 'link', 'show', 'inner')) != (
            state == 'up'
        ):
            time.sleep(0.02)

    def readdress(self):
        """Give the first robot another address."""
        ip('-n', self.robots[0], 'address', 'flush', 'dev', 'inner')
        self._address(self.robots[0], 77)

    def join(self):
        """Have this process, and all that it starts, be on the network of the base."""
        with Path('/run/netns', self.base).open() as network:
            if ctypes.CDLL(None, use_errno=True).setns(network.fileno(), CLONE_NEWNET):
                raise NoNetworksError(f'{self.base}: {os.strerror(ctypes.get_errno())}')


@contextmanager
def networks(robots, multicast=True):
    """Have a network for the base and one for each robot, with multicast or without."""
    made = Networks(robots, multicast)
    try:
        made.make()
        yield made
    finally:
        made.delete()
