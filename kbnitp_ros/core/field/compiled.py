# SPDX-License-Identifier: Apache-2.0
"""
Compilation of kernels, where it can be had.

A kernel is a plain function over arrays, in a file that holds nothing but kernels, and may call
those of other files. Machine code is kept until one of these files changes.

A kernel gives the same bits compiled and interpreted if it takes its functions from `math`, which
is the C library in both, uses neither `**` nor sums of whole arrays, and never divides by 0 or
takes its logarithm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, update_wrapper
import logging
from pathlib import Path
import sys
from typing import Any, cast, TypeVar
from warnings import warn

Kernel = TypeVar('Kernel', bound=Callable[..., Any])

_CHECKS: list[Callable[[], None]] = []

# Folders of kept code that a warning named.
_WARNED_OF: set[str] = set()

# The versions that the kernels were run with.
TRIED = ('0.61', '0.62', '0.68')


def compiled(kernel: Kernel) -> Kernel:
    """
    Return the kernel compiled by numba, or interpreted where that cannot be.

    It is compiled when a kernel of its file is first called: many processes call none, and numba
    takes as long to import as all else together. The machine code is kept beside the source or in
    the home's cache, so that it is made once, which is said in the log. A RuntimeWarning tells
    once why kernels are not compiled, and once for each folder that kept code in it cannot be read
    or written: then it is compiled anew.

    Parameters
    ----------
    kernel : callable
        A function over numbers and arrays that numba can compile.

    Returns
    -------
    callable
        With the same arguments and results.

    """
    return cast(Kernel, Compiled(kernel))


def inlined(kernel: Kernel) -> Kernel:
    """
    Do what `compiled` does, for a kernel called in loops: copy its code to where it is called.

    It makes and returns no arrays, so references to those handed over are not counted: counting
    those of many arrays takes as long as much of what is done with them.
    """
    return cast(Kernel, Compiled(kernel, is_inlined=True))


class Compiled:
    """A kernel that is compiled, with all that it calls, when it is first called."""

    def __init__(self, kernel: Callable[..., Any], is_inlined: bool = False) -> None:
        update_wrapper(self, kernel)
        self._kernel, self._is_inlined = kernel, is_inlined
        self._code: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        return (self._code or self.code)(*arguments)

    @property
    def code(self) -> Callable[..., Any]:
        """Return the compiled code, or the kernel itself where that cannot be."""
        if self._code is None:
            self._code = _code_of(self._kernel, self._is_inlined)
            # numba follows a call to another kernel only if the name stands for compiled code.
            names = self._kernel.__globals__
            for name, each in list(names.items()):
                if isinstance(each, Compiled):
                    names[name] = each.code
        return self._code


def while_compiling(check: Callable[[], None]) -> None:
    """
    Have something called again and again while kernels are compiled.

    Parameters
    ----------
    check : callable
        What it raises ends the compilation. Called before each of numba's passes over a function.

    """
    if check not in _CHECKS:
        _CHECKS.append(check)


def _code_of(kernel: Callable[..., Any], is_inlined: bool) -> Callable[..., Any]:
    """Return the kernel compiled, or itself where that cannot be."""
    numba = _numba()
    if numba is None or numba.config.DISABLE_JIT:
        return kernel
    try:
        kept = _kept_code(numba.core.caching.FunctionCache)(kernel)
        kept.used = _stamps(kernel.__module__)
    except RuntimeError:
        # The documented exception where no folder can be written.
        _warn_once(
            'numba can keep compiled code nowhere: set NUMBA_CACHE_DIR to a folder to write in'
        )
        return kernel
    # Others of the process go on meanwhile. Without `_nrt` references are not counted.
    code: Callable[..., Any] = numba.njit(nogil=True, forceinline=is_inlined, _nrt=not is_inlined)(
        kernel
    )
    # What `cache=True` sets, but for files that cannot be used and calls to other files.
    code._cache = kept  # type: ignore[attr-defined]
    return code


@cache
def _kept_code(function_cache: type[Any]) -> type[Any]:
    """Return numba's cache as one that does without files that it cannot read or write."""

    class KeptCode(function_cache):  # type: ignore[misc]
        """
        The compiled code of a kernel, in files.

        numba does not flush them to the disk, so that a machine that loses power leaves some cut
        short or empty. pickle raises almost anything when it reads such a file.
        """

        # numba itself looks at the kernel's own file alone.
        used: frozenset[tuple[str, int, int]]

        def _index_key(self, signature: Any, codegen: Any) -> Any:
            """Return what the code is kept by: that which holds Python's lock is another."""
            return *super()._index_key(signature, codegen), 'nogil', self.used

        def load_overload(self, signature: Any, target: Any) -> Any:
            """Return the code for arguments of these types; None where it is to be compiled."""
            try:
                return super().load_overload(signature, target)
            except Exception as error:
                _warn_of_files(self.cache_path, f'cannot be read ({error!r})')
                with self._or_without_files():
                    self.flush()
                return None

        def save_overload(self, signature: Any, code: Any) -> None:
            """Keep the code for arguments of these types, if that can be."""
            with self._or_without_files():
                super().save_overload(signature, code)

        @contextmanager
        def _or_without_files(self) -> Iterator[None]:
            try:
                yield
            except Exception as error:
                _warn_of_files(self.cache_path, f'cannot be written ({error!r})')
                self.disable()

    return KeptCode


@cache
def _stamps(module: str) -> frozenset[tuple[str, int, int]]:
    """Return when a file of kernels and those that it uses were changed, and their sizes."""
    names = vars(sys.modules[module])
    used = {str(getattr(each, '__module__', None)) for each in names.values()}
    if __name__ not in used:
        # It has no kernels.
        return frozenset()
    found = Path(names['__file__']).stat()
    stamps = {(module, found.st_mtime_ns, found.st_size)}
    return frozenset(stamps.union(*map(_stamps, used.intersection(sys.modules) - {module})))


@cache
def _numba() -> Any:
    try:
        import numba
    except ImportError as error:
        _warn_once(f'numba cannot be used ({error}): pip install "numba=={TRIED[-1]}.*"')
        return None
    if not numba.__version__.startswith(tuple(f'{version}.' for version in TRIED)):
        warn(
            f'numba {numba.__version__} was not tried, only {", ".join(TRIED)}: '
            'set NUMBA_DISABLE_JIT=1 if results are in doubt',
            RuntimeWarning,
            stacklevel=3,
        )
    event = numba.core.event

    class Notice(event.Listener):  # type: ignore[misc, name-defined]
        """Hears of code that is compiled, pass by pass, but not of what was kept."""

        def on_start(self, told: Any) -> None:
            if told.kind == 'numba:compile':
                _say_once()
            for check in _CHECKS:
                check()

        def on_end(self, _: object) -> None:
            """Say nothing."""

    for kind in ('numba:compile', 'numba:run_pass'):
        event.register(kind, Notice())
    return numba


@cache
def _say_once() -> None:
    logging.getLogger(__package__).warning(
        'kernels are compiled for the first time, which takes up to a minute'
    )


def _warn_of_files(folder: str, problem: str) -> None:
    if folder not in _WARNED_OF:
        _WARNED_OF.add(folder)
        warn(
            f'the cache of numba in {folder} {problem}: kernels are compiled again. '
            'If this message appears at every start, delete the folder',
            RuntimeWarning,
            stacklevel=4,
        )


@cache
def _warn_once(reason: str) -> None:
    warn(f'{reason}; kernels run interpreted, much slower', RuntimeWarning, stacklevel=4)
