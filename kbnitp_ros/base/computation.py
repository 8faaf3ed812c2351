# SPDX-License-Identifier: Apache-2.0
"""A computation while the planner goes on listening."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import Generic, TypeVar

T = TypeVar('T')


class Computation(Generic[T]):
    """
    Something that takes long, in a thread of its own.

    Compiled kernels leave Python's lock to others, and no computation can be interrupted: one that
    is not wanted any more runs to its end, and nothing comes of it. `when_over` is called in that
    thread.
    """

    def __init__(self, compute: Callable[[], T], when_over: Callable[[], object]) -> None:
        self._compute = compute
        self._when_over = when_over
        self._result: Future[T] = Future()
        # A process that ends does not wait for it.
        Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        try:
            self._result.set_result(self._compute())
        except BaseException as error:
            self._result.set_exception(error)
        self._when_over()

    @property
    def is_over(self) -> bool:
        """Return whether there is a result, or an error."""
        return self._result.done()

    def result(self) -> T:
        """Return the result, once it is over; raises what the computation raised."""
        return self._result.result()
