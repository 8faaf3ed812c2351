# SPDX-License-Identifier: Apache-2.0
"""A mission with robots that refuse and crash, while nodes of its base are killed."""

import json
import subprocess
import sys
import time

from fickle_robot import CRASHED
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.read import LogError
from kbnitp_ros.log.replay import replay
from mission import Mission, NAMESPACE, StuckError
import numpy as np
from unbroken import draw_faults, folded

BASE = ('recorder', 'estimator', 'planner')
SILENT = {
    'silent_loss': True, 'step_period': 0.02, 'return_deadline': 1.0, 'robots': 8, 'max_steps': 8,
    'grid.width': 5, 'grid.height': 5, 'method': 'kappa_bnitp',
}  # fmt: skip


# Maximum number of agents of a mission.
MAX_AGENTS = 3

# Seconds for a restarted robot to publish again.
HEARD_AGAIN = 120.0


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
        self.until_over()
        # Robots that were given up may still return.
        deadline = time.monotonic() + HEARD_AGAIN
        while time.monotonic() < deadline and not self._is_taken_in(self.logged()):
            self.wait(0.5)
        return faults

    def _is_taken_in(self, logged):
        return not self._unheard(logged) and self._is_believed(logged)

    def _is_believed(self, logged):
        given = folded(self._own, logged).joint.tobytes()
        return np.asarray(self.onlooker.belief.joint).tobytes() == given

    def _unheard(self, logged):
        reports = logged.reports
        return [
            key
            for key, told in self.journals().items()
            if 'departed' in told and 'lost' not in told
            if not any(report.survived for report in reports.get(key, ()))
        ]

    def journals(self):
        told = {}
        for agent in self._own['agents']:
            path = self._journal(agent)
            lines = path.read_text().splitlines() if path.exists() else []
            for stamp, what, value in map(json.loads, lines):
                told.setdefault(DeploymentKey(agent, stamp), {})[what] = value
        return told

    def findings(self):
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
            elif 'home' in told[key] and not any(report.survived for report in reports):
                found.append(('false', f'{key} came home: {reports}'))
        found += [('lost', f'{key} departed') for key in departed - logged.reports.keys()]
        # Robots that came back without a step are sent again.
        unmoved = [
            key for key in logged.reports if len({*told.get(key, {}).get('home', [[]])[0]}) == 1
        ]
        robots = self._own['robots'] + len(unmoved)
        if len(logged.reports) != robots:
            found.append(('double', f'{len(logged.reports)} deployments: {robots}'))
        if not reproduced:
            found.append(('replay', f'{self.log} does not replay'))
        if not self._is_believed(logged):
            found.append(('belief', 'the belief published last is not that of the log'))
        return found
