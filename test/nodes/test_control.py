# SPDX-License-Identifier: Apache-2.0
"""Orders over HTTP to real nodes, and the board that people beside the field see."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count, pairwise
import json
import random
import re
import socket
from threading import Thread
import time
import urllib.error
import urllib.request

from base import Base, GRID, NODES
from kbnitp_msgs.msg import OperatorAction
from kbnitp_ros.cli import control as controls
from kbnitp_ros.cli import server, watch
from kbnitp_ros.cli.control import Control, Operator
from kbnitp_ros.cli.server import Address
from kbnitp_ros.core import Observation
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.messages.orders import describe_orders, ORDERS
from kbnitp_ros.messages.orders import PARAMETERS as SETTABLE
import pytest
from test_policies import FOLDER, in_graph, not_allowed, not_used, read_policy

HOSTILE = '</script>\u2028<img src=x>'


class Client:
    """A page that acts, and reads the board."""

    nonces = count()

    def __init__(self, address):
        self.url, self.look, self.act = re.fullmatch(
            r'(http://[^/]+)/#token=(.{22})&act=(.{22})', address
        ).groups()
        # All boards that the stream sent, the time of each, and that of its begin.
        self.boards = []
        self.times = []
        self.begun = 0.0

    def request(self, path, token, body=None, **headers):
        headers = {'X-Kbnitp-Token': token, 'Origin': self.url, **headers}
        if body is not None:
            headers['Content-Type'] = 'application/json'
        return urllib.request.Request(f'{self.url}{path}', body, headers)

    def post(self, value):
        """Return the status and the answer of a request to act."""
        body = value if isinstance(value, bytes) else json.dumps(value).encode()
        try:
            with urllib.request.urlopen(self.request('/act', self.act, body), timeout=60) as got:
                return got.status, json.load(got)
        except urllib.error.HTTPError as error:
            return error.code, json.load(error)

    def order(self, order, arguments=None, nonce=None, **more):
        nonce = nonce or f'nonce-{next(self.nonces):08}'
        return self.post({'nonce': nonce, 'order': order, 'arguments': arguments or {}, **more})

    def do(self, order, arguments=None, **more):
        status, answer = self.order(order, arguments, **more)
        assert (status, answer['success']) == (200, True), answer
        return answer

    def say(self, order, arguments, **more):
        """Give an order of the evidence that its preview names."""
        foreseen = self.do(order, {**arguments, 'preview': True})
        named = {name: foreseen['effect'][name] for name in ('epoch', 'events')}
        return foreseen, self.do(order, {**arguments, **named}, **more)

    def read(self, path, token=None):
        with urllib.request.urlopen(self.request(path, token or self.look), timeout=60) as got:
            return got.read().decode()

    def follow(self, token=None):
        """Read the stream of the board in a thread."""

        def read():
            with (
                suppress(OSError),
                urllib.request.urlopen(
                    self.request('/board', token or self.act), timeout=60
                ) as stream,
            ):
                for line in stream:
                    if line.startswith(b'data: '):
                        self.boards.append(json.loads(line[6:]))
                        self.times.append(time.monotonic())

        self.begun = time.monotonic()
        Thread(target=read, daemon=True).start()

    @property
    def board(self):
        return self.boards[-1] if self.boards else None


class Asked:
    """Calls a function in a thread, while the test's own node answers."""

    def __init__(self, field):
        self.field = field
        self.pool = ThreadPoolExecutor(8)

    def __call__(self, function, *arguments, **named):
        called = self.pool.submit(function, *arguments, **named)
        self.field.until(called.done, 'answer')
        return called.result()


@contextmanager
def controlled(field, base, **more):
    """Yield a client of `watch --control`, whose orders the test's node does not block."""
    field.until(lambda: base.beliefs and base.log.exists(), 'belief')
    with (
        watch.controlling(base.log, None) as control,
        watch.serving(base.log, None, Address(port=0), control) as address,
    ):
        client = Client(address)
        client.follow()
        field.until(lambda: client.board and client.board['robots'], 'board')
        yield client
        assert control.broken is None


def until(field, client, condition, what):
    try:
        field.until(lambda: condition(client.board), f'board: {what}')
    except AssertionError:
        print('BOARD', json.dumps(client.board))
        raise


def report(base, survived, agent='scout_1'):
    key, cells = read_path(GRID, agent, base.paths[agent][-1])
    outcome = Observation(cells, survived, [False] * (len(cells) - 1) if survived else None)
    base.reports[agent].publish(report_message(key, outcome, base.field.now()))
    return key, cells


def test_each_order_of_the_planner_has_its_effect(field):
    base = Base(field, approval=True)
    ask = Asked(field)
    base.proposed()
    with controlled(field, base) as client:
        until(field, client, lambda board: board['needs'], 'proposal')
        (need,) = client.board['needs']
        assert (need['what'], need['agent'], need['cells']) == (
            'approval', 'scout_1', base.proposed()
        )  # fmt: skip
        assert 0.0 < need['returns'] < 1.0
        first = base.proposed()
        ask(client.do, 'refuse')
        field.until(
            lambda: base.proposals['scout_1'][-1].poses and base.proposed() != first, 'new'
        )
        # The board may hear of it later than the test.
        until(
            field,
            client,
            lambda board: [each['cells'] for each in board['needs']] == [base.proposed()],
            'new proposal',
        )
        # The paths that were shown wait no more.
        status, refused = ask(client.order, 'approve', confirm={'scout_1': first})
        assert status == 409
        assert 'the paths that wait for approval by now' in refused['error']
        ask(client.do, 'approve', confirm={'scout_1': base.proposed()})
        base.until_sent(1)
        until(field, client, lambda board: board['mission']['sent'] == 1, 'robot sent')
        for order, value in (
            ('pause', True),
            ('resume', False),
            ('hold', True),
            ('resume', False),
        ):
            ask(client.do, order)
            until(field, client, lambda b, v=value: b['mission']['hold'] == v, f'hold is {value}')
        shut = {'cells': [24], 'reason': HOSTILE, 'author': 'Ann'}
        ask(client.do, 'no_go', {**shut, 'preview': True})
        until(field, client, lambda board: len(board['needs']) == 1, 'preview')
        assert client.board['needs'][0]['order'] == 'no_go'
        ask(client.do, 'no_go', shut)
        until(field, client, lambda board: board['closed'] == [24] and not board['needs'], 'no-go')
        (said,) = client.board['said']
        assert (said['kind'], said['note'], said['holds']) == ('no_go', HOSTILE, True)
        ask(client.do, 'no_go', {'cells': [24], 'lift': True})
        until(field, client, lambda board: board['closed'] == [], 'lift')
        values = dict(zip(SETTABLE, (False, 0.25, 0.1, 3, 0.0, 0.01, 3)))
        for name, value in values.items():
            ask(client.do, 'set', {'name': name, 'value': value})
        until(field, client, lambda board: board['parameters'] == values, 'parameters')
        for name, value, words in (
            ('loss_costs', 1.0, 'did you mean loss_cost'), ('seed', 1, 'must be one of'),
            ('robots', 'x', 'must be a whole number'), ('robots', -1, 'from 0 to'),
        ):  # fmt: skip
            status, answer = ask(client.order, 'set', {'name': name, 'value': value})
            assert (status, words in answer['error']) == (400, True), answer
        _, late = ask(client.order, 'take_back', {'agent': 'scout_1'})
        assert 'left: its robot can only be given up or annotated' in late['message']
        gone = ask(client.do, 'give_up', {'agent': 'scout_1', 'steps_survived': 1})
        assert 'gave up scout_1' in gone['message']
        until(field, client, lambda board: board['mission']['lost'] == 1, 'loss')
        status, answer = ask(client.order, 'end_mission', confirm='other')
        assert (status, answer['error']) == (
            409, "confirm is 'other': it must be the name of the mission, 'log'"
        )  # fmt: skip
        ask(client.do, 'end_mission', confirm='log')
        until(field, client, lambda board: board['mission']['state'] == 'ENDED', 'end')
    decided = {action.action for action in base.actions}
    assert decided >= {
        getattr(OperatorAction, name)
        for name in (
            *('PAUSE', 'RESUME', 'APPROVE', 'REFUSE', 'GIVE_UP', 'END', 'SET', 'NO_GO', 'LIFT'),
        )
    }


def test_what_people_say_counts_and_stands_on_the_board(field):
    base = Base(field)
    ask = Asked(field)
    base.until_sent(1)
    with controlled(field, base) as client:
        key, path = report(base, survived=False)
        until(field, client, lambda board: board['mission']['deployments'] == 1, 'belief')
        name = {'agent': key.agent, 'deployment': {'sec': key.stamp // 10**9}}
        name['deployment']['nanosec'] = key.stamp % 10**9
        assert client.board['robots'][0]['name'] == 'scout_1'
        told = {'annotation': {**name, 'kind': 2, 'steps': [1], 'author': 'Ann', 'note': HOSTILE}}
        _, answer = ask(client.say, 'annotate', told)
        cell = int(path[2])
        there = {'finding': {'cells': [cell], 'hazard': 2, 'author': 'Bob'}}
        ask(client.say, 'add_finding', there)
        # Nobody clears cells without their number.
        cleared = {'finding': {'hazard': 1, 'author': HOSTILE}, 'polygon': True}
        x, y = GRID.centers([cell])[0].tolist()
        cleared['x'], cleared['y'] = [x - 0.6, x + 0.6, x], [y - 0.4, y - 0.4, y + 0.9]
        foreseen = ask(client.do, 'add_finding', {**cleared, 'preview': True})
        assert foreseen['cells'] == 1
        named = {each: foreseen['effect'][each] for each in ('epoch', 'events')}
        for confirm in (None, 2, '1', True):
            status, refused = ask(
                client.order, 'add_finding', {**cleared, **named}, confirm=confirm
            )
            assert (status, 'the number of cells, 1' in refused['error']) == (409, True)
        taken = ask(client.do, 'add_finding', {**cleared, **named}, confirm=1)
        until(field, client, lambda board: board['contradictions'], 'contradiction')
        (pair,) = client.board['contradictions']
        assert pair['findings'][1] == taken['content']
        assert pair['cells'] == [cell]
        # Evidence has changed since the preview.
        status, stale = ask(client.order, 'add_finding', {**there, **named})
        assert (status, stale['success']) == (200, False)
        assert 'ask for the preview again' in stale['message']
        assert 'effect' not in stale
        ask(client.say, 'revoke', {'revocation': {'revokes': taken['content'], 'author': 'Cleo'}})
        until(field, client, lambda board: not board['contradictions'], 'revocation')
        said = {each['hash']: each for each in client.board['said']}
        assert [each['kind'] for each in said.values()] == [
            *('annotation', 'finding', 'finding', 'revocation')
        ]
        assert said[taken['content']]['revoked_by'] == 'Cleo'
        assert [each['holds'] for each in said.values()] == [True, True, False, True]
        assert said[answer['content']]['note'] == HOSTILE
        assert said[answer['content']]['effect'] == {
            name: answer['effect'][name] for name in ('p_free', 'hazards')
        }
        # A preview is shown, and its evidence may change.
        ask(client.do, 'add_finding', {**there, 'preview': True})
        until(field, client, lambda board: board['needs'], 'preview')
        base.until_sent(2)
        report(base, survived=True)
        until(field, client, lambda b: any(n.get('stale') for n in b['needs']), 'stale preview')
        table = client.read('/said.csv')
        field.until(lambda: client.read('/said.csv').count(taken['content']) == 2, 'said.csv')
        features = json.loads(client.read('/said.geojson'))['features']
        assert [each['properties']['hash'] for each in features] == [*said]
        assert table.startswith('time,author,kind')
    base.replayed()


def test_two_clients_act_at_once_and_a_repeated_nonce_does_nothing(field):
    base = Base(field)
    ask = Asked(field)
    base.until_sent(1)
    with controlled(field, base) as one:
        other = Client(f'{one.url}/#token={one.look}&act={one.act}')
        other.follow(other.look)
        _, full_name, allowed = read_policy(FOLDER / 'operator.policy.xml')
        services = {f'/{each.service}' for each in ORDERS.values()}
        asked = {'/planner/get_parameters', '/estimator/get_parameters'}
        assert allowed['request'] == services | asked | {'/planner/set_parameters'}
        # The test may discover the node later than the node discovers the base.
        field.until(lambda: not not_used(in_graph(field.node, full_name), allowed), 'endpoints')
        assert not not_allowed(in_graph(field.node, full_name), allowed)
        until(field, one, lambda board: board['open'] == {'act': 1, 'look': 1}, 'two streams')
        # Twice the same order: the nonce counts for all clients.
        calls = [
            ask.pool.submit(client.order, order, nonce=nonce)
            for nonce, order in (('same-nonce', 'pause'), ('other-nonce', 'hold'))
            for client in (one, other, one, other)
        ]
        field.until(lambda: all(call.done() for call in calls), 'answers')
        answers = [call.result() for call in calls]
        assert len({json.dumps(each) for each in answers[:4]}) == 1
        assert len({json.dumps(each) for each in answers[4:]}) == 1
        # The clients may have their answers before the test has the action.
        field.until(lambda: base.actions, 'pause')
        assert sum(each.action == OperatorAction.PAUSE for each in base.actions) == 1
        ask(one.do, 'resume')
        assert ask(other.order, 'pause', nonce='same-nonce') == answers[0]
        assert sum(each.action == OperatorAction.PAUSE for each in base.actions) == 1
        until(field, other, lambda board: not board['mission']['hold'], 'same board')


def test_a_base_that_is_restarted_is_followed_by_the_open_stream(field, monkeypatch):
    base = Base(field)
    ask = Asked(field)
    base.until_sent(1)
    with controlled(field, base) as client:
        ask(client.say, 'add_finding', {'finding': {'cells': [7], 'walked': 0.5}})
        report(base, survived=True)
        base.until_sent(2)
        until(field, client, lambda board: board['mission']['sent'] == 2, 'two robots')
        before = client.board['mission']
        for node in NODES:
            field.kill(f'/{node}')
        # Not before: a busy base needs longer.
        monkeypatch.setattr(controls, 'ANSWER', 2.0)
        foreseen = {'finding': {'cells': [8], 'walked': 0.5}, 'preview': True}
        foresee = partial(client.order, 'add_finding', foreseen, 'nonce-asked-again')
        assert ask(foresee)[0] == 504
        until(field, client, lambda board: (board['mission']['age'] or 0) >= 3, 'silence')
        base.start(resume=str(base.log))
        # A preview that has no answer is called again.
        field.until(lambda: ask(foresee)[0] == 200, 'preview', patience=120.0)
        until(field, client, lambda b: b['mission']['epoch'] != before['epoch'], 'new estimator')
        until(field, client, lambda board: board['mission']['age'] == 0, 'sign')
        assert client.board['mission']['sent'] == 2
        (said,) = client.board['said']
        assert said['holds']
        # DDS lists the killed nodes for some time.
        field.until(lambda: ask(client.order, 'pause')[1].get('success'), 'order', patience=120.0)
        # At most four a second were sent, however late each was read, and no two alike.
        passed = [time - client.begun for time in client.times]
        assert all(number <= 1 + 4 * each for number, each in enumerate(passed))
        assert all(one != other for one, other in pairwise(client.boards))


def test_the_table_of_orders_is_all_that_may_be_ordered():
    assert describe_orders() == (
        'may order pause, hold, resume, approve, refuse, give_up, take_back, no_go, '
        'end_mission, add_finding, annotate, revoke, and set approval, loss_cost, '
        'minimum_survival, robots, stop.confidence, stop.gain, stop.losses of the planner'
    )


def test_more_orders_than_the_queue_holds_are_refused(field, monkeypatch):
    monkeypatch.setattr(controls, 'ANSWER', 0.2)
    operator = Operator('small', '/', field.node.context)
    # Nobody takes the orders.
    control = Control(operator)
    body = '{"nonce": "nonce-%04d", "order": "pause"}'
    with ThreadPoolExecutor(32) as pool:
        bodies = [(body % number).encode() for number in range(20)]
        answers = [*pool.map(control.act, bodies)]
    assert sorted(status for status, _ in answers) == [503] * 4 + [504] * controls.MAX_ORDERS
    assert all('order again later' in text for status, text in answers if status == 503)
    operator.destroy_node()


def hostile(client, rng):
    """Return a request that must change nothing."""
    port = client.url.rpartition(':')[2]
    text = rng.choice([HOSTILE, '\x00', '\ud800', 'x' * 70_000, '', 'é' * 40])
    number = rng.choice([-1, 2**64, float('inf'), float('nan'), 1.5, '7', True, None, [], {}])
    nonce = f'hostile-{rng.random()}'
    order = rng.choice([*ORDERS, 'set', text, number])
    arguments = rng.choice(
        [
            {'data': True}, {'agent': text}, {'cells': number}, {'cells': [number]}, text,
            {str(text): number}, {'finding': {'cells': [0], 'hazard': number}, 'preview': number},
            {'name': text, 'value': number}, {'name': 'robots', 'value': text},
            {'finding': {'cells': [3], 'hazard': 1}}, {'annotation': {'agent': text}},
            {'steps_survived': number}, {'revocation': {'revokes': number}},
        ]
    )  # fmt: skip
    values = {'nonce': nonce, 'order': order, 'arguments': arguments}
    if ORDERS.get(str(order), ORDERS['give_up']).fixed and not arguments:
        values['nonce'] = rng.choice([7, None, 'short', text])
    plain = json.dumps(values, ensure_ascii=rng.random() < 0.5).encode(errors='surrogatepass')
    fine = json.dumps({'nonce': nonce, 'order': 'pause'}).encode()
    good = {
        'Host': f'127.0.0.1:{port}', 'Origin': client.url, 'X-Kbnitp-Token': client.act,
        'Content-Type': 'application/json', 'Content-Length': str(len(fine)),
    }  # fmt: skip
    kind = rng.choice(['values', 'values', 'values', 'head', 'head', 'method'])
    if kind == 'values':
        # Wrong bodies of those who may act.
        broken = b'[' * 60_000, rng.randbytes(99), plain[:-1], b'\xff', b'9' * 9_000
        fine = rng.choice([plain, plain, plain, *broken])
        good['Content-Length'] = str(len(fine))
    elif kind == 'head':
        # Right bodies of others.
        good |= rng.choice(
            [
                {'X-Kbnitp-Token': client.look}, {'X-Kbnitp-Token': None}, {'Origin': None},
                {'Origin': 'http://evil.example'}, {'Host': 'evil.example'}, {'Host': None},
                {'Sec-Fetch-Site': 'cross-site'}, {'Content-Type': 'text/plain'},
                {'Content-Length': None, 'Transfer-Encoding': 'chunked'},
                {'Content-Length': '99999999'}, {'Content-Length': str(len(fine) + 1)},
            ]
        )  # fmt: skip
    method = rng.choice(['GET', 'PUT', 'HEAD']) if kind == 'method' else 'POST'
    lines = ''.join(f'{name}: {each}\r\n' for name, each in good.items() if each is not None)
    return f'{method} /act HTTP/1.1\r\n{lines}\r\n'.encode() + fine


def answered(port, sent):
    received = b''
    with (
        suppress(ConnectionError),
        socket.create_connection((server.HOST, port), timeout=60.0) as connection,
    ):
        connection.sendall(sent)
        while data := connection.recv(2**16):
            received += data
    return received


def test_hostile_requests_change_nothing_and_stop_nothing(field, monkeypatch):
    monkeypatch.setattr(server, 'MAX_SECONDS', 2.0)
    base = Base(field)
    ask = Asked(field)
    base.until_sent(1)
    rng = random.Random(29)
    with controlled(field, base) as client:
        tokens = base.log.with_suffix('.tokens')
        assert tokens.stat().st_mode & 0o777 == 0o600
        assert [line.split()[0] for line in tokens.read_text().splitlines()] == ['look', 'act']
        before = client.board
        port = int(client.url.rpartition(':')[2])
        sent = [hostile(client, rng) for _ in range(200)]
        calls = [ask.pool.submit(answered, port, each) for each in sent]
        field.until(lambda: all(call.done() for call in calls), 'answers', patience=200.0)
        obeyed = [call.result() for call in calls if b'"success": true' in call.result()]
        assert obeyed == []
        statuses = {call.result().split()[1] for call in calls if call.result()}
        assert statuses >= {b'400', b'403', b'415'}
        assert base.actions == []
        ask(client.do, 'pause')
        until(field, client, lambda board: board['mission']['hold'], 'pause')
        for name in ('said', 'closed', 'parameters', 'goal', 'contradictions'):
            assert client.board[name] == before[name]
    assert not tokens.exists()
    base.replayed()


def test_without_a_base_it_says_so(field, capsys, monkeypatch):
    monkeypatch.setattr(controls, 'START', 1.0)
    base = Base(field)
    field.until(lambda: base.beliefs and base.log.exists(), 'belief')
    with pytest.raises(ValueError, match='no planner is heard on /other/mission.* ROS_DOMAIN_ID'):
        watch.controlling(base.log, '/other').__enter__()
