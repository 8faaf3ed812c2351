# SPDX-License-Identifier: Apache-2.0
"""
What messages hold, as plain objects with the fields of their types.

Whoever computes, compares or reads the content of messages does not need the packages that define
them: those are imported only where a message is made to be sent.
"""

from __future__ import annotations

from array import array
from types import SimpleNamespace
from typing import TypeVar

import numpy as np

M = TypeVar('M')

# An object with fields, arrays of numbers as numpy's, lists of messages as lists of such objects.
Fields = SimpleNamespace


def filled(message: M, fields: Fields) -> M:
    """Return a message, after its fields were set."""
    for name, value in vars(fields).items():
        if isinstance(value, Fields):
            filled(getattr(message, name), value)
        elif isinstance(value, np.ndarray):
            # Of all that can be assigned, only this type is not checked value by value.
            setattr(message, name, array(value.dtype.char, value.tobytes()))
        elif not (isinstance(value, list) and value and isinstance(value[0], Fields)):
            setattr(message, name, value)
    return message
