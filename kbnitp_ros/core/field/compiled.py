# SPDX-License-Identifier: Apache-2.0
"""
Compilation of kernels by numba, which is imported when the first kernel is called.

Kernels give the same bits compiled and interpreted if they take functions from `math`, use neither
`**` nor sums of whole arrays, and never divide by 0 or take its logarithm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, partial, update_wrapper
from hashlib import sha256
import logging
from os.path import realpath
from pathlib import Path
from shutil import rmtree
from typing import Any, cast, TypeVar
from warnings import warn

Kernel = TypeVar('Kernel', bound=Callable[..., Any])
PACKAGE = Path(__file__).parents[2]
_warn = partial(warn, category=RuntimeWarning, stacklevel=2)

# Whether kernels that are not loaded yet run interpreted.
_INTERPRETED = ContextVar('interpreted', default=False)


def compiled(kernel: Kernel) -> Kernel:
    """Return the kernel, compiled at its first call; interpreted if numba is missing."""
    return cast(Kernel, Compiled(kernel, is_inlined=False))


def inlined(kernel: Kernel) -> Kernel:
    """Inline a kernel that other kernels call in loops; it must not make or return arrays."""
    return cast(Kernel, Compiled(kernel, is_inlined=True))


@cache
def announce() -> None:
    """Print once that kernels are being compiled."""
    logging.getLogger(__package__).warning('compiling kernels, which takes up to half a minute')


# Functions called before each pass of the compiler: their exceptions end the compilation.
WHILE_COMPILING: list[Callable[[], None]] = [announce]


@contextmanager
def interpreted(applies: bool = True) -> Iterator[None]:
    """Run kernels interpreted: faster for a few calls, as loading them takes half a second."""
    token = _INTERPRETED.set(applies)
    try:
        yield
    finally:
        _INTERPRETED.reset(token)


class Compiled:
    """A kernel that is compiled at its first call, with the kernels it calls."""

    def __init__(self, kernel: Callable[..., Any], is_inlined: bool) -> None:
        # numba names its cache by this path, which must not depend on how the file is imported.
        file = realpath(kernel.__code__.co_filename)
        kernel.__code__ = kernel.__code__.replace(co_filename=file)
        update_wrapper(self, kernel)
        self._kernel, self._is_inlined, self._code = kernel, is_inlined, cast(Any, None)

    def __call__(self, *arguments: Any) -> Any:
        code = self._code or (self._kernel if _INTERPRETED.get() else self.code)
        return code(*arguments)

    @property
    def code(self) -> Any:
        """Return the compiled code, or the kernel itself if numba is missing or disabled."""
        if self._code is None:
            self._code = _dispatcher(self._kernel, self._is_inlined) if _numba() else self._kernel
            # numba compiles calls of another kernel only if its name refers to compiled code.
            names = self._kernel.__globals__
            names.update({n: each.code for n, each in names.items() if isinstance(each, Compiled)})
        return self._code


def cache_folder() -> Path:
    """Return the cache folder, named by a hash of all kernels and of this file."""
    files = [*sorted(PACKAGE.rglob('*_kernels.py')), Path(__file__)]
    sources = b''.join(path.read_bytes() for path in files)
    return PACKAGE / '__pycache__' / f'kernels-{sha256(sources).hexdigest()[:16]}'


@cache
def _numba() -> Any:
    """Return numba, set up; None if kernels run interpreted."""
    try:
        import numba
    except ImportError as error:
        _warn(f'{error}; kernels run interpreted, slowly: pip install numba')
        return None
    if numba.config.DISABLE_JIT:
        return None
    # If this folder is not writable, numba chooses another one.
    numba.config.CACHE_DIR = numba.config.CACHE_DIR or str(cache_folder())

    class Compilation(numba.core.event.Listener):  # type: ignore[misc]
        """A hook of numba before each pass of the compiler."""

        def on_start(self, event: Any) -> None:
            for function in WHILE_COMPILING:
                function()

        def on_end(self, event: Any) -> None:
            """Do nothing."""

    numba.core.event.register('numba:run_pass', Compilation())
    return numba


def _dispatcher(kernel: Callable[..., Any], is_inlined: bool) -> Any:
    """Return numba's dispatcher of a kernel, with a cache that tolerates what a disk does."""
    # Reference counting of arrays would take a large part of the time. A kernel inherits options
    # that are not set from the kernel that calls it.
    options = {'forceinline': is_inlined, '_nrt': not is_inlined}
    code, unliteral = _numba().njit(nogil=True, **options)(kernel), _numba().types.unliteral
    # A call with constants is compiled as a call with variables.
    template = code.get_call_template
    code.get_call_template = lambda args, kws: template([*map(unliteral, args)], kws)
    try:
        code.enable_caching()
    except RuntimeError as error:
        _warn(f'{error}; kernels are compiled at every start: set NUMBA_CACHE_DIR')
        return code
    for name in ('load_overload', 'save_overload'):
        access = partial(_access, code._cache.cache_path, getattr(code._cache, name))
        setattr(code._cache, name, access)
    return code


def _access(folder: str, access: Callable[..., Any], *arguments: Any) -> Any:
    """Access a cache; empty its folder if a file is corrupt or the disk is full."""
    try:
        return access(*arguments)
    except Exception as error:
        # pickle raises many types of exceptions on a corrupt file.
        _warn(f'{error!r}; {folder} is emptied and kernels are compiled anew')
        rmtree(folder, ignore_errors=True)
