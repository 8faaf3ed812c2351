# SPDX-License-Identifier: Apache-2.0
"""The signals that end a process of ROS: noted when they come, acted on between two callbacks."""

from __future__ import annotations

import ctypes
import signal

# What ends a node, and what of it this process was sent, one after another.
ENDING = (signal.SIGINT, signal.SIGTERM)
SIGNALS: list[int] = []


class StoppedError(BaseException):
    """A signal came before the node was made or while it compiles; no error to be handled."""


def note_signals() -> None:
    """Note the signals of `ENDING` from now on, in `SIGNALS`."""
    SIGNALS.clear()
    for number in ENDING:
        signal.signal(number, lambda received, _: SIGNALS.append(received))


def stop_on_signal() -> None:
    """End what takes long after a signal, such as a compilation of up to a minute."""
    if SIGNALS:
        raise StoppedError


def ignore_signals() -> None:
    """Ignore the signals of `ENDING` for what is left of the process."""
    # Python gives up its handlers before it ends: a second Ctrl-C would kill it.
    for number in ENDING:
        ctypes.pythonapi.PyOS_setsig(number, ctypes.c_void_p(signal.SIG_IGN))
        signal.signal(number, signal.SIG_IGN)
