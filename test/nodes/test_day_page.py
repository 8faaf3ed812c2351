# SPDX-License-Identifier: Apache-2.0
"""
A day in the field from the page alone: a person orders and says in a browser, and real nodes obey.

``KBNITP_TESTS=full python3 -m pytest test/nodes/test_day_page.py --pictures docs/images`` takes
the pictures of the tutorial as well.
"""

from collections import Counter
from functools import partial
from io import BytesIO
from pathlib import Path
import signal

from fleet import GRID
from kbnitp_msgs.msg import AgentStatus, Annotation, Finding, OperatorAction, Revocation
from kbnitp_ros.core import AnnotationKind, DeploymentKey, Verdict
from kbnitp_ros.core.inference.record import deployment_order
from kbnitp_ros.log.record import read_ledger
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.operator_actions import Action
from kbnitp_ros.messages.progress import read_decision
from PIL import Image
import pytest
from test_board_page import GO, SAID, tab
from test_day import AGENTS, Day, MISSION, PARKING

PHONE = {'viewport': {'width': 390, 'height': 800}, 'has_touch': True, 'is_mobile': True}
DESK = {'viewport': {'width': 1100, 'height': 760}}

# An order of somebody who may only look.
FORBIDDEN = """async () => (await fetch('act', {
    method: 'POST', headers: { ...headersOf(), 'Content-Type': 'application/json' },
    body: JSON.stringify({ nonce: crypto.randomUUID(), order: 'hold', arguments: {} }),
})).status"""


class DayOnThePage(Day):
    """A day whose orders come from pages of the board."""

    def __init__(self, field):
        super().__init__(field)
        listen = field.listen
        self.findings = listen(Finding, f'{MISSION}/findings')
        self.annotations = listen(Annotation, f'{MISSION}/annotations')
        self.revocations = listen(Revocation, f'{MISSION}/revocations')
        self.actions = listen(OperatorAction, f'{MISSION}/operator')
        self.statuses = {each: listen(AgentStatus, f'{MISSION}/{each}/status') for each in AGENTS}

    def serve(self):
        """Serve the board; return the addresses to look and to act."""
        tokens = self.log.with_suffix('.tokens')
        self.field.until(lambda: self.beliefs and self.log.exists(), 'log')
        output = self.field._outputs['watch'] = self.field.folder / 'watch.txt'
        arguments = ['watch', str(self.log), '--control', '--port', '0']
        with output.open('ab') as file:
            self.field.processes.started['watch'] = self.field.processes.launch(arguments, file)
        self.field.until(lambda: tokens.exists() and tokens.read_text().count('\n') == 2, 'tokens')
        return [line.split()[1] for line in tokens.read_text().splitlines()]

    def did(self, action):
        """Return the actions of a kind: a planner that starts publishes all of them again."""
        by_stamp = {from_stamp(each.header.stamp): each for each in self.actions}
        return [each for each in by_stamp.values() if each.action == action]

    def until_did(self, action, number=1):
        """Wait until an action was taken so often; return it."""
        self.field.until(lambda: len(self.did(action)) >= number, f'{number} of {action.name}')
        return self.did(action)[number - 1]

    def until_home(self, but=0):
        """Wait until all robots are reported, but for a number of lost ones."""

        def is_home():
            sent = sum(len(self.sent(agent)) for agent in AGENTS)
            return (self.told[-1].ordered, self.told[-1].out) == (sent, but)

        self.field.until(is_home, f'{but} robots in flight')

    def numbered(self, key):
        """Return the name of a deployment on the page."""
        sent = [each for agent in AGENTS for each, _ in self.sent(agent)]
        return f'no. {sorted(sent, key=deployment_order).index(key) + 1} of {key.agent}'

    @property
    def decision(self):
        return read_decision(GRID, self.decisions[-1])


class Person:
    """Somebody with a page."""

    def __init__(self, day, page, pictures):
        self.day, self.page, self.pictures = day, page, pictures

    def take(self, name, selector='body'):
        """Take a picture for the tutorial, with a part of the page at its top."""
        if self.pictures:
            page = self.page.page
            page.evaluate(
                'at => document.querySelector(at).scrollIntoView({ block: "start" })', selector
            )
            taken = Image.open(BytesIO(page.screenshot())).convert('RGB').quantize(128)
            taken.save(self.pictures / f'day_{name}.png', optimize=True)

    def proposed(self):
        """Return the stamps of the paths that wait for approval, by agent."""
        return self.page.page.evaluate(
            'Object.fromEntries(proposals().map((each) => [each.agent, each.deployment]))'
        )

    def send(self, *agents, once_shown=lambda: None):
        """Approve what the page proposes until each agent has a robot; return keys and paths."""
        day, left = self.day, self.day.unsent(agents)

        def proposed():
            return self.proposed().keys() & left()

        while left():
            day.field.until(lambda: not left() or proposed(), f'paths of {agents}')
            if wanted := proposed():
                shown = self.proposed()
                self.page.press('#needs button', 'approve')
                self.page.until(f'!{GO}.disabled || {SAID}')
                if not self.page.page.evaluate(SAID):
                    once_shown()
                    if not self.page.answer('Approve'):
                        self.until_over(shown, lambda wanted=wanted: wanted - left())
                self.page.page.keyboard.press('Escape')
        return [day.sent(each)[-1] for each in agents]

    def until_over(self, shown, is_sent):
        """Wait until approved paths are sent, or others are shown in their place."""
        self.day.field.until(lambda: is_sent() or self.proposed() != shown, 'other paths')

    def until_known(self, key):
        """Wait until the dialogs know a deployment by its number."""
        named = 'name => deploymentsKnown().some((each) => each.name === name)'
        self.page.until(named, self.day.numbered(key))

    def lose(self, agent):
        """Say that the robot of an agent that is out is lost."""
        self.page.page.locator(f'[data-key="lost {agent}"]').click()
        self.page.go(f'Give {agent} up')

    def mark(self, *cells):
        self.page.press('#unmark')
        self.page.press('#mark')
        for cell in cells:
            self.page.mark(cell)
        self.page.press('#mark')


@pytest.fixture
def pictures(request):
    """Return the folder for the pictures of the tutorial; None to take none."""
    folder = request.config.getoption('--pictures')
    return folder and Path(folder)


@pytest.mark.full
def test_a_day_in_the_field_from_the_page(field, browser, pictures):
    day = DayOnThePage(field)
    day.fleet.simulate(**PARKING)
    day.charge['scout_1'] = 0.18
    day.start_base()
    for agent in AGENTS[:2]:
        day.start_robot(agent)
    look, act = day.serve()
    with (
        tab(field, browser, act, **DESK) as page,
        tab(field, browser, act, **PHONE) as phone,
        tab(field, browser, look) as looking,
    ):
        ann, ben = Person(day, page, pictures), Person(day, phone, pictures)
        for opened in (page, phone, looking):
            opened.ready()
        first = see_that_robots_leave_once_preflight_is_green(day, ann)
        wrecked, wreck = see_that_what_she_knows_counts(day, ann, first)
        dug = see_that_a_phone_says_what_it_stands_before(day, ben)
        see_that_orders_outlive_the_planner(day, ann)
        see_that_the_goal_is_reached_lost_and_reached(day, ann)
        see_that_looking_changes_nothing(day, looking)
        page.press('#end')
        page.until_says('#act-confirm', 'type the name of the mission, log,')
        page.page.keyboard.type('log')
        page.page.keyboard.press('Enter')
        day.until_did(Action.END)
        for opened in (page, phone, looking):
            opened.until_says('#state', 'ENDED')
        assert page.problems == phone.problems == []
    see_that_the_log_says_all(day, first, wrecked, wreck, dug)


def see_that_robots_leave_once_preflight_is_green(day, ann):
    """Return the first robot of scout_1, which is lost; the others are back."""
    page = ann.page
    page.until_says('#preflight', 'scout_1 battery: 18 %: 30 % needed')
    page.until_says('#preflight', 'scout_3 heard: nothing on scout_3/state')
    ann.take('preflight')
    day.charge['scout_1'] = 0.9
    day.start_robot('scout_3')
    page.until('board.preflight.length && board.preflight.every((e) => e.light === "GREEN")')
    assert day.did(Action.APPROVE) == []
    page.press('#needs button', 'approve')
    page.until(f'!{GO}.disabled')
    ann.take('approve')
    page.page.keyboard.press('Escape')
    day.fleet.inject('stuck!', 'scout_1')
    ((first, _),) = ann.send('scout_1')
    day.until_away('scout_1')
    # The next one is only proposed once this one is far enough away.
    day.field.until(lambda: ann.proposed().keys() - {'scout_1'}, 'another proposal')
    day.field.kill(f'{MISSION}/scout_1/robot')
    ann.send('scout_2', 'scout_3')
    day.until_home(but=1)
    return first


def see_that_what_she_knows_counts(day, ann, first):
    """Return the second robot that is lost, and the cell of its wreck."""
    field, page = day.field, ann.page
    ann.lose('scout_1')
    day.until_judged(first, Verdict.LOSS)
    ann.until_known(first)
    page.page.locator('[data-key="more scout_1"]').click()
    flat = {'place': day.numbered(first), 'kind': '2', 'steps': '1', 'note': 'battery flat'}
    for name, value in {**flat, 'author': 'Ann'}.items():
        page.fill(name, value)
    page.foresee()
    ann.page.go('Say of a robot')
    page.until_says('#statements', f'{day.numbered(first)}: no hazard, survived 1 step')
    day.charge['scout_1'] = 0.18
    day.replace('scout_1')
    # From here on the dialog knows her name, and so has its preview at once.
    lane = day.decision.path[1:].tolist()
    ann.mark(*lane)
    page.press('#say-walked')
    page.until_says('#act-effect', 'the goal is free of hazards with')
    before, after = page.page.evaluate('act.preview.effect.p_free')
    assert before < after
    ann.take('walked')
    ann.page.go('Say it was walked')
    field.until(lambda: day.findings, 'finding')
    assert sorted(day.findings[0].cells) == sorted(lane)
    day.fleet.inject('stuck!', 'scout_2')
    ((wrecked, path),) = ann.send('scout_2')
    day.until_away('scout_2')
    field.kill(f'{MISSION}/scout_2/robot')
    day.until_home(but=1)
    ann.lose('scout_2')
    day.until_judged(wrecked, Verdict.LOSS)
    wreck = int(path[4])
    ann.mark(wreck)
    ann.until_known(wrecked)
    page.press('#say-wreck')
    page.fill('place', day.numbered(wrecked))
    page.fill('cause', '1')
    page.foresee()
    page.until_says('#act-effect', 'hazards expected')
    ann.take('wreck')
    ann.page.go('Say of a robot')
    field.until(lambda: len(day.annotations) == 2, 'wreck')
    # A drag with the mouse closes the wreck and the cells beside it.
    page.press('#unmark')
    page.press('#mark')
    page.page.mouse.move(*page.place(wreck))
    page.page.mouse.down()
    page.page.mouse.move(*page.place(wreck + GRID.width + 1), steps=3)
    page.page.mouse.up()
    page.press('#mark')
    closed = page.page.evaluate('[...markedCells].sort((one, other) => one - other)')
    assert wreck in closed
    page.press('#no-go')
    ann.page.go('No-go')
    assert [*day.until_did(Action.NO_GO).cells] == closed
    page.until('maps.get("map").box.data.some(({ name, x }) => name === "closed" && x.length)')
    page.press('#unmark')
    ann.take('closed', '#map-title')
    return wrecked, wreck


def see_that_a_phone_says_what_it_stands_before(day, ben):
    """Say that a hazard is in a cell, and that it was dug out; return the cell."""
    phone, cell = ben.page, 100
    phone.page.touchscreen.tap(*phone.place(cell))
    phone.until('cell => markedCells.has(cell)', cell)
    phone.press('#say-hazard')
    phone.fill('author', 'Ben')
    phone.foresee()
    phone.until(f'!{GO}.disabled')
    assert phone.page.evaluate('document.documentElement.scrollWidth') == 390
    ben.take('phone')
    ben.page.go('Say there is a hazard')
    day.field.until(lambda: len(day.findings) == 2, 'hazard')
    phone.press('#say-cleared')
    phone.until_says('#act-confirm', 'type the number of cells, 1,')
    phone.page.locator('#act-confirm input').fill('1')
    ben.page.go('Say a hazard was cleared')
    day.field.until(lambda: len(day.findings) == 3, 'clearance')
    return cell


def see_that_orders_outlive_the_planner(day, ann):
    """Hold, resume, loss_cost, a planner that is killed, and an order that is taken back."""
    field, page = day.field, ann.page
    page.press('#hold button')
    day.until_did(Action.PAUSE)
    page.until_says('#needs', 'departures are on hold')
    page.press('#hold button')
    ann.page.go('Resume')
    day.until_did(Action.RESUME)
    page.press('summary', 'Parameters and the end')
    page.page.locator('#set-loss_cost').fill('0.25')
    page.page.get_by_label('set loss_cost').click()
    ann.page.go('Set loss_cost')
    assert [*day.until_did(Action.SET).parameters] == ['{loss_cost: 0.25}']
    page.until_says('#needs', 'approve scout_3')
    field.kill(f'{MISSION}/planner')
    page.until_says('#heard', 'planner silent for')
    day.charge.update(scout_1=0.9, scout_3=0.18)
    day.start_node('planner', resume=str(day.log))
    page.until_says('#heard', 'live')
    page.until('board.parameters.loss_cost === 0.25')
    # Nobody waits for the node of scout_2, whose robot is lost, and nothing for scout_3.
    page.until('`${proposals().map(({ agent }) => agent)}` === "scout_1"')
    # The robot's node has stopped, so that it cannot leave; stopped for long, it would count as
    # gone.
    robot = field.processes.started[f'{MISSION}/scout_1/robot']
    ann.send('scout_1', once_shown=partial(robot.send_signal, signal.SIGSTOP))
    page.until_says('#robots', 'scout_1 has an order')
    page.press('#robots button', 'take back')
    page.fill('note', 'rain')
    page.foresee()
    ann.page.go('Take the order of scout_1 back')
    day.until_did(Action.TAKE_BACK)
    robot.send_signal(signal.SIGCONT)
    said = day.statuses['scout_1']
    field.until(lambda: said[-1].state == AgentStatus.REFUSED, 'refusal')
    assert said[-1].reason == 'taken back by Ann: rain'
    page.until('page("summary").textContent.startsWith(`${board.mission.sent} robots of`)')


def see_that_the_goal_is_reached_lost_and_reached(day, ann):
    page = ann.page

    def walk():
        """Say that the lane was walked; return P(free) before and after."""
        ann.mark(*day.decision.path[1:].tolist())
        page.press('#say-walked')
        page.until(f'!{GO}.disabled')
        foreseen = page.page.evaluate('act.preview.effect.p_free')
        ann.page.go('Say it was walked')
        return foreseen

    before, after = walk()
    page.page.locator('[id="set-stop.confidence"]').fill(f'{(before + after) / 2:.4f}')
    page.page.get_by_label('set stop.confidence', exact=True).click()
    ann.page.go('Set stop.confidence')
    day.until_did(Action.REACHED)
    page.until_says('#goal', ', reached')
    page.until_says('#state', 'DONE')
    walked = page.page.locator('#statements li', has_text='walked').first
    walked.get_by_text('revoke').click()
    ann.page.go('Revoke')
    day.until_did(Action.GOAL_LOST)
    page.until_says('#needs', 'the goal was reached, and no longer holds')
    ann.take('lost')
    walk()
    day.until_did(Action.REACHED, 2)


def see_that_looking_changes_nothing(day, looking):
    """Look at all that was said, without a button; an order is refused."""
    page, actions = looking.page, len(day.actions)
    looking.until('board.said.length === 9')
    looking.until_says('#goal', ', reached')
    assert page.locator('.act >> visible=true').count() == 0
    assert page.evaluate(FORBIDDEN) == 403
    assert len(day.actions) == actions


def see_that_the_log_says_all(day, first, wrecked, wreck, dug):
    day.field.processes.stop()
    told = replay(day.log)
    assert told.reproduced
    ledger = read_ledger(MissionLog(day.log))
    last = read_belief_maps(day.beliefs[-1]).belief
    assert ledger.belief.joint.tobytes() == last.joint.tobytes()
    flat, found = sorted(
        (each for each in ledger.annotations.values()), key=lambda each: each[0].stamp
    )
    assert (flat[0], found[0]) == (first, wrecked)
    assert (flat[1].kind, flat[1].steps) == (AnnotationKind.NO_HAZARD, (1,))
    assert (found[1].kind, found[1].by_hazard) == (AnnotationKind.LOCATED, True)
    assert {int(ledger.paths[wrecked][step]) for step in found[1].steps} == {wreck}
    assert last.hazard[wreck] > 0.99
    assert last.hazard[dug] < 0.02
    said = sorted(ledger.findings.values(), key=lambda each: each.since)
    assert [(each.walked, each.hazard, each.changed) for each in said] == [
        (0.9, None, False), (0.0, True, False), (0.0, False, True), (0.9, None, False),
    ]  # fmt: skip
    # The second walk was revoked.
    assert Counter(each.author for each in told.evidence.said.values()) == {'Ann': 6, 'Ben': 2}
    approved = {
        DeploymentKey(agent, from_stamp(path.header.stamp))
        for action in day.did(Action.APPROVE)
        for agent, path in zip(action.agents, action.paths)
    }
    assert {*ledger.paths} <= approved
    assert [each.action for each in told.evidence.actions][-1] is Action.END
