# SPDX-License-Identifier: Apache-2.0
"""An end for a process that waits for good with Python's lock held, so that no Python can run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
from ctypes import c_int, c_long, c_void_p
import os
import time

SIGEV_THREAD = 2  # have a new thread call a function when the time has come

LIBC = ctypes.CDLL(None, use_errno=True)


class _Event(ctypes.Structure):
    """A `struct sigevent` of Linux on a 64-bit machine, for SIGEV_THREAD."""

    _fields_ = (
        ('value', c_void_p),
        ('signal', c_int),
        ('notify', c_int),
        ('function', c_void_p),
        ('attributes', c_void_p),
        ('padding', c_int * 8),
    )


class _Setting(ctypes.Structure):
    """A `struct itimerspec`."""

    _fields_ = (
        ('interval_seconds', c_long),
        ('interval_nanoseconds', c_long),
        ('seconds', c_long),
        ('nanoseconds', c_long),
    )


@contextmanager
def exit_at_the_latest(seconds: float, code: int) -> Iterator[None]:
    """
    End the process with a code if what is in the ``with`` statement takes more seconds.

    Unlike a signal's handler or a thread of Python this needs no lock of Python's: the C library
    calls `_exit` itself.
    """
    timer = c_void_p()
    event = _Event(code, 0, SIGEV_THREAD, ctypes.cast(LIBC._exit, c_void_p), None)
    if LIBC.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    whole, rest = divmod(seconds, 1.0)
    LIBC.timer_settime(timer, 0, ctypes.byref(_Setting(0, 0, int(whole), int(rest * 1e9))), None)
    try:
        yield
    finally:
        LIBC.timer_delete(timer)
