# SPDX-License-Identifier: Apache-2.0
"""
Run missions under random faults; count the faults and the findings.

    python3 test/faults/campaign.py --missions 200 --seed 1
    python3 test/faults/campaign.py --robots --missions 200 --seed 1
    python3 test/faults/campaign.py --forged --missions 100 --seed 1

With `--robots` the robots refuse orders and crash as well, before they depart, at the gate, in the
field and at home. With `--forged` nobody is struck; each mission is sent forged messages of every
kind instead, and floods of them.

A mission is fixed by its seed, but for the moments at which the machine gets round to it: mission
k of a campaign has the seed of the campaign plus k, so that `--missions 1 --seed N` runs it again.
"""

import argparse
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
import os
from pathlib import Path
import shutil
import sys
import tempfile
import time
from typing import Any

from departing import DepartingMission
from fickle_robot import CRASHED
from forger import FORGERIES, run_forged
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from mission import full_name, Mission, StuckError
import numpy as np
from tqdm import tqdm
from unbroken import draw_faults, draw_parameters, KINDS, NODES

# Kinds of findings, and their columns in the table.
FINDINGS = {
    'stuck': 'missions that did not end', 'lost': 'deployments lost',
    'false': 'reports of robots that did not depart, or came home',
    'double': 'deployments counted twice', 'belief': 'beliefs that are not those of core',
    'replay': 'logs that do not replay', 'log': 'logs that cannot be read',
    'exit': 'nodes that ended badly',
}  # fmt: skip

Run = Callable[[tuple[int, str, Path]], 'Outcome']


@dataclass
class Outcome:
    seed: int
    kind: str
    folder: Path
    faults: Counter[str] = field(default_factory=Counter)
    strikes: Counter[tuple[str, str]] = field(default_factory=Counter)
    crashes: Counter[int] = field(default_factory=Counter)
    findings: list[tuple[str, str]] = field(default_factory=list)
    unused: int = 0
    seconds: float = 0.0

    def __str__(self) -> str:
        found = ''.join(f'\n  {kind}: {words}' for kind, words in self.findings)
        return f'mission --kind {self.kind} --seed {self.seed} in {self.folder}:{found}'


def run_mission(
    job: tuple[int, str, Path],
    processes: type[Processes] = Processes,
    has_robots: bool = False,
) -> Outcome:
    """Run the mission of a seed under faults of a kind, perhaps with robots that crash."""
    seed, kind, folder = job
    rng = np.random.default_rng(seed)
    parameters = draw_parameters(rng)
    outcome = Outcome(seed, kind, folder / f'{kind}-{seed}')
    begun = time.monotonic()
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        os.environ |= environment(domain) | {'ROS_LOG_DIR': str(outcome.folder / 'ros_log')}
        mission: Any = stack.enter_context(
            DepartingMission(domain, outcome.folder, seed)
            if has_robots
            else Mission(domain, outcome.folder, parameters, processes=processes)
        )
        try:
            if has_robots:
                faults = mission.live(None)
            else:
                faults = draw_faults(rng, kind, parameters['robots'])
                mission.live(faults, is_ended=bool(rng.random() < 0.25))
            for fault in faults:
                outcome.faults[fault.kind] += 1
                outcome.faults['held'] += fault.is_held
                outcome.strikes.update((fault.kind, node) for node in fault.pauses)
            outcome.findings = mission.findings()
            outcome.unused = mission.unused
        except StuckError as error:
            outcome.findings = [('stuck', str(error))]
        outcome.crashes = mission.ended
    outcome.seconds = time.monotonic() - begun
    if not outcome.findings:
        shutil.rmtree(outcome.folder)
    return outcome


def run_missions(
    jobs: list[tuple[int, str, Path]], parallel: int = 2, run: Run = run_mission
) -> list[Outcome]:
    outcomes = []
    # A new process each: one that joined a ROS domain keeps its state.
    with get_context('spawn').Pool(parallel, maxtasksperchild=1) as pool:
        bar = tqdm(total=len(jobs), unit='mission', disable=None)
        for outcome in pool.imap_unordered(run, jobs):
            outcomes.append(outcome)
            bar.update()
            if outcome.findings:
                bar.write(str(outcome))
        bar.close()
    return outcomes


def table(outcomes: list[Outcome]) -> str:
    strikes = sum((outcome.strikes for outcome in outcomes), Counter())
    faults = sum((outcome.faults for outcome in outcomes), Counter())
    found = Counter(kind for outcome in outcomes for kind, _ in outcome.findings)
    crashes = sum((outcome.crashes for outcome in outcomes), Counter())
    seconds = [outcome.seconds for outcome in outcomes]
    rows = [('missions', len(outcomes))]
    for node in NODES:
        kills = sum(strikes[kind, node] for kind in ('kill', 'two', 'all'))
        rows.append((f'SIGKILLs of the {node}', kills))
    rows += [(f'SIGSTOPs of the {node}', strikes['stop', node]) for node in NODES]
    rows += [('robots that crashed', crashes[CRASHED])]
    rows += [('two nodes killed at once', faults['two'])]
    rows += [('all nodes killed at once', faults['all'])]
    rows += [('faults in a pause of the operator', faults['held'])]
    rows += [(words, found[kind]) for kind, words in FINDINGS.items()]
    rows += [('paths that no robot took', sum(outcome.unused for outcome in outcomes))]
    rows += [('seconds a mission, mean', f'{np.mean(seconds):.1f}')]
    rows += [('seconds a mission, longest', f'{max(seconds):.1f}')]
    return '\n'.join(['| what | count |', '|---|---|', *(f'| {a} | {b} |' for a, b in rows)])


def run_forged_missions(missions: int, seed: int, scale: float, folder: Path) -> int:
    """Run missions under all forgeries and print results; return 1 if any fails."""
    outcomes = []
    failed = []
    for number in tqdm(range(seed, seed + missions), unit='mission'):
        outcome = run_forged(folder / f'forged-{number}', FORGERIES, scale, number)
        outcomes.append(outcome)
        if outcome.findings:
            failed.append(number)
            tqdm.write(f'--forged --missions 1 --seed {number}: {outcome}')
    print('| node | refused | at least | most memory | most growth |')
    print('|---|---|---|---|---|')
    for node in NODES:
        refused = sum(outcome.refused.get(node, 0) for outcome in outcomes)
        required = sum(outcome.required[node] for outcome in outcomes)
        name = full_name(node)
        ended = [(each.after[name], each.before[name]) for each in outcomes if each.after]
        memory = max((after for after, _ in ended), default=0.0)
        growth = max((after - before for after, before in ended), default=0.0)
        print(f'| {node} | {refused} | {required} | {memory:.0f} MB | {growth:.0f} MB |')
    print(f'\n{missions} missions, of which {len(failed)} did not end as they must.')
    if failed:
        print(f'Seeds of these: {", ".join(map(str, failed))}.')
    return 1 if failed else 0


def main() -> int:
    """Run the command; return 1 if there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--missions', type=int, default=200, help='how many; default 200')
    parser.add_argument('--seed', type=int, default=1, help='of the first; default 1')
    parser.add_argument('--kind', choices=KINDS, default='mixed', help='of faults; default mixed')
    parser.add_argument('--parallel', type=int, default=2, help='how many at a time; default 2')
    parser.add_argument('--robots', action='store_true', help='have robots refuse and crash, too')
    parser.add_argument('--forged', action='store_true', help='send forged messages instead')
    parser.add_argument(
        '--scale', type=float, default=1.0, help='of the number of forged messages; default 1'
    )
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix='campaign-'))
    if options.forged:
        return run_forged_missions(options.missions, options.seed, options.scale, folder)
    seeds = range(options.seed, options.seed + options.missions)
    begun = time.monotonic()
    run = run_mission
    if options.robots:
        run = partial(run_mission, has_robots=True)
    jobs = [(seed, options.kind, folder) for seed in seeds]
    outcomes = run_missions(jobs, options.parallel, run)
    print(table(outcomes))
    print(f'\nSeeds {seeds[0]} to {seeds[-1]}, {time.monotonic() - begun:.0f} s in all.')
    failed = [outcome for outcome in outcomes if outcome.findings]
    print(*failed, sep='\n')
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
