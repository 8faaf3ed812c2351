# SPDX-License-Identifier: Apache-2.0
"""Signals that end a process: recorded when they arrive, handled between two callbacks."""

from __future__ import annotations

import ctypes
import signal

# The signals that end a node, and the signals received, in order.
ENDING = (signal.SIGINT, signal.SIGTERM)
SIGNALS: list[int] = []


def note_signals() -> None:
    """Record the signals of `ENDING` from now on, in `SIGNALS`."""
    SIGNALS.clear()
    for number in ENDING:
        signal.signal(number, lambda received, _: SIGNALS.append(received))


def stop_on_signal() -> None:
    """Raise KeyboardInterrupt after a signal; for long operations such as a compilation."""
    if SIGNALS:
        raise KeyboardInterrupt


def ignore_signals() -> None:
    """Ignore the signals of `ENDING` until the process ends."""
    # Python removes its handlers before it ends, so a second Ctrl-C would kill it.
    for number in ENDING:
        ctypes.pythonapi.PyOS_setsig(number, ctypes.c_void_p(signal.SIG_IGN))
        signal.signal(number, signal.SIG_IGN)
