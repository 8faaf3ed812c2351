# SPDX-License-Identifier: Apache-2.0
"""Topics and their roles in a mission, and the messages of a log by role."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
import operator
from pathlib import Path
from typing import Any, NamedTuple

from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import (
    Bookmark,
    LoggedMessage,
    parse_parameters,
    read_log,
    read_metadata,
    read_recorded,
    RecordedMessage,
    RUN,
)
from kbnitp_ros.messages.beliefs import belief_field_names, read_belief_maps
from kbnitp_ros.messages.deployments import hear_report, read_path_name, read_status
from kbnitp_ros.messages.grids import read_occupancy_grid
from kbnitp_ros.messages.headers import mission_of_path, read_stamp
from kbnitp_ros.messages.health import read_health
from kbnitp_ros.messages.operator_actions import read_action_name
from kbnitp_ros.messages.progress import (
    check_decision,
    read_mission_status,
    read_model_belief,
)
from kbnitp_ros.messages.remarks import read_remark
from kbnitp_ros.messages.standings import read_standings
from kbnitp_ros.messages.states import read_state
from kbnitp_ros.messages.topics import (
    BELIEF,
    GRID,
    OF_AGENT,
    OF_MISSION,
    PATH,
    REMARKS,
    REPORT,
    ROBOTS,
    topic_names,
)

# Name of the metadata record of the roles, and its key for the namespace.
RECORD = 'roles'
NAMESPACE = 'namespace'

# Maximum number of characters of an invalid message in an error.
MAX_SHOWN = 500


class Role(NamedTuple):
    """The role of a topic, such as `path`, and its agent; '' if the topic has no agent."""

    name: str
    agent: str
    type_name: str


@dataclass(frozen=True)
class Roles:
    """The roles of a mission, such as `scout_1/path`, with the full names of their topics."""

    namespace: str
    names: Mapping[str, str]
    # Whether they were read from a record, which does not change, and not from topics.
    are_recorded: bool = field(default=False, compare=False)

    @classmethod
    def of(
        cls,
        namespace: str,
        agents: Iterable[str],
        resolve: Callable[[str], str] | None = None,
        node: str = 'recorder',
    ) -> Roles:
        """Return the roles of a node, with its resolved topic names."""
        root = namespace.rstrip('/')
        roles = [] if node in ROBOTS else topic_names(node, OF_MISSION)
        roles += [f'{agent}/{name}' for agent in agents for name in topic_names(node, OF_AGENT)]
        return cls(root or '/', {each: (resolve or f'{root}/{{}}'.format)(each) for each in roles})

    @property
    def agents(self) -> list[str]:
        """Return the agents of the team."""
        return [each.removesuffix('/path') for each in self.names if each.endswith('/path')]

    @cached_property
    def by_topic(self) -> dict[str, Role]:
        """Return the role of each topic that has one."""
        roles = {}
        for name, topic in self.names.items():
            agent, _, own = name.partition('/')
            if name in OF_MISSION:
                roles[topic] = Role(name, '', OF_MISSION[name].type_name)
            elif own in OF_AGENT:
                roles[topic] = Role(own, agent, OF_AGENT[own].type_name)
        return roles

    @property
    def record(self) -> dict[str, str]:
        """Return the values of the metadata record `RECORD`."""
        return {NAMESPACE: self.namespace, **self.names}

    def meant_by(self, node: str, stated: Mapping[str, str]) -> dict[str, str]:
        """Return the stated roles of a node that concern this mission."""
        root, above = self.namespace.rstrip('/'), node.rpartition('/')[0]
        if above == root:
            # Only agents' nodes lack the role belief; their agents outside the team are ignored.
            is_whole = 'belief' in stated
            return {role: name for role, name in stated.items() if is_whole or role in self.names}
        agent = above.removeprefix(f'{root}/')
        is_own = agent in self.agents
        return {
            role: name for role, name in stated.items() if is_own and role.startswith(f'{agent}/')
        }

    def is_node(self, name: str) -> bool:
        """Return whether a node of this full name is in the namespace of the mission."""
        above, root = name.rpartition('/')[0], self.namespace.rstrip('/')
        return above in (root, *(f'{root}/{agent}' for agent in self.agents))

    def difference(self, stated: Mapping[str, str]) -> str:
        """Describe the first role for which another node states another topic; empty if none."""
        for role, topic in stated.items():
            own = self.names.get(role)
            if own is None:
                agents = ', '.join(self.agents)
                agent = role.partition('/')[0]
                return f'agent {agent} is not in the parameter agents, which names {agents}'
            if own not in (None, topic):
                return f'{role} is {topic}, and not {own}'
        return ''


def roles_on_record(
    log: str | Path, namespace: str | None = None, own: Roles | None = None
) -> Roles:
    """Return the roles of a mission from its record, or deduced from topics."""
    topics: dict[str, str] = {}
    for item in read_recorded(log, []):
        if isinstance(item, RecordedMessage):
            topics[item.channel.topic] = item.schema.name
        # Other programs may write a record with this name.
        elif (
            item.name == RECORD
            and {NAMESPACE, 'belief'} <= item.values.keys()
            and namespace in (None, item.values[NAMESPACE])
        ):
            return Roles(item.values.pop(NAMESPACE), item.values, are_recorded=True)
    return roles_by_topics(log, namespace, own, topics)


def roles_by_topics(
    log: str | Path, namespace: str | None, reader: Roles | None, topics: Mapping[str, str]
) -> Roles:
    """Return the roles of a bag that another program recorded, from its topics."""
    above = {
        topic.removesuffix('/belief')
        for topic, kind in topics.items()
        if kind == BELIEF and topic.endswith('/belief')
    }
    if namespace is None and len(above) > 1:
        found = ', '.join(sorted(each or '/' for each in above))
        raise LogError(f'{log} has missions in the namespaces {found}: choose one by --namespace')
    # A log without beliefs does not name a mission yet.
    unknown = reader.namespace if reader else ''
    root = (next(iter(above), unknown) if namespace is None else namespace).rstrip('/')
    sent = [
        topic.removeprefix(f'{root}/').partition('/')
        for topic, kind in topics.items()
        if kind in (PATH, REPORT) and topic.startswith(f'{root}/')
    ]
    found_agents = (agent for agent, _, role in sent if role in ('path', 'report'))
    return Roles.of(root, dict.fromkeys([*(reader.agents if reader else ()), *found_agents]))


class MissionLog:
    """A log read by the roles of its topics; topics without a role are ignored."""

    def __init__(
        self, path: str | Path, namespace: str | None = None, own: Roles | None = None
    ) -> None:
        self.path = Path(path)
        self.roles = roles_on_record(path, namespace, own)
        # Defects of invalid messages on topics with a role, by topic and index.
        self.left_out: dict[tuple[str, int], str] = {}

    def read(
        self,
        *names: str,
        corrupt: list[LogError] | None = None,
        progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
        bookmark: Bookmark | None = None,
    ) -> Iterator[tuple[Role, LoggedMessage]]:
        """Yield the messages of roles with these names in order; the rest is as in `read_log`."""
        roles = {topic: each for topic, each in self.roles.by_topic.items() if each.name in names}
        types = {each.type_name for each in roles.values()}
        for logged in progress(read_log(self.path, types, corrupt, roles.keys(), bookmark)):
            role = roles[logged.topic]
            if role.type_name != logged.type_name:
                continue
            if role.name == 'belief':
                check_version(self.path, logged.message)
            try:
                with self.leaving_out(logged):
                    logged = replace(logged, said=read_content(role, logged.message))
            except (AttributeError, TypeError) as error:
                raise LogError(
                    f'{self.path} has messages of another version of their type: {error}'
                ) from error
            if (logged.topic, logged.index) not in self.left_out:
                yield role, logged

    @contextmanager
    def leaving_out(self, logged: LoggedMessage) -> Iterator[None]:
        """Leave out a message if the body of the `with` statement raises ValueError."""
        try:
            yield
        except LogError:
            raise
        except ValueError as error:
            self.left_out[logged.topic, logged.index] = str(error)[:MAX_SHOWN]

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Return the last parameters of the mission's nodes, by their full names."""
        return self.parse_parameters(read_metadata(self.path, []))

    def parse_parameters(
        self, metadata: Mapping[str, Mapping[str, str]]
    ) -> dict[str, dict[str, Any]]:
        """Return the parameters of the mission's nodes in the metadata of the log."""
        known = parse_parameters(self.path, metadata)
        return {name: values for name, values in known.items() if self.roles.is_node(name)}


def resumed_log(log: str, own: Roles) -> MissionLog:
    """Return a log to resume; raise ValueError if it is not of the node's mission."""
    try:
        recorded = MissionLog(log, own=own)
    except LogError:
        # The log may hold several missions.
        recorded = MissionLog(log, own.namespace, own)
    if differs := recorded.roles.difference(own.names):
        raise ValueError(
            f'{log} is of another mission: {differs} (namespace, remapped topics and the '
            'parameter agents must be those of the mission)'
        )
    return recorded


def read_content(role: Role, message: Any) -> Any:
    """Convert a message by its role, without the grid; raise ValueError if that fails."""
    match role.name:
        case 'path':
            return DeploymentKey(role.agent, read_path_name(message)), mission_of_path(message)
        case 'report':
            return hear_report(message, role.agent)
        case 'status':
            return read_status(message, role.agent)
        case 'standings':
            return read_standings(message)
        case 'mission':
            return read_mission_status(message)
        case 'state':
            return read_state(message, role.agent)
        case 'health':
            return read_health(message, role.agent)
        case 'operator':
            return read_action_name(message)
        case name if name in REMARKS:
            return read_remark(name, message)
        case 'belief':
            operator.index(message.deployments)
            return read_belief_maps(message)
        case 'model':
            return read_model_belief(message)
        case 'decision':
            return check_decision(message)
        case 'progress':
            return read_stamp('header.stamp', message.header.stamp)
    return read_occupancy_grid(message) if role.type_name == GRID else None


def check_version(log: str | Path, belief: Any) -> None:
    """Check that a log was recorded with this version's message types."""
    known, fields = belief_field_names(), set(belief.__slots__)
    if known != fields:
        recorder = read_metadata(log, []).get(RUN, {}).get('kbnitp_ros', 'not on record')
        differing = min(known ^ fields)
        raise LogError(
            f'{log} was recorded by another version ({recorder}): the field {differing} of its '
            'beliefs is not that of this version; logs of 1.x are read by kbnitp_ros 1.9'
        )
