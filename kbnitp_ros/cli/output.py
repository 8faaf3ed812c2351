# SPDX-License-Identifier: Apache-2.0
"""Printing that survives closed pipes and full disks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from io import TextIOWrapper
import os
import signal
import sys
from types import FrameType
from typing import TextIO

from kbnitp_ros.files import in_words, OutputError, writing

# The main function of a command: takes its arguments, and returns the exit code.
Main = Callable[..., int]


def say(*lines: str) -> None:
    """Print lines."""
    with writing():
        print(*lines, sep='\n', flush=True)


def confirmed(question: str) -> bool:
    """Ask a question on a terminal; without a terminal the answer is no."""
    is_asked = sys.stdin is not None and sys.stdin.isatty()
    with suppress(EOFError):
        return is_asked and input(f'{question} [y/N] ').strip().lower() in ('y', 'yes')
    return False


def end_on_signals() -> list[int]:
    """
    End a command, with the processes that it has started, at SIGINT and SIGTERM.

    Returns the signals that have arrived: rclpy may raise another exception in place of theirs.
    """
    arrived: list[int] = []

    def end(number: int, _frame: FrameType | None) -> None:
        arrived.append(number)
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        sys.exit(128 + number)

    # Shells start background jobs with SIGINT ignored.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    return arrived


def complain(name: str, error: object) -> None:
    """Print an error of a command on standard error, if that is open."""
    words = in_words(error) if isinstance(error, BaseException) else error
    try:
        print(f'{name}: {words}', file=sys.stderr, flush=True)
    except OSError:
        discard(sys.stderr)


def command(name: str) -> Callable[[Main], Main]:
    """Return a decorator that ends a command without a traceback if it cannot print."""

    def decorate(main: Main) -> Main:
        @wraps(main)
        def run(argv: Sequence[str] | None = None) -> int:
            if isinstance(sys.stdout, TextIOWrapper):
                # Names of files need not be valid text.
                sys.stdout.reconfigure(errors='backslashreplace')
            try:
                try:
                    return main(argv)
                finally:
                    if sys.stdout is not None:
                        with writing():
                            sys.stdout.flush()
            except KeyboardInterrupt:
                return 128 + signal.SIGINT
            except MemoryError as error:
                complain(name, f'there is not enough memory: {error}')
                return 1
            except OutputError as error:
                discard(sys.stdout)
                reason = error.__cause__
                if isinstance(reason, BrokenPipeError):
                    return 128 + signal.SIGPIPE
                why = reason.strerror if isinstance(reason, OSError) else reason
                complain(name, f'nothing can be printed: {why}')
                return os.EX_IOERR

        return run

    return decorate


def discard(stream: TextIO) -> None:
    """Discard unprinted output, which Python would otherwise write at exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
