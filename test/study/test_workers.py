# SPDX-License-Identifier: Apache-2.0
"""Outcomes of trials do not depend on where they run, and finished trials are kept."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial
import json
import os
from pathlib import Path
import re
import subprocess
import sys
import time

from disk import mounted, room_for
from extent import FULL
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from kbnitp_ros.study import workers as module
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import list_trials, run_trial, Trial
from kbnitp_ros.study.workers import Folder, workers
from laws import for_each, spoilt
import numpy as np
import pyarrow
from pyarrow import parquet
import pytest

PATIENCE = 180.0


@pytest.fixture
def dask_cluster(tmp_path):
    """Start a scheduler and two workers as processes; return the address."""
    distributed = pytest.importorskip('distributed')
    file = tmp_path / 'scheduler.json'
    dask = [sys.executable, '-m', 'dask']
    options = ['--scheduler-file', str(file), '--no-dashboard']
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        [*dask, 'scheduler', '--host', '127.0.0.1', '--port', '0', *options], env=environment
    ) as scheduler:
        with subprocess.Popen(
            [*dask, 'worker', '--nworkers', '2', '--nthreads', '1', *options], env=environment
        ) as pool:
            deadline = time.monotonic() + PATIENCE
            while not file.exists() and time.monotonic() < deadline:
                time.sleep(0.1)
            address = json.loads(file.read_text())['address']
            with distributed.Client(address) as client:
                client.wait_for_workers(2, PATIENCE)
            yield address
            pool.terminate()
        scheduler.terminate()


def as_parquet(results):
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(results.table(), sink)
    return sink.getvalue().to_pybytes()


def check_same(scenario, results, pool):
    outcomes = dict(pool.run(partial(run_trial, scenario), list_trials(scenario)))
    assert as_parquet(Results(scenario, outcomes)) == as_parquet(results)


# `test_compare.py` does so by loky before each change.
@pytest.mark.processes
@pytest.mark.full
@for_each('backend, count', [('loky', 2), ('loky', 1), ('dask', 2)])
def test_processes_of_this_machine_give_the_same_table(scenario, results, backend, count):
    if backend == 'dask':
        pytest.importorskip('distributed')
    with workers(backend, count) as pool:
        check_same(scenario, results, pool)


@pytest.mark.processes
@pytest.mark.full
def test_a_dask_cluster_gives_the_same_table(scenario, results, dask_cluster):
    with workers('dask', scheduler=dask_cluster) as pool:
        check_same(scenario, results, pool)


@pytest.mark.processes
def test_without_trials_there_are_no_outcomes(scenario):
    with workers('loky', 2) as pool:
        assert list(pool.run(partial(run_trial, scenario), [])) == []


@pytest.mark.processes
def test_a_trial_that_fails_is_named(scenario):
    """Robots are lost although the belief excludes losses."""
    sensor = replace(scenario.sensor, malfunction=0.0)
    impossible = replace(scenario, believed_lethality=0.0, sensor=sensor)
    trials = [trial for trial in list_trials(impossible) if trial.lethality == 0.9]
    with (
        workers('loky', 1) as pool,
        pytest.raises(RuntimeError, match=r"Trial\(lethality=0.9, method='.*', .*impossible"),
    ):
        list(pool.run(partial(run_trial, impossible), trials))


@pytest.fixture
def scheduler():
    """Return a scheduler of its own, in a process."""
    pytest.importorskip('distributed')
    started = dask('scheduler', '--host', '127.0.0.1', '--port', '0', stderr=subprocess.PIPE)
    with started:
        address = next(
            found[0] for line in started.stderr if (found := re.search(r'tcp://.*', line))
        )
        try:
            yield started, address
        finally:
            started.kill()


def dask(*arguments, **options):
    command = [sys.executable, '-m', 'dask', *arguments, '--no-dashboard']
    # Python imports from the working folder.
    return subprocess.Popen(command, text=True, cwd='/', **options)


@contextmanager
def one_worker(address, path):
    """Start a worker with one thread, and this path of Python."""
    environment = {**os.environ, 'PYTHONPATH': path}
    with dask('worker', address, '--nthreads', '1', '--no-nanny', env=environment) as worker:
        try:
            yield worker
        finally:
            worker.kill()


def slow_double(number):
    """Return a double after a while, and the process that computed it."""
    time.sleep(0.2)
    return 2 * number, os.getpid()


@pytest.mark.processes
def test_a_cluster_of_one_thread_is_used_and_its_loss_is_one_error(scheduler):
    process, address = scheduler
    here = os.pathsep.join(filter(None, [str(Path(__file__).parent), *sys.path]))
    with one_worker(address, here), workers('dask', scheduler=address) as pool:
        done = pool.run(slow_double, range(50))
        number, (doubled, by) = next(done)
        assert doubled == 2 * number
        assert by != os.getpid()
        process.kill()
        began = time.monotonic()
        with pytest.raises(RuntimeError, match='the Dask cluster is lost'):
            list(done)
        assert time.monotonic() < began + 30.0


@pytest.mark.processes
def test_workers_without_the_package_are_one_error(scheduler, tmp_path):
    _, address = scheduler
    tmp_path.joinpath('kbnitp_ros.py').write_text("raise ImportError('there is none here')")
    began = time.monotonic()
    with (
        one_worker(address, str(tmp_path)),
        pytest.raises(ConnectionError, match=r'a Dask worker cannot run trials: .*install kbnitp'),
        workers('dask', scheduler=address),
    ):
        pass
    assert time.monotonic() < began + 10.0


@pytest.mark.processes
@for_each('address', ['127.0.0.1:1', 'nowhere.invalid:8786', 'magic://here'])
def test_a_cluster_out_of_reach_is_one_error(monkeypatch, address):
    pytest.importorskip('distributed')
    monkeypatch.setattr(module, 'PATIENCE', 1)
    with (
        pytest.raises(ConnectionError, match=f'no Dask workers.*{address}'),
        workers('dask', scheduler=address),
    ):
        pass


@pytest.mark.processes
def test_a_cluster_without_workers_is_one_error(monkeypatch):
    distributed = pytest.importorskip('distributed')
    monkeypatch.setattr(module, 'PATIENCE', 1)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        pytest.raises(ConnectionError, match='no Dask workers.*tcp'),
        workers('dask', scheduler=cluster.scheduler_address),
    ):
        pass


@pytest.mark.processes
def test_a_backend_that_is_not_installed_is_one_error(monkeypatch):
    monkeypatch.setattr(module, 'find_spec', lambda name: None)
    with pytest.raises(ValueError, match='backend dask.*pip install'), workers('dask'):
        pass


@pytest.mark.processes
@for_each('arguments, complaint', [
    (('loky', None, 'host:1'), 'scheduler is host:1.*must be dask, not loky'),
    (('dask', 2, 'host:1'), 'workers is 2: leave it out.*host:1'),
])  # fmt: skip
def test_arguments_that_do_not_go_together_are_refused(monkeypatch, arguments, complaint):
    monkeypatch.setattr(module, 'find_spec', lambda name: True)
    with pytest.raises(ValueError, match=complaint), workers(*arguments):
        pass


@pytest.mark.processes
@for_each('error, told', [
    (ValueError('a robot met the impossible'), 'failed: a robot met the impossible'),
    (OverflowError('int too large'), 'failed: int too large'),
    (MemoryError('14.6 TiB'), r'needs more memory than there is: 14\.6 TiB'),
])  # fmt: skip
def test_a_trial_is_named_with_any_error(scenario, error, told):
    def fail(trial):
        raise error

    trial = list_trials(scenario)[0]
    with pytest.raises(RuntimeError, match=rf'^Trial\(lethality=0\.2.*\) {told}'):
        module._run(fail, {}, trial)


@pytest.mark.processes
@for_each('count', [0, 1025, 99999999999])
def test_a_number_of_workers_that_no_machine_has_is_refused(count):
    pool = workers('loky', count)
    with pytest.raises(ValueError, match=f'workers is {count}: it must be from 1 to 1024'):
        pool.__enter__()


TRIAL = Trial(0.9, 'kappa_bnitp', 1)


@pytest.fixture
def folder(tmp_path, scenario, results):
    """Return a folder with one finished trial."""
    folder = Folder(tmp_path / 'made' / 'here', scenario)
    folder.save(TRIAL, results.outcomes[TRIAL])
    return folder


def the_file(tmp_path):
    (file,) = tmp_path.rglob('*.npz')
    return file


def test_a_trial_on_a_full_disk_is_named_and_run_again(folder, results, tmp_path):
    other = TRIAL._replace(number=2)
    with room_for(100), pytest.raises(OSError, match=r'File too large: .*trials/.*-2\.npz\.part'):
        folder.save(other, results.outcomes[TRIAL])
    assert list(folder.outcomes()) == [TRIAL]


@pytest.mark.processes
def test_a_disk_that_cannot_be_written_to_is_named(scenario, tmp_path):
    with mounted(tmp_path / 'disk', 'ro') as disk:
        path = disk / 'study'
        with pytest.raises(OSError, match=f'Read-only file system: {str(path)!r}'):
            Folder(path, scenario)


def test_an_outcome_is_kept_to_the_last_bit(folder, results):
    outcomes = folder.outcomes()
    assert list(outcomes) == [TRIAL]
    for kept, made in zip(outcomes[TRIAL], results.outcomes[TRIAL], strict=True):
        assert kept.dtype == made.dtype
        assert np.array_equal(kept, made, equal_nan=kept.dtype == float)


@pytest.mark.slow
@given(st.data())
@settings(
    max_examples=1000 if FULL else 60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_a_trial_that_is_damaged_does_not_count(folder, tmp_path, results, data):
    """Also if the damage is in unused bytes."""
    folder.save(TRIAL, results.outcomes[TRIAL])
    file = the_file(tmp_path)
    file.write_bytes(data.draw(spoilt(file.read_bytes())))
    for outcome in folder.outcomes().values():
        assert [each.tobytes() for each in outcome] == [
            each.tobytes() for each in results.outcomes[TRIAL]
        ]


def test_a_trial_that_was_not_saved_to_its_end_does_not_count(folder, tmp_path):
    file = the_file(tmp_path)
    file.rename(f'{file}.part')
    assert folder.outcomes() == {}


def test_a_trial_of_another_shape_does_not_count(folder, results):
    outcome = results.outcomes[TRIAL]
    for other in (
        outcome._replace(measures=outcome.measures[:-1]),
        outcome._replace(believed=outcome.believed.ravel()),
        outcome._replace(truth=outcome.believed),
        outcome._replace(learnt=outcome.learnt[:, 1:]),
        outcome._replace(numbers=outcome.numbers[1:]),
    ):
        folder.save(TRIAL, other)
        assert folder.outcomes() == {}


def test_a_trial_that_cannot_be_opened_is_reported(folder, tmp_path):
    file = the_file(tmp_path)
    file.unlink()
    file.mkdir()
    with pytest.raises(OSError, match=r'Is a directory: .*\.npz'):
        folder.outcomes()


@pytest.mark.parametrize('change, complaint', [
    ({'robots': 5}, 'robots 4 and not 5'),
    ({'lethalities': (0.2, 0.8)}, r'lethalities \(0.2, 0.9\) and not \(0.2, 0.8\)'),
    ({'believed_lethality': 1.0}, 'believed_lethality None and not 1.0'),
])  # fmt: skip
def test_the_folder_of_another_scenario_is_refused(folder, tmp_path, scenario, change, complaint):
    with pytest.raises(ValueError, match=f'here holds results of another scenario.*{complaint}'):
        Folder(tmp_path / 'made' / 'here', replace(scenario, **change))


def test_more_trials_are_added_to_those_that_are_done(folder, tmp_path, scenario, results):
    done = folder.outcomes()
    # Its process ended.
    os.close(folder._lock)
    more = Folder(tmp_path / 'made' / 'here', replace(scenario, trials=4))
    assert more.outcomes().keys() == done.keys()
    fourth = Trial(0.2, 'kappa_bnitp', 3)
    more.save(fourth, results.outcomes[TRIAL])
    assert more.outcomes().keys() == {*done, fourth}


def test_trials_of_an_unknown_scenario_are_refused(tmp_path, scenario):
    tmp_path.joinpath('trials').mkdir()
    with pytest.raises(ValueError, match='unknown scenario.*another folder'):
        Folder(tmp_path, scenario)


def test_the_folder_of_a_mission_is_refused(tmp_path, scenario):
    tmp_path.joinpath('mission.mcap').touch()
    with pytest.raises(ValueError, match='holds a mission: name another folder'):
        Folder(tmp_path, scenario)


def test_two_studies_do_not_work_in_one_folder(folder, tmp_path, scenario):
    with pytest.raises(ValueError, match='in use by another study'):
        Folder(tmp_path / 'made' / 'here', scenario)


def test_a_file_is_no_folder(tmp_path, scenario):
    tmp_path.joinpath('file').write_text('')
    with pytest.raises(OSError, match='file'):
        Folder(tmp_path / 'file', scenario)


def test_the_trials_of_teams_are_kept_apart(tmp_path, scenario, results):
    scenario = replace(scenario, teams=(Strategy(), Strategy(2), Strategy(2, loss_cost=0.1)))
    folder = Folder(tmp_path / 'teams', scenario)
    done = [TRIAL, TRIAL._replace(team=Strategy(2))]
    for trial in done:
        folder.save(trial, results.outcomes[TRIAL])
    assert list(folder.outcomes()) == done
