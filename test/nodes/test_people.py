# SPDX-License-Identifier: Apache-2.0
"""Findings, annotations and revocations by real services, and their effect across crashes."""

import re
import shlex
from shutil import which
import subprocess
import time

from base import Base, GRID
from documented import ROOT
from kbnitp_msgs.msg import Annotation, Finding, Revocation, Standing, Standings
from kbnitp_msgs.srv import AddFinding, Annotate, Revoke
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.core import Observation, Verdict
from kbnitp_ros.log.record import read_ledger
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.messages.headers import from_stamp, in_seconds, to_stamp
from kbnitp_ros.messages.standings import read_standings
import pytest
import yaml

SERVICES = {'add_finding': AddFinding, 'annotate': Annotate, 'revoke': Revoke}


class Person:
    """A person beside the base, who says what she knows."""

    def __init__(self, base):
        self.base, self.field = base, base.field
        self.clients = {
            name: self.field.node.create_client(kind, f'/{name}')
            for name, kind in SERVICES.items()
        }
        self.standings = self.field.listen(Standings, '/standings')

    def ask(self, service, **request):
        """Call a service; again if no estimator answers, as after it was killed."""
        client, calls = self.clients[service], []
        self.field.until(client.service_is_ready, service)

        def answers():
            # A call that is repeated is refused while the first one is still being judged.
            done = [call.result() for _, call in calls if call.done()]
            return [each for each in done if 'another remark is being judged' not in each.message]

        def is_answered():
            if not calls or time.monotonic() > calls[-1][0] + 5.0:
                made = client.call_async(SERVICES[service].Request(**request))
                calls.append((time.monotonic(), made))
            return bool(answers())

        self.field.until(is_answered, f'answer of {service}')
        return answers()[0]

    def say(self, service, **request):
        """Say something after its preview; return the answer and the effect foreseen."""
        foreseen = self.ask(service, preview=True, **request)
        assert foreseen.success, foreseen.message
        assert foreseen.content == 0
        named = foreseen.effect
        answer = self.ask(service, epoch=named.epoch, events=named.events, **request)
        assert answer.success, answer.message
        assert (answer.message, answer.effect.events) == (foreseen.message, named.events)
        return answer

    def standing(self, agent='scout_1'):
        """Return the newest standings of the deployments of an agent, by stamp."""
        told = {}
        for message in self.standings:
            told |= read_standings(message).standings
        return [told[key] for key in sorted(told) if key.agent == agent]


def report(base, survived, agent='scout_1', stamp=None):
    """Report the newest robot of an agent; return its key and path."""
    key, cells = read_path(GRID, agent, base.paths[agent][-1])
    steps = len(cells) - 1
    outcome = Observation(cells, survived, [False] * steps if survived else None)
    now = base.field.now() if stamp is None else stamp
    base.reports[agent].publish(report_message(key, outcome, now))
    return key, cells


@pytest.mark.parametrize('killed', ['none', 'estimator', 'recorder', 'planner', 'all'])
def test_what_people_say_counts_and_lasts(field, killed):
    base = Base(field)
    person = Person(base)
    base.until_sent(1)
    lost, path = report(base, survived=False)
    base.until_held(1)
    base.until_sent(2)
    before = read_belief_maps(base.beliefs[-1]).belief
    flat = Annotation(agent='scout_1', deployment=to_stamp(lost.stamp), steps=[2])
    flat.kind, flat.author = Annotation.NO_HAZARD, 'Ann'
    person.say('annotate', annotation=flat)
    field.until(lambda: person.standing()[0].annotation, 'annotated standing')
    assert person.standing()[0].verdict is Verdict.LOSS
    walked = Finding(cells=[int(path[3])], walked=0.9, note='on foot')
    answer = person.say('add_finding', finding=walked)
    assert answer.effect.hazards[1] < answer.effect.hazards[0]
    if killed == 'all':
        base.crash()
    elif killed != 'none':
        field.kill(f'/{killed}')
        field.start(killed, {**base.parameters, 'resume': str(base.log)})
    report(base, survived=True)
    base.until_held(2)
    base.until_sent(3)
    withdrawn, _ = report(base, survived=False)
    base.until_held(3)
    base.until_sent(4)
    out = Annotation(agent='scout_1', deployment=to_stamp(withdrawn.stamp))
    out.kind = Annotation.WITHDRAW
    answer = person.say('annotate', annotation=out)
    assert answer.effect.lost.tolist() == [2, 1]
    field.until(lambda: person.standing()[2].verdict is Verdict.WITHDRAWN, 'withdrawal')
    revocation = Revocation(revokes=answer.content)
    answer = person.say('revoke', revocation=revocation)
    assert answer.effect.lost.tolist() == [1, 2]
    field.until(lambda: person.standing()[2].verdict is Verdict.LOSS, 'revocation')
    refused = person.ask('revoke', preview=True, revocation=revocation)
    assert 'was revoked before' in refused.message
    report(base, survived=True)
    base.until_held(4)
    base.until_state('4 of 4 robots')
    field.until(lambda: from_stamp(base.beliefs[-1].header.stamp), 'belief')
    last = read_belief_maps(base.beliefs[-1]).belief
    report_of_log = base.replayed()
    ledger = read_ledger(MissionLog(base.log))
    (finding,) = ledger.findings.values()
    since = in_seconds(finding.since)
    assert ledger.belief.joint.tobytes() == last.joint.tobytes()
    assert len(ledger.remarks) == 4
    told = [line for line in lines(report_of_log) if 'said of' in line or 'took back' in line]
    assert [line.split(', at')[0] for line in told] == [
        f'Ann said of {lost}: no hazard, survived 2 steps',
        f'a person said of 1 cell since {since}: walked (0.9)',
        f'a person said of {withdrawn}: says nothing',
        f'a person took back remark {revocation.revokes}',
    ]
    assert (last.hazard[path[1:-1]] != before.hazard[path[1:-1]]).any()


def test_a_change_holds_a_loss_until_its_order_is_told(field):
    base = Base(field)
    person = Person(base)
    base.until_sent(1)
    sent, path = read_path(GRID, 'scout_1', base.paths['scout_1'][-1])
    dug = Finding(cells=[int(path[2])], hazard=Finding.ABSENT, changed=True)
    # The estimator may learn of the path after the test.
    field.until(
        lambda: person.ask('add_finding', preview=True, finding=dug).effect.out, 'robot out'
    )
    answer = person.say('add_finding', finding=dug)
    assert list(answer.effect.out) == [str(sent)]
    report(base, survived=False)
    field.until(lambda: person.standing(), 'standing')
    assert person.standing()[0].verdict is Verdict.HELD
    base.until_state('the operator to decide on')
    told = Annotation(agent='scout_1', deployment=to_stamp(sent.stamp), kind=Annotation.BEFORE)
    person.say('annotate', annotation=told)
    base.until_held(1)
    base.until_sent(2)
    base.replayed(has_refused=True)


def test_places_are_cells_points_and_polygons(field):
    base = Base(field)
    person = Person(base)
    base.until_sent(1)
    walked = Finding(walked=0.5)
    x, y = GRID.centers([3, 8]).T.tolist()
    person.say('add_finding', finding=walked, x=x, y=y)
    side = [0.0, 2.1, 2.1, 0.0], [3.0, 3.0, 5.0, 5.0]
    person.say('add_finding', finding=walked, x=side[0], y=side[1], polygon=True)
    report(base, survived=True)
    base.until_held(1)
    base.replayed()
    first, second = read_ledger(MissionLog(base.log)).findings.values()
    assert first.cells.tolist() == [3, 8]
    assert second.cells.tolist() == [15, 16, 20, 21]


def test_bad_remarks_change_nothing(field):
    base = Base(field)
    person = Person(base)
    base.until_sent(1)
    key, path = report(base, survived=True)
    base.until_held(1)
    changes = base.beliefs[-1].changes
    at = to_stamp(key.stamp)
    said = {'agent': 'scout_1', 'deployment': at}
    cases = [
        ('add_finding', {'finding': Finding(cells=[99], walked=0.5)}, '99'),
        ('add_finding', {'finding': Finding(cells=[1], hazard=1, confidence=1.0)}, 'below 1'),
        ('add_finding', {'finding': Finding(cells=[1])}, 'say one of them'),
        ('add_finding', {'finding': Finding(cells=[1], walked=2.0)}, 'walked is 2.0'),
        ('add_finding', {'finding': Finding(cells=[], walked=0.5)}, 'at least one cell'),
        ('add_finding', {'finding': Finding(walked=0.5), 'x': [1.0], 'y': []}, 'x has 1 values'),
        (
            'add_finding',
            {'finding': Finding(walked=0.5), 'x': [1.0], 'y': [1.0], 'geographic': True},
            'datum is empty',
        ),
        (
            'add_finding',
            {'finding': Finding(walked=0.5), 'x': [0.1, 0.2], 'y': [1.0, 1.0], 'polygon': True},
            'at least 3',
        ),
        ('annotate', {'annotation': Annotation(kind=1, agent='scout_9', deployment=at)}, 'known'),
        ('annotate', {'annotation': Annotation(kind=9, **said)}, 'kind is 9'),
        ('annotate', {'annotation': Annotation(kind=1, **said)}, 'not reported lost'),
        ('annotate', {'annotation': Annotation(kind=4, report=5, **said)}, 'no such report'),
        ('annotate', {'annotation': Annotation(kind=4, steps=[1], **said)}, 'WITHDRAW has none'),
        ('revoke', {'revocation': Revocation(revokes=7)}, 'was never said'),
        ('revoke', {'revocation': Revocation()}, 'revokes is 0'),
    ]
    for service, request, words in cases:
        for preview in (True, False):
            asked = {} if preview else {'epoch': base.beliefs[-1].epoch, 'events': 1}
            answer = person.ask(service, preview=preview, **asked, **request)
            assert not answer.success
            assert words in answer.message, (service, answer.message)
    fine = Finding(cells=[int(path[1])], walked=0.5)
    stale = person.ask('add_finding', finding=fine)
    assert 'ask for the preview again' in stale.message
    assert base.beliefs[-1].changes == changes
    base.replayed()


def fill(message, values):
    """Set the fields of a message, as `ros2 service call` does."""
    for name, value in values.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def test_services_are_called_as_on_the_page(field):
    base = Base(field)
    person = Person(base)
    base.until_sent(1)
    key, _ = report(base, survived=False)
    base.until_held(1)
    lines = re.findall(
        r'(?m)^ros2 service call (.*)$', ROOT.joinpath('docs/people.md').read_text()
    )
    assert len(lines) == 8
    for line in lines:
        name, kind, request = shlex.split(line)
        assert kind == f'kbnitp_msgs/srv/{SERVICES[name[1:]].__name__}'
        asked = yaml.safe_load(request)
        if 'annotation' in asked:
            asked['annotation']['deployment'] = {
                'sec': key.stamp // 10**9, 'nanosec': key.stamp % 10**9,
            }  # fmt: skip
        refusals = {'revocation': 'was never said', 'epoch': 'ask for the preview again'}
        why = next((refusals[each] for each in refusals if each in asked), '')
        if which('ros2'):
            call = ['ros2', 'service', 'call', name, kind, yaml.safe_dump(asked)]
            ended = subprocess.run(call, capture_output=True, text=True, timeout=60)
            assert f'success={not why}' in ended.stdout, ended.stdout + ended.stderr
            assert why in ended.stdout
            continue
        answer = person.ask(name[1:], **fields(SERVICES[name[1:]], asked))
        assert (answer.success, why in answer.message) == (not why, True), answer.message
    base.until_sent(2)
    base.replayed()


def fields(service, asked):
    """Return the fields of a request as messages."""
    request = fill(service.Request(), asked)
    return {name: getattr(request, name) for name in asked}


def test_messages_state_no_default_that_counts():
    assert Finding().confidence == 0.99
    assert Annotate.Request().cell == -1
    assert Standing().annotation == 0
