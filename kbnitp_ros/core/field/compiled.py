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
from functools import cache, update_wrapper
from hashlib import sha256
import logging
from os.path import realpath
from pathlib import Path
from shutil import rmtree
from typing import Any, cast, TypeVar
from warnings import warn

Kernel = TypeVar('Kernel', bound=Callable[..., Any])
PACKAGE = Path(__file__).parents[2]
_CHECKS: list[Callable[[], None]] = []

# Whether kernels that are not loaded yet run interpreted.
_INTERPRETED = ContextVar('interpreted', default=False)


def compiled(kernel: Kernel) -> Kernel:
    """Return the kernel, compiled at its first call; interpreted if numba is missing."""
    return cast(Kernel, Compiled(kernel, is_inlined=False))


def inlined(kernel: Kernel) -> Kernel:
    """Inline a kernel that other kernels call in loops; it must not make or return arrays."""
    return cast(Kernel, Compiled(kernel, is_inlined=True))


@contextmanager
def interpreted(applies: bool = True) -> Iterator[None]:
    """Run kernels interpreted: faster for a few calls, as loading them takes half a second."""
    token = _INTERPRETED.set(applies)
    try:
        yield
    finally:
        _INTERPRETED.reset(token)


def while_compiling(check: Callable[[], None]) -> None:
    """Call a function before each pass of the compiler; its exceptions end the compilation."""
    _CHECKS.append(check)


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
        """Return the compiled code, or the kernel itself if numba is missing."""
        if self._code is None:
            self._code = self._kernel
            if jit := _jit():
                # Reference counting of arrays would take a large part of the time.
                options = {'forceinline': self._is_inlined, '_nrt': not self._is_inlined}
                self._code = _cached(_for_all_values(jit(nogil=True, **options)(self._kernel)))
            # numba compiles calls of another kernel only if its name refers to compiled code.
            names = self._kernel.__globals__
            for name, each in [*names.items()]:
                if isinstance(each, Compiled):
                    names[name] = each.code
        return self._code


def cache_folder() -> Path:
    """Return the cache folder, named by a hash of all kernels' sources: old code is never used."""
    sources = b''.join(path.read_bytes() for path in sorted(PACKAGE.rglob('*_kernels.py')))
    return PACKAGE / '__pycache__' / f'kernels-{sha256(sources).hexdigest()[:16]}'


@cache
def _jit() -> Any:
    """Return numba's decorator with its cache set up; None if kernels run interpreted."""
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
        """Hooks of numba into each compilation and its passes."""

        def on_start(self, event: Any) -> None:
            if event.kind == 'numba:compile':
                _say_once('compiling kernels, which takes up to half a minute')
            for check in _CHECKS:
                check()

        def on_end(self, event: Any) -> None:
            """Do nothing."""

    for kind in ('numba:compile', 'numba:run_pass'):
        numba.core.event.register(kind, Compilation())
    return numba.njit


def _for_all_values(code: Any) -> Any:
    """Return a dispatcher that compiles a call with constants as a call with variables."""
    import numba

    compile_for, unliteral = code.get_call_template, numba.types.unliteral

    def get_call_template(args: Any, kws: Any) -> Any:
        return compile_for([*map(unliteral, args)], {n: unliteral(a) for n, a in kws.items()})

    code.get_call_template = get_call_template
    return code


def _cached(code: Any) -> Any:
    """Return a numba dispatcher whose cache tolerates corrupt files and a full disk."""
    try:
        code.enable_caching()
    except RuntimeError as error:
        _warn(f'{error}; kernels are compiled at every start: set NUMBA_CACHE_DIR')
        return code
    files = code._cache

    def guarded(access: Callable[..., Any]) -> Callable[..., Any]:
        def access_or_remove(*arguments: Any) -> Any:
            try:
                return access(*arguments)
            except Exception as error:
                # pickle raises many types of exceptions on a corrupt file.
                _warn(f'{error!r}; {files.cache_path} is emptied and kernels are compiled anew')
                rmtree(files.cache_path, ignore_errors=True)

        return access_or_remove

    files.load_overload = guarded(files.load_overload)
    files.save_overload = guarded(files.save_overload)
    return code


def _warn(message: str) -> None:
    warn(message, RuntimeWarning, stacklevel=4)


@cache
def _say_once(message: str) -> None:
    logging.getLogger(__package__).warning(message)
