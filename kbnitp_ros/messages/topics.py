# SPDX-License-Identifier: Apache-2.0
"""The topics of a mission: names, types, QoS, and the roles that publish and read them."""

from __future__ import annotations

from enum import auto, Enum
from typing import NamedTuple

ANNOTATION = 'kbnitp_msgs/msg/Annotation'
BELIEF = 'kbnitp_msgs/msg/BeliefMaps'
BOOL = 'std_msgs/msg/Bool'
DECISION = 'kbnitp_msgs/msg/Decision'
FINDING = 'kbnitp_msgs/msg/Finding'
GRID = 'nav_msgs/msg/OccupancyGrid'
HEALTH = 'kbnitp_msgs/msg/AgentHealth'
MISSION = 'kbnitp_msgs/msg/MissionStatus'
MODEL = 'kbnitp_msgs/msg/ModelBelief'
OPERATOR = 'kbnitp_msgs/msg/OperatorAction'
PATH = 'nav_msgs/msg/Path'
PROGRESS = 'kbnitp_msgs/msg/Progress'
RECORDED = 'kbnitp_msgs/msg/Recorded'
RECORDERS = 'kbnitp_msgs/msg/RecorderState'
REPORT = 'kbnitp_msgs/msg/DeploymentReport'
REVOCATION = 'kbnitp_msgs/msg/Revocation'
STANDINGS = 'kbnitp_msgs/msg/Standings'
STATE = 'kbnitp_msgs/msg/AgentState'
STATUS = 'kbnitp_msgs/msg/AgentStatus'


class History(Enum):
    """The messages that a publisher keeps for nodes that join late."""

    # All messages of a mission.
    ALL = auto()
    # The last messages, of which a reader may ask for all by subscribing again.
    SOME = auto()
    # The last message.
    LAST = auto()
    # Nothing.
    NONE = auto()


class Topic(NamedTuple):
    """A topic of a mission, or of each of its agents, relative to its namespace."""

    name: str
    type_name: str
    history: History
    # Roles of the nodes that publish it, and of those that read it beside the recorder.
    authors: tuple[str, ...]
    readers: tuple[str, ...] = ()


ROBOTS = ('agent', 'robot')
BASE = ('planner', 'estimator')
ESTIMATOR, PLANNER, RECORDER = ('estimator',), ('planner',), ('recorder',)

# What people say of the field and of deployments.
REMARKS = {'findings': FINDING, 'annotations': ANNOTATION, 'revocations': REVOCATION}

# The maps of a belief, and those of the hidden truth.
VIEWS = ('hazard', 'target', 'kappa')
TRUTH = ('truth/hazard', 'truth/target')

OF_MISSION = {
    topic.name: topic
    for topic in (
        Topic('standings', STANDINGS, History.SOME, ESTIMATOR, (*PLANNER, *ESTIMATOR)),
        Topic('belief', BELIEF, History.LAST, ESTIMATOR, PLANNER),
        Topic('decision', DECISION, History.LAST, ESTIMATOR, (*PLANNER, *ESTIMATOR)),
        Topic('decision/lane', PATH, History.LAST, ESTIMATOR),
        Topic('model', MODEL, History.LAST, ESTIMATOR),
        Topic('progress', PROGRESS, History.LAST, ESTIMATOR),
        *(Topic(f'belief/{name}', GRID, History.LAST, ESTIMATOR) for name in VIEWS),
        Topic('mission', MISSION, History.LAST, PLANNER, ESTIMATOR),
        Topic('operator', OPERATOR, History.ALL, PLANNER, ROBOTS),
        *(Topic(name, kind, History.ALL, ESTIMATOR) for name, kind in REMARKS.items()),
        Topic('operator/recorded', RECORDED, History.ALL, RECORDER, BASE),
        Topic('hold', BOOL, History.LAST, PLANNER, (*PLANNER, *ROBOTS)),
        Topic('state', STATE, History.LAST, PLANNER, (*PLANNER, *ROBOTS)),
        Topic('recorders', RECORDERS, History.NONE, RECORDER, RECORDER),
        *(Topic(name, GRID, History.LAST, ('agent',), ESTIMATOR) for name in TRUTH),
    )
}
OF_AGENT = {
    topic.name: topic
    for topic in (
        Topic('path', PATH, History.ALL, PLANNER, (*BASE, *ROBOTS)),
        Topic('proposal', PATH, History.LAST, PLANNER),
        # The planner reports robots that are given up.
        Topic('report', REPORT, History.ALL, (*PLANNER, *ROBOTS), BASE),
        Topic('health', HEALTH, History.NONE, ROBOTS, PLANNER),
        Topic('state', STATE, History.LAST, ROBOTS, (*PLANNER, *ROBOTS)),
        Topic('status', STATUS, History.ALL, ROBOTS, BASE),
        Topic('recorded', RECORDED, History.ALL, RECORDER, (*BASE, *ROBOTS)),
        *(Topic(name, GRID, History.LAST, ('agent',), ESTIMATOR) for name in TRUTH),
    )
}


def topic_names(role: str, topics: dict[str, Topic]) -> list[str]:
    """Return the names of the topics that nodes of a role publish or read."""
    if role == 'recorder':
        # Only recorders read each other's signs of life.
        return [topic.name for topic in topics.values() if topic.readers != RECORDER]
    # Simulated agents publish the truth under two names, of which they state none.
    return [
        topic.name
        for topic in topics.values()
        if role in (*topic.authors, *topic.readers) and topic.name not in TRUTH
    ]
