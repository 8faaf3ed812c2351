# SPDX-License-Identifier: Apache-2.0
"""Missions that forged messages come to, and what must hold at their end."""

from dataclasses import dataclass, field
import os

from forger import Forger
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import BELIEF
from mission import full_name, Mission, NAMESPACE, StuckError
import numpy as np
from schedule import NODES
from unbroken import core_mission

# A mission that lasts as long as the forgeries do: a robot takes half a second.
PARAMETERS = {
    'grid.width': 5, 'grid.height': 5, 'max_steps': 10, 'robots': 12, 'planner': 'relaxed',
    'step_period': 0.05, 'seed': 5,
}  # fmt: skip

# By how many megabytes a node may grow beyond what it has in an undisturbed mission.
GROWTH = 50.0


@dataclass
class Forged:
    """What became of a mission that forged messages came to."""

    kinds: tuple[str, ...]
    findings: list[tuple[str, str]] = field(default_factory=list)
    refused: dict[str, int] = field(default_factory=dict)
    required: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NODES, 0))
    memory: dict[str, float] = field(default_factory=dict)

    def compare_memory(self, undisturbed):
        """Find nodes that have much more in memory than in a mission without forgeries."""
        for name, now in self.memory.items():
            if now > undisturbed.memory[name] + GROWTH:
                words = f'{name} has {now:.0f} MB, undisturbed {undisturbed.memory[name]:.0f} MB'
                self.findings.append(('memory', words))

    def __str__(self):
        found = ''.join(f'\n  {kind}: {words}' for kind, words in self.findings)
        return f'mission with {", ".join(self.kinds) or "nothing"} forged:{found}'


def run_forged(folder, kinds, scale=1.0, seed=1, processes=Processes):
    """Run a mission and forge messages of some kinds, one after another."""
    parameters = PARAMETERS | {'seed': seed}
    outcome = Forged(tuple(kinds))
    with free_domain() as domain:
        os.environ |= environment(domain) | {'ROS_LOG_DIR': str(folder / 'ros_log')}
        with Mission(domain, folder, parameters, processes=processes) as mission:
            mission.start(*NODES)
            try:
                _forge(mission, parameters, outcome, scale)
            except StuckError as error:
                outcome.findings.append(('stuck', f'{error}: {outcome.required} to be refused'))
                return outcome
            outcome.memory = mission.memory()
            codes = mission.processes.stop()
            bad = {name: code for name, code in codes.items() if code}
            outcome.findings += [('exit', f'{name} ended with {bad[name]}') for name in bad]
            said = [mission.said(name) for name in NODES]
            outcome.findings += [('exit', words) for words in said if 'Traceback' in words]
            outcome.findings += wrong_beliefs(mission.log, parameters)
    return outcome


def _forge(mission, parameters, outcome, scale):
    """Send the forgeries, and wait until the mission is over and all were refused."""
    onlooker = mission.onlooker
    mission.until(lambda: onlooker.evidence.reports, 'report')
    forger = Forger(mission, NAMESPACE, parameters, np.random.default_rng(parameters['seed']))
    for kind in outcome.kinds:
        for node, count in getattr(forger, kind)(scale).items():
            outcome.required[node] += count
    over = f'done: {parameters["robots"]} of {parameters["robots"]} '
    states = onlooker.states
    mission.until(lambda: states.get(full_name('planner'), '').startswith(over), 'end')

    def are_refused():
        outcome.refused = {name: onlooker.refused.get(full_name(name), 0) for name in NODES}
        return all(outcome.refused[name] >= outcome.required[name] for name in NODES)

    mission.until(are_refused, 'refusal of all that was forged')

    def is_recorded():
        *_, last = read_log(mission.log, (BELIEF,))
        return last.message.deployments == parameters['robots']

    mission.until(is_recorded, 'last belief on record')


def wrong_beliefs(log, parameters):
    """Yield what is wrong with the beliefs on record; of views anybody may have sent some."""
    report = replay(log)
    topic = f'{NAMESPACE}/belief'
    for mismatch in report.mismatches:
        if mismatch.topic == topic:
            yield 'replay', str(mismatch)
    *_, last = read_log(log, (BELIEF,))
    unbroken = core_mission(parameters)[-1].belief.joint.tobytes()
    if np.asarray(last.message.joint).tobytes() != unbroken:
        yield 'belief', 'the belief recorded last is not that of core'
