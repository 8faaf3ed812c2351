# SPDX-License-Identifier: Apache-2.0
"""Serve the page of a mission while it runs, following the log as it grows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
import json
import os
from pathlib import Path
from threading import Event, Thread
import time
from typing import TYPE_CHECKING

from kbnitp_ros.cli import server
from kbnitp_ros.cli.output import command, complain, end_on_signals, say
from kbnitp_ros.cli.server import Address, HOST, PORT, Resource
from kbnitp_ros.log.files import log_parts
from kbnitp_ros.log.history import History, read_history
from kbnitp_ros.log.read import is_finished
from kbnitp_ros.log.record import first_belief, required_belief
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.orders import describe_orders
from kbnitp_ros.nodes.runtime.command_line import add_namespace, command_parser
from kbnitp_ros.report.mission import MissionSummary, recorded_mission
from kbnitp_ros.report.page import fitting_facts, page, policy
from kbnitp_ros.report.said import said_csv, said_geojson
from kbnitp_ros.report.tables import mission_curves

if TYPE_CHECKING:
    from kbnitp_ros.cli.control import Control

DESCRIPTION = """
Serve the page of a mission while it runs. The page follows the log as it grows. The command reads
the log, takes no part in the mission and writes nothing. Ctrl-C ends it.

Only the printed address opens the page: it has a token that is made anew at each start. For other
machines give a certificate and its key, or use a tunnel.

With --control a node, operator, also takes orders from those who have the second token. It needs
ROS 2 and a base that runs.

The exit code is 0 after Ctrl-C, and 2 if the log cannot be used or the port is taken.
"""

EXAMPLES = (
    'python3 -m kbnitp_ros watch runs/small',
    'python3 -m kbnitp_ros watch runs/small/mission.mcap --port 8081',
    'python3 -m kbnitp_ros watch runs/small --control',
    'python3 -m kbnitp_ros watch --host base.example --certificate base.pem --key base.key',
)

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
    parser.add_argument(
        '--name',
        metavar='NAME',
        help='name by which browsers reach this machine; default the one of --host',
    )
    for name, what in (('certificate', 'certificate'), ('key', 'private key')):
        parser.add_argument(
            f'--{name}',
            metavar='FILE',
            type=Path,
            help=f'{what} of this machine (PEM); default none, without TLS',
        )
    parser.add_argument(
        '--control',
        action='store_true',
        help='also order, by the services of the mission; default only show it',
    )
    options = parser.parse_args(argv)
    end_on_signals()
    try:
        log = options.log or newest_log()
        if not log.exists():
            raise ValueError(f'{log} does not exist: name the log of a mission that has begun')
        where = Address(options.host, options.port, options.name, options.certificate, options.key)
        control = controlling(log, options.namespace) if options.control else nullcontext()
        with control as operator, serving(log, options.namespace, where, operator):
            while not (operator and operator.broken):
                time.sleep(LOOK)
            complain('watch', operator.broken)
            return 1
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


def controlling(log: Path, namespace: str | None) -> AbstractContextManager[Control]:
    """Return the control of the mission of a log; ValueError without ROS 2."""
    try:
        from kbnitp_ros.cli.control import operating
    except ModuleNotFoundError as error:
        raise ValueError(f'--control needs ROS 2, which is not here: {error}') from error
    if namespace is None:
        namespace = MissionLog(log_parts(log)[0]).roles.namespace
    return operating(mission_name(log), namespace)


def mission_name(log: Path) -> str:
    """Return the name of a mission: that of the folder of its log."""
    return log_parts(log)[0].resolve().parent.name


@contextmanager
def written_tokens(log: Path, address: str) -> Iterator[Path]:
    """Write the addresses to look and to act beside the log while they are valid."""
    file = log.with_suffix('.tokens')
    file.unlink(missing_ok=True)
    handle = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, 'w', encoding='utf-8') as tokens:
        tokens.write(f'look {address.partition("&")[0]}\nact {address}\n')
    try:
        yield file
    finally:
        file.unlink(missing_ok=True)


@contextmanager
def serving(
    log: Path, namespace: str | None, where: Address, control: Control | None = None
) -> Iterator[str]:
    """Serve the page of a log, with the board and orders of a control; yield its address."""
    follower = Follower(log_parts(log)[0], namespace)
    resources = {
        '/': Resource(
            'text/html', lambda: page(follower.log, has_board=control is not None), is_open=True
        ),
        '/facts': Resource('application/json', lambda: follower.facts),
        '/events': Resource('application/x-ndjson', follower.changes),
        '/said.csv': Resource('text/csv', lambda: follower.said(said_csv)),
        '/said.geojson': Resource('application/geo+json', lambda: follower.said(said_geojson)),
    }
    acts = server.NO_ACTS
    if control:
        look, act = (partial(control.stream, role) for role in ('look', 'act'))
        resources['/board'] = Resource('text/event-stream', look, acting=act)
        acts = {'/act': control.act}
    with server.serving(resources, policy(), where, acts) as address:
        Thread(target=follower.follow, daemon=True).start()
        tokens = written_tokens(follower.log, address) if control else nullcontext()
        try:
            with tokens as file:
                if control:
                    say(f'--control {describe_orders()}', f'the tokens are in {file}')
                say(f'the page of {follower.log} is at {address}')
                yield address
        finally:
            follower.is_over.set()


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
        self._mission: MissionSummary | None = None
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

    def changes(self) -> Iterator[str]:
        """Yield the state and the version of the facts, as JSON in lines, when they change."""
        shown = ''
        while not self.is_over.is_set():
            now = json.dumps({'told': self.sentence, 'version': self.version})
            # An empty line, by which a write fails once the browser has left.
            yield '\n' if now == shown else f'{now}\n'
            shown = now
            self.is_over.wait(LOOK)

    def said(self, write: Callable[[MissionSummary], str]) -> str:
        """Return what people said, as a function writes it; empty before the first belief."""
        return write(self._mission) if self._mission else ''

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
            mission = self._mission = recorded_mission(*read)
            facts, _ = fitting_facts(mission, mission_curves(mission))
            robots, out = len(mission.robots), mission.in_flight
            sentence = f'Following the log: {robots} robots reported, {out} in flight.'
        self.sentence = sentence
        self._read = read
        if facts != self.facts:
            self.facts = facts
            self.version += 1
