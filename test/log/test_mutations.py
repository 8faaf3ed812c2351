# SPDX-License-Identifier: Apache-2.0
"""A change to any field of any message on record is reported, or docs/log.md says why not."""

from copy import deepcopy
from functools import cache
import json
from math import isnan
from pathlib import Path
import re

from kbnitp_msgs.msg import AgentStatus, Annotation, Finding, Progress, Recorded, Revocation
from kbnitp_ros.cli.replay import lines, replayed
from kbnitp_ros.configuration.known import node_parameters
from kbnitp_ros.core import Lane, Observation, RobotType, Unknowns
from kbnitp_ros.core.inference.record import OrderState
from kbnitp_ros.log.read import PARAMETERS
from kbnitp_ros.log.replayed import Grade
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.deployments import (
    path_message,
    read_report,
    report_message,
    Source,
    status_message,
)
from kbnitp_ros.messages.grids import occupancy_grid
from kbnitp_ros.messages.headers import content_hash, header, to_stamp
from kbnitp_ros.messages.operator_actions import Action, operator_action_message, OperatorAction
from kbnitp_ros.messages.progress import (
    Helper,
    mission_status_message,
    MissionState,
    MissionStatus,
    Need,
    Obstacle,
)
from kbnitp_ros.messages.remarks import read_remark
from kbnitp_ros.messages.states import Readiness, state_message
from kbnitp_ros.messages.topics import History, OF_AGENT, OF_MISSION, REMARKS, TRUTH
from kbnitp_ros.nodes.recorded_topics import message_class
from laws import for_each
from mission_log import Deciding, instead, MAX_STEPS, record_to, without
import numpy as np
import pytest
from rosidl_parser.definition import AbstractNestedType, NamespacedType
from std_msgs.msg import Bool

DOCUMENT = Path(__file__).parents[2] / 'docs/log.md'
TITLE = '## Fields that replay does not compare'
# In place of a field: the message is missing.
MISSING = 'the message'

AGENT, OTHER = 'scout_1', 'scout_2'

# A confidence that the second decision has, and the last one has not.
CONFIDENCE = 0.4

# All recorded topics.
TOPICS = {
    name: topic
    for topics, place in ((OF_MISSION, ''), (OF_AGENT, 'AGENT/'))
    for name, topic in {f'{place}{name}': topic for name, topic in topics.items()}.items()
    if topic.history is not History.NONE
}
KINDS = {
    'path': Recorded.PATH, 'operator': Recorded.ACTION, 'report': Recorded.REPORT,
    **dict.fromkeys(REMARKS, Recorded.REMARK),
}  # fmt: skip
STATUS_KINDS = {
    AgentStatus.ACCEPTED: Recorded.ACCEPTANCE,
    AgentStatus.DEPARTED: Recorded.DEPARTURE,
    AgentStatus.REFUSED: Recorded.REFUSAL,
}

# Starts of lines by which replay reports a message.
REPORTED = ('not ', 'refused', 'by its evidence', 'deployment ')


class Acknowledged(Deciding):
    """A mission with messages on all topics."""

    def publish(self, topic, message):
        super().publish(topic, message)
        agent, _, name = topic.rpartition('/')
        kind = STATUS_KINDS[message.state] if name == 'status' else KINDS.get(name)
        if kind:
            self.publish(
                f'{agent or "operator"}/recorded',
                Recorded(
                    stamp=getattr(
                        message, '' if name in REMARKS else 'deployment', message.header.stamp
                    ),
                    content=content_hash(message),
                    agent=agent,
                    kind=kind,
                ),
            )

    def publish_belief(self):
        super().publish_belief()
        self.publish('progress', Progress(header=header(self.now)))

    def order(self, path, agent, *states):
        """Send a robot on a path, with the statuses of its agent; return the deployment's key."""
        self.publish(f'{agent}/proposal', path_message(self.grid, path, self.now))
        key = self.send_out(path, agent)
        self.hear_path(key, path)
        for state in states:
            self.hear_status(key, state)
        return key

    def hear_status(self, key, state):
        reason = 'no battery' * (state is OrderState.REFUSED)
        self.publish(f'{key.agent}/status', status_message(key, state, self.now, reason))
        if self.ledger.record_status(key, state, self.now):
            self.publish_standings()
            self.publish_belief()
        elif self.ledger.changed:
            self.publish_standings()

    def act(self, action, paths=(), **options):
        action = OperatorAction(self.now, action, 1, dict(paths), **options)
        self.publish('operator', operator_action_message(self.grid, action))

    def say(self, topic, message):
        """Publish and record a remark of a person; return its hash."""
        message.header, message.author, message.note = header(self.now), 'Ann', 'seen'
        self.publish(topic, message)
        remark = read_remark(topic, message)
        remark.record(self.ledger)
        self.publish_standings()
        self.publish_belief()
        return remark.content

    def say_state(self, state, obstacle, ends_by, **numbers):
        status = MissionStatus(
            self.now, '/planner', state, obstacle, ends_by, reason='why', **numbers
        )
        self.publish('mission', mission_status_message(status))


@cache
def whole_mission():
    """Return the messages of a mission of two robots in turn; not to be changed."""
    whole = Acknowledged(
        Lane(to=19, confidence=CONFIDENCE),
        unknowns=Unknowns(lethality=(0.1, 0.9), duds=(0.0, 0.9)),
        robot_types={OTHER: RobotType(malfunction=0.1)},
    )
    back = OrderState.ACCEPTED, OrderState.DEPARTED
    whole.act(Action.START, parameters={'minimum_survival': 0.0})
    for name in TRUTH:
        truth = occupancy_grid(whole.grid, np.eye(1, 20, 3)[0], whole.now)
        for topic in (name, f'{AGENT}/{name}'):
            whole.publish(topic, truth)
    whole.publish('state', state_message(whole.grid, '', Readiness.READY, '', False, whole.now))
    for agent in (AGENT, OTHER):
        state = whole.grid, agent, Readiness.WAITING, 'why', True, whole.now, 'journal'
        whole.publish(f'{agent}/state', state_message(*state))
    for hold in (True, False):
        whole.act(Action.PAUSE if hold else Action.RESUME)
        whole.publish('hold', Bool(data=hold))
        state = MissionState.PAUSED if hold else MissionState.RUNNING
        whole.say_state(state, Obstacle.NONE, Helper.NOBODY, hold=hold)
    tour = [2, 7, 12, 7, 2]
    for number in range(2):
        key = whole.order(tour, AGENT, *back)
        readings = [True, False, number == 1, False]
        whole.hear_report(*whole.come_back(key, Observation(tour, True, readings)))
    # Cells that are closed to robots, and opened again.
    for what, shut in ((Action.NO_GO, (4, 9)), (Action.LIFT, (4,)), (Action.NO_GO, (4, 13))):
        whole.act(what, cells=shut, reason='a wreck', author='Ann')
        whole.no_go = tuple(sorted({*whole.no_go} ^ {*shut}))
        whole.publish_belief()
    # Another report, which contradicts the last one.
    whole.hear_report(*whole.come_back(key, Observation(tour, True, [False] * 4)))
    key = whole.order(tour, AGENT, *back)
    lost = Observation(tour, False, lost_at=[0.0, 0.5, 1.0, 0.5])
    whole.hear_report(*whole.come_back(key, lost))
    for steps in ([2, 3], [3, 4]):
        located = Annotation(kind=Annotation.LOCATED, cause=Annotation.HAZARD, steps=steps)
        located.agent, located.deployment = key.agent, to_stamp(key.stamp)
        located.report = whole.ledger.standings[key].report
        whole.say('annotations', located)
    for cells in ([3, 8], [4, 9]):
        since = to_stamp(whole.now)
        found = Finding(cells=cells, hazard=1, target=1, confidence=0.9, walked=0.4, since=since)
        whole.say('findings', found)
    for said in [*whole.ledger.findings]:
        whole.say('revocations', Revocation(revokes=said))
    key = whole.order(tour, OTHER)
    whole.act(Action.TAKE_BACK, {key: tour}, reason='not needed', author='Ann')
    whole.hear_status(key, OrderState.REFUSED)
    key = whole.order([2, 3, 4, 3, 2], OTHER, *back)
    heard = content_hash(whole.sent[0].message)
    whole.act(Action.GIVE_UP, {key: [2, 3, 4, 3, 2]}, steps_survived=1, settled=(heard,))
    given_up = report_message(
        key,
        Observation([2, 3, 4, 3, 2], False, steps_survived=1),
        whole.now,
        Source.OPERATOR,
        settled=[heard],
    )
    whole.publish(f'{OTHER}/report', given_up)
    whole.hear_report(*read_report(given_up))
    kept = {'waiting': {AGENT: Need.BATTERY}, 'no_go': whole.no_go, 'ordered': 5, 'lost': 2}
    whole.say_state(MissionState.RUNNING, Obstacle.UNREPORTED, Helper.ROBOT, **kept)
    return whole.sent


def replay_log(path, sent):
    """Return a replay of messages, with the parameters of their planner and estimator."""
    defaults = {name: each.default for name, each in node_parameters('planner').items()}
    goal = {'goal.kind': 'lane', 'goal.cells': [19], 'stop.confidence': CONFIDENCE}
    planner = defaults | goal | {'max_steps': MAX_STEPS, 'robots': 20}
    estimator = {'stop.confidence': CONFIDENCE}
    with LogWriter(path) as log:
        for node, values in {'planner': planner, 'estimator': estimator}.items():
            record = {name: json.dumps(value) for name, value in values.items()}
            log.add_metadata(f'{PARAMETERS}/{node}', record)
        record_to(log, sent)
    report = replayed(path)
    path.unlink()
    return report


def leaves(kind, above=''):
    """Yield the names of all fields of a message class that are no messages."""
    for name, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES):
        is_array = isinstance(slot, AbstractNestedType)
        element = slot.value_type if is_array else slot
        full = f'{above}{name}{"[]" * is_array}'
        if isinstance(element, NamespacedType):
            yield from leaves(message_class('/'.join(element.namespaced_name())), f'{full}.')
        else:
            yield full


def other(value):
    """Return another value of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return value[:-1] + ('x' if value[-1:] != 'x' else 'y')
    if isinstance(value, bytes):
        return b'\1' if value == b'\0' else b'\0'
    if isinstance(value, int):
        return value - 1 if value in (127, 255) else value + 1
    if isnan(value):
        return 0.5
    # A probability stays one.
    return value + 1.0 if not 0.0 <= value <= 1.0 else 1.0 - value if value != 0.5 else 0.25


def changed_in(message, field):
    """Return a copy of a message with another value of a field; None if it has none."""
    copy = deepcopy(message)
    *above, last = field.split('.')
    owner = copy
    for name in above:
        owner = getattr(owner, name.removesuffix('[]'))
        if name.endswith('[]'):
            if not owner:
                return None
            owner = owner[-1]
    name = last.removesuffix('[]')
    value = getattr(owner, name)
    if last.endswith('[]'):
        if not len(value):
            return None
        values = list(value)
        values[len(values) // 2] = other(values[len(values) // 2])
        setattr(owner, name, values)
    else:
        setattr(owner, name, other(value))
    return copy


def messages(name):
    """Return the messages on a topic; on topics of agents, those of all agents."""
    own = name.removeprefix('AGENT/')
    agents = (AGENT, OTHER) if own != name else ('',)
    topics = [f'{f"/{agent}" * bool(agent)}/{own}' for agent in agents]
    return [each for each in whole_mission() if each.topic in topics]


def mutations(name, field):
    """Return changes of the mission in a field of a topic: in a message amid others, and last."""
    if field == MISSING:
        found = [without(whole_mission(), each) for each in messages(name)]
    else:
        forged = ((each, changed_in(each.message, field)) for each in messages(name))
        found = [instead(whole_mission(), each, message) for each, message in forged if message]
    return found[len(found) // 2], found[-1]


def excused():
    """Return the fields of each topic that the documentation says are not compared."""
    text = DOCUMENT.read_text().partition(TITLE)[2].partition('\n## ')[0]
    fields = {}
    for topics, names in re.findall(r'^\| `(.+?)` \| (.+?) \| .+ \|$', text, re.MULTILINE):
        for topic in topics.split('`, `'):
            fields.setdefault(topic, []).extend(
                re.sub('`', '', each) for each in names.split(', ')
            )
    return fields


def is_excused(topic, field):
    """Return whether the documentation names a field, or all fields above it."""
    names = excused().get(topic, ())
    if 'all fields' in names and field != MISSING:
        return True
    return any(name == field or field.startswith(f'{name}.') for name in names)


def all_fields(topic):
    return [*leaves(message_class(TOPICS[topic].type_name)), MISSING]


@pytest.mark.slow
@for_each('topic', TOPICS, every=11)
def test_a_change_of_any_field_is_reported_or_documented(tmp_path, topic):
    """Numbers and stamps change by 1, the latter in their seconds and in their nanoseconds."""
    report = replay_log(tmp_path / 'mission.mcap', whole_mission())
    assert report.reproduced, report.mismatches
    known = {*lines(report)}
    unsaid = []
    for field in all_fields(topic):
        for sent in mutations(topic, field):
            report = replay_log(tmp_path / 'mission.mcap', sent)
            told = [each for each in lines(report) if each.startswith(REPORTED)]
            if report.grade != Grade.DIFFERENT and known.issuperset(told):
                unsaid.append(field)
    named = [field for field in all_fields(topic) if is_excused(topic, field)]
    assert [*dict.fromkeys(unsaid)] == named


def test_the_documentation_names_fields_that_exist():
    assert excused().keys() <= TOPICS.keys()
    for topic, names in excused().items():
        fields = all_fields(topic)
        for name in names:
            assert name == 'all fields' or any(
                field == name or field.startswith(f'{name}.') for field in fields
            ), (topic, name)
