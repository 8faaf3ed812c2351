# SPDX-License-Identifier: Apache-2.0
"""The processes that missions run in: on this machine, or on a Dask cluster."""

from __future__ import annotations

from asyncio import TimeoutError as AsyncTimeoutError
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from importlib.util import find_spec
import signal
from typing import Any, TypeVar

from joblib import cpu_count, delayed, Parallel, parallel_config
from threadpoolctl import threadpool_limits

# The engines of joblib that can be used, and the package that each needs.
BACKENDS = {'loky': 'joblib', 'dask': 'distributed'}

# How long a scheduler, and then its first worker, is waited for, in seconds.
PATIENCE = 10

# Processes that can be asked for: few machines have as many cores.
MOST_WORKERS = 1024

Item = TypeVar('Item')
Result = TypeVar('Result')


class Workers:
    """Processes that call a function of many items."""

    def __init__(self, count: int | None = None) -> None:
        self._parallel = Parallel(count, batch_size=1, return_as='generator_unordered')

    def run(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[Item, Result]]:
        """Yield each item with its result once known; a RuntimeError names an item that fails."""
        # A terminal interrupts all its processes. Those that are started meanwhile ignore it, too,
        # and leave it to this one to end them.
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            done = self._parallel(delayed(_run)(function, item) for item in items)
        finally:
            signal.signal(signal.SIGINT, handler)
        yield from done


def _run(function: Callable[[Item], Result], item: Item) -> tuple[Item, Result]:
    # Sums split among threads may round differently; and all cores are busy with other items.
    threadpool_limits(1, 'blas')
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
    """Start processes, one a core by default, or connect to a running Dask scheduler."""
    package = BACKENDS[backend]
    if find_spec(package) is None:
        raise ValueError(f'backend {backend} needs a package: pip install {package}')
    if count is not None and not 1 <= count <= MOST_WORKERS:
        raise ValueError(f'workers is {count}: it must be from 1 to {MOST_WORKERS}')
    if scheduler is not None and backend != 'dask':
        raise ValueError(f'scheduler is {scheduler}: the backend must be dask, not {backend}')
    if scheduler is not None and count is not None:
        raise ValueError(f'workers is {count}: leave it out, those of {scheduler} are used')
    if backend == 'loky':
        yield Workers(count or cpu_count())
        return
    with _dask(count or cpu_count(), scheduler) as client, parallel_config('dask', client=client):
        yield Workers()


@contextmanager
def _dask(count: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of the scheduler, or of a new one with its workers on this machine."""
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        cluster = scheduler or stack.enter_context(
            LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
        )
        try:
            client = stack.enter_context(Client(cluster, timeout=PATIENCE))
            client.wait_for_workers(1, timeout=PATIENCE)
        except (OSError, ValueError, AsyncTimeoutError) as error:
            raise ConnectionError(f'no Dask workers can be had at {scheduler}: {error}') from error
        yield client
