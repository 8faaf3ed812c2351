# SPDX-License-Identifier: Apache-2.0
"""The server of the page, against requests that are not from its page."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from http import HTTPStatus
import http.client
import json
import random
import re
import socket
import ssl
import subprocess
import sys
import threading
import time

from kbnitp_ros.cli import server
from kbnitp_ros.cli.server import Address, Resource, serving
from kbnitp_ros.cli.watch import serving as serving_log
from mission_log import record
from missions import sent_by_single
import pytest

SECRET = 'the facts of the mission'


def endless():
    while True:
        yield f'{SECRET}\n'
        time.sleep(0.05)


RESOURCES = {
    '/': Resource('text/html', lambda: 'a page', is_open=True),
    '/facts': Resource('application/json', lambda: SECRET),
    '/events': Resource('text/plain', endless),
}


def parts(address):
    """Return scheme, host, port and token of an address."""
    scheme, host, port, token = re.fullmatch(
        r'(https?)://([^:/]+):(\d+)/#token=(.{22})', address
    ).groups()
    return scheme, host, int(port), token


def answer(port, request, seconds=30.0):
    """Send bytes, and return all that is answered."""
    received = b''
    with (
        suppress(ConnectionError),
        socket.create_connection((server.HOST, port), timeout=seconds) as connection,
    ):
        connection.sendall(request)
        while data := connection.recv(2**16):
            received += data
            if received.count(SECRET.encode()) > 3:
                # A stream.
                break
    return received


def request(port, token, path='/facts', method='GET', body=b'', **headers):
    """Return a request; headers by their name with `_`, None for none."""
    lines = {'Host': f'localhost:{port}', 'X-Kbnitp-Token': token}
    lines |= {name.replace('_', '-'): value for name, value in headers.items()}
    head = ''.join(f'{name}: {value}\r\n' for name, value in lines.items() if value is not None)
    return f'{method} {path} HTTP/1.1\r\n{head}\r\n'.encode('latin-1') + body


def status(port, *arguments, **headers):
    received = answer(port, request(port, *arguments, **headers))
    return int(received.split()[1]) if received else None


def hostile(port, token, rng):
    """Return a request that must not be answered with facts."""
    path = rng.choice(['/facts', '/events'])
    odd = rng.choice(['', 'x', token[:-1], token + 'x', token.swapcase(), 'é' * 22, '\x00'])
    foreign = rng.choice(
        ['evil.example', f'localhost:{port + 1}', 'localhost', f'x@localhost:{port}']
    )
    return rng.choice(
        [
            lambda: request(port, None, path),
            lambda: request(port, odd, path),
            lambda: request(port, token, path, Host=foreign),
            lambda: request(port, token, path, Host=None),
            lambda: request(port, token, path, Host=f'localhost:{port}\r\nHost: evil.example'),
            lambda: request(
                port,
                token,
                path,
                Origin=rng.choice(['null', 'http://evil.example', f'https://localhost:{port}']),
            ),
            lambda: request(
                port, token, path, Sec_Fetch_Site=rng.choice(['cross-site', 'same-site'])
            ),
            lambda: request(
                port, token, path, rng.choice(['POST', 'PUT', 'DELETE', 'OPTIONS', 'HEAD', 'get'])
            ),
            lambda: request(
                port, token, path, Transfer_Encoding='chunked', body=b'5\r\nhello\r\n0\r\n\r\n'
            ),
            lambda: request(port, token, path, Content_Length='5', body=b'hello'),
            lambda: request(port, token, path, X_Long='x' * 70_000),
            lambda: request(port, token, path + 'x' * 70_000),
            lambda: request(port, token, path, **{f'X_{each}': 'y' for each in range(200)}),
            lambda: request(
                port,
                token,
                rng.choice(['/../facts', '/facts/', '/%66acts', '*', f'/facts?token={token}']),
            ),
            lambda: request(port, token, path)[:-3] + b'\x00',
            lambda: rng.randbytes(rng.randrange(1, 3000)) + b'\r\n\r\n',
            lambda: b'\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03' + rng.randbytes(200) + b'\n\n',
        ]
    )()


def test_hostile_requests_get_nothing_and_stop_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(server, 'MAX_SECONDS', 2.0)
    folder = tmp_path / 'a\u2028<script>alert(1)<'
    folder.mkdir()
    log = record(folder / 'mission.mcap', sent_by_single(3).sent)
    before = {file: file.read_bytes() for file in folder.iterdir()}
    rng = random.Random(71)
    with serving_log(log, None, Address(port=0)) as address:
        *_, port, token = parts(address)
        facts = answer(port, request(port, token)).partition(b'\r\n\r\n')[2]
        assert json.loads(facts)['summary']
        with ThreadPoolExecutor(8) as pool:
            sent = [hostile(port, token, rng) for _ in range(200)]
            received = [*pool.map(lambda each: answer(port, each), sent)]
        for what, got in zip(sent, received):
            assert b' 200 ' not in got.partition(b'\r\n')[0], what
            assert facts[:40] not in got, what
            assert token.encode() not in got, what
        page = answer(port, request(port, None, '/')).decode()
        assert page.startswith('HTTP/1.0 200')
        # The name of the folder is text.
        assert '<script>alert' not in page
        assert answer(port, request(port, token)).partition(b'\r\n\r\n')[2] == facts
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_only_its_own_names_open_it():
    with serving(RESOURCES, "default-src 'none'", Address(port=0, name='base.example')) as address:
        scheme, host, port, token = parts(address)
        assert (scheme, host) == ('http', 'base.example')
        for name, expected in (
            (f'base.example:{port}', 200),
            (f'BASE.example:{port}', 200),
            (f'localhost:{port}', 200),
            (f'127.0.0.1:{port}', 200),
            (f'127.0.0.2:{port}', 403),
            (f'base.example.:{port}', 403),
            # Browsers leave out no other port than 80.
            ('base.example', 403),
            ('localhost', 403),
        ):
            assert status(port, token, Host=name) == expected, name
        own = f'http://localhost:{port}'
        assert status(port, token, Origin=own, Sec_Fetch_Site='same-origin') == 200
        assert status(port, token, '/', 'POST') == 403
        assert status(port, token, '/', 'POST', Origin=own) == 405
        assert status(port, None, '/', Sec_Fetch_Site='none') == 200
        head = answer(port, request(port, None, '/')).decode().partition('\r\n\r\n')[0]
    with serving(RESOURCES, '', Address(port=0)) as later:
        assert parts(later)[-1] != token
    for line in (
        'Cache-Control: no-store',
        'Cross-Origin-Resource-Policy: same-origin',
        'Referrer-Policy: no-referrer',
        'X-Content-Type-Options: nosniff',
        "Content-Security-Policy: default-src 'none'; frame-ancestors 'none'; "
        "base-uri 'none'; form-action 'none'",
    ):
        assert line in head.splitlines(), line


def acting(port, look, act, rng):
    """Return an order, and changes of its request by each of which it must not be obeyed."""
    own = f'http://localhost:{port}'
    body = b'{"hold": true}'
    order = {
        'path': '/act', 'method': 'POST', 'body': body, 'Origin': own,
        'Content_Type': 'application/json', 'Content_Length': str(len(body)),
    }  # fmt: skip
    foreign = ['evil.example', 'null', f'https://localhost:{port}', f'http://127.0.0.1:{port}']
    changes = [
        (403, {'X_Kbnitp_Token': rng.choice([None, look, act[:-1], f'{act}x', 'é' * 22])}),
        (403, {'Origin': rng.choice([None, *foreign, f'{own}\r\nOrigin: {own}'])}),
        (403, {'Host': rng.choice([None, 'evil.example', f'localhost:{port + 1}'])}),
        (403, {'Sec_Fetch_Site': rng.choice(['cross-site', 'same-site', 'none', ''])}),
        (415, {'Content_Type': rng.choice([None, 'text/plain', 'application/json2', 'é'])}),
        (411, {'Content_Length': None}),
        (411, {'Content_Length': None, 'Transfer_Encoding': 'chunked'}),
        (400, {'Transfer_Encoding': 'chunked'}),
        (400, {'Content_Length': rng.choice(['-1', '1e3', '0x10', '', '²', '9' * 10])}),
        (400, {'Content_Length': f'{len(body)}\r\nContent-Length: {len(body)}'}),
        (413, {'Content_Length': str(rng.randrange(2**16 + 1, 10**9))}),
        (404, {'path': rng.choice(['/ACT', '/act/', '/act?x', '/%61ct', '//act', '*'])}),
        (405, {'path': rng.choice(['/', '/facts', '/events'])}),
        (404, {'method': 'GET', 'Content_Type': None, 'Content_Length': None, 'body': b''}),
        (501, {'method': rng.choice(['PUT', 'DELETE', 'PATCH', 'OPTIONS', 'post', 'HEAD'])}),
    ]
    return order, changes


def test_an_order_needs_the_acting_token_this_page_and_a_short_body(monkeypatch):
    monkeypatch.setattr(server, 'MAX_SECONDS', 2.0)
    obeyed = []

    def act(body):
        obeyed.append(body)
        return HTTPStatus.CONFLICT, '{"error": "x"}'

    rng = random.Random(5)
    with serving(RESOURCES, '', Address(port=0), {'/act': act}) as address:
        address, act_token = address.split('&act=')
        *_, port, look = parts(address)
        assert len({look, act_token}) == 2
        for _ in range(6):
            order, changes = acting(port, look, act_token, rng)
            for expected, change in changes:
                sent = request(port, act_token, **{**order, **change})
                received = answer(port, sent)
                # An answer may be lost to a request that was not read to its end.
                assert not received or int(received.split()[1]) == expected, sent
        # A body that does not come, or not in time.
        for length in ('15', '65536'):
            unfinished = {**order, 'Content_Length': length}
            assert answer(port, request(port, act_token, **unfinished)) == b''
        assert obeyed == []
        for site in (None, 'same-origin'):
            received = answer(port, request(port, act_token, **order, Sec_Fetch_Site=site))
            assert received.startswith(b'HTTP/1.0 409'), received
            assert received.endswith(b'{"error": "x"}')
        body = b'x' * 2**16
        sent = {**order, 'body': body, 'Content_Length': str(len(body))}
        assert status(port, act_token, **sent) == 409
        assert obeyed == [order['body'], order['body'], body]
        # Those who may act may look, too.
        assert status(port, act_token) == status(port, look) == 200
    with serving(RESOURCES, '', Address(port=0)) as address:
        *_, port, look = parts(address)
        own = f'http://localhost:{port}'
        assert status(port, look, '/act', 'POST', Origin=own) == 404


def test_streams_know_who_may_act():
    acting = Resource('text/plain', lambda: iter(['look']), acting=lambda: iter(['act']))
    acts = {'/act': lambda _: (HTTPStatus.OK, '')}
    with serving({'/board': acting}, '', Address(port=0), acts) as address:
        address, act = address.split('&act=')
        *_, port, look = parts(address)
        for token, expected in ((look, b'look'), (act, b'act')):
            assert answer(port, request(port, token, '/board')).endswith(b'\r\n\r\n' + expected)


def test_half_and_slow_requests_hold_neither_threads_nor_the_page(monkeypatch):
    monkeypatch.setattr(server, 'MAX_SECONDS', 3.0)
    threads = threading.active_count()
    with serving(RESOURCES, '', Address(port=0)) as address, ExitStack() as stack:
        *_, port, token = parts(address)
        held = []

        def hold(count):
            for _ in range(count):
                held.append(socket.create_connection((server.HOST, port), timeout=30.0))
                stack.enter_context(held[-1])
                with suppress(ConnectionError):
                    held[-1].sendall(b'GET /facts HTTP/1.1\r\nX-Slow: ')

        hold(server.MAX_CONNECTIONS)
        began = time.monotonic()
        assert status(port, token) is None
        hold(300 - server.MAX_CONNECTIONS)
        assert threading.active_count() - threads <= server.MAX_CONNECTIONS + 1
        while status(port, token) != 200:
            # A byte now and then does not prolong a request.
            for connection in held:
                with suppress(ConnectionError):
                    connection.sendall(b'x')
            assert time.monotonic() - began < 20.0


def test_streams_are_limited_and_those_that_leave_make_room():
    with serving(RESOURCES, '', Address(port=0)) as address:
        *_, port, token = parts(address)
        with ExitStack() as stack:
            for _ in range(server.MAX_STREAMS):
                connection = stack.enter_context(socket.create_connection((server.HOST, port)))
                connection.sendall(request(port, token, '/events'))
                assert connection.recv(100).startswith(b'HTTP/1.0 200')
            assert status(port, token, '/events') == 503
            assert status(port, token) == 200
        deadline = time.monotonic() + 30.0
        while status(port, token, '/events') != 200:
            assert time.monotonic() < deadline


@pytest.fixture(scope='module')
def certified(tmp_path_factory):
    """Return a certificate for base.example and its key."""
    folder = tmp_path_factory.mktemp('tls')
    made = [folder / 'base.pem', folder / 'base.key']
    subprocess.run(
        [
            *('openssl', 'req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256'),
            *('-nodes', '-days', '1', '-subj', '/CN=base.example'),
            *('-addext', 'subjectAltName=DNS:base.example', '-out', made[0], '-keyout', made[1]),
        ],
        check=True,
        capture_output=True,
    )
    return made


@pytest.mark.processes
def test_other_machines_need_a_certificate_and_half_a_handshake_holds_nobody(certified):
    with pytest.raises(ValueError, match='give --certificate and --key, or use a tunnel'):
        Address('0.0.0.0', 0, 'base.example')
    with pytest.raises(ValueError, match='give the name of this machine as --name'):
        Address('0.0.0.0', 0, None, *certified)
    where = Address('0.0.0.0', 0, 'base.example', *certified)
    with serving(RESOURCES, '', where) as address, ExitStack() as stack:
        scheme, host, port, token = parts(address)
        assert (scheme, host) == ('https', 'base.example')
        for _ in range(20):
            half = stack.enter_context(socket.create_connection((server.HOST, port)))
            half.sendall(b'\x16\x03\x01')
        context = ssl.create_default_context(cafile=certified[0])
        sent = {'Host': f'base.example:{port}', server.TOKEN: token}
        began = time.monotonic()
        for changed, expected in (({}, 200), ({'Host': f'localhost:{port}'}, 403)):
            plain = socket.create_connection((server.HOST, port), timeout=5.0)
            with context.wrap_socket(plain, server_hostname='base.example') as secured:
                assert secured.version() in ('TLSv1.2', 'TLSv1.3')
                connection = http.client.HTTPConnection('base.example')
                connection.sock = secured
                connection.request('GET', '/facts', headers={**sent, **changed})
                assert connection.getresponse().status == expected
        assert time.monotonic() - began < server.MAX_SECONDS
        # Plain text is not answered.
        assert SECRET.encode() not in answer(port, request(port, token, Host=sent['Host']))


@pytest.mark.processes
def test_without_control_nothing_of_ros_is_imported():
    program = 'import sys, kbnitp_ros.cli.watch; sys.exit("rclpy" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', program]).returncode == 0
