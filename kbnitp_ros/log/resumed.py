# SPDX-License-Identifier: Apache-2.0
"""What the base of a recorded mission knows by its evidence, to go on from."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from kbnitp_ros.bag import LogError, read_log, same_types
from kbnitp_ros.core import Ledger
from kbnitp_ros.log.deployments import is_of_mission, read_mission
from kbnitp_ros.log.evidence import begun, PATH, record, REPORT, required_belief


def read_ledger(log: str | Path) -> Ledger:
    """Return the ledger of a mission on record, with all its evidence."""
    prior = required_belief(log)
    if prior.deployments:
        raise LogError(
            f'{log} begins with a belief in {prior.deployments} deployments: the prior is not on '
            'record'
        )
    ledger, mission = begun(prior), read_mission(log)
    with same_types(log):
        for logged in read_log(log, (PATH, REPORT)):
            if is_of_mission(logged, mission):
                # The estimator refused it as well.
                with suppress(ValueError):
                    record(ledger, logged)
    return ledger
