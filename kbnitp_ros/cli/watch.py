# SPDX-License-Identifier: Apache-2.0
"""Serve the page of a mission while it runs, following the log as it grows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
import errno
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event, Thread
import time

from kbnitp_ros.cli.output import command, complain, end_on_signals, say
from kbnitp_ros.log.files import log_parts
from kbnitp_ros.log.history import History, read_history
from kbnitp_ros.log.read import is_finished
from kbnitp_ros.log.record import first_belief, required_belief
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.nodes.runtime.command_line import add_namespace, command_parser
from kbnitp_ros.report.mission import recorded_mission
from kbnitp_ros.report.page import fitting_facts, page
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

# Errors of a port that is taken or reserved.
PORT_ERRORS = errno.EADDRINUSE, errno.EACCES

# Seconds between two reads of the log, and seconds without growth after which the page reports the
# standstill: a recorder writes diagnostics every second.
LOOK, STILL = 0.5, 5.0


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
        type=int,
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
    wrong_host = f'--host is {host!r}: it must be an IPv4 address or a name of this machine'
    if not host:
        # It would listen on every address of this machine.
        raise ValueError(wrong_host)
    follower = Follower(log_parts(log)[0], namespace)
    try:
        server = ThreadingHTTPServer((host, port), partial(Handler, follower))
    except (OSError, UnicodeError) as error:
        if isinstance(error, OSError) and error.errno in PORT_ERRORS:
            raise OSError(
                f'cannot listen on {host}:{port} ({error.strerror}): name another --port'
            ) from error
        raise ValueError(wrong_host) from error
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
    """The facts of a log that grows, and its state in a sentence."""

    def __init__(self, log: Path, namespace: str | None = None) -> None:
        self.log = log
        # Facts of the mission in JSON, empty before the first belief; and number of their changes.
        self.facts, self.version = '', 0
        self.sentence = ''
        self.is_over = Event()
        self._namespace = namespace
        # Inode, size and time of change of each part, and the time at which they changed.
        self._parts: list[tuple[int, int, int]] = []
        self._grown_at = time.monotonic()
        # The log and its history, as far as they were read.
        self._read: tuple[MissionLog, History] | None = None
        # A missing log is awaited. Other errors are raised here, but only shown by `follow`.
        with suppress(FileNotFoundError):
            self._look()
            if not self.facts and is_finished(self.log):
                required_belief(MissionLog(self.log, namespace))

    def follow(self) -> None:
        """Read the log repeatedly until the server ends."""
        while not self.is_over.is_set():
            began = time.monotonic()
            try:
                self._look()
            except FileNotFoundError:
                self.sentence = 'Waiting for the recorder to begin the log.'
            except (ValueError, OSError) as error:
                self.sentence = f'The page is out of date, since the log cannot be read: {error}'
            # Reading a large log takes at most half of the time.
            self.is_over.wait(LOOK + time.monotonic() - began)

    def _look(self) -> None:
        """Read what is new in the log, if it has changed."""
        stats = [part.stat() for part in log_parts(self.log)]
        parts = [(each.st_ino, each.st_size, each.st_mtime_ns) for each in stats]
        if parts != self._parts:
            before, self._parts, self._grown_at = self._parts, parts, time.monotonic()
            if not before or parts[0][0] != before[0][0] or parts[0][1] < before[0][1]:
                # The log was replaced.
                self._read = None
            self._update()
        elif is_finished(self.log):
            self.sentence = 'The log is finished. The page resumes with the mission.'
        elif (still := time.monotonic() - self._grown_at) > STILL:
            self.sentence = (
                f'The log has not grown for {still:.0f} s: its recorder has ended or was killed. '
                'The page resumes with the mission.'
            )

    def _update(self) -> None:
        """Read what is new in the log, or all if it must be read anew."""
        # What raises an error here is read again.
        read, self._read = self._read, None
        is_named = read is not None and read[0].roles.are_recorded
        log = read[0] if read and is_named else MissionLog(self.log, self._namespace)
        # The check sum of a finished log is that of all of it.
        if read is None or read[0].roles != log.roles or is_finished(self.log):
            read = (log, read_history(log)) if first_belief(log) else None
        else:
            read_history(read[0], history=read[1])
        belief, facts = log.roles.names['belief'], ''
        sentence = (
            f'Waiting for the first belief on {belief}: the nodes of the mission are starting.'
        )
        if read is not None:
            mission = recorded_mission(*read)
            facts, _ = fitting_facts(mission, mission_curves(mission))
            robots, out = len(mission.robots), mission.in_flight
            sentence = f'Following the log: {robots} robots reported, {out} in flight.'
        self.sentence = sentence
        self._read = read
        if facts != self.facts:
            self.facts = facts
            self.version += 1


class Handler(BaseHTTPRequestHandler):
    """Request handler for the page, its facts and events."""

    def __init__(self, follower: Follower, *arguments: object) -> None:
        self._follower = follower
        super().__init__(*arguments)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        """Answer a request, unless its Host is foreign: other sites must not read the page."""
        # A browser leaves out the port 80.
        name = self.headers.get('Host', '').partition(':')[0]
        if self.client_address[0] == HOST and name not in (HOST, 'localhost'):
            self.send_error(403)
        elif self.path == '/':
            self._begin('text/html; charset=utf-8', page(self._follower.log))
        elif self.path == '/facts':
            self._begin('application/json', self._follower.facts)
        elif self.path == '/events':
            self._begin('text/event-stream')
            self._send_changes()
        else:
            self.send_error(404)

    def _begin(self, kind: str, content: str | None = None) -> None:
        """Send the head of an answer, and its content if it is known."""
        self.send_response(200)
        self.send_header('Content-Type', kind)
        self.send_header('Cache-Control', 'no-store')
        if content is not None:
            self.send_header('Content-Length', str(len(content.encode())))
        self.end_headers()
        self.wfile.write((content or '').encode())

    def _send_changes(self) -> None:
        """Send server-sent events until the browser or the server ends."""
        version, sentence = 0, ''
        while not self._follower.is_over.is_set():
            # A comment of the protocol, which browsers ignore, and by which a write fails once the
            # browser has left.
            events = ': \n\n'
            if sentence != (sentence := self._follower.sentence):
                events += f'event: told\ndata: {" ".join(sentence.split())}\n\n'
            if version != (version := self._follower.version):
                events += f'event: facts\ndata: {version}\n\n'
            self.wfile.write(events.encode())
            self._follower.is_over.wait(LOOK)

    def handle(self) -> None:
        """Answer requests until the browser disconnects."""
        with suppress(ConnectionError):
            super().handle()

    def log_message(self, *_: object) -> None:
        """Log no requests."""
