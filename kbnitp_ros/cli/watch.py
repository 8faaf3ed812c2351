# SPDX-License-Identifier: Apache-2.0
"""Serve the page of a mission while it runs, following the log as it grows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Condition, Event, Thread
import time

from kbnitp_ros.cli.output import command, complain, end_on_signals, say
from kbnitp_ros.cli.study import count
from kbnitp_ros.log.files import log_parts
from kbnitp_ros.log.read import is_finished
from kbnitp_ros.log.record import first_belief
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.nodes.runtime.command_line import add_namespace, command_parser
from kbnitp_ros.report.mission import read_mission
from kbnitp_ros.report.page import library, mission_page, mission_title, rendered
from kbnitp_ros.report.tables import mission_curves

DESCRIPTION = """
Serve the page of a mission while it runs. The page follows the log as it grows. The command reads
the log, takes no part in the mission and writes nothing. Ctrl-C ends it.

The exit code is 0 after Ctrl-C, and 2 if the log cannot be used or the port is taken.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros watch runs/small',
    'python3 -m kbnitp_ros watch runs/small/mission.mcap --port 8081',
)

HOST, PORT = '127.0.0.1', 8080

# Seconds between two reads of the log, and seconds without growth after which the page reports the
# standstill: a recorder writes diagnostics every second.
LOOK, STILL = 0.5, 5.0

# Maximum seconds between two messages to a browser, so that it notices a dead server.
BEAT = 5.0


@command('watch')
def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = command_parser('watch', DESCRIPTION, *EXAMPLES)
    parser.add_argument(
        'log',
        metavar='LOG',
        type=Path,
        nargs='?',
        help='the log of a mission: its first file, or its folder; default the newest in runs/',
    )
    add_namespace(parser)
    parser.add_argument(
        '--port',
        metavar='N',
        type=partial(count, least=0),
        default=PORT,
        help=f'port to listen on, from 0 to 65535; default {PORT}, 0 for a free one',
    )
    parser.add_argument(
        '--host',
        metavar='ADDRESS',
        default=HOST,
        help=f'address to listen on; default {HOST}, which only this machine can reach',
    )
    options = parser.parse_args(argv)
    end_on_signals()
    try:
        log = options.log or newest_log()
        if not log.exists():
            raise ValueError(f'{log} does not exist: name the log of a mission that has begun')
        with serving(log, options.namespace, options.host, options.port):
            while True:
                time.sleep(LOOK)
    except KeyboardInterrupt:
        return 0
    except (ValueError, OSError) as error:
        complain('watch', error)
        return 2


def newest_log() -> Path:
    """Return the log in runs/ that was written last."""
    logs = [*Path('runs').glob('*/*.mcap')]
    if not logs:
        raise ValueError('no log is in runs/: name the log, or its folder')
    return log_parts(max(logs, key=lambda log: log.stat().st_mtime).parent)[0]


@contextmanager
def serving(log: Path, namespace: str | None, host: str, port: int) -> Iterator[str]:
    """Serve the page of a log, and yield its address."""
    if not 0 <= port < 2**16:
        raise ValueError(f'--port is {port}: it must be from 0 to {2**16 - 1}')
    follower = Follower(log_parts(log)[0], namespace)
    try:
        server = ThreadingHTTPServer((host, port), partial(Handler, follower))
    except OSError as error:
        raise OSError(
            f'cannot listen on {host}:{port} ({error.strerror}): name another --port'
        ) from error
    server.daemon_threads = True
    address = f'http://{host}:{server.server_port}/'
    if host != HOST:
        say(f'anyone who can reach {host} can read this mission')
    for work in (server.serve_forever, follower.follow):
        Thread(target=work, daemon=True).start()
    say(f'the page of {follower.log} is at {address}')
    try:
        yield address
    finally:
        follower.is_over.set()
        server.shutdown()
        server.server_close()


class Follower:
    """The current page of a log, and its state in a sentence."""

    def __init__(self, log: Path, namespace: str | None = None) -> None:
        self.log = log
        self.page = self._bare = ''
        # Number of changes of the page, and the state of the log in a sentence.
        self.version = 0
        self.sentence = ''
        self.changed = Condition()
        self.is_over = Event()
        self._namespace = namespace
        self._state: list[tuple[int, int, int]] = []
        self._file = 0
        self._grown_at = time.monotonic()
        self._show(self._waiting())
        # A missing log is awaited. Other errors are raised here, but only shown by `follow`.
        with suppress(FileNotFoundError):
            self._look()

    def _waiting(self) -> str:
        return rendered('waiting', title=f'Mission {mission_title(self.log)}', log=self.log)

    def follow(self) -> None:
        """Read the log repeatedly until the server ends."""
        while not self.is_over.is_set():
            began = time.monotonic()
            try:
                self._look()
            except FileNotFoundError:
                self._describe('Waiting for the recorder to begin the log.')
            except (ValueError, OSError) as error:
                self._describe(f'The page is out of date, since the log cannot be read: {error}')
            # Reading a large log takes at most half of the time.
            self.is_over.wait(LOOK + time.monotonic() - began)

    def _look(self) -> None:
        parts = [part.stat() for part in log_parts(self.log)]
        state = [(each.st_ino, each.st_size, each.st_mtime_ns) for each in parts]
        now = time.monotonic()
        if state == self._state:
            if is_finished(self.log):
                self._describe('The log is finished. The page resumes with the mission.')
            elif now > self._grown_at + STILL:
                self._describe(
                    f'The log has not grown for {now - self._grown_at:.0f} s: its recorder has '
                    'ended or was killed. The page resumes with the mission.'
                )
            return
        is_replaced = self._file not in (0, state[0][0])
        self._state, self._file, self._grown_at = state, state[0][0], now
        if is_replaced:
            self._show(self._waiting())
        if first_belief(MissionLog(self.log, self._namespace)) is None:
            self._describe('Waiting for the first belief: the nodes of the mission are starting.')
            return
        mission = read_mission(self.log, namespace=self._namespace)
        page, _ = mission_page(mission, mission_curves(mission), is_live=True)
        self._describe(
            f'Following the log: {len(mission.robots)} robots reported, {mission.in_flight} in '
            'flight.'
        )
        if page != self._bare:
            self._show(page)

    def _show(self, page: str) -> None:
        with self.changed:
            self.version += 1
            named = f'<html lang="en" data-version="{self.version}">'
            self._bare, self.page = page, page.replace('<html lang="en">', named, 1)
            self.changed.notify_all()

    def _describe(self, sentence: str) -> None:
        if sentence != self.sentence:
            with self.changed:
                self.sentence = sentence
                self.changed.notify_all()


class Handler(BaseHTTPRequestHandler):
    """Request handler for the page, for the page without Plotly, and for events."""

    def __init__(self, follower: Follower, *arguments: object) -> None:
        self._follower = follower
        super().__init__(*arguments)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        """Answer a request, unless its Host is foreign: other sites must not read the page."""
        name = self.headers.get('Host', '').rpartition(':')[0]
        is_local = self.client_address[0] == HOST
        if is_local and name not in (HOST, 'localhost'):
            self.send_error(403)
        elif self.path == '/':
            self._answer(self._follower.page)
        elif self.path == '/update':
            # The browser has loaded Plotly already.
            self._answer(self._follower.page.replace(library(), ''))
        elif self.path == '/events':
            self._send_changes()
        else:
            self.send_error(404)

    def _answer(self, page: str) -> None:
        body = page.encode()
        self.send_response(200)
        self.send_header('Content-Type', 'text/html; charset=utf-8')
        self.send_header('Content-Length', str(len(body)))
        self.send_header('Cache-Control', 'no-store')
        self.end_headers()
        self.wfile.write(body)

    def _send_changes(self) -> None:
        """Send server-sent events until the browser or the server ends."""
        self.send_response(200)
        self.send_header('Content-Type', 'text/event-stream')
        self.send_header('Cache-Control', 'no-store')
        self.end_headers()
        follower, known = self._follower, (0, '')
        while not follower.is_over.is_set():
            with follower.changed:
                if known == (follower.version, follower.sentence):
                    follower.changed.wait(BEAT)
                version, sentence = news = follower.version, follower.sentence
            # A comment of the protocol, which browsers ignore.
            events = ': \n\n'
            if version != known[0]:
                events += f'event: page\ndata: {version}\n\n'
            if sentence != known[1]:
                events += f'event: told\ndata: {" ".join(sentence.split())}\n\n'
            known = news
            self.wfile.write(events.encode())

    def handle(self) -> None:
        """Answer requests until the browser disconnects."""
        with suppress(ConnectionError):
            super().handle()

    def log_message(self, *_: object) -> None:
        """Log no requests."""
