# SPDX-License-Identifier: Apache-2.0
"""What the base of a recorded mission knows by its evidence, to go on from."""

from __future__ import annotations

from contextlib import suppress

from kbnitp_ros.bag import LogError
from kbnitp_ros.core import Ledger
from kbnitp_ros.log.deployments import is_of_mission, read_mission
from kbnitp_ros.log.evidence import begun, record, required_belief
from kbnitp_ros.log.roles import MissionLog


def read_ledger(log: MissionLog) -> Ledger:
    """Return the ledger of a mission on record, with all its evidence."""
    prior = required_belief(log)
    if prior.deployments:
        raise LogError(
            f'{log.path} begins with a belief in {prior.deployments} deployments: the prior is '
            'not on record'
        )
    ledger, mission = begun(prior), read_mission(log)
    for role, logged in log.read('path', 'report'):
        if is_of_mission(role, logged.message, mission):
            # The estimator refused it as well.
            with suppress(ValueError):
                record(ledger, role, logged.message)
    return ledger
