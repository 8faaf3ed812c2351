# SPDX-License-Identifier: Apache-2.0
"""Paths and reports on a small grid, valid ones and others."""

from copy import deepcopy

from kbnitp_msgs.msg import Recorded
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    Report,
    SensorModel,
)
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import path_message, report_message
from kbnitp_ros.messages.headers import content_hash
from kbnitp_ros.messages.standings import standings_fields, standings_message
from rclpy.serialization import deserialize_message, serialize_message

GRID = Grid(4, 3, blocked=[5])
FIELD = {'grid.width': 4, 'grid.height': 3, 'grid.blocked': [5], 'max_steps': 6}
HOME = [0, 1, 2, 1, 0]


def key(number, agent='scout_1'):
    return DeploymentKey(agent, number * 10**9)


def path(number, cells=HOME):
    """Return the path of a deployment."""
    return path_message(GRID, cells, key(number).stamp)


def on_disk(message):
    """Return the recorder's message that a path, or a departure, is on disk."""
    stamp = getattr(message, 'deployment', message.header.stamp)
    return Recorded(stamp=stamp, content=content_hash(message))


AUTHOR = '/estimator'
EPOCH = 1


def new_ledger(grid=GRID, max_steps=6):
    """Return a ledger before the first deployment."""
    estimator = Estimator(Belief.prior(grid, 0.5, 0.45, 0.8), SensorModel(0.5))
    return Ledger(grid, max_steps, estimator)


def standings(ledger, keys=None, since=0, epoch=EPOCH, author=AUTHOR):
    """Return the message of a ledger's standings: all of them by default."""
    keys = ledger.judged if keys is None else keys
    return standings_message(standings_fields(ledger, keys, 1, author, epoch, 7, since))


def belief(ledger, started=1, mission=0, epoch=EPOCH):
    """Return the message of a ledger's belief."""
    return belief_maps(ledger, started, mission, AUTHOR, epoch)


def prior(mission=0):
    return belief(new_ledger(), 1, mission)


def after_loss(mission=0):
    """Return the belief after the first robot was lost."""
    ledger = new_ledger()
    ledger.record_path(key(1), HOME)
    ledger.record_report(key(1), Report(False))
    return belief(ledger, 2, mission)


def returned(number, cells=HOME, agent='scout_1'):
    """Return the report of a robot that came back with a target in every second reading."""
    readings = [step % 2 == 0 for step in range(len(cells) - 1)]
    return report_message(key(number, agent), Observation(cells, True, readings), 0)


def lost(number):
    """Return the report of a robot that was lost."""
    return report_message(key(number), Observation(HOME, False), 0)


def changed(message, **fields):
    copy = deepcopy(message)
    for name, value in fields.items():
        setattr(copy, name, value)
    return copy


def in_frame(message, frame):
    copy = deepcopy(message)
    copy.header.frame_id = frame
    return copy


def with_pose(message, index, **fields):
    copy = deepcopy(message)
    for name, value in fields.items():
        setattr(copy.poses[index].pose.position, name, value)
    return copy


BAD_PATHS = [
    (in_frame(path(2), 'odom'), "header.frame_id is 'odom': it must be 'map'"),
    (changed(path(2), poses=[]), 'poses is empty'),
    (with_pose(path(2), 1, x=99.0), 'outside the grid'),
    (path(2, [0, 2, 1, 0]), 'jump'),
    (path(2, [1, 0, 1]), 'base'),
    (path(2, [0, 4, 5, 1, 0]), 'blocked'),
    (path(2, [0, 1, 0, 1, 0, 1, 0, 0]), 'max_steps = 6'),
    (changed(path(1), poses=path(1, [0, 1, 0]).poses), 'differs from its first path'),
]


def over_the_wire(message):
    """Return the message that a subscriber receives."""
    return deserialize_message(serialize_message(message), type(message))
