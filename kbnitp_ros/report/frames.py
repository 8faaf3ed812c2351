# SPDX-License-Identifier: Apache-2.0
"""The beliefs of a mission in few bytes, for a page."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
import json
from typing import Any
import zlib

from kbnitp_ros.core import Belief
import numpy as np
from numpy.typing import NDArray

NAMES = ('hazard', 'target', 'kappa')
LEVELS = 255


def quantised(beliefs: Sequence[Belief]) -> NDArray[np.uint8]:
    """Return the three maps of beliefs in steps of 1/255, shape (beliefs, 3, cells)."""
    frames = np.empty((len(beliefs), len(NAMES), beliefs[0].cells), dtype=np.uint8)
    for frame, belief in zip(frames, beliefs):
        for level, name in zip(frame, NAMES):
            level[:] = np.rint(LEVELS * getattr(belief, name))
    return frames


def packed_frames(frames: NDArray[np.uint8]) -> str:
    """Pack frames as text: differences modulo 256, zlib, base64."""
    # In uint8 what is less than nothing goes round, as it does in the page.
    changes = np.diff(frames, axis=0, prepend=np.zeros_like(frames[:1]))
    return packed(changes.tobytes())


def packed_json(value: Any) -> str:
    """Return a value as JSON, packed by zlib, in base64; there is no NaN in it."""
    return packed(json.dumps(value, separators=(',', ':'), allow_nan=False).encode())


def packed(data: bytes) -> str:
    """Return bytes packed by zlib, in base64."""
    return b64encode(zlib.compress(data, 6)).decode()
