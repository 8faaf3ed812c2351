# SPDX-License-Identifier: Apache-2.0
"""The study command: complete, interrupted and refused studies."""

import contextlib
import os
from pathlib import Path
import random
import re
import shutil
import signal
import subprocess
import sys
import time

from extent import FULL, some
from kbnitp_ros.cli.study import parse, study
from kbnitp_ros.study import comparing
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import ALONE, INDEPENDENT, NUMBERS, RIGHT, STILL
from kbnitp_ros.study.scenario_file import read_study, scenario_file
from kbnitp_ros.study.workers import Folder
from launches import run_on_terminal
from laws import for_each
import pytest
import small_study
import yaml

STUDY = [sys.executable, '-m', 'kbnitp_ros', 'study']
PATIENCE = 300.0
PICTURES = [
    f'{name}.{suffix}'
    for name in ('entropy', 'log_loss', 'differences', 'final')
    for suffix in ('png', 'pdf')
]
LEFT = ['table.csv', *PICTURES, 'summary.md', 'summary.tex', 'scenario.yaml']

SCENARIO = {
    **small_study.CONTENT,
    'trials': 10,
    'robots': 12,
    'methods': ['kappa_bnitp_published', 'kappa_bnitp'],
    'lethalities': [0.1, 0.9],
    'grid': {'width': 5, 'height': 5, 'base': 0},
    'planning': {'planner': 'relaxed', 'max_steps': 10, 'width': 1, 'max_visits': 3},
}
TRIALS = 10 * 2 * 2


def command(scenario, out, *options):
    return [*STUDY, str(scenario), '--out', str(out), *map(str, options)]


def run_study(*arguments):
    return subprocess.run(
        command(*arguments),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        stdin=subprocess.DEVNULL,
    )


@pytest.fixture
def unsaved(monkeypatch):
    """Save no figures, which takes most of the time of a small study."""
    monkeypatch.setattr(comparing, 'save', lambda *_: [])


def refusal(capsys, scenario, out, *options):
    assert study(parse([str(scenario), '--out', str(out), *map(str, options)])) == 2
    return capsys.readouterr().err


def write(path, **changes):
    path.write_text(yaml.safe_dump({**SCENARIO, **changes}))
    return path


@pytest.fixture(scope='module')
def scenario(tmp_path_factory):
    return write(tmp_path_factory.mktemp('scenario') / 'scenario.yaml')


@pytest.fixture(scope='module')
def whole(tmp_path_factory, scenario):
    """Return the folder of an uninterrupted study in one process."""
    out = tmp_path_factory.mktemp('whole')
    done = run_study(scenario, out, '--workers', 1)
    assert done.returncode == 0, done.stderr
    assert all(f'wrote {out / name}' in done.stdout for name in LEFT[:-1])
    return out


@pytest.fixture
def start():
    started = []

    def start(scenario, out, enough):
        process = subprocess.Popen(
            command(scenario, out, '--workers', 2),
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        deadline = time.monotonic() + PATIENCE
        while len(list(out.glob('trials/*.npz'))) < enough and time.monotonic() < deadline:
            time.sleep(0.005)
        return process

    yield start
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.slow
def test_a_study_beyond_memory_is_refused_with_an_estimate(capsys, tmp_path):
    large = {'grid': {'width': 1000, 'height': 1000, 'base': 0}}
    planning = {'planner': 'beam', 'max_steps': 10**6, 'width': 1, 'max_visits': 10**6}
    for changes, told in (
        (
            {**large, 'robots': 100},
            r'a mission of 100 robots on 1000000 cells takes about 3\.2 GB',
        ),
        ({'trials': 10**5}, r'400000 missions of 12 robots .* GB.*lower'),
        ({'planning': planning}, 'planning: .*max_steps = 1000000.* takes about .* GB'),
    ):
        out = tmp_path / 'out'
        said = refusal(capsys, write(tmp_path / 'large.yaml', **changes), out)
        assert re.fullmatch(f'study: .*{told}.*\n', said), said
        assert not out.exists()


@pytest.mark.processes
@pytest.mark.usefixtures('unsaved')
def test_a_study_leaves_its_table_figures_and_summary_and_runs_no_trial_again(scenario, whole):
    results = Results.read(whole)
    assert results.axes == ['lethality']
    table = results.to_dataframe()
    assert set(table['world']) == set(range(10))
    assert set(table['robot']) == set(range(13))
    for name in ('entropy.png', 'log_loss.png', 'differences.png', 'final.png'):
        assert (whole / name).read_bytes().startswith(b'\x89PNG')
    assert '| 0.9 | kappa_bnitp_published |' in (whole / 'summary.md').read_text()
    written = {path: path.stat().st_mtime_ns for path in whole.glob('trials/*')}
    assert len(written) == TRIALS
    assert study(parse([str(scenario), '--out', str(whole)])) == 0
    assert {path: path.stat().st_mtime_ns for path in whole.glob('trials/*')} == written


@pytest.mark.processes
@pytest.mark.full
def test_a_killed_study_resumes_to_the_same_table(start, scenario, whole, tmp_path):
    """Killed at random moments."""
    for _ in range(3 if FULL else 1):
        done_before = len(list(tmp_path.glob('trials/*.npz')))
        process = start(scenario, tmp_path, random.randint(done_before + 1, done_before + 10))
        time.sleep(random.uniform(0, 0.05))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        assert not (tmp_path / 'table.csv').exists()
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob('trials/*.npz')}
    assert 1 <= len(kept) < TRIALS
    done = run_study(scenario, tmp_path, '--workers', 2)
    assert done.returncode == 0, done.stderr
    for name in LEFT:
        assert (tmp_path / name).read_bytes() == (whole / name).read_bytes(), name
    assert all(path.stat().st_mtime_ns == written for path, written in kept.items())
    assert not list(tmp_path.glob('**/*.part'))


def test_a_shipped_scenario_is_known_by_its_name_and_kept_whole(tmp_path):
    Folder(tmp_path, read_study(scenario_file('paper')))
    kept = yaml.safe_load((tmp_path / 'scenario.yaml').read_text())
    shipped = Path(__file__).parents[2] / 'config/scenarios/paper.yaml'
    told = yaml.safe_load(shipped.read_text())
    told['sensor'] |= {'reach': 0.0, 'duds': 0.0}
    told['planning']['max_distance'] = 0.0
    told['learn'] = dict.fromkeys(NUMBERS)
    told |= {'believed_lethality': None, 'asked': None, 'teams': [vars(ALONE)], 'ties': 'first'}
    told |= {'targets': vars(STILL), 'believed': vars(RIGHT)}
    assert kept == told | {'hazards': vars(INDEPENDENT)}


@pytest.mark.processes
@pytest.mark.parametrize('number, status', some([(signal.SIGINT, 130), (signal.SIGTERM, 143)], 2))
def test_an_interrupted_study_ends_at_once_and_keeps_finished_trials(
    start, tmp_path, number, status
):
    process = start(write(tmp_path / 'long.yaml', trials=300), tmp_path, 1)
    os.killpg(process.pid, number)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == status
    assert 'Traceback' not in stderr
    assert list(tmp_path.glob('trials/*.npz'))
    assert not tmp_path.joinpath('table.csv').exists()
    if number == signal.SIGINT:
        assert re.search(f'interrupted.*same command.*{tmp_path}', stderr)


@pytest.mark.processes
@pytest.mark.full
def test_workers_leave_interrupts_to_the_study(start, tmp_path):
    process = start(write(tmp_path / 'mine.yaml', trials=4), tmp_path / 'out', 1)
    children = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text().split()
    assert len(children) >= 2
    for child in children:
        os.kill(int(child), signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert 'Traceback' not in stderr


@pytest.mark.processes
@pytest.mark.full
def test_the_bar_shows_finished_trials_and_the_time_left(scenario, whole, tmp_path):
    out = tmp_path / 'out'
    shutil.copytree(whole, out)
    for file in sorted(out.glob('trials/*,kappa_bnitp.npz')):
        file.unlink()
    code, shown = run_on_terminal(command(scenario, out, '--workers', 1))
    assert code == 0
    bars = re.findall(r'(\d+)/40 \[\d\d:\d\d<(\d\d:\d\d|\?)', shown)
    assert bars[0][0] == '20'
    assert bars[-1] == ('40', '00:00')
    assert (out / 'table.csv').read_bytes() == (whole / 'table.csv').read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures('unsaved')
def test_choices_of_the_command_line_are_columns(tmp_path, scenario):
    options = ['--trials', '1', '--set', 'robots=3', '--set', 'max_visits=1,2', '--workers', '1']
    assert study(parse([str(scenario), '--out', str(tmp_path / 'out'), *options])) == 0
    results = Results.read(tmp_path / 'out')
    assert results.axes == ['lethality', 'max_visits']
    assert set(results.to_dataframe()['robot']) == {0, 1, 2, 3}


@for_each('changes, options, complaint', [
    ({'colour': 'red'}, [], 'colour is unknown'),
    ({'lethalities': [1.5]}, [], r'lethalities is 1\.5.*from 0\.0 to 1\.0'),
    ({'trials': 0}, [], 'trials is 0.*from 1'),
    ({}, ['--trials', '2', '--set', 'max_visit=3'], 'max_visit is unknown: did you mean planning'),
    ({}, ['--set', 'max_visits'], 'max_visits has no value: write max_visits=VALUE'),
    ({}, ['--workers', '99999999999'], 'workers is 99999999999.*from 1 to 1024'),
    ({}, ['--scheduler', 'localhost:8786'], 'scheduler is localhost:8786.*dask'),
])  # fmt: skip
def test_a_bad_study_is_one_error_before_any_work(capsys, tmp_path, changes, options, complaint):
    file = write(tmp_path / 'mine.yaml', **changes)
    said = refusal(capsys, file, tmp_path / 'out', *options)
    assert re.fullmatch(f'study: .*{complaint}.*\n', said), said
    assert not list(tmp_path.glob('out/trials/*'))


def test_an_unknown_scenario_is_named_with_the_known_ones(capsys, tmp_path):
    told = (
        'study: scenario magic is neither a file nor one of '
        '.*calibrated, .*last_contact, loss_cost, .*teams.*\n'
    )
    assert re.fullmatch(told, refusal(capsys, 'magic', tmp_path / 'out'))


@for_each('options', [
    ['--workers', '0'], ['--workers', 'many'], ['--backend', 'magic'], ['--trials', '0'],
])  # fmt: skip
def test_unusable_options_are_named(capsys, scenario, tmp_path, options):
    with pytest.raises(SystemExit) as ended:
        refusal(capsys, scenario, tmp_path / 'out', *options)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert f'{options[0]}: ' in said
    assert options[1] in said
    assert not (tmp_path / 'out').exists()
