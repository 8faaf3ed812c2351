# SPDX-License-Identifier: Apache-2.0
"""Planner, estimator and recorder as one loop without nodes, from one seed."""

from collections import deque
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

from kbnitp_ros.base.protocol import PlannerState
from kbnitp_ros.base.state import EvidenceName, LackingError, MissingError
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    SensorModel,
)
from kbnitp_ros.core.inference.record import OPEN, OrderState, Verdict
from kbnitp_ros.log.read import LoggedMessage
from kbnitp_ros.log.record import fold_evidence, RecordedMission
from kbnitp_ros.log.roles import read_content, Role
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import (
    hear_report,
    path_message,
    read_path,
    read_report,
    read_status,
    report_message,
    Source,
    status_message,
)
from kbnitp_ros.messages.headers import content_hash
from kbnitp_ros.messages.operator_actions import (
    Action,
    operator_action_message,
    OperatorAction,
    read_operator_action,
)
from kbnitp_ros.messages.progress import Helper, Obstacle
from kbnitp_ros.messages.standings import read_standings, standings_fields, standings_message
from kbnitp_ros.messages.topics import OF_AGENT, OF_MISSION
from kbnitp_ros.robot.journal import JournaledDeployment
from kbnitp_ros.robot.orders import Orders
import numpy as np
from rclpy.serialization import serialize_message

GRID = Grid(3, 3, base=4)
PATHS = [[4, 0, 4], [4, 1, 0, 4], [4, 8, 4]]
# Sensors that make evidence impossible, or do not.
MODELS = [
    SensorModel(0.5),
    SensorModel(0.5, true_positive=1.0, false_positive=0.0),
    SensorModel(1.0, malfunction=0.0, false_negative=0.0),
]
AGENTS = ['a', 'b']
VALUES = {
    'robots': 4, 'rolling': False, 'recorded': True, 'silent_loss': True,
    'presume_departure': False, 'return_deadline': 10.0, 'step_period': 1.0,
}  # fmt: skip
OTHER = '0123456789abcdef'
EVIDENCE = 'path', 'report', 'status', 'standings'
ACKNOWLEDGED = 'path', 'report', 'status', 'operator'


class States:
    """Agents that say nothing of themselves."""

    foreign = unstated = ()

    def reason(self, agent):
        return ''

    def reasons(self):
        return ''


class Loop:
    """A base, its agents and its operator; a random generator chooses what happens next."""

    def __init__(self, seed, rolling=None):
        self.rng = np.random.default_rng(seed)
        self.model = MODELS[self.rng.integers(3)]
        self.values = {**VALUES, 'rolling': bool(self.rng.integers(2))}
        # Messages on their way, by author, topic and reader.
        self.wires = {}
        # What each author has published and repeats for readers that join late, by topic.
        self.kept = {}
        self.log = []
        self.on_disk = set()
        self.stamp = 0
        self.clock = 10**6
        self.actions = 0
        self.plans = {}
        self.reported = {}
        # Orders of which the agents heard that they are taken back.
        self.taken_back = set()
        # Number of robots that each agent has had before.
        self.replaced = dict.fromkeys(AGENTS, 0)
        self.start_recorder()
        self.start_estimator()
        self.start_planner()

    def choose(self, options):
        return options[self.rng.integers(len(options))]

    # Wires: reliable and in order for one author, topic and reader; doubled at a restart.

    def publish(self, author, topic, message, *, keep=True):
        if keep:
            self.kept.setdefault((author, topic), []).append(message)
        agents = ['agents'] if topic == 'operator' else []
        for reader in ('planner', 'estimator', 'recorder', *agents):
            self.wires.setdefault((author, topic, reader), deque()).append(message)

    def join(self, reader):
        """Give a reader that starts what publishers keep, after nothing of before."""
        for key in [key for key in self.wires if key[2] == reader]:
            del self.wires[key]
        for (author, topic), messages in self.kept.items():
            self.wires[author, topic, reader] = deque(messages)

    def leave(self, author):
        """End a publisher: what it keeps goes, and what was on its way may go as well."""
        for key in [key for key in self.kept if key[0] == author]:
            del self.kept[key]
        for key in [key for key in self.wires if key[0] == author]:
            wire = self.wires[key]
            for _ in range(self.rng.integers(len(wire) + 1)):
                wire.pop()

    def deliver(self):
        """Deliver one message; return whether there was any."""
        ready = [key for key, wire in self.wires.items() if wire]
        if not ready:
            return False
        _, topic, reader = key = ready[self.rng.integers(len(ready))]
        message = self.wires[key].popleft()
        if self.rng.random() < 0.03:
            # Doubled, and late.
            self.wires[key].append(message)
        getattr(self, f'{reader}_hears')(topic, message)
        return True

    # The recorder.

    def start_recorder(self):
        self.kept_first = {}
        for topic, message in self.log:
            self.note(topic, message)
            if topic.rpartition('/')[2] in ACKNOWLEDGED:
                self.publish('recorder', 'recorded', (topic, message))

    def note(self, topic, message):
        """Return whether a message counts, as the first of its stamp."""
        _, _, role = topic.rpartition('/')
        if role == 'path':
            name = topic, message.header.stamp.sec, message.header.stamp.nanosec
            return self.kept_first.setdefault(name, content_hash(message)) == content_hash(message)
        return True

    def recorder_hears(self, topic, message):
        if topic == 'recorded':
            return
        if not self.note(topic, message):
            return
        if (topic, content_hash(message)) not in self.on_disk:
            self.on_disk.add((topic, content_hash(message)))
            self.log.append((topic, message))
        if topic.rpartition('/')[2] in ACKNOWLEDGED:
            self.publish('recorder', 'recorded', (topic, message))

    # The estimator.

    def start_estimator(self):
        prior = Belief.prior(GRID, 0.5, 0.45, 0.8)
        self.ledger = Ledger(GRID, 6, Estimator(prior, self.model))
        self.prior = self.ledger.copy()
        # Messages without an acknowledgement, acknowledgements, and those looked up in the log.
        self.waiting, self.acknowledged, self.missed = {}, set(), set()
        last = fold_evidence(self.ledger, self.logged(*EVIDENCE), None)
        self.clock += 1
        self.epoch = max(self.clock, last + 1)
        self.published = 0
        self.publish_standings(is_whole=True)
        self.publish('estimator', 'belief', belief_maps(self.prior, 1, 0, '/e', self.epoch))
        self.publish_belief()

    def logged(self, *names):
        """Yield the messages of the log, by role."""
        for number, (topic, message) in enumerate(self.log):
            agent, _, name = topic.rpartition('/')
            if names and name not in names:
                continue
            topics = OF_AGENT if agent else OF_MISSION
            role = Role(name, agent, topics[name].type_name)
            with suppress(ValueError):
                said = read_content(role, message)
                data = serialize_message(message)
                yield (
                    role,
                    LoggedMessage(
                        f'/{topic}', number, role.type_name, number, 0, 0, data, message, said
                    ),
                )

    def publish_standings(self, *, is_whole=False):
        changed, since = self.ledger.take_changed(), self.published
        if is_whole or self.rng.integers(5) == 0:
            since, changed = 0, self.ledger.judged
        self.published = self.ledger.events
        fields = standings_fields(self.ledger, changed, 1, '/e', self.epoch, 7, since)
        self.kept['estimator', 'standings'] = []
        self.publish('estimator', 'standings', standings_message(fields))

    def publish_belief(self):
        self.kept['estimator', 'belief'] = []
        self.publish('estimator', 'belief', belief_maps(self.ledger, 1, 0, '/e', self.epoch))

    def estimator_hears(self, topic, message):
        _, _, role = topic.rpartition('/')
        if role == 'recorded':
            name = message[0], content_hash(message[1])
            self.acknowledged.add(name)
            if name in self.waiting:
                self.judge(*self.waiting.pop(name))
        elif role in ('path', 'report', 'status'):
            name = topic, content_hash(message)
            if name in self.acknowledged:
                self.judge(topic, message)
            else:
                self.waiting[name] = topic, message

    def judge(self, topic, message):
        agent, _, role = topic.rpartition('/')
        changes = self.ledger.changes
        with suppress(ValueError):
            if role == 'path':
                key, cells = read_path(GRID, agent, message)
                self.ledger.record_path(key, cells, content_hash(message))
            elif role == 'report':
                self.ledger.record_report(*hear_report(message, agent))
            else:
                key, status = read_status(message, agent)
                self.ledger.record_status(key, status.state, status.stamp)
        if self.ledger.changed:
            self.publish_standings()
            if self.ledger.changes != changes:
                self.publish_belief()

    # The planner.

    def start_planner(self):
        self.base = RecordedMission(GRID, 6, values=self.values)
        for role, logged in self.logged():
            self.base.take(role, logged)
        # Orders of which this planner says that they are taken back.
        self.said_back = {*self.base.operator.taken_back}
        self.beliefs = None
        # What the recorder has acknowledged lately.
        self.seen = set()
        self.why_unfollowed = None
        for key in self.base.orders:
            path = path_message(GRID, self.base.paths[key], key.stamp)
            self.publish('planner', f'{key.agent}/path', path)
            self.stamp = max(self.stamp, key.stamp)
        for topic, message in self.log:
            is_loss = topic.endswith('/report') and message.source != Source.AGENT
            if is_loss or topic == 'operator':
                self.publish('planner', topic, message)
        for key, action in self.base.unreported_losses.items():
            self.lose(key, Source.OPERATOR, action.settled)

    def planner_hears(self, topic, message):
        agent, _, role = topic.rpartition('/')
        with suppress(ValueError):
            if role == 'recorded':
                self.hear_recorded(*message)
            elif role == 'path':
                key, cells = read_path(GRID, agent, message)
                self.base.take_other_path(key, cells, content_hash(message), 0)
            elif role == 'status':
                self.base.take_status(*read_status(message, agent))
            elif role == 'report':
                self.base.record_report(*hear_report(message, agent))
            elif role == 'standings':
                self.follow(message)
            elif role == 'belief' and content_hash(message):
                named = EvidenceName(
                    message.epoch.sec * 10**9 + message.epoch.nanosec, message.changes
                )
                self.beliefs = max(self.beliefs or named, named)

    def follow(self, message):
        try:
            self.base.follow(read_standings(message))
            self.why_unfollowed = None
        except MissingError:
            # The planner subscribes again, upon which all standings are published.
            self.publish_standings(is_whole=True)
        except LackingError as error:
            self.why_unfollowed = str(error)

    def read_again(self):
        """Read the log again if something on record is not known; return whether it was read."""
        planner, estimator = known_contents(self.base), known_contents(self.ledger)
        planner_lacks = self.seen - planner
        estimator_lacks = {
            name
            for name in self.acknowledged - self.missed - estimator
            if name[0].rpartition('/')[2] in ('path', 'report')
        }
        self.seen.clear()
        self.missed |= estimator_lacks
        if planner_lacks:
            before = {*self.base.paths}
            for role, logged in self.logged():
                self.base.take(role, logged)
            for key in self.base.paths.keys() - before:
                path = path_message(GRID, self.base.paths[key], key.stamp)
                self.publish('planner', f'{key.agent}/path', path)
        if estimator_lacks:
            for topic, message in self.log:
                if topic.rpartition('/')[2] in ('path', 'report', 'status'):
                    self.judge(topic, message)
        return bool(planner_lacks or estimator_lacks)

    def hear_recorded(self, topic, message):
        if topic.rpartition('/')[2] in ('path', 'report'):
            self.seen.add((topic, content_hash(message)))
        agent, _, role = topic.rpartition('/')
        if role == 'operator':
            action = read_operator_action(GRID, message)
            if self.base.take_action(action) and action.action == Action.GIVE_UP:
                for key in action.paths:
                    if key in self.base.in_flight:
                        self.lose(key, Source.OPERATOR, action.settled)
        elif role == 'path':
            key, _ = read_path(GRID, agent, message)
            self.base.take_recorded(key, content_hash(message))
        elif role == 'status':
            key, status = read_status(message, agent)
            self.base.take_recorded(key, status.content)
        else:
            key, report = hear_report(message, agent)
            self.base.take_recorded(key, report.content)

    @property
    def now(self):
        return PlannerState(
            agents=AGENTS,
            base=self.base,
            states=States(),
            unrecorded_action=None,
            newest=self.beliefs,
            why_unfollowed=self.why_unfollowed,
            estimators=1,
            is_decided=True,
            why_over=lambda: None,
            missing_listeners=lambda: None,
            topic=str,
            service=str,
        )

    def send(self):
        """Send robots, if nothing blocks them."""
        now = self.now
        if now.obstacle is not Obstacle.NONE:
            return
        for key, reports in self.base.heard.items():
            judged = self.base.standings.get(key, OPEN).judged
            assert {each.content for each in reports} <= judged, 'a robot leaves too early'
        for agent in now.free_agents[: now.robots - now.sent]:
            self.stamp += 10
            key = DeploymentKey(agent, self.stamp)
            cells = self.choose(PATHS)
            message = path_message(GRID, cells, key.stamp)
            self.base.take_path(key, cells, content_hash(message))
            self.publish('planner', f'{agent}/path', message)
            self.plans[key] = cells, self.choose(ENDINGS)

    def lose(self, key, source, settled=()):
        lost = Observation(self.base.paths[key], False)
        message = report_message(key, lost, key.stamp + 5, source, settled=settled)
        self.publish('planner', f'{key.agent}/report', message)
        with suppress(ValueError):
            self.base.record_report(*read_report(message))

    def give_up_silent(self):
        """Give up a robot that is away, as after its deadline."""
        silent = [
            key
            for key in self.base.in_flight
            if self.base.is_away(key)
            and key not in self.base.unjudged
            and key not in self.base.standings
        ]
        if silent:
            self.lose(self.choose(silent), Source.SILENCE)

    # The operator.

    def act(self, what, key=None):
        self.actions += 1
        paths = {} if key is None else {key: self.base.paths[key]}
        settled = self.base.heard_hashes(key) if what is Action.GIVE_UP else ()
        action = OperatorAction(self.actions, what, self.base.robots_left, paths, 0, settled)
        self.publish('planner', 'operator', operator_action_message(GRID, action))

    def give_up_any(self):
        held = [key for key in self.base.in_flight if not self.base.is_at_base(key)]
        if held:
            self.act(Action.GIVE_UP, self.choose(held))

    def take_back_any(self):
        at_base = self.base.undeparted
        if at_base:
            key = self.choose(at_base)
            self.act(Action.TAKE_BACK, key)
            self.said_back.add(key)

    # The agents.

    def agents_hears(self, _, message):
        action = read_operator_action(GRID, message)
        if action.action is Action.TAKE_BACK:
            self.taken_back |= action.paths.keys()

    def refuse(self, key):
        """Let an agent refuse an order that is taken back; return whether it has not departed."""
        cells, ending = self.plans[key]
        said = ending[: self.reported.setdefault(key, 0)]
        if key not in self.taken_back or {*said} - {'accepted'}:
            return False
        self.plans[key], self.reported[key] = (cells, ('refused',)), 1
        _, message = made(key, cells, 'refused', self.replaced[key.agent])
        self.publish(f'agent {key.agent}', f'{key.agent}/status', message)
        return True

    def is_on_record(self, key):
        """Return whether the path of a robot is on record."""
        cells, _ = self.plans[key]
        content = content_hash(path_message(GRID, cells, key.stamp))
        return (f'{key.agent}/path', content) in self.on_disk

    def say(self):
        """Let an agent say something of a deployment that is on record."""
        known = [key for key in self.plans if self.is_on_record(key)]
        if not known:
            return
        key = self.choose(known)
        cells, ending = self.plans[key]
        said = self.reported.setdefault(key, 0)
        if not self.refuse(key) and said < len(ending):
            self.reported[key] += 1
            role, message = made(key, cells, ending[said], self.replaced[key.agent])
            self.publish(f'agent {key.agent}', f'{key.agent}/{role}', message)

    def replace_robot(self, agent):
        """Give an agent another robot, which knows nothing but what is on record."""
        author = f'agent {agent}'
        # The last that a robot said arrives before anybody has another one.
        for (who, topic, reader), wire in [*self.wires.items()]:
            while who == author and wire:
                getattr(self, f'{reader}_hears')(topic, wire.popleft())
        for key in [key for key in self.kept if key[0] == author]:
            del self.kept[key]
        self.replaced[agent] += 1
        orders = Orders(SimpleNamespace(deployments=[]))
        for topic, message in self.log:
            if topic == f'{agent}/path':
                key, cells = read_path(GRID, agent, message)
                orders.take(JournaledDeployment(key.stamp, 0, tuple(cells.tolist())))
            elif topic == f'{agent}/report':
                orders.note_end(hear_report(message, agent)[0].stamp)
            elif topic == f'{agent}/status':
                key, status = read_status(message, agent)
                if status.state is OrderState.DEPARTED:
                    orders.note_departure(key.stamp)
                elif status.state is OrderState.REFUSED:
                    orders.note_end(key.stamp)
        # Its orders that are not on record yet are taken later.
        known = {key for key in self.plans if key.agent == agent and self.is_on_record(key)}
        for key in known - {DeploymentKey(agent, each.stamp) for each in orders.open_orders[-1:]}:
            del self.plans[key]
        for key in known & self.plans.keys():
            self.reported[key] = 0

    # What happens.

    def step(self):
        what = self.rng.random()
        if what < 0.62:
            self.deliver()
        elif what < 0.72:
            self.send()
        elif what < 0.90:
            self.say()
        elif what < 0.93:
            self.give_up_silent()
        elif what < 0.94:
            self.give_up_any()
        elif what < 0.945:
            self.take_back_any()
        elif what < 0.95:
            self.act(self.choose([Action.PAUSE, Action.RESUME]))
        elif what < 0.985:
            self.crash(self.choose(['planner', 'estimator', 'recorder', 'agent a', 'agent b']))
        elif what < 0.995:
            self.replace_robot(self.choose(AGENTS))

    def crash(self, name):
        """Kill a node and restart it from the log."""
        if all(topic != 'belief' for topic, _ in self.log):
            # Without its prior no mission can be resumed.
            return
        kept = {key: each for key, each in self.kept.items() if key[0] == name}
        self.leave(name)
        if name.startswith('agent'):
            # An agent says again what is in its journal, and hears again what the planner keeps.
            self.taken_back = {key for key in self.taken_back if key.agent != name[-1]}
            told = self.kept.get(('planner', 'operator'), ())
            self.wires['planner', 'operator', 'agents'] = deque(told)
            for (author, topic), messages in kept.items():
                for message in messages:
                    self.publish(author, topic, message)
            return
        getattr(self, f'start_{name}')()
        self.join(name)
        # A new subscriber receives all standings.
        self.publish_standings(is_whole=True)

    def settle(self):
        """Deliver all that is on its way."""
        for _ in range(100_000):
            if not (self.deliver() or self.read_again()):
                return
        raise AssertionError('messages never end')


def made(key, cells, what, robot=0):
    """Return a role and a message of an agent; `robot`: number of its robots before."""
    stamp = key.stamp + 1 + WORDS.index(what) + len(WORDS) * robot
    if what in ('accepted', 'departed', 'refused'):
        state = OrderState[what.upper()]
        reason = 'no battery' if what == 'refused' else ''
        return 'status', status_message(key, state, stamp, reason)
    if what in ('lost', 'lost elsewhere'):
        field_id = OTHER if what.endswith('elsewhere') else ''
        seen = Observation(cells, False)
        return 'report', report_message(key, seen, stamp, field_id=field_id)
    walk = [4, 4] if what == 'unmoved' else cells
    readings = [what != 'unseen'] * (len(walk) - 1)
    message = report_message(
        key,
        Observation(walk, True, readings),
        stamp,
        field_id=OTHER if what == 'elsewhere' else '',
    )
    if what == 'jump':
        message.readings[0].cell = 99
    if what == 'unreadable':
        message.header.frame_id = 'odom'
    return 'report', message


WORDS = [
    'accepted', 'departed', 'refused', 'back', 'unseen', 'unmoved', 'lost', 'lost elsewhere',
    'elsewhere', 'jump', 'unreadable',
]  # fmt: skip
LEFT = ('accepted', 'departed')
ENDINGS = [
    (*LEFT, 'back'), (*LEFT, 'back'), (*LEFT, 'unseen'), (*LEFT, 'lost'), LEFT, ('accepted',),
    (*LEFT, 'unmoved'), ('refused',), ('refused', 'departed', 'back'), ('accepted', 'lost'),
    ('accepted', 'lost', 'departed'), (*LEFT, 'elsewhere'), (*LEFT, 'jump', 'back'),
    (*LEFT, 'back', 'jump'), (*LEFT, 'lost', 'elsewhere'), (*LEFT, 'lost', 'back'),
    (*LEFT, 'lost elsewhere', 'lost'), (*LEFT, 'unreadable'), (*LEFT, 'back', 'unseen'),
    ('back',), ('refused', 'lost'), (*LEFT, 'jump', 'unmoved'), (*LEFT, 'elsewhere', 'unseen'),
]  # fmt: skip


def known_contents(record):
    """Return the topics and hashes of the paths and reports that a node has heard."""
    paths = {(f'{key.agent}/path', content) for key, content in record.path_contents.items()}
    return paths | {
        (f'{key.agent}/report', report.content)
        for key, reports in record.heard.items()
        for report in reports
    }


# What a node knows of a mission, in a form to compare.


def counted(record, standings):
    """Return what counts by the standings of a node."""
    return {
        key: (standing.verdict, standing.report, [each[:2] for each in standing.refusals])
        for key, standing in standings.items()
        if standing != OPEN
    }, record.lost


def known(base):
    return {
        'counted': counted(base, base.standings),
        'in flight': {*base.in_flight},
        'away': {key for key in base.in_flight if base.is_away(key)},
        'held': {*base.held},
        'unjudged': {*base.unjudged},
        'unmoved': base.unmoved,
        'void': base.void,
        'still': sorted(base.still_agents),
        'sent': base.robots_left,
        'ended': base.ended,
        'operator': (base.operator.is_paused, base.operator.is_ended),
        'taken back': {*base.operator.taken_back},
    }


def run(seed, steps=150):
    """Return a loop after so many steps."""
    loop = Loop(seed)
    for _ in range(steps):
        loop.step()
    return loop


def check(loop):
    """Check the laws of a loop in which nothing is on its way any more."""
    loop.settle()
    while any(loop.is_on_record(key) and loop.refuse(key) for key in loop.plans):
        loop.settle()
    # An order that was taken back is void, unless its robot left.
    for key in loop.said_back & loop.plans.keys() & loop.ledger.paths.keys():
        said = {*loop.plans[key][1][: loop.reported[key]]}
        if said <= {'accepted', 'refused'}:
            assert loop.ledger.standings[key].verdict is Verdict.VOID, key
            assert key in loop.base.void
        elif 'departed' in said:
            assert key not in loop.base.void
    # Nodes that have heard the same agree.
    assert loop.base.evidence == (loop.epoch, loop.ledger.changes)
    assert counted(loop.base, loop.base.standings) == counted(loop.ledger, loop.ledger.standings)
    read = RecordedMission(GRID, 6, values=loop.values)
    for role, logged in loop.logged():
        read.take(role, logged)
    theirs, ours = known(read), known(loop.base)
    assert theirs == ours, {
        name: (theirs[name], ours[name]) for name in ours if theirs[name] != ours[name]
    }
    # Resumed, the estimator judges the same.
    again = loop.prior.copy()
    fold_evidence(again, loop.logged(*EVIDENCE), None)
    assert again.standings == loop.ledger.standings
    assert again.belief.joint.tobytes() == loop.ledger.belief.joint.tobytes()
    # Who was heard to be back is not lost, unless the operator settled it.
    for key, reports in loop.ledger.heard.items():
        settled = {content for each in reports for content in each.settled or ()}
        signs = {
            each.content
            for each in reports
            if (each.survived or each.field_id == OTHER) and each.content not in settled
        }
        verdict = loop.ledger.standings.get(key, OPEN).verdict
        assert not (signs and verdict.is_loss), key
    # No two robots leave on one order.
    departed = [
        read_status(message, topic.partition('/')[0])[0]
        for topic, message in loop.log
        if topic.endswith('/status') and message.state == OrderState.DEPARTED
    ]
    assert len(departed) == len({*departed})
    # A robot whose agent refused the order is at its base, unless it departed or came back.
    at_base = (Verdict.VOID, Verdict.RETURN, Verdict.UNMOVED)
    for key, said in loop.ledger.statuses.items():
        if OrderState.REFUSED in said and OrderState.DEPARTED not in said:
            assert loop.ledger.standings.get(key, OPEN).verdict in at_base, key
    # What waits names who can end it, and what is held can be given up.
    assert all(loop.base.is_at_base(key) for key in loop.base.unjudged)
    now = loop.now
    if now.obstacle not in (Obstacle.NONE, Obstacle.ALL_DEPLOYED):
        assert now.ends_by(now.obstacle) is not Helper.NOBODY, now.obstacle
    # A loss may make a later return impossible, which is held then.
    for _ in loop.base.paths:
        for key in [*loop.base.held, *loop.base.unjudged]:
            loop.act(Action.GIVE_UP, key)
        loop.settle()
    assert not loop.base.held
    assert not loop.base.unjudged
    assert replace(now, newest=loop.beliefs).obstacle is not Obstacle.UNJUDGED
    assert all(standing.verdict is not Verdict.HELD for standing in loop.ledger.standings.values())
