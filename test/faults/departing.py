# SPDX-License-Identifier: Apache-2.0
"""A mission with robots that refuse and crash, under a base whose nodes are killed as well."""

from collections import Counter
import json
import subprocess
import sys
import time

from fickle_robot import CRASHED, UNPLUGGED, WITHOUT_LINK
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.read import LogError
from kbnitp_ros.log.replay import replay
from kbnitp_ros.nodes.robot import NEW_LINKS
from mission import Mission, NAMESPACE, StuckError
from networks import ENVIRONMENT
import numpy as np
from schedule import draw_faults
from unbroken import folded

BASE = ('recorder', 'estimator', 'planner')
SILENT = {
    'silent_loss': True, 'step_period': 0.02, 'return_deadline': 1.0, 'robots': 8, 'max_steps': 8,
    'grid.width': 5, 'grid.height': 5, 'method': 'kappa_bnitp',
}  # fmt: skip


# The most agents of a mission.
MOST_AGENTS = 3

# How long robots may take to be heard again, in seconds, and how long those that came up without a
# link have none, at most.
HEARD_AGAIN, LINK_BACK = 120.0, 4.0


class DepartingMission(Mission):
    """A base, and robots in processes that are started again when they crash."""

    def __init__(self, domain, folder, seed, networks=None):
        self._rng = np.random.default_rng(seed)
        self._networks = networks
        agents = [
            f'scout_{number + 1}' for number in range(self._rng.integers(1, MOST_AGENTS + 1))
        ]
        self._own = {**SILENT, 'agents': agents, 'rolling': bool(self._rng.random() < 0.5)}
        awaited = {'estimator': ['planner', 'recorder'], 'planner': ['estimator', 'recorder']}
        super().__init__(domain, folder, self._own, awaited=awaited)
        if networks is not None:
            # Nodes are started for this machine alone otherwise.
            self.processes._environment |= ENVIRONMENT
        self._field = folder / 'field.json'
        is_apart = networks is not None
        self._field.write_text(json.dumps({'size': [5, 5], 'seed': seed, 'apart': is_apart}))
        self._robots = {}
        # Until when robots have no link, by agent; None as long as they are not up again.
        self._unplugged = {}
        self._crashes_without_link = Counter()

    def __exit__(self, *exception):
        """End all nodes and robots."""
        for robot in self._robots.values():
            robot.kill()
        super().__exit__(*exception)

    def _said(self, agent):
        return self._field.with_name(f'{agent}.txt')

    def _journal(self, agent):
        return self._field.with_name(f'{agent}.jsonl')

    def _start_robot(self, agent):
        command = [sys.executable, __file__.replace('departing', 'fickle_robot'), agent]
        if self._networks is not None:
            network = self._networks.robots[self._own['agents'].index(agent)]
            command = ['ip', 'netns', 'exec', network, *command]
        with self._said(agent).open('ab') as output:
            self._robots[agent] = subprocess.Popen(
                [*command, NAMESPACE, self._field, self._journal(agent)], stderr=output
            )

    def _check_alive(self):
        super()._check_alive()
        for agent, robot in list(self._robots.items()):
            if (code := robot.poll()) is not None:
                if code not in (CRASHED, UNPLUGGED, NEW_LINKS):
                    raise StuckError(f'{agent} ended with {code}')
                self.ended[code] += 1
                if code == UNPLUGGED:
                    self._switch(agent, 'down')
                    self._unplugged[agent] = None
                    self._crashes_without_link[agent] += 1
                self._start_robot(agent)
        for agent, until in list(self._unplugged.items()):
            if until is None and self._has_come_up(agent):
                self._unplugged[agent] = time.monotonic() + self._rng.uniform(0.0, LINK_BACK)
            elif until is not None and time.monotonic() > until:
                del self._unplugged[agent]
                self._switch(agent, 'up')

    def _has_come_up(self, agent):
        """Say whether a robot has come up after each of its crashes that took its link."""
        said = self._said(agent).read_text().count(WITHOUT_LINK)
        return said == self._crashes_without_link[agent]

    def _switch(self, agent, state):
        self._networks.switch(self._own['agents'].index(agent) + 1, state)

    def live(self, _):
        """Run the mission with faults of the base, and return these."""
        for agent in self._own['agents']:
            self._start_robot(agent)
        self.start(*BASE)
        faults = draw_faults(self._rng, 'mixed', self._own['robots'])
        for fault in faults:
            for node in [node for node in fault.pauses if node not in BASE]:
                del fault.pauses[node]
            self.suffer(fault)
        self.until_over()
        # Those that were given up may still come home.
        deadline = time.monotonic() + HEARD_AGAIN
        while time.monotonic() < deadline and not self._is_taken_in(self.logged()):
            self.wait(0.5)
        return faults

    def _is_taken_in(self, logged):
        """Say whether all robots that come home are in the log, and what it says is believed."""
        return not self._unheard(logged) and self._is_believed(logged)

    def _is_believed(self, logged):
        given = folded(self._own, logged).joint.tobytes()
        return np.asarray(self.onlooker.belief.joint).tobytes() == given

    def _unheard(self, logged):
        """Return the deployments from which robots come home that were not heard of yet."""
        reports = logged.reports
        return [
            key
            for key, told in self.journals().items()
            if 'departed' in told and 'lost' not in told
            if not any(each.survived for each in reports.get(key, ()))
        ]

    def journals(self):
        """Return what the robots know of their orders, by deployment."""
        told = {}
        for agent in self._own['agents']:
            path = self._journal(agent)
            lines = path.read_text().splitlines() if path.exists() else []
            for stamp, what, value in map(json.loads, lines):
                told.setdefault(DeploymentKey(agent, stamp), {})[what] = value
        return told

    def findings(self):
        """End all nodes and return what is not as it must be, as `Mission.findings` does."""
        codes = self.processes.stop()
        found = [('exit', f'{name} ended with {code}') for name, code in codes.items() if code]
        found += [('exit', f'{n}: {self.said(n)}') for n in BASE if 'Traceback' in self.said(n)]
        try:
            logged = self.logged()
            reproduced = replay(self.log).reproduced
        except LogError as error:
            return [*found, ('log', str(error))]
        told = self.journals()
        departed = {key for key, each in told.items() if 'departed' in each}
        for key, reports in logged.reports.items():
            if key not in departed:
                found.append(('false', f'{key} did not depart: {reports}'))
            elif 'home' in told[key] and not any(each.survived for each in reports):
                found.append(('false', f'{key} came home: {reports}'))
        found += [('lost', f'{key} departed') for key in departed - logged.reports.keys()]
        if len(logged.reports) != self._own['robots']:
            found.append(('double', f'{len(logged.reports)} deployments: {self._own["robots"]}'))
        if not reproduced:
            found.append(('replay', f'{self.log} does not replay'))
        if not self._is_believed(logged):
            found.append(('belief', 'the belief published last is not that of the log'))
        return found
