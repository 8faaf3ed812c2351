# SPDX-License-Identifier: Apache-2.0
"""The processes that missions run in: on this machine, or on a Dask or Ray cluster."""

from __future__ import annotations

from asyncio import TimeoutError as AsyncTimeoutError
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
import signal
from typing import Any, TypeVar

from joblib import cpu_count, delayed, Parallel, parallel_config
from threadpoolctl import threadpool_limits

# The engines of joblib that can be used, and the package that each needs.
BACKENDS = {'loky': 'joblib', 'dask': 'distributed', 'ray': 'ray'}

ONE_BY_ONE = {'batch_size': 1, 'return_as': 'generator_unordered'}

# How long a scheduler, and then its first worker, is waited for, in seconds.
PATIENCE = 10

# Processes that can be asked for: few machines have as many cores.
MOST_WORKERS = 1024

Item = TypeVar('Item')
Result = TypeVar('Result')


@dataclass(frozen=True)
class Workers:
    """Processes that call a function of many items."""

    # Hands calls out to them.
    parallel: Parallel
    # How many results come together; None when each comes by itself.
    batch: int | None = None

    def run(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[Item, Result]]:
        """
        Yield each item with its result as soon as that is known; in the main thread.

        Raises
        ------
        RuntimeError
            If the function fails, which names the item, or a worker is lost.

        """
        batch = self.batch or max(1, len(items))
        for start in range(0, len(items), batch):
            end = start + batch
            yield from self._handed_out(delayed(_run)(function, item) for item in items[start:end])

    def _handed_out(self, calls: Iterable[Any]) -> Any:
        """Hand out calls and return their results; in batches they are waited for."""
        if self.batch:
            return self.parallel(calls)
        # A terminal interrupts all its processes. Those that are started meanwhile ignore it, too,
        # and leave it to this one to end them.
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            return self.parallel(calls)
        finally:
            signal.signal(signal.SIGINT, handler)


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
    """
    Start worker processes, or connect to a cluster, until the ``with`` statement is left.

    Parameters
    ----------
    backend : str
        One of `BACKENDS`.
    count : int, optional
        How many to start, 1 to `MOST_WORKERS`; None for one a core.
    scheduler : str, optional
        Address of a Dask scheduler that runs already, with kbnitp_ros installed on its workers.

    Raises
    ------
    ValueError
        If the backend is not installed, the count is out of range, or the arguments do not go
        together.
    ConnectionError
        If the cluster cannot be reached or has no workers.

    """
    package = BACKENDS[backend]
    if find_spec(package) is None:
        raise ValueError(f'backend {backend} needs a package: pip install {package}')
    if count is not None and not 1 <= count <= MOST_WORKERS:
        raise ValueError(f'workers is {count}: it must be from 1 to {MOST_WORKERS}')
    if scheduler is not None and backend != 'dask':
        raise ValueError(f'scheduler is {scheduler}: the backend must be dask, not {backend}')
    if scheduler is not None and count is not None:
        raise ValueError(f'workers is {count}: leave it out, those of {scheduler} are used')
    with ExitStack() as stack:
        if backend == 'loky':
            yield Workers(Parallel(count or cpu_count(), 'loky', **ONE_BY_ONE))
        elif backend == 'dask':
            client = stack.enter_context(_dask(count or cpu_count(), scheduler))
            stack.enter_context(parallel_config('dask', client=client))
            yield Workers(Parallel(**ONE_BY_ONE))
        else:
            cores = stack.enter_context(_ray(count))
            stack.enter_context(parallel_config('ray'))
            yield Workers(Parallel(cores, batch_size=1), batch=cores)


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


@contextmanager
def _ray(count: int | None) -> Iterator[int]:
    """Start Ray, or connect to where RAY_ADDRESS says; yield how many cores it has."""
    import ray
    from ray.util.joblib import register_ray

    ray.init(num_cpus=count, logging_level='error', log_to_driver=False)
    try:
        register_ray()
        yield int(ray.cluster_resources()['CPU'])
    finally:
        ray.shutdown()
