# SPDX-License-Identifier: Apache-2.0
"""Logs of missions for reports, made without running ROS."""

from kbnitp_ros.core import Observation, World
from kbnitp_ros.messages.grids import occupancy_grid
from mission_log import GRID, Mission, MODEL, record
import numpy as np


def random_walk(grid, rng, steps):
    path = [grid.base]
    while len(path) <= steps // 2:
        path.append(int(rng.choice(grid.neighbors(path[-1]))))
    return [*path, *path[-2::-1]] if len(path) > 1 else [grid.base, grid.base]


class Shown(Mission):
    """A mission in a world of its own, which is published, with robots on random walks."""

    def __init__(self, grid=GRID, seed=2, **options):
        self.rng = np.random.default_rng(seed)
        self.world = World.random(grid, self.rng, 0.25, 0.7, 0.2)
        super().__init__(grid=grid, **options)

    def publish_truth(self):
        """Publish the truth, like an agent with publish_truth."""
        for name in ('hazard', 'target'):
            values = getattr(self.world, name).astype(float)
            self.publish(f'scout_1/truth/{name}', occupancy_grid(self.grid, values, self.now))

    def walk(self, steps=8):
        """Return a robot's orders and its observation."""
        path = random_walk(self.grid, self.rng, steps)
        return self.world.traverse(path, MODEL, self.rng)


def single(path, robots=6, with_truth=True, grid=GRID, steps=8):
    """Write the log of a mission whose robots go one after another."""
    return record(path, sent_by_single(robots, with_truth, grid, steps).sent)


def sent_by_single(robots=6, with_truth=True, grid=GRID, steps=8):
    """Return a mission whose robots go one after another."""
    whole = Shown(grid)
    if with_truth:
        whole.publish_truth()
    for _ in range(robots):
        whole.deploy(whole.walk(steps))
    return whole


def team(path, agents=8, rounds=3):
    """Write the log of a team that leaves in rounds, and whose losses are silent."""
    whole = Shown()
    whole.publish_truth()
    late = []
    for number in range(rounds):
        sent = []
        for agent in range(agents):
            seen = whole.walk()
            sent.append((whole.send_out(seen.path, f'scout_{agent + 1}'), seen))
        for place, (key, seen) in enumerate(sent):
            is_late = seen.survived and place % 2 == 0 and number < rounds - 1
            told = Observation(seen.path, False) if is_late else seen
            whole.assimilate(seen.path, *whole.come_back(key, told))
            if is_late:
                late.append((key, seen))
        if number:
            for _ in range(len(late) // 2):
                key, seen = late.pop(0)
                whole.assimilate(seen.path, *whole.come_back(key, seen))
    return record(path, whole.sent), whole
