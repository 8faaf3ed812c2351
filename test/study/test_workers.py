# SPDX-License-Identifier: Apache-2.0
"""Wherever the trials run, their outcomes are the same."""

from dataclasses import replace
from functools import partial
import json
import os
import subprocess
import sys
import time

from kbnitp_ros.study import workers as module
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.trial import run_trial, trials_of
from kbnitp_ros.study.workers import workers
from laws import for_each
import pyarrow
from pyarrow import parquet
import pytest

pytestmark = pytest.mark.processes

PATIENCE = 180.0


@pytest.fixture
def dask_cluster(tmp_path):
    """Start a scheduler and two workers, processes of their own; return its address."""
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
    outcomes = dict(pool.run(partial(run_trial, scenario), trials_of(scenario)))
    assert as_parquet(Results(scenario, outcomes)) == as_parquet(results)


@for_each('backend, count', [('loky', 2), ('loky', 1), ('dask', 2)], every=3)
def test_processes_of_this_machine_give_the_same_table(scenario, results, backend, count):
    if backend == 'dask':
        pytest.importorskip('distributed')
    with workers(backend, count) as pool:
        check_same(scenario, results, pool)


@pytest.mark.full
def test_a_dask_cluster_gives_the_same_table(scenario, results, dask_cluster):
    with workers('dask', scheduler=dask_cluster) as pool:
        check_same(scenario, results, pool)


def test_no_trials_need_no_work(scenario):
    with workers('loky', 2) as pool:
        assert list(pool.run(partial(run_trial, scenario), [])) == []


def test_a_trial_that_fails_is_named(scenario):
    """Robots are lost where nothing is believed able to destroy them."""
    sensor = replace(scenario.sensor, malfunction=0.0)
    impossible = replace(scenario, believed_lethality=0.0, sensor=sensor)
    trials = [trial for trial in trials_of(impossible) if trial.lethality == 0.9]
    with (
        workers('loky', 1) as pool,
        pytest.raises(RuntimeError, match=r"Trial\(lethality=0.9, method='.*', .*impossible"),
    ):
        list(pool.run(partial(run_trial, impossible), trials))


@for_each('address', ['127.0.0.1:1', 'nowhere.invalid:8786', 'magic://here'])
def test_a_cluster_out_of_reach_is_one_error(monkeypatch, address):
    pytest.importorskip('distributed')
    monkeypatch.setattr(module, 'PATIENCE', 1)
    with (
        pytest.raises(ConnectionError, match=f'no Dask workers.*{address}'),
        workers('dask', scheduler=address),
    ):
        pass


def test_a_cluster_without_workers_is_one_error(monkeypatch):
    distributed = pytest.importorskip('distributed')
    monkeypatch.setattr(module, 'PATIENCE', 1)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        pytest.raises(ConnectionError, match='no Dask workers.*tcp'),
        workers('dask', scheduler=cluster.scheduler_address),
    ):
        pass


def test_a_backend_that_is_not_installed_is_one_error(monkeypatch):
    monkeypatch.setattr(module, 'find_spec', lambda name: None)
    with pytest.raises(ValueError, match='backend dask.*pip install'), workers('dask'):
        pass


@for_each('arguments, complaint', [
    (('loky', None, 'host:1'), 'scheduler is host:1.*must be dask, not loky'),
    (('dask', 2, 'host:1'), 'workers is 2: leave it out.*host:1'),
])  # fmt: skip
def test_arguments_that_do_not_go_together_are_refused(monkeypatch, arguments, complaint):
    monkeypatch.setattr(module, 'find_spec', lambda name: True)
    with pytest.raises(ValueError, match=complaint), workers(*arguments):
        pass


@for_each('error, told', [
    (ValueError('a robot met the impossible'), 'failed: a robot met the impossible'),
    (OverflowError('int too large'), 'failed: int too large'),
    (MemoryError('14.6 TiB'), r'needs more memory than there is: 14\.6 TiB'),
])  # fmt: skip
def test_a_trial_is_named_whatever_it_fails_of(scenario, error, told):
    def fail(trial):
        raise error

    trial = trials_of(scenario)[0]
    with pytest.raises(RuntimeError, match=rf'^Trial\(lethality=0\.2.*\) {told}'):
        module._run(fail, trial)


@for_each('count', [0, 1025, 99999999999])
def test_a_number_of_workers_that_no_machine_has_is_refused(count):
    pool = workers('loky', count)
    with pytest.raises(ValueError, match=f'workers is {count}: it must be from 1 to 1024'):
        pool.__enter__()
