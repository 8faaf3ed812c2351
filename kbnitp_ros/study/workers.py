# SPDX-License-Identifier: Apache-2.0
"""The folder of a study, and the worker processes for its missions."""

from __future__ import annotations

from asyncio import TimeoutError as AsyncTimeoutError
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack, suppress
import fcntl
from functools import cache, partial
import gc
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
import logging
from operator import methodcaller
import os
from pathlib import Path
import platform
import signal
from typing import Any, BinaryIO, TypeVar

from joblib import cpu_count, delayed, Parallel
from kbnitp_ros.core.field.check import number
from kbnitp_ros.files import in_words, naming, read_yaml, yaml_text
from kbnitp_ros.plugins import REGISTRIES
from kbnitp_ros.study.scenario import ALONE
from kbnitp_ros.study.scenario_file import read_study, Study
from kbnitp_ros.study.trial import list_trials, Trial
import numpy as np
from pandas import DataFrame
from threadpoolctl import threadpool_limits


@cache
def made_with() -> dict[str, str]:
    """Return the versions of what computes a trial, and the platform."""
    versions = {}
    for name in ('kbnitp_ros', 'numpy', 'numba'):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = 'none'
    return {**versions, 'platform': f'{platform.system()} {platform.machine()}'}


def differences(ours: Mapping[str, str], others: Mapping[str, str]) -> str:
    """Describe how the versions of others differ from ours; empty if they are the same."""
    return ', '.join(
        f'{name} {others.get(name, "unknown")} and not {own}'
        for name, own in ours.items()
        if others.get(name) != own
    )


class Folder:
    """The saved outcomes of a study's trials."""

    def __init__(self, path: Path, study: Study, *, anew: bool = False) -> None:
        self._study = study
        self._trials = path / 'trials'
        kept = path / 'scenario.yaml'
        if kept.exists():
            for key, value in read_study(kept).content.items():
                # The number of trials may differ: it does not affect a trial.
                if key != 'trials' and value != study.content[key]:
                    raise ValueError(
                        f'{path} holds results of another scenario, with {key} {value} '
                        f'and not {study.content[key]}: name another folder'
                    )
        elif self._trials.exists():
            raise ValueError(f'{path} holds results of an unknown scenario: name another folder')
        elif any(path.glob('*.mcap')):
            raise ValueError(f'{path} holds a mission: name another folder with --out')
        path.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f'{path} is in use by another study: name another folder') from error
        try:
            self._check_versions(path / 'made_with.yaml', anew=anew)
        except ValueError:
            os.close(self._lock)
            raise
        text = yaml_text(study.content)
        _write(kept, lambda file: file.write(text.encode()))
        self._trials.mkdir(exist_ok=True)

    def _check_versions(self, file: Path, *, anew: bool) -> None:
        """Check that the trials were made with the versions that are installed."""
        own, has_trials = made_with(), any(self._trials.glob('*.npz'))
        known = read_yaml(file) if file.exists() else {}
        differs = differences(own, known if isinstance(known, Mapping) else {})
        if has_trials and differs and not anew:
            raise ValueError(
                f'{file.parent} holds trials made with {differs}: results would mix; go on with '
                'these versions, name another folder, or give --anew to compute them anew'
            )
        if anew:
            for trial in self._trials.glob('*.npz'):
                trial.unlink()
        _write(file, lambda written: written.write(yaml_text(own).encode()))

    def save(self, trial: Trial, outcome: DataFrame) -> None:
        """Save the outcome of a trial; returns once it is on disk."""
        arrays = {'names': outcome.columns.to_numpy(np.str_), 'values': outcome.to_numpy()}
        _write(self._file(trial), lambda file: np.savez_compressed(file, **arrays))

    def outcomes(self) -> dict[Trial, DataFrame]:
        """Return the outcomes of all trials with readable files."""
        outcomes = {}
        for trial in list_trials(self._study):
            try:
                file = self._file(trial).open('rb')
            except FileNotFoundError:
                continue
            # zipfile and numpy raise many types of exceptions on corrupt files.
            with file, suppress(Exception), np.load(file, allow_pickle=False) as arrays:
                outcome = DataFrame(arrays['values'], columns=arrays['names'])
                if len(outcome) == self._study.scenarios[trial.choices].robots + 1:
                    outcomes[trial] = outcome
        return outcomes

    def _file(self, trial: Trial) -> Path:
        own = {
            **{n: value for n, value in vars(trial.team).items() if value != getattr(ALONE, n)},
            **dict(zip(self._study.axes, trial.choices)),
        }
        named = (f'{name}={value}' for name, value in own.items())
        name = ','.join([f'{trial.number},{trial.lethality},{trial.method}', *named])
        name = name.replace('/', '_')
        if len(name.encode()) > MAX_NAME:
            # File systems take names of at most 255 bytes.
            name = f'{name[: MAX_NAME // 4]},{sha256(name.encode()).hexdigest()[:32]}'
        return self._trials / f'{name}.npz'


def _write(path: Path, write: Callable[[BinaryIO], object]) -> None:
    part = path.with_name(f'{path.name}.part')
    with naming(part), part.open('wb') as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


# Maximum bytes of a trial's name in its file's.
MAX_NAME = 240

# Backends of joblib, with the package that each needs.
BACKENDS = {'loky': 'joblib', 'dask': 'distributed'}

# Seconds to wait for a scheduler, and then for its first worker.
PATIENCE = 10

# Maximum number of processes: few machines have as many cores.
MAX_WORKERS = 1024

Item = TypeVar('Item')
Result = TypeVar('Result')


class Workers:
    """Worker processes that map a function over items."""

    def __init__(self, spread: Callable[[Callable[..., Any], Sequence[Any]], Iterator[Any]]):
        self._spread = spread

    def run(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[Item, Result]]:
        """Yield each item with its result; a RuntimeError names an item that fails."""
        names = {kind: each.loaded for kind, each in REGISTRIES.items()}
        yield from self._spread(partial(_run, function, names, made_with()), items)


def _here(count: int, run: Callable[..., Any], items: Sequence[Any]) -> Iterator[Any]:
    """Yield results in any order, from processes of this machine."""
    parallel = Parallel(count, batch_size=1, return_as='generator_unordered')
    # Start workers that ignore interrupts of the terminal; this process ends them.
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        done = parallel(delayed(run)(item) for item in items)
    finally:
        signal.signal(signal.SIGINT, handler)
    yield from done


def _on_cluster(client: Any, run: Callable[..., Any], items: Sequence[Any]) -> Iterator[Any]:
    """Yield results in any order, from the workers of Dask."""
    from distributed import as_completed, CancelledError, KilledWorker

    try:
        # Data is opaque to the scheduler, which may lack this package, and functions are not.
        nth = client.scatter(lambda number: run(items[number]), broadcast=True)
        calls = [methodcaller('__call__', number) for number in range(len(items))]
        for done in as_completed([client.submit(call, nth, pure=False) for call in calls]):
            yield done.result()
    except (CancelledError, KilledWorker, OSError) as error:
        raise RuntimeError(
            f'the Dask cluster is lost ({type(error).__name__}); finished trials are kept'
        ) from None


def _run(
    function: Callable[[Item], Result],
    loaded: Mapping[str, Sequence[str]],
    versions: Mapping[str, str],
    item: Item,
) -> tuple[Item, Result]:
    if differs := differences(versions, made_with()):
        raise RuntimeError(f'a worker has {differs}: install the same versions there')
    # One thread: sums split among threads may round differently, and other items keep all cores
    # busy.
    threadpool_limits(1, 'blas')
    for kind, names in loaded.items():
        for name in names:
            REGISTRIES[kind].load(name)
    try:
        return item, function(item)
    except (ValueError, ArithmeticError) as error:
        raise RuntimeError(f'{item} failed: {error}') from error
    except MemoryError as error:
        raise RuntimeError(f'{item} needs more memory than there is: {error}') from error


@contextmanager
def workers(
    backend: str, count: int | None = None, scheduler: str | None = None
) -> Iterator[Workers]:
    """Start worker processes, by default one for each core, or connect to a Dask scheduler."""
    package = BACKENDS[backend]
    if find_spec(package) is None:
        raise ValueError(f'backend {backend} needs a package: pip install {package}')
    if count is not None:
        allowed = range(1, MAX_WORKERS + 1)
        count = int(number('workers', count, f'from 1 to {MAX_WORKERS}', allowed.__contains__))
    if scheduler is not None and backend != 'dask':
        raise ValueError(f'scheduler is {scheduler}: the backend must be dask, not {backend}')
    if scheduler is not None and count is not None:
        raise ValueError(f'workers is {count}: leave it out: {scheduler} has its own workers')
    if backend == 'loky':
        yield Workers(partial(_here, count or cpu_count()))
        return
    with _dask(count or cpu_count(), scheduler) as client:
        yield Workers(partial(_on_cluster, client))


@contextmanager
def _dask(count: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of the scheduler, by default of a new scheduler on this machine."""
    from distributed import Client, LocalCluster

    # Its messages about a lost cluster are tracebacks.
    logging.getLogger('distributed.client').setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        cluster = scheduler or stack.enter_context(
            LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
        )
        failure = ''
        try:
            client = stack.enter_context(Client(cluster, timeout=PATIENCE))
            client.wait_for_workers(1, timeout=PATIENCE)
            # Only built-in functions reach a worker that lacks this package.
            client.run(exec, f'import {__name__}')
        except (OSError, ValueError, AsyncTimeoutError) as error:
            failure = f'no Dask workers found at {scheduler}: {error}'
        except ImportError as error:
            failure = (
                f'a Dask worker cannot run trials: {in_words(error)}; install its extra study '
                'in the Python of the workers'
            )
        if failure:
            # A client that could not connect, deleted while another one starts, waits for ever.
            gc.collect()
            raise ConnectionError(failure)
        yield client
