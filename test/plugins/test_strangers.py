# SPDX-License-Identifier: Apache-2.0
"""Methods, planners and allocations of other packages are used, or refused with a reason."""

import os
import subprocess
import sys

from extent import some
from kbnitp_ros.core import Belief, Grid, METHODS, plan, SearchOptions, SensorModel
from kbnitp_ros.files import read_yaml
from kbnitp_ros.log.history import read_history
import numpy as np
import pytest
from strangers import install, ROOT
import yaml

pytestmark = pytest.mark.processes

# A method that keeps all losses, a planner that takes the shortest found path, and an allocation
# that sends robots one after another along the best path.
SOURCE = """
from kbnitp_ros.core import PLANNERS, update
from kbnitp_ros.core import KnownModel


class ReturnsFirst(KnownModel):
    def __init__(self, belief, model, unknowns, seed):
        super().__init__(belief, model)
        self._returned, self._losses = belief, ()

    def assimilate(self, observation, robot_type):
        returned, losses = self._returned, self._losses
        if observation.survived:
            returned = update(returned, robot_type.model(self.model), observation)
        else:
            losses = (*losses, (observation, robot_type))
        belief = returned
        for lost, its_type in losses:
            belief = update(belief, its_type.model(self.model), lost)
        self._returned, self._losses, self.belief = returned, losses, belief


def shortest(finder, objective):
    return [min(PLANNERS['relaxed'](finder, objective), key=lambda each: each.path.size)]


def in_turn(robots):
    found = [robot.finder.candidates(robot.objective) for robot in robots]
    return [each[n % len(each)].path for n, each in enumerate(found)]
"""
ADDED = {
    'methods': {'theirs': 'ReturnsFirst'},
    'planners': {'theirs': 'shortest'},
    'allocations': {'theirs': 'in_turn'},
}

STUDY = """
seed: 1
trials: 2
robots: 2
methods: ['mine:ReturnsFirst']
lethalities: [0.5]
grid: {width: 3, height: 3, base: 0}
planning: {planner: 'mine:plan', max_steps: 4, width: 1, max_visits: 3}
world: {hazard_density: 0.15, kappa: 0.8, target_background: 0.1}
sensor: {malfunction: 0.05, false_negative: 0.05, true_positive: 0.95, false_positive: 0.05}
prior: {hazard: 0.15, target: 0.205, kappa: 0.8}
"""

BAD_SOURCE = """
from kbnitp_ros.core import Belief, PLANNERS
from kbnitp_ros.core import KnownModel
from kbnitp_ros.core import Candidate
import numpy as np

number = 3


class Works(KnownModel):
    def assimilate(self, observation, robot_type):
        self.belief = Belief(self.belief.joint)


class Small(KnownModel):
    def assimilate(self, observation, robot_type):
        self.belief = Belief(self.belief.joint[:-1])


class Breaks(KnownModel):
    def assimilate(self, observation, robot_type):
        raise KeyError('nothing here')


class Unlearned:
    def __init__(self, belief, model, unknowns, seed):
        self.belief = belief


class Unnumbered(Unlearned):
    learns, version = False, 0


class Unable(KnownModel):
    pass


def half_way(finder, objective):
    base = finder.grid.base
    return [Candidate(1.0, np.array([base, finder.grid.neighbors(base)[0]]))]


def one_for_all(robots):
    return [robots[0].finder.candidates(robots[0].objective)[0].path]
"""
BAD = {
    'methods': {
        'works': 'Works',
        'small': 'Small',
        'breaks': 'Breaks',
        'unlearned': 'Unlearned',
        'unnumbered': 'Unnumbered',
        'unable': 'Unable',
        'odd': 'number',
        'absent': 'nobody',
        'gone': 'no_such_module:Method',
        'leaves': 'leaver:Method',
        'kappa_bnitp': 'Works',
        'twice': 'Works',
    },
    'planners': {'half_way': 'half_way'},
    'allocations': {'one_for_all': 'one_for_all'},
}


@pytest.fixture(scope='module')
def bad(tmp_path_factory):
    """Return the environment of a machine with packages that have all faults."""
    folder = tmp_path_factory.mktemp('bad')
    folder.joinpath('leaver.py').write_text('raise SystemExit(3)\n')
    install(folder, 'another', BAD_SOURCE, {'methods': {'twice': 'Works'}})
    return install(folder, 'strangers_of_theirs', BAD_SOURCE, BAD)


def run(environment, *command, cwd=None):
    return subprocess.run(
        [sys.executable, *command], env=environment, cwd=cwd, capture_output=True, text=True
    )


@pytest.mark.full
def test_a_demo_runs_with_a_method_a_planner_and_an_allocation_of_another_package(tmp_path):
    environment = install(tmp_path, 'theirs', SOURCE, ADDED)
    done = run(
        environment, '-m', 'kbnitp_ros', 'demo', '--method', 'theirs', '--planner', 'theirs',
        '--allocation', 'theirs', '--agents', '2', '--robots', '4', '--size', '4',
        '--max-steps', '6', '--lethality', '0.5', '--out', 'out', cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert '/belief: 5 of 5 messages reproduced' in done.stdout
    assert len(read_history(tmp_path / 'out/mission.mcap').observations) == 4


@pytest.mark.parametrize('command', some([
    ['demo', '--planner', 'mine:plan', '--method', 'mine:ReturnsFirst', '--robots', '3',
     '--size', '3', '--max-steps', '4', '--out', 'out'],
    ['study', 'study.yaml', '--workers', '2', '--out', 'out'],
    ['forecast', '--set', 'planner=mine:plan', '--set', 'robots=3', '--worlds', '4',
     '--workers', '2'],
]))  # fmt: skip
def test_a_planner_and_a_method_in_a_file_of_the_working_folder_are_used(tmp_path, command):
    plan = "def plan(finder, objective):\n    return PLANNERS['relaxed'](finder, objective)\n"
    tmp_path.joinpath('mine.py').write_text(f'{SOURCE}\n\n{plan}')
    tmp_path.joinpath('study.yaml').write_text(STUDY)
    # Neither the command nor its nodes import from the working folder by themselves.
    environment = {**os.environ, 'PYTHONSAFEPATH': '1'}
    done = run(environment, '-m', 'kbnitp_ros', *command, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert command[0] != 'demo' or '/belief: 4 of 4 messages reproduced' in done.stdout


def test_names_in_logs_and_messages_import_no_module(tmp_path, monkeypatch):
    tmp_path.joinpath('theirs.py').write_text("raise SystemExit('imported')")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="method is 'theirs:Method': known are"):
        METHODS.find('theirs:Method')
    assert 'theirs' not in sys.modules
    METHODS.load('theirs:Method')
    with pytest.raises(ValueError, match="method is 'theirs:Method': SystemExit: imported; known"):
        METHODS.find('theirs:Method')


@pytest.fixture
def small_benchmark(tmp_path):
    """Return a folder with the package beside a benchmark of a small field."""
    scenarios = tmp_path / 'config/scenarios'
    scenarios.mkdir(parents=True)
    # The scenarios beside the package: links stay links.
    tmp_path.joinpath('kbnitp_ros').symlink_to(ROOT / 'kbnitp_ros')
    content = read_yaml(ROOT / 'config/scenarios/benchmark.yaml')
    content['grid'] = {'width': 4, 'height': 4, 'base': 0}
    content['planning']['max_steps'] = 6
    content |= {'trials': 1, 'robots': 2}
    scenarios.joinpath('benchmark.yaml').write_text(yaml.safe_dump(content))
    grid, model = Grid(4, 4), SensorModel(0.5)
    belief = Belief.prior(grid, 0.15, 0.205, 0.8)
    found = plan(grid, belief, model, SearchOptions(max_steps=6))
    np.savez(
        scenarios / 'benchmark_2.npz',
        joint=[belief.joint],
        lethality=[model.lethality],
        bound=[1.1 * found.information],
    )
    return tmp_path


@pytest.mark.full
def test_a_planner_of_another_package_enters_the_benchmark_with_one_command(small_benchmark):
    environment = install(small_benchmark, 'theirs', SOURCE, {'planners': {'theirs': 'shortest'}})
    done = run(
        environment, '-m', 'kbnitp_ros', 'study', 'benchmark', '--workers', '1', '--out', 'out',
        cwd=small_benchmark,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    table = small_benchmark.joinpath('out/benchmark.md').read_text()
    rows = [[cell.strip(' `') for cell in line.split('|')[1:-1]] for line in table.splitlines()]
    entries = {row[0]: row for row in rows if len(row) > 1}
    assert {'random', 'beam', 'theirs'} <= entries.keys()
    least, log_loss, lost = (float(entries['theirs'][column].split()[0]) for column in (3, 5, 7))
    assert 0.0 < least <= float(entries['beam'][3]) <= 1.0
    assert log_loss > 0.0
    assert 0.0 <= lost <= 2.0


OF = 'of strangers_of_theirs 1.0 (entry point'


REASONS = {
    'odd': f'{OF} odd = strangers_of_theirs:number): it is 3: it must be callable with',
    'unlearned': 'it must have an attribute learns that is True or False',
    'unnumbered': 'it must have an attribute version that is a whole number from 1',
    'unable': 'it must have assimilate',
    'absent': f'{OF} absent = strangers_of_theirs:nobody): AttributeError: ',
    'gone': f'{OF} gone = no_such_module:Method): ModuleNotFoundError: No module named',
    'leaves': f'{OF} leaves = leaver:Method): SystemExit: 3',
    'twice': 'another 1.0 (entry point twice = another:Works) and strangers_of_theirs 1.0',
}


def test_a_command_with_a_broken_method_states_the_reason(bad):
    done = run(bad, '-m', 'kbnitp_ros', 'demo', '--method', 'odd')
    assert done.returncode == 2
    _, _, complaint = done.stderr.partition('demo: parameter method is')
    assert REASONS['odd'] in complaint
    assert 'works' in complaint.partition('it must be one of')[2]


def test_broken_packages_are_imported_on_use_and_reported_once_and_the_rest_works(bad):
    program = f"""
import sys
from kbnitp_ros.core import *
grid, model = Grid(3, 3), SensorModel(0.5)
belief = Belief.prior(grid, 0.1, 0.2, 0.3)
plan_team(grid, Estimator(belief, model).belief, model, Team(2), SearchOptions(max_steps=4))
print('strangers_of_theirs' in sys.modules)
print(Estimator(belief, model, 'works').method)
print(*METHODS.added, '|', *METHODS.refused)
print(type(METHODS['kappa_bnitp']).__name__, len(METHODS), len(METHODS))
for name in {list(REASONS)}:
    try:
        Estimator(belief, model, name)
    except ValueError as error:
        print(error)
"""
    done = run(bad, '-c', program)
    is_imported, works, added, own, *lines = done.stdout.splitlines()
    assert (is_imported, works) == ('False', 'works')
    assert set(added.partition('|')[0].split()) == {'works', 'small', 'breaks'}
    assert own.startswith('OnePass 8')
    for line, (name, reason) in zip(lines, REASONS.items(), strict=True):
        assert line.startswith(f"method is '{name}': refused plug-in {OF}")
        assert reason in line
        assert 'works' in line.partition('known are')[2]
    for name in ('odd', 'gone', 'leaves', 'kappa_bnitp'):
        assert done.stderr.count(f"RuntimeWarning: method '{name}': refused plug-in {OF}") == 1
    assert 'kbnitp_ros has a method of this name' in done.stderr


VIOLATIONS = {
    "e = Estimator(belief, model, 'small'); e.assimilate(lost)": (
        f"method 'small' {OF} small = strangers_of_theirs:Small) gives a belief of 8 cells "
        'where the field has 9'
    ),
    "e = Estimator(belief, model, 'breaks'); e.assimilate(lost)": (
        f"method 'breaks' {OF} breaks = strangers_of_theirs:Breaks) failed: KeyError"
    ),
    "e = Estimator(belief, model); plan(grid, belief, model, SearchOptions('half_way', 4))": (
        f"planner 'half_way' {OF} half_way = strangers_of_theirs:half_way) returns an "
        'invalid path: path must end at the base 4'
    ),
    'e = Estimator(belief, model); '
    "plan_team(grid, belief, model, Team(2, 'one_for_all'), SearchOptions(max_steps=4))": (
        f"allocation 'one_for_all' {OF} one_for_all = strangers_of_theirs:one_for_all) "
        'returns 1 paths for 2 robots'
    ),
}


def test_violations_of_the_rules_are_named_and_change_nothing(bad):
    program = f"""
from kbnitp_ros.core import *
from kbnitp_ros.plugins import PluginError
grid, model = Grid(3, 3, base=4), SensorModel(0.5)
belief, lost = Belief.prior(grid, 0.1, 0.2, 0.3), Observation([4, 0, 4], False)
for use in {list(VIOLATIONS)}:
    try:
        exec(use)
    except PluginError as error:
        print(error, e.belief.joint.tobytes() == belief.joint.tobytes())
"""
    done = run(bad, '-c', program)
    for line, told in zip(done.stdout.splitlines(), VIOLATIONS.values(), strict=True):
        assert told in line
        assert line.endswith(' True')
