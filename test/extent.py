# SPDX-License-Identifier: Apache-2.0
"""Extent of the tests: quick by default, or everything with KBNITP_TESTS=full."""

from collections.abc import Iterable
import os
from typing import Any

import pytest

VARIABLE = 'KBNITP_TESTS'

FULL = os.environ.get(VARIABLE) == 'full'

# Marks of cases that take minutes or their own networks.
LONG = [pytest.mark.full, pytest.mark.campaign]


def some(cases: Iterable[Any], every: int = 4) -> list[Any]:
    """Return cases for `parametrize`: the first of every few, and the rest marked `full`."""
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)),
            marks=[pytest.mark.full] if number % every else [],
        )
        for number, case in enumerate(cases)
    ]
