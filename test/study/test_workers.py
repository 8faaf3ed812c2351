# SPDX-License-Identifier: Apache-2.0
"""Outcomes of trials do not depend on where they run, and finished trials are kept."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial
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
from kbnitp_ros.files import read_yaml, yaml_text
from kbnitp_ros.study import workers as module
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.scenario_file import parse_study
from kbnitp_ros.study.trial import list_trials, run_trial, Trial
from kbnitp_ros.study.workers import Folder, made_with, workers
from laws import for_each, spoilt
import numpy as np
import pytest
from small_study import CONTENT, single


def check_same(study, outcomes, pool):
    found = dict(pool.run(partial(run_trial, study), list_trials(study)))
    assert found.keys() == outcomes.keys()
    assert all(each.equals(outcomes[trial]) for trial, each in found.items())


# `test_compare.py` does so by loky before each change.
@pytest.mark.processes
@pytest.mark.full
@for_each('backend, count', [('loky', 2), ('loky', 1), ('dask', 2)])
def test_processes_of_this_machine_give_the_same_outcomes(study, outcomes, backend, count):
    if backend == 'dask':
        pytest.importorskip('distributed')
    with workers(backend, count) as pool:
        check_same(study, outcomes, pool)


@pytest.mark.processes
def test_without_trials_there_are_no_outcomes(study):
    with workers('loky', 2) as pool:
        assert list(pool.run(partial(run_trial, study), [])) == []


@pytest.mark.processes
def test_a_trial_that_fails_is_named(scenario):
    """Robots are lost although the belief excludes losses."""
    sensor = replace(scenario.sensor, malfunction=0.0)
    impossible = single(replace(scenario, believed_lethality=0.0, sensor=sensor))
    trials = [trial for trial in list_trials(impossible) if trial.lethality == 0.9]
    with (
        workers('loky', 1) as pool,
        pytest.raises(RuntimeError, match=r"Trial\(lethality=0.9, method='.*', .*impossible"),
    ):
        list(pool.run(partial(run_trial, impossible), trials))


@pytest.fixture
def scheduler():
    """Return a scheduler of its own, in a process, and its address."""
    pytest.importorskip('distributed')
    started = dask('scheduler', '--host', '127.0.0.1', '--port', '0', stderr=subprocess.PIPE)
    with started:
        found = (re.search(r'tcp://.*', line) for line in started.stderr)
        address = next((each[0] for each in found if each), None)
        if address is None:
            pytest.skip('no Dask scheduler starts here: it needs a port of 127.0.0.1')
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


HERE = os.pathsep.join(filter(None, [str(Path(__file__).parent), *sys.path]))


@pytest.mark.processes
@pytest.mark.full
def test_two_workers_of_a_scheduler_give_the_same_outcomes(study, outcomes, scheduler):
    distributed = pytest.importorskip('distributed')
    _, address = scheduler
    with one_worker(address, HERE), one_worker(address, HERE):
        with distributed.Client(address) as client:
            client.wait_for_workers(2, timeout=60)
        with workers('dask', scheduler=address) as pool:
            check_same(study, outcomes, pool)


def slow_double(number):
    """Return a double after a while, and the process that computed it."""
    time.sleep(0.2)
    return 2 * number, os.getpid()


@pytest.mark.processes
def test_a_cluster_of_one_thread_is_used_and_its_loss_is_one_error(scheduler):
    process, address = scheduler
    with one_worker(address, HERE), workers('dask', scheduler=address) as pool:
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
        pytest.raises(
            ConnectionError, match=r'a Dask worker cannot run trials: .*install its extra '
        ),
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
def test_a_trial_is_named_with_any_error(study, error, told):
    def fail(trial):
        raise error

    trial = list_trials(study)[0]
    with pytest.raises(RuntimeError, match=rf'^Trial\(lethality=0\.2.*\) {told}'):
        module._run(fail, {}, made_with(), trial)


@pytest.mark.processes
@for_each('count', [0, 1025, 99999999999])
def test_a_number_of_workers_that_no_machine_has_is_refused(count):
    pool = workers('loky', count)
    with pytest.raises(ValueError, match=f'workers is {count}: it must be from 1 to 1024'):
        pool.__enter__()


TRIAL = Trial(0.9, 'kappa_bnitp', 1)


@pytest.fixture
def folder(tmp_path, study, outcomes):
    """Return a folder with one finished trial."""
    folder = Folder(tmp_path / 'made' / 'here', study)
    folder.save(TRIAL, outcomes[TRIAL])
    return folder


def the_file(tmp_path):
    (file,) = tmp_path.rglob('*.npz')
    return file


def test_a_trial_on_a_full_disk_is_named_and_run_again(folder, outcomes, tmp_path):
    other = TRIAL._replace(number=2)
    with room_for(100), pytest.raises(OSError, match=r'File too large: .*trials/2,.*\.npz\.part'):
        folder.save(other, outcomes[TRIAL])
    assert list(folder.outcomes()) == [TRIAL]


@pytest.mark.processes
def test_a_disk_that_cannot_be_written_to_is_named(study, tmp_path):
    with mounted(tmp_path / 'disk', 'ro') as disk:
        path = disk / 'study'
        with pytest.raises(OSError, match=f'Read-only file system: {str(path)!r}'):
            Folder(path, study)


def test_an_outcome_is_kept_to_the_last_bit(folder, outcomes):
    found = folder.outcomes()
    assert list(found) == [TRIAL]
    assert found[TRIAL].equals(outcomes[TRIAL])


@pytest.mark.slow
@given(st.data())
@settings(
    max_examples=1000 if FULL else 60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_a_trial_that_is_damaged_does_not_count(folder, tmp_path, outcomes, data):
    """Also if the damage is in unused bytes."""
    folder.save(TRIAL, outcomes[TRIAL])
    file = the_file(tmp_path)
    file.write_bytes(data.draw(spoilt(file.read_bytes())))
    for outcome in folder.outcomes().values():
        assert outcome.equals(outcomes[TRIAL])


def test_a_trial_that_was_not_saved_to_its_end_does_not_count(folder, tmp_path):
    file = the_file(tmp_path)
    file.rename(f'{file}.part')
    assert folder.outcomes() == {}


def test_a_trial_of_another_number_of_robots_does_not_count(folder, outcomes):
    folder.save(TRIAL, outcomes[TRIAL].iloc[:-1])
    assert folder.outcomes() == {}


def test_a_trial_that_cannot_be_opened_is_reported(folder, tmp_path):
    file = the_file(tmp_path)
    file.unlink()
    file.mkdir()
    with pytest.raises(OSError, match=r'Is a directory: .*\.npz'):
        folder.outcomes()


@pytest.mark.parametrize('change, complaint', [
    ({'robots': 5}, 'robots 4 and not 5'),
    ({'lethalities': [0.2, 0.8]}, r'lethalities \(0.2, 0.9\) and not \(0.2, 0.8\)'),
    ({'believed_lethality': 1.0}, 'believed_lethality None and not 1.0'),
    ({'ties': ['first', 'random']}, r"ties first and not \['first', 'random'\]"),
])  # fmt: skip
def test_the_folder_of_another_scenario_is_refused(folder, tmp_path, change, complaint):
    with pytest.raises(ValueError, match=f'here holds results of another scenario.*{complaint}'):
        Folder(tmp_path / 'made' / 'here', parse_study(CONTENT, change))


def test_more_trials_are_added_to_those_that_are_done(folder, tmp_path, outcomes):
    done = folder.outcomes()
    # Its process ended.
    os.close(folder._lock)
    more = Folder(tmp_path / 'made' / 'here', parse_study(CONTENT, {'trials': 4}))
    assert more.outcomes().keys() == done.keys()
    fourth = Trial(0.2, 'kappa_bnitp', 3)
    more.save(fourth, outcomes[TRIAL])
    assert more.outcomes().keys() == {*done, fourth}


def test_trials_of_other_versions_are_refused_or_computed_anew(folder, tmp_path, study, outcomes):
    folder.save(TRIAL, outcomes[TRIAL])
    os.close(folder._lock)
    path = tmp_path / 'made' / 'here'
    file = path / 'made_with.yaml'
    ours = read_yaml(file)
    assert ours == made_with()
    assert ours['numpy'] == np.__version__
    for name in ours:
        file.write_text(yaml_text({**ours, name: '0.0'}))
        with pytest.raises(ValueError, match=f'trials made with {name} 0.0 and not {ours[name]}'):
            Folder(path, study)
    # Trials of before versions were kept.
    file.unlink()
    with pytest.raises(ValueError, match='kbnitp_ros unknown and not .*--anew'):
        Folder(path, study)
    assert not Folder(path, study, anew=True).outcomes()
    assert read_yaml(file) == ours


def test_a_worker_of_another_version_is_refused():
    other = {**made_with(), 'numpy': '1.0'}
    with pytest.raises(RuntimeError, match='a worker has numpy .* and not 1.0: install the same'):
        module._run(str, {}, other, 1)


def test_long_names_of_trials_fit_a_file_system(tmp_path, outcomes):
    own = {'loss_cost': 0.1234567890123456, 'survey': 0.6543210987654321, 'trusted': 0.75}
    own |= {'allocation': 'independent', 'objective': 'information_per_loss', 'paths': 'static'}
    own |= {'dynamics': 'used_up', 'clustering': 'learn', 'last_contact': 0.1234567890123456}
    folder = Folder(tmp_path, parse_study(CONTENT, {}))
    trials = [TRIAL._replace(team=Strategy(agents, **own)) for agents in (2, 3)]
    assert len({folder._file(trial) for trial in trials}) == 2
    for trial in trials:
        folder.save(trial, outcomes[TRIAL])


def test_trials_of_an_unknown_scenario_are_refused(tmp_path, study):
    tmp_path.joinpath('trials').mkdir()
    with pytest.raises(ValueError, match='unknown scenario.*another folder'):
        Folder(tmp_path, study)


def test_the_folder_of_a_mission_is_refused(tmp_path, study):
    tmp_path.joinpath('mission.mcap').touch()
    with pytest.raises(ValueError, match='holds a mission: name another folder'):
        Folder(tmp_path, study)


def test_two_studies_do_not_work_in_one_folder(folder, tmp_path, study):
    with pytest.raises(ValueError, match='in use by another study'):
        Folder(tmp_path / 'made' / 'here', study)


def test_a_file_is_no_folder(tmp_path, study):
    tmp_path.joinpath('file').write_text('')
    with pytest.raises(OSError, match='file'):
        Folder(tmp_path / 'file', study)


def test_the_trials_of_teams_and_choices_are_kept_apart(tmp_path, outcomes):
    teams = [{}, {'agents': 2}, {'agents': 2, 'loss_cost': 0.1}]
    folder = Folder(
        tmp_path / 'teams', parse_study(CONTENT, {'teams': teams, 'max_visits': [1, 2]})
    )
    done = [
        TRIAL._replace(choices=(1,)),
        TRIAL._replace(team=Strategy(2), choices=(1,)),
        TRIAL._replace(team=Strategy(2), choices=(2,)),
    ]
    for trial in done:
        folder.save(trial, outcomes[TRIAL])
    assert list(folder.outcomes()) == done
