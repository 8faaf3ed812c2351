# SPDX-License-Identifier: Apache-2.0
"""Where on the earth the parameters put the field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.maps import Datum


def datum_of(values: Mapping[str, Any]) -> Datum | None:
    """
    Return the datum that these parameters give; None if they give none.

    Raises
    ------
    ValueError
        If it is no place on the earth.

    """
    return Datum.of(values['datum'])
