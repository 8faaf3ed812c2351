# SPDX-License-Identifier: Apache-2.0
"""The deployments of a log as they came off the wire, for a node that goes on with its mission."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kbnitp_ros.core import deployment_order, DeploymentKey
from kbnitp_ros.log.reader import LoggedMessage, read_log
from kbnitp_ros.log.replay import PATH, REPORT
from kbnitp_ros.messages.deployments import key_of_path
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
    for logged in read_log(log, (PATH, REPORT)):
        message = logged.message
        if logged.type_name == REPORT:
            key = DeploymentKey(message.agent, from_stamp(message.deployment))
            if key not in reports or message.survived > reports[key].message.survived:
                reports[key] = logged
        elif sent := key_of_path(logged.topic, message):
            paths.setdefault(sent, logged)
    return {
        key: RecordedDeployment(paths[key], reports.get(key))
        for key in sorted(paths, key=deployment_order)
    }
