# SPDX-License-Identifier: Apache-2.0
"""The page of the board in a real browser: its buttons order what they say from real nodes."""

from contextlib import contextmanager
import json
from pathlib import Path

from base import Base, GRID, NODES
from kbnitp_msgs.msg import OperatorAction
from kbnitp_ros.cli import watch
from kbnitp_ros.cli.server import Address
from kbnitp_ros.messages.deployments import OrderState
from test_control import controlled, HOSTILE, report
from test_departures import StatedBase

AXE = Path(__file__).parents[1] / 'report/node_modules/axe-core/axe.min.js'

# Counts the sounds of a page.
COUNTED = """
    window.sounds = 0;
    const make = AudioContext.prototype.createOscillator;
    AudioContext.prototype.createOscillator = function () { sounds += 1; return make.call(this); };
"""

# The button that gives an order.
GO = 'document.getElementById("act-go")'

# The dialog, and what it says.
DIALOG = 'document.getElementById("act")'
SAID = 'document.getElementById("act-said").textContent'

# A click on the middle of a cell of the map.
AT = """each => {
    const map = maps.get('map'), { box } = map, at = map.place(box.clientWidth, box.clientHeight);
    const [x, y] = map.at(at, ...map.center(each)), around = map.canvas.getBoundingClientRect();
    return [around.x + x, around.y + y];
}"""


class Tab:
    """A page of the board, its requests to act, and their answers."""

    def __init__(self, field, browser, address, **options):
        self.field, self.address = field, address
        self.context = browser.new_context(**options)
        self.page = self.context.new_page()
        self.urls, self.acts, self.problems = [], [], []
        self.page.on('request', self._keep)
        self.page.on('pageerror', lambda error: self.problems.append(str(error)))
        self.page.on('console', lambda each: self.problems.append(each.text))
        self.page.add_init_script(COUNTED)
        self.page.goto(address)

    def _keep(self, request):
        self.urls.append(request.url)
        if request.method == 'POST':
            self.acts.append(json.loads(request.post_data))

    def orders(self):
        """Return the orders without nonces that were sent, without previews and repetitions."""
        once = {each['nonce']: each for each in self.acts}
        return [
            (each['order'], each['arguments'])
            for each in once.values()
            if not each['arguments'].get('preview')
        ]

    def errors(self):
        """Return the problems but answers 409, no confirmation, and 504, none so far."""
        return [each for each in self.problems if '409' not in each and '504' not in each]

    def until(self, condition, *values):
        """Wait for a condition of the page, while the test's own node answers."""
        self.field.until(lambda: self.page.evaluate(condition, *values), condition)

    def until_says(self, selector, text):
        self.until(
            '([at, text]) => document.querySelector(at)?.textContent.includes(text)',
            [selector, text],
        )

    def ready(self):
        self.until('document.documentElement.dataset.ready === "true" && board !== null')

    def violations(self):
        """Return the rules of accessibility that the page breaks."""
        self.page.evaluate(AXE.read_text())
        return [
            (each['id'], each['nodes'][0]['html'])
            for each in self.page.evaluate('axe.run()')['violations']
        ]

    def press(self, selector, text=None):
        found = self.page.locator(f'{selector} >> visible=true')
        if text is not None:
            found = found.get_by_text(text, exact=True)
        found.first.click()

    def place(self, cell):
        """Scroll to the map, and return the pixel of a cell."""
        self.page.locator('#map canvas').scroll_into_view_if_needed()
        return self.page.evaluate(AT, cell)

    def mark(self, cell):
        self.page.mouse.click(*self.place(cell))
        self.until('each => markedCells.has(each)', cell)

    def tab_to(self, selector):
        """Press the tabulator until it leads to an element."""
        for _ in range(150):
            self.page.keyboard.press('Tab')
            if self.page.evaluate('at => document.activeElement.matches(at)', selector):
                return
        raise AssertionError(f'the tabulator does not lead to {selector}')

    def fill(self, name, value):
        field = self.page.locator(f'#act-fields [name="{name}"]')
        if field.evaluate('each => each.tagName') == 'SELECT':
            field.select_option(value)
        else:
            field.fill(value)

    def foresee(self):
        self.press('#act button', 'Preview')

    def order(self, title):
        """Press the button that gives the order, once its preview has come."""
        self.until(f'title => {GO}.textContent === title && !{GO}.disabled', title)
        self.page.locator('#act-go').click()

    def answer(self, title):
        """Press the button that gives the order; return what the dialog says if it stays."""
        self.order(title)
        self.until(f'!{DIALOG}.open || !["", NO_ANSWER].includes({SAID})')
        return self.page.evaluate(f'{DIALOG}.open ? {SAID} : ""')

    def go(self, title):
        """Give the order of the dialog, again if what it shows changed meanwhile."""
        while said := self.answer(title):
            assert 'changed since' in said, said

    def annotate(self, button, says, effect='', **values):
        """Say something of the first deployment of scout_1; `effect`: words of its preview."""
        self.press('#robots button', button)
        for name, value in {'place': 'no. 1 of scout_1', **values}.items():
            self.fill(name, value)
        self.foresee()
        self.until_says('#act-effect', effect)
        self.go('Say of a robot')
        self.until(
            'says => board.said.filter((each) => each.says === says && each.holds).length === 1',
            says,
        )


@contextmanager
def tab(field, browser, address, **options):
    opened = Tab(field, browser, address, **options)
    yield opened
    own = (address.partition('#')[0], 'data:', 'blob:')
    assert [each for each in opened.urls if not each.startswith(own)] == []
    opened.context.close()


def full_address(client):
    return f'{client.url}/#token={client.look}&act={client.act}'


def test_each_button_of_the_planner_orders_what_it_says(field, browser):
    numbers = {'minimum_survival': 0.01, 'robots': 9, 'stop.losses': 8}
    base = StatedBase(field, approval=True, return_deadline=1000.0)
    base.proposed()
    with (
        controlled(field, base) as client,
        tab(field, browser, full_address(client)) as one,
    ):
        one.ready()
        assert one.page.url == f'{client.url}/'
        one.until_says('#needs', 'approve scout_1 (returns with .')
        one.until_says('#preflight-title', 'Preflight: 3 of 4')
        one.until_says('#preflight', 'scout_1 version: not known: install')
        assert one.page.title() == '(1) log'
        assert one.page.evaluate('sounds') == 0
        if AXE.exists():
            assert one.violations() == []
        first = base.proposed()
        one.press('#needs button', 'refuse')
        one.go('Refuse')
        field.until(
            lambda: base.proposals['scout_1'][-1].poses and base.proposed() != first, 'new'
        )
        one.until(
            'cells => board.needs.some((each) => `${each.cells}` === `${cells}`)', base.proposed()
        )
        # Something new waits, and the page was clicked.
        one.until('sounds > 0')
        one.press('#needs button', 'approve')
        one.until_says('#act-warning', 'cannot be called back')
        one.go('Approve')
        base.until_sent(1)
        one.until_says('#counts', '1 sent')
        # What was approved leaves the page, which moves the robots up.
        one.until('!proposals().length')
        # A row that changes while a button of it is held down is still clicked.
        one.page.locator('#robots button').get_by_text('take back', exact=True).hover()
        one.page.mouse.down()
        # Its agent says so: the next board has it, too.
        field.stand('scout_1', GRID, 'changed', stamp=1)
        one.until('board.robots[0].reason === "changed"')
        one.page.mouse.up()
        one.until_says('#robots', 'changed')
        one.fill('note', 'not needed')
        one.fill('author', 'Ann')
        one.foresee()
        one.until_says('#act-warning', 'A robot that has left by then stays out.')
        one.go('Take the order of scout_1 back')
        one.until_says('#robots', 'has an order that is taken back')
        base.say(OrderState.REFUSED, 'taken back by Ann: not needed')
        one.until_says('#needs', 'approve scout_1')
        one.press('#needs button', 'approve')
        one.go('Approve')
        base.until_sent(2)
        base.until_named(base.say(OrderState.DEPARTED))
        one.until('document.getElementById("preflight-part").hidden')
        one.press('#mute')
        assert one.page.locator('#mute').get_attribute('aria-pressed') == 'true'
        # One click, without a dialog.
        one.press('#hold button')
        one.until_says('#hold', 'Resume')
        one.press('#hold button')
        one.go('Resume')
        one.until_says('#hold', 'HOLD')
        one.mark(24)
        one.press('#no-go')
        one.fill('author', 'Ann')
        if AXE.exists():
            assert one.violations() == []
        one.fill('note', HOSTILE)
        one.foresee()
        one.go('No-go')
        one.until('`${board.closed}` === "24"')
        one.until(
            'maps.get("map").box.data.some(({ name, x }) => name === "closed" && x[0] === 4.5)'
        )
        one.until_says('#statements', HOSTILE)
        assert one.page.locator('#statements img').count() == 0
        one.press('#lift')
        one.go('Open again')
        one.until('!board.closed.length')
        one.press('summary', 'Parameters and the end')
        one.page.locator('#set-loss_cost').fill('0.25')
        one.page.get_by_label('set loss_cost').click()
        one.until_says('#act-effect', 'loss_cost: 0 → 0.25')
        one.go('Set loss_cost')
        one.until('board.parameters.loss_cost === 0.25')
        for name, value in numbers.items():
            one.page.locator(f'[id="set-{name}"]').fill(str(value))
            one.page.get_by_label(f'set {name}', exact=True).click()
            one.go(f'Set {name}')
            one.until('([name, value]) => board.parameters[name] === value', [name, value])
        one.page.locator('#set-approval').uncheck()
        one.page.get_by_label('set approval').click()
        one.go('Set approval')
        one.until('board.parameters.approval === false')
        one.press('#robots button', 'lost')
        one.fill('steps_survived', '1')
        one.foresee()
        one.until_says('#act-warning', 'cannot be taken back')
        one.go('Give scout_1 up')
        one.until('board.mission.lost === 1')
        # The next robot leaves by itself: the dialog says who is out.
        one.until('outNow().length === 1')
        one.press('#end')
        one.until_says('#act-confirm', 'type the name of the mission, log,')
        typed = one.page.locator('#act-confirm input')
        typed.fill('other')
        one.order('End the mission')
        one.until_says('#act-said', 'it must be the name of the mission')
        typed.fill('log')
        one.go('End the mission')
        one.until_says('#state', 'ENDED')
        with tab(field, browser, f'{client.url}/#token={client.look}') as looking:
            looking.ready()
            looking.until_says('#state', 'ENDED')
            assert looking.page.locator('.act >> visible=true').count() == 0
        orders = one.orders()
        shut = {'cells': [24], 'author': 'Ann'}
        back = {'agent': 'scout_1', 'reason': 'not needed', 'author': 'Ann'}
        assert orders[:13] == [
            *[('refuse', {}), ('approve', {}), ('take_back', back)],
            *[('approve', {}), ('hold', {}), ('resume', {})],
            ('no_go', {**shut, 'lift': False, 'reason': HOSTILE}),
            ('no_go', {**shut, 'lift': True, 'reason': ''}),
            ('set', {'name': 'loss_cost', 'value': 0.25}),
            *[('set', {'name': name, 'value': value}) for name, value in numbers.items()],
            ('set', {'name': 'approval', 'value': False}),
        ]
        assert orders[13:] == [
            ('give_up', {'agent': 'scout_1', 'steps_survived': 1}),
            *2 * [('end_mission', {})],
        ]
        # Only what is repeated for lack of an answer has the nonce of another.
        acts = {json.dumps(each) for each in one.acts}
        assert len({each['nonce'] for each in one.acts}) == len(acts)
        assert one.errors() == []


def test_what_people_say_on_the_page_is_previewed_and_counts(field, browser):
    base = Base(field)
    base.until_sent(1)
    with (
        controlled(field, base) as client,
        tab(field, browser, full_address(client)) as one,
        tab(field, browser, full_address(client)) as other,
    ):
        _, path = report(base, survived=False)
        for opened in (one, other):
            opened.ready()
            opened.until_says('#open', '2 other pages open')
            opened.until('board.mission.deployments === 1 && mission.table[0].outcome === "lost"')
        wreck = int(path[2])
        one.mark(wreck)
        one.press('#say-wreck')
        one.fill('author', HOSTILE)
        one.fill('cause', '1')
        one.foresee()
        one.until_says('#act-effect', 'robots lost: 1 → 1')
        one.go('Say of a robot')
        other.until_says('#statements', 'no. 1 of scout_1: lost in step 2, by a hazard')
        other.until('maps.get("map").box.data.some(({ name, x }) => name === "wreck" && x.length)')
        # A rectangle of cells by a drag.
        one.press('#unmark')
        one.press('#mark')
        one.page.mouse.move(*one.place(16))
        one.page.mouse.down()
        one.page.mouse.move(*one.place(22), steps=3)
        one.page.mouse.up()
        one.until('markedCells.size === 4')
        one.press('#say-walked')
        one.fill('walked', '0.8')
        one.foresee()
        # The name is asked for once; other evidence arrives before the order.
        one.until(f'!{GO}.disabled')
        # It moves the map down.
        other.until_says('#needs', 'preview of add finding')
        other.mark(23)
        other.press('#say-target')
        other.fill('author', 'Bob')
        other.foresee()
        other.go('Say there is a target')
        one.until('board.said.length === 2')
        one.order('Say it was walked')
        one.until_says(
            '#act-said', 'The evidence has changed since the preview. Nothing was ordered'
        )
        one.go('Say it was walked')
        other.until_says('#statements', 'walked (0.8), 4 cells')
        other.until_says('#statements', ', expected hazards ')
        # Only with the number of cells.
        one.press('#say-cleared')
        one.until_says('#act-confirm', 'type the number of cells, 4,')
        one.page.locator('#act-confirm input').fill('3')
        one.order('Say a hazard was cleared')
        one.until_says('#act-said', 'it must be the number of cells, 4')
        one.until(f'!{GO}.disabled')
        one.page.locator('#act-confirm input').fill('4')
        one.go('Say a hazard was cleared')
        one.until('board.said.length === 4')
        one.page.locator('#x').fill('0.2')
        one.page.locator('#y').fill('4.9')
        one.press('#go')
        one.until('markedCells.size === 5 && markedCells.has(20)')
        one.press('#unmark')
        one.press('#mark')
        one.press('#go')
        one.press('#say-hazard')
        one.fill('since', '2026-01-01T00:00:00')
        one.foresee()
        one.go('Say there is a hazard')
        one.until('board.said.length === 5')
        other.press('#statements button', 'revoke')
        other.go('Revoke')
        one.until_says('#statements', 'taken back by Bob')
        one.annotate('more', 'NO_HAZARD', kind='2', steps='1')
        one.annotate('recovered', 'RECOVERED', steps='1, 2')
        one.annotate('more', 'WITHDRAW', 'robots lost: 0 → 0', kind='4')
        said = one.page.evaluate('board.said')
        assert [each['kind'] for each in said] == [
            'annotation',
            *4 * ['finding'],
            'revocation',
            *3 * ['annotation'],
        ]
        assert [each['author'] for each in said] == [
            HOSTILE,
            'Bob',
            HOSTILE,
            HOSTILE,
            HOSTILE,
            'Bob',
            *3 * [HOSTILE],
        ]
        assert said[0]['cells'] == [wreck]
        assert said[0]['by_hazard'] is True
        assert (said[1]['cells'], said[1]['target'], said[1]['hazard']) == ([23], True, None)
        assert (said[2]['cells'], said[2]['walked']) == ([16, 17, 21, 22], 0.8)
        assert (said[3]['hazard'], said[3]['changed'], said[3]['target']) == (False, True, None)
        assert (said[4]['cells'], said[4]['hazard']) == ([20], True)
        assert said[4]['since'] < said[3]['since']
        assert [each['steps'] for each in said[6:]] == [[1], [1, 2], []]
        for opened in (one, other):
            assert opened.page.locator('#statements img').count() == 0
            assert opened.errors() == []
    base.replayed()


def test_a_phone_with_keys_alone_outlives_lost_answers_and_restarts(field, browser):
    base = Base(field)
    base.until_sent(1)
    look = {'viewport': {'width': 390, 'height': 800}, 'color_scheme': 'dark'}
    with controlled(field, base) as client:
        one = Tab(field, browser, full_address(client), **look)
        keys = one.page.keyboard
        one.ready()
        assert one.page.evaluate('document.documentElement.scrollWidth') == 390
        one.tab_to('#map canvas')
        for key, reached in (('ArrowUp', 5), ('ArrowUp', 10), ('ArrowRight', 11)):
            keys.press(key)
            one.until('cell => maps.get("map").box.layout.frame === cell', reached)
        assert one.page.evaluate('[...markedCells]') == [11]
        one.tab_to('#no-go')
        keys.press('Enter')
        one.tab_to('[name=author]')
        keys.press('Escape')
        one.until(f'!{DIALOG}.open')
        assert one.page.evaluate('document.activeElement.id') == 'no-go'
        keys.press('Enter')
        assert one.page.evaluate('document.documentElement.scrollWidth') == 390
        one.tab_to('[name=author]')
        keys.type('Cleo')
        keys.press('Enter')
        one.until('document.activeElement.textContent === "No-go"')
        keys.press('Enter')
        one.until('`${board.closed}` === "11"')
        assert one.orders() == [
            ('no_go', {'cells': [11], 'lift': False, 'reason': '', 'author': 'Cleo'})
        ]
        # The first answer is lost on its way.
        lost = []

        def lose(route):
            if not lost:
                lost.append(route.fetch().json())
                route.abort()
            else:
                route.continue_()

        one.page.route('**/act', lose)
        one.page.locator('#hold button').focus()
        keys.press('Enter')
        one.until_says('#done', 'HOLD: ')
        first, again = one.acts[-2:]
        assert lost[0]['success']
        assert first == again
        # The page may have its answer before the test has the action.
        field.until(lambda: len(base.actions) >= 2, 'no-go and pause')
        assert sum(each.action == OperatorAction.PAUSE for each in base.actions) == 1
        assert all('ERR_FAILED' in each for each in one.problems)
        one.problems.clear()
        before = client.board['mission']['epoch']
        for node in NODES:
            field.kill(f'/{node}')
        one.until_says('#heard', 'planner silent for')
        base.start(resume=str(base.log))
        one.until('before => !sameDeployment(board.mission.epoch, before)', before)
        one.until_says('#heard', 'live')
        one.until_says('#hold', 'Resume')
        assert one.page.evaluate('`${board.closed}`') == '11'
        assert one.problems == []
    one.until_says('#broken p', 'Connection lost, as of ')
    box = one.page.locator('#broken').bounding_box()
    assert (box['width'], box['height']) == (390, 800)
    assert one.page.title().startswith('Connection lost')
    # Another start has another token.
    port = int(client.url.rpartition(':')[2])
    with (
        watch.controlling(base.log, None) as control,
        watch.serving(base.log, None, Address(port=port), control),
    ):
        one.until_says('#broken p', 'open that one')
    one.context.close()
