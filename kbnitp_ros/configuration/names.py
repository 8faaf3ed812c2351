# SPDX-License-Identifier: Apache-2.0
"""The names of parameters and agents, and which of them one that is misspelt may mean."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
import re

NAME = '[A-Za-z][A-Za-z0-9_]*'


def own_name(name: str) -> tuple[str, str] | None:
    """Return the agent and the parameter that ``team.AGENT.NAME`` names; None of other names."""
    own = re.fullmatch(rf'team\.({NAME})\.(.+)', name)
    return (own[1], own[2]) if own else None


def nearest(name: str, known: Iterable[str]) -> str:
    """Return which of the names known may have been meant, as a question; empty when none."""
    # A name within groups, such as lethality, is further from the whole ones than it looks.
    meant = [each for each in sorted(known) if each.rpartition('.')[2] == name]
    meant = meant or get_close_matches(name, sorted(known), n=1, cutoff=0.5)
    return f'did you mean {" or ".join(meant)}? ' if meant else ''
