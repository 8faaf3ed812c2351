# SPDX-License-Identifier: Apache-2.0
"""A mission with robots that refuse and crash, while nodes of its base are killed."""

import json
import subprocess
import sys
import time

from fickle_robot import CRASHED
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.read import LogError
from kbnitp_ros.log.replay import replay
from mission import Mission, NAMESPACE, PATIENCE, StuckError
import numpy as np
from unbroken import draw_faults, folded

BASE = ('recorder', 'estimator', 'planner')
SILENT = {
    'silent_loss': True, 'step_period': 0.02, 'return_deadline': 1.0, 'robots': 8, 'max_steps': 8,
    'grid.width': 5, 'grid.height': 5, 'method': 'kappa_bnitp',
}  # fmt: skip


# Maximum number of agents of a mission.
MAX_AGENTS = 3


class DepartingMission(Mission):
    """A base, and robots in processes that are restarted after crashes."""

    def __init__(self, domain, folder, seed):
        self._rng = np.random.default_rng(seed)
        agents = [f'scout_{number + 1}' for number in range(self._rng.integers(1, MAX_AGENTS + 1))]
        self._own = {**SILENT, 'agents': agents, 'rolling': bool(self._rng.random() < 0.5)}
        awaited = {'estimator': ['planner', 'recorder'], 'planner': ['estimator', 'recorder']}
        super().__init__(domain, folder, self._own, awaited=awaited)
        self._field = folder / 'field.json'
        self._field.write_text(json.dumps({'size': [5, 5], 'seed': seed}))
        self._robots = {}

    def __exit__(self, *exception):
        for robot in self._robots.values():
            robot.kill()
        super().__exit__(*exception)

    def _said(self, agent):
        return self._field.with_name(f'{agent}.txt')

    def _journal(self, agent):
        return self._field.with_name(f'{agent}.jsonl')

    def _start_robot(self, agent):
        command = [sys.executable, __file__.replace('departing', 'fickle_robot'), agent]
        with self._said(agent).open('ab') as output:
            self._robots[agent] = subprocess.Popen(
                [*command, NAMESPACE, self._field, self._journal(agent)], stderr=output
            )

    def _check_alive(self):
        super()._check_alive()
        for agent, robot in list(self._robots.items()):
            if (code := robot.poll()) is not None:
                if code != CRASHED:
                    raise StuckError(f'{agent} ended with {code}')
                self.ended[code] += 1
                self._start_robot(agent)

    def live(self, _):
        """Run the mission under faults of the base; return the faults."""
        for agent in self._own['agents']:
            self._start_robot(agent)
        self.start(*BASE)
        faults = draw_faults(self._rng, 'mixed', self._own['robots'])
        for fault in faults:
            for node in [node for node in fault.pauses if node not in BASE]:
                del fault.pauses[node]
            self.suffer(fault)
        # Robots that were given up may return, and others replace those that did not move.
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            self.wait(0.5)
            if self.log.exists():
                logged = self.logged()
                if not self._misjudged(logged) and self._is_believed(logged):
                    break
        return faults

    def _is_believed(self, logged):
        given, belief = folded(self._own, logged).joint.tobytes(), self.onlooker.belief
        return belief is not None and np.asarray(belief.joint).tobytes() == given

    def journals(self):
        told = {}
        for agent in self._own['agents']:
            path = self._journal(agent)
            lines = path.read_text().splitlines() if path.exists() else []
            for stamp, what, value in map(json.loads, lines):
                told.setdefault(DeploymentKey(agent, stamp), {})[what] = value
        return told

    def _misjudged(self, logged):
        """Return contradictions between the reports in the log and the robots' journals."""
        told, found = self.journals(), []
        departed = {key for key, each in told.items() if 'departed' in each}
        for key, reports in logged.reports.items():
            if key not in departed:
                found.append(('false', f'{key} did not depart: {reports}'))
            elif 'home' in told[key] and not any(report.survived for report in reports):
                found.append(('false', f'{key} came home: {reports}'))
        found += [('lost', f'{key} departed') for key in departed - logged.reports.keys()]
        out = [key for key in departed if not told[key].keys() & {'home', 'lost'}]
        found += [('stuck', f'{key} is out') for key in out]
        # Robots that came back without a step are sent again.
        unmoved = [
            key for key in logged.reports if len({*told.get(key, {}).get('home', [[]])[0]}) == 1
        ]
        robots = self._own['robots'] + len(unmoved)
        if len(logged.reports) != robots:
            found.append(('double', f'{len(logged.reports)} deployments: {robots}'))
        return found

    def findings(self):
        codes = self.processes.stop()
        found = [('exit', f'{name} ended with {code}') for name, code in codes.items() if code]
        found += [('exit', f'{n}: {self.said(n)}') for n in BASE if 'Traceback' in self.said(n)]
        try:
            logged = self.logged()
            replayed = replay(self.log)
        except LogError as error:
            return [*found, ('log', str(error))]
        found += self._misjudged(logged)
        if not replayed.reproduced:
            found.append(('replay', '\n'.join(lines(replayed))))
        if not self._is_believed(logged):
            found.append(('belief', 'the belief published last is not that of the log'))
        return found
