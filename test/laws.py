# SPDX-License-Identifier: Apache-2.0
"""Many cases of one law in one test that names a failing case, and corrupt bytes."""

from collections.abc import Callable, Iterable
import functools
import inspect
import shlex
from typing import Any

from hypothesis import strategies as st
import pytest

# Selected cases: that of this name, or those with this value; see `pytest --case`.
alone: str | None = None


def for_each(names: str, cases: Iterable[Any], every: int = 1) -> Callable[[Any], Any]:
    """Run a test for all cases, one after another, as one item."""
    keys = [name.strip() for name in names.split(',')]
    own_cases = [
        dict(zip(keys, case if len(keys) > 1 else (case,), strict=True)) for case in cases
    ]

    def decorate(decorated: Any) -> Any:
        test, inner = getattr(decorated, 'law', (decorated, [{}]))
        combined = [case | others for case in own_cases for others in inner]
        named = [
            (', '.join(f'{k}={called(v)}' for k, v in each.items()), each) for each in combined
        ]

        @functools.wraps(decorated)
        def law(rest: bool = False, **others: Any) -> None:
            chosen = [each for number, each in enumerate(named) if bool(number % every) == rest]
            if alone is not None:
                chosen = [each for each in chosen if is_called(*each, alone)]
                if not chosen:
                    pytest.skip(f'has no case {alone}')
            for number, (name, arguments) in enumerate(chosen):
                own = dict(others)
                if 'tmp_path' in own:
                    own['tmp_path'] /= str(number)
                    own['tmp_path'].mkdir()
                try:
                    with pytest.MonkeyPatch.context() as patch:
                        if 'monkeypatch' in own:
                            own['monkeypatch'] = patch
                        test(**arguments, **own)
                except (Exception, pytest.fail.Exception) as error:
                    message = f'case {name}: {error}\nalone: --case {shlex.quote(name)}'
                    raise AssertionError(message) from error

        signature = inspect.signature(decorated)
        others = [each for name, each in signature.parameters.items() if name not in keys]
        if every == 1:
            law.law = test, combined
            law.__signature__ = signature.replace(parameters=others)
            return law
        rest = inspect.Parameter('rest', inspect.Parameter.KEYWORD_ONLY)
        law.__signature__ = signature.replace(parameters=[*others, rest])
        marked = [False, pytest.param(True, marks=pytest.mark.full)]
        return pytest.mark.parametrize('rest', marked, ids=['some', 'rest'])(law)

    return decorate


def is_called(name: str, arguments: dict[str, Any], told: str) -> bool:
    """Return whether a case or one of its values has this name."""
    return told == name or told in (str(called(value)) for value in arguments.values())


def called(value: Any) -> Any:
    """Return the name of a value; of functions and classes their own."""
    return getattr(value, '__name__', value)


def spoilt(content: bytes) -> st.SearchStrategy[bytes]:
    """Return a strategy for these bytes with some changed, perhaps truncated."""

    def change(changes: list[tuple[int, int]], end: int) -> bytes:
        changed = bytearray(content)
        for place, value in changes:
            changed[place] = value
        return bytes(changed[:end])

    # The start is the most informative part.
    place = st.integers(0, min(80, len(content) - 1)) | st.integers(0, len(content) - 1)
    changes = st.lists(st.tuples(place, st.integers(0, 255)), min_size=1, max_size=6)
    return st.builds(change, changes, st.just(len(content)) | st.integers(0, len(content)))
