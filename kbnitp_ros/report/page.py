# SPDX-License-Identifier: Apache-2.0
"""The page of a mission: one HTML file that needs no network."""

from __future__ import annotations

from base64 import b64encode
from functools import cache
import gzip
from hashlib import sha256
from html import escape
from importlib.resources import files
import json
from pathlib import Path
import re
from typing import Any

from kbnitp_ros.report.facts import mission_facts, mission_title, packed
from kbnitp_ros.report.mission import MissionSummary
from kbnitp_ros.report.tables import Curves
import numpy as np

# Maximum bytes of a page that can be sent by mail.
MAX_BYTES = 15_000_000

# Facts that a search of the file finds.
PLAIN = ('name', 'summary', 'notes', 'tiles', 'configuration', 'frames')


def mission_page(mission: MissionSummary, curves: Curves) -> tuple[str, str]:
    """Return the page of a mission, of at most `MAX_BYTES`, and a note on omitted moments."""
    facts, left_out = fitting_facts(mission, curves)
    return page(mission.log, facts), left_out


def fitting_facts(mission: MissionSummary, curves: Curves) -> tuple[str, str]:
    """Return the facts that fit into a page, in JSON, and a note on omitted moments."""
    moments = len(mission.moments)
    empty = len(page(mission.log).encode())
    stride = 1
    while True:
        kept = np.unique([*range(0, moments, stride), moments - 1])
        left_out = ''
        if stride > 1:
            left_out = (
                f'The page shows {kept.size} of {moments} moments, one in {stride}, to stay below '
                f'{MAX_BYTES // 10**6} MB; deployments.csv and belief.npz have all moments.'
            )
        whole = packed_facts(mission_facts(mission, curves, kept, left_out))
        if empty + len(whole) <= MAX_BYTES:
            return whole, left_out
        if kept.size == 2:
            raise ValueError(
                f'a page of {mission.grid.cells} cells has {(empty + len(whole)) / 1e6:.1f} MB '
                f'with two beliefs: at most {MAX_BYTES / 1e6:.0f} MB are allowed'
            )
        needed = stride * len(whole) / max(1, MAX_BYTES - empty)
        stride = min(moments, max(stride + 1, int(needed)))


def packed_facts(facts: dict[str, Any]) -> str:
    """Return facts in JSON for a page: sentences and parameters as texts, all else packed."""
    rest = {name: facts[name] for name in facts if name not in PLAIN}
    plain = {name: facts[name] for name in PLAIN}
    return in_json({**plain, 'packed': packed(in_json(rest).encode())})


def in_json(value: dict[str, Any]) -> str:
    """Return a value in JSON, without tags of HTML."""
    text = json.dumps(value, separators=(',', ':'), allow_nan=False)
    return text.replace('<', '\\u003c')


def page(log: Path, facts: str = '', *, has_board: bool = False) -> str:
    """Return the page of a log with packed facts; without any it asks its server for them."""
    title = escape(f'Mission {mission_title(log)}')
    board = ' data-board="look"' if has_board else ''
    parts = {**shared_parts(), 'title': title, 'facts': facts, 'board': board}
    return re.sub('@([a-z]+)@', lambda match: parts[match[1]], asset('page.html').decode())


@cache
def shared_parts() -> dict[str, str]:
    """Return the parts that all pages share: style, scripts, and Plotly packed by gzip."""
    return {
        'style': asset('page.css').decode(),
        'script': script().decode(),
        'plotly': b64encode(asset('plotly-cartesian.min.js.gz')).decode(),
        'policy': policy(),
    }


@cache
def policy() -> str:
    """Return the content security policy of all pages, which allows their own scripts only."""
    plotly = gzip.decompress(asset('plotly-cartesian.min.js.gz'))
    digests = [sha256(code).digest() for code in (script(), plotly)]
    scripts = ' '.join(f"'sha256-{b64encode(digest).decode()}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; "
        "img-src data: blob:; connect-src 'self'"
    )


def script() -> bytes:
    """Return the script of all pages."""
    return b''.join(map(asset, ('drawing.js', 'map.js', 'board.js', 'page.js')))


def asset(name: str) -> bytes:
    """Return a file of the page that is the same for all missions."""
    return files('kbnitp_ros.report').joinpath('assets').joinpath(name).read_bytes()
