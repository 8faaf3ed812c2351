# SPDX-License-Identifier: Apache-2.0
"""A mission as a table of pandas."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core.field import Belief, binary_entropy, log_loss, Observation, World
from kbnitp_ros.plugins import extra

if TYPE_CHECKING:
    from pandas import DataFrame


def deployments_table(
    observations: Iterable[Observation],
    beliefs: Iterable[Belief | None],
    worlds: Iterable[World | None],
) -> DataFrame:
    """
    Return one row a deployment.

    Parameters
    ----------
    observations : iterable of Observation
        In deployment order.
    beliefs : iterable of Belief or None
        After each; None where it is not known.
    worlds : iterable of World or None
        The truth then, if it is known.

    Returns
    -------
    pandas.DataFrame
        The columns ``path`` (list of int), ``steps``, ``survived``, ``steps_survived`` of a lost
        robot, ``readings`` (list of int, None of a lost robot), ``hazard_entropy``,
        ``target_entropy`` in nats and, with the truth, ``hazard_log_loss``, ``target_log_loss``.

    Raises
    ------
    ModuleNotFoundError
        If pandas is not installed.

    """
    with extra('report'):
        import pandas
    rows = [
        {**outcome(seen), **knowledge(belief, world)}
        for seen, belief, world in zip(observations, beliefs, worlds, strict=True)
    ]
    return pandas.DataFrame(rows, index=pandas.RangeIndex(1, len(rows) + 1, name='deployment'))


def outcome(seen: Observation) -> dict[str, Any]:
    """Return the columns of what came of a deployment."""
    return {
        'path': seen.path.tolist(),
        'steps': len(seen.path) - 1,
        'survived': seen.survived,
        'steps_survived': None if seen.survived else seen.steps_survived,
        'readings': None if seen.readings is None else seen.readings.astype(int).tolist(),
    }


def knowledge(belief: Belief | None, world: World | None) -> dict[str, float]:
    """Return the columns of what is known after it."""
    columns: dict[str, float] = {}
    for name in ('hazard', 'target') if belief else ():
        values = getattr(belief, name)
        columns[f'{name}_entropy'] = float(binary_entropy(values).sum())
        if world:
            columns[f'{name}_log_loss'] = float(log_loss(values, getattr(world, name)))
    return columns
