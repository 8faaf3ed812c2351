# SPDX-License-Identifier: Apache-2.0
"""The deployments of a log as they came off the wire, for a node that goes on with its mission."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kbnitp_ros.core import deployment_order, DeploymentKey
from kbnitp_ros.log.bag import LoggedMessage, read_log, same_types
from kbnitp_ros.log.replay import BELIEF, PATH, REPORT
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.deployments import agent_of, key_of_path
from kbnitp_ros.messages.headers import from_stamp


@dataclass
class RecordedDeployment:
    """
    What a log has of a deployment.

    Attributes
    ----------
    path : LoggedMessage
        A nav_msgs/Path.
    report : LoggedMessage or None
        A DeploymentReport; None if the robot was still out. That of a return, if there is one.

    """

    path: LoggedMessage
    report: LoggedMessage | None = None


def read_deployments(log: str | Path) -> dict[DeploymentKey, RecordedDeployment]:
    """
    Return the deployments whose path is on record, in the order they were made.

    Parameters
    ----------
    log : str or Path
        The log of one mission, finished or not.

    Raises
    ------
    LogError
        If it cannot be read or is damaged.

    """
    paths: dict[DeploymentKey, LoggedMessage] = {}
    reports: dict[DeploymentKey, LoggedMessage] = {}
    with same_types(log):
        for logged in read_log(log, (PATH, REPORT)):
            message = logged.message
            if logged.type_name == REPORT:
                key = DeploymentKey(message.agent, from_stamp(message.deployment))
                # No node believed who answered for another.
                if key.agent == agent_of(logged.topic) and (
                    key not in reports or message.survived > reports[key].message.survived
                ):
                    reports[key] = logged
            elif sent := key_of_path(logged.topic, message):
                paths.setdefault(sent, logged)
    return {
        key: RecordedDeployment(paths[key], reports.get(key))
        for key in sorted(paths, key=deployment_order)
    }


def read_newest_round(
    log: str | Path, deployments: dict[DeploymentKey, RecordedDeployment]
) -> tuple[Snapshot, list[DeploymentKey]] | None:
    """
    Return the belief that the newest deployments on record were planned on, and which these are.

    A round's first path, which need not be on record, has the stamp of the belief that it was
    planned on. A belief in some of the round's robots is younger than the round.

    Parameters
    ----------
    log : str or Path
        The log of one mission, finished or not.
    deployments : dict
        Those of the log, in the order they were made.

    Returns
    -------
    tuple or None
        None if that belief is not on record.

    Raises
    ------
    LogError
        If the log cannot be read or is damaged.
    ValueError
        If that belief is not one.

    """
    keys = list(deployments)
    planned_on = None
    with same_types(log):
        for logged in read_log(log, (BELIEF,)):
            held, stamp = logged.message.deployments, from_stamp(logged.message.header.stamp)
            if held < len(keys) and stamp <= keys[held].stamp:
                planned_on = logged.message
        if planned_on is None:
            return None
        first = planned_on.deployments
        return read_belief_maps(planned_on), keys[first:]
