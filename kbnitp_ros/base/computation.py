# SPDX-License-Identifier: Apache-2.0
"""A computation while the planner goes on listening."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import TypeVar

T = TypeVar('T')


def computed(compute: Callable[[], T], when_over: Callable[[], object]) -> Future[T]:
    """Return the future of a computation in a thread, which calls `when_over` at its end."""
    future: Future[T] = Future()
    future.add_done_callback(lambda _: when_over())

    def run() -> None:
        try:
            future.set_result(compute())
        except BaseException as error:
            future.set_exception(error)

    # A process that ends waits for the threads of a pool, but not for this one.
    Thread(target=run, daemon=True).start()
    return future
