# SPDX-License-Identifier: Apache-2.0
"""Serve a mission over HTTP to those who hold a token of this start, and to nobody else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import errno
import hmac
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import io
from ipaddress import IPv4Address
from pathlib import Path
import re
import secrets
import socket
import ssl
from threading import BoundedSemaphore, Thread
import time
from types import MappingProxyType
from typing import Any

HOST, PORT = '127.0.0.1', 8080

# The header that carries the token.
TOKEN = 'X-Kbnitp-Token'

# Seconds in which a request must be read, and in which each piece of an answer must be sent.
MAX_SECONDS = 10.0

# Maximum number of connections and of streams, and bytes of the head of a request, of its body and
# of a piece of an answer.
MAX_CONNECTIONS, MAX_STREAMS, MAX_BYTES = 64, 32, 2**16

# Errors of a port that is taken or reserved.
PORT_ERRORS = errno.EADDRINUSE, errno.EACCES

HEADERS = {
    'Cache-Control': 'no-store',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Referrer-Policy': 'no-referrer',
    'X-Content-Type-Options': 'nosniff',
}


@dataclass(frozen=True)
class Address:
    """Where a server listens, its name for others, and its files of TLS."""

    host: str = HOST
    port: int = PORT
    name: str | None = None
    certificate: Path | None = None
    key: Path | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.port < 2**16:
            raise ValueError(f'--port is {self.port}: it must be from 0 to {2**16 - 1}')
        if (self.certificate is None) != (self.key is None):
            raise ValueError('--certificate and --key must be given together')
        address = self.resolved()
        if not address.is_loopback and self.certificate is None:
            raise ValueError(
                f'--host is {self.host!r}, which others can reach: give --certificate and --key, '
                f'or use a tunnel to {HOST}'
            )
        if address.is_unspecified and self.name is None:
            raise ValueError(f'--host is {self.host!r}: give the name of this machine as --name')

    def wrong_host(self) -> ValueError:
        """Return the error of a host that is no address of this machine."""
        return ValueError(
            f'--host is {self.host!r}: it must be an IPv4 address or a name of this machine'
        )

    def resolved(self) -> IPv4Address:
        """Return the address of the host."""
        if not self.host:
            # It would listen on every address of this machine.
            raise self.wrong_host()
        try:
            return IPv4Address(socket.gethostbyname(self.host))
        except (OSError, UnicodeError) as error:
            raise self.wrong_host() from error

    def context(self) -> ssl.SSLContext | None:
        """Return the context of TLS, from version 1.2 up."""
        if self.certificate is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        # A key with a password must not be asked for on the terminal.
        try:
            context.load_cert_chain(self.certificate, self.key, password=b'')
        except OSError as error:
            raise ValueError(f'--certificate or --key cannot be used: {error}') from error
        return context


@dataclass(frozen=True)
class Resource:
    """A text or a stream of texts at a path; only an open one needs no token."""

    kind: str
    content: Callable[[], str | Iterator[str]]
    is_open: bool = False
    # The content for those who may act, where it differs.
    acting: Callable[[], str | Iterator[str]] | None = None


# A function from the body of a POST request to the status and the JSON of its answer.
Act = Callable[[bytes], tuple[HTTPStatus, str]]

NO_ACTS: Mapping[str, Act] = MappingProxyType({})


@contextmanager
def serving(
    resources: Mapping[str, Resource],
    policy: str,
    where: Address,
    acts: Mapping[str, Act] = NO_ACTS,
) -> Iterator[str]:
    """Serve resources and acts by their paths, and yield the address of `/` with the tokens."""
    context = where.context()
    try:
        server = Server(resources, policy, where, context, acts)
    except (OSError, UnicodeError) as error:
        if isinstance(error, OSError) and error.errno in PORT_ERRORS:
            raise OSError(
                f'cannot listen on {where.host}:{where.port} ({error.strerror}): '
                'name another --port'
            ) from error
        raise where.wrong_host() from error
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        name = where.name or where.host
        act = f'&act={server.acting}' if acts else ''
        yield f'{server.scheme}://{name}:{server.server_port}/#token={server.looking}{act}'
    finally:
        server.shutdown()
        server.server_close()


class Server(ThreadingHTTPServer):
    """A server with a bounded number of connections, each in a thread."""

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS

    def __init__(
        self,
        resources: Mapping[str, Resource],
        policy: str,
        where: Address,
        context: ssl.SSLContext | None,
        acts: Mapping[str, Act],
    ) -> None:
        self.resources = resources
        self.acts = acts
        self.policy = f"{policy}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        # Tokens to look, and to act as well.
        self.looking, self.acting = secrets.token_urlsafe(16), secrets.token_urlsafe(16)
        self.streams = BoundedSemaphore(MAX_STREAMS)
        self._connections = BoundedSemaphore(MAX_CONNECTIONS)
        self._context = context
        self.scheme, default = ('https', 443) if context else ('http', 80)
        super().__init__((where.host, where.port), Handler)
        names = {where.name or where.host}
        if where.resolved().is_loopback:
            names |= {HOST, 'localhost'}
        # A browser leaves out the default port.
        ports = {f':{self.server_port}', *([''] if self.server_port == default else [])}
        self.hosts = {f'{name.lower()}{port}' for name in names for port in ports}

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a thread of its own, or close it if there are too many."""
        if self._connections.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._connections.release()

    def finish_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection, with TLS if there is a certificate, until either side gives up."""
        request.settimeout(MAX_SECONDS)
        with suppress(ConnectionError, TimeoutError, ssl.SSLError):
            if self._context is None:
                super().finish_request(request, client_address)
                return
            with self._context.wrap_socket(request, server_side=True) as secured:
                super().finish_request(secured, client_address)


class Incoming(io.RawIOBase):
    """The bytes of one request, as far as its limits allow."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._left = MAX_BYTES
        self._end = time.monotonic() + MAX_SECONDS

    def allow(self, count: int) -> None:
        """Allow the bytes of a body, in the same time."""
        self._left += count

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read what has arrived."""
        seconds = self._end - time.monotonic()
        if seconds <= 0 or self._left <= 0:
            raise TimeoutError('the request is too slow or too large')
        self._connection.settimeout(seconds)
        count = self._connection.recv_into(memoryview(buffer)[: self._left])
        self._left -= count
        return count


class Handler(BaseHTTPRequestHandler):
    """Request handler for one request of a connection."""

    server: Server
    server_version, sys_version = 'kbnitp_ros', ''

    def setup(self) -> None:
        """Limit the request."""
        super().setup()
        self.rfile.close()
        self._incoming = Incoming(self.connection)
        self.rfile = io.BufferedReader(self._incoming)

    def do_GET(self) -> None:
        """Answer a request."""
        resource = self.server.resources.get(self.path)
        if status := self._refusal(resource):
            self.send_error(status)
            return
        assert resource
        acting = resource.acting if self._has(self.server.acting) else None
        content = (acting or resource.content)()
        if isinstance(content, str):
            self._send(resource.kind, iter([content]))
        elif self.server.streams.acquire(blocking=False):
            try:
                self._send(resource.kind, content)
            finally:
                self.server.streams.release()
        else:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)

    def do_POST(self) -> None:
        """Answer a request to act."""
        if status := self._act_refusal():
            self.send_error(status)
            return
        length = int(self.headers['Content-Length'])
        self._incoming.allow(length)
        body = self.rfile.read(length)
        if len(body) == length:
            answer, text = self.server.acts[self.path](body)
            self._send('application/json', iter([text]), answer)

    def _is_own(self) -> bool:
        """Return whether a request names this server, and is from no other site."""
        hosts = self.headers.get_all('Host', [])
        if len(hosts) != 1 or hosts[0].lower() not in self.server.hosts:
            return False
        own = f'{self.server.scheme}://{hosts[0]}'
        # Only GET requests may lack an origin. Typed addresses have no site, and other clients
        # than browsers no such header.
        is_get = self.command == 'GET'
        origins = self.headers.get_all('Origin', [own] if is_get else [])
        sites = ('none', 'same-origin') if is_get else ('same-origin',)
        return origins == [own] and self.headers.get('Sec-Fetch-Site', sites[-1]) in sites

    def _has(self, *tokens: str) -> bool:
        """Return whether a request has one of these tokens."""
        given = self.headers.get(TOKEN, '').encode(errors='replace')
        return any(hmac.compare_digest(given, token.encode()) for token in tokens)

    def _refusal(self, resource: Resource | None) -> HTTPStatus | None:
        """Return the status of a request that is refused: other sites must not read anything."""
        if not self._is_own():
            return HTTPStatus.FORBIDDEN
        if 'Transfer-Encoding' in self.headers or self.headers.get('Content-Length', '0') != '0':
            return HTTPStatus.BAD_REQUEST
        if resource is None:
            return HTTPStatus.NOT_FOUND
        if not (resource.is_open or self._has(self.server.looking, self.server.acting)):
            return HTTPStatus.FORBIDDEN
        return None

    def _act_refusal(self) -> HTTPStatus | None:
        """Return the status of a request to act that is refused."""
        if not self._is_own():
            return HTTPStatus.FORBIDDEN
        if self.path not in self.server.acts:
            is_read = self.path in self.server.resources
            return HTTPStatus.METHOD_NOT_ALLOWED if is_read else HTTPStatus.NOT_FOUND
        if not self._has(self.server.acting):
            return HTTPStatus.FORBIDDEN
        if self.headers.get_content_type() != 'application/json':
            return HTTPStatus.UNSUPPORTED_MEDIA_TYPE
        lengths = self.headers.get_all('Content-Length', [])
        if not lengths:
            return HTTPStatus.LENGTH_REQUIRED
        if 'Transfer-Encoding' in self.headers or not re.fullmatch('[0-9]{1,9}', lengths[0]):
            return HTTPStatus.BAD_REQUEST
        if int(lengths[0]) > MAX_BYTES:
            return HTTPStatus.REQUEST_ENTITY_TOO_LARGE
        return None if len(lengths) == 1 else HTTPStatus.BAD_REQUEST

    def _send(self, kind: str, content: Iterator[str], status: HTTPStatus = HTTPStatus.OK) -> None:
        """Send an answer, whose end is that of the connection."""
        self.connection.settimeout(MAX_SECONDS)
        self.send_response(status)
        self.send_header('Content-Type', f'{kind}; charset=utf-8')
        self.end_headers()
        for text in content:
            data = text.encode()
            for begin in range(0, len(data), MAX_BYTES):
                end = begin + MAX_BYTES
                self.wfile.write(data[begin:end])

    def end_headers(self) -> None:
        """Send the head of an answer."""
        for name, value in {**HEADERS, 'Content-Security-Policy': self.server.policy}.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, *_: object) -> None:
        """Log no requests: they hold a token."""
