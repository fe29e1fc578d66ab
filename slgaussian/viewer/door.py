"""The door of the viewer: at which address it answers, and whom.

The server of viser answers whoever reaches its port, takes another port without a word where one is
in use, and asks no page of another site why it connects. So it is given a socket that is bound
here, and every request passes :class:`Door` first.
"""

from __future__ import annotations

import errno
import secrets
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from slgaussian.errors import InputError, SLGaussianError

PORT = 8080
"""Tried first where the user names none."""

LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True)
class Door:
    """A socket that listens, and who may come in.

    Attributes
    ----------
    host : str
        As the user gave it.
    listener : socket
    token : str or None
        What the path of every address begins with; None on loopback.
    """

    host: str
    listener: socket.socket
    token: str | None

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self.listener.getsockname()[1])

    @property
    def address(self) -> str:
        """What to open in a browser.

        A host that stands for all of a machine's is told by the machine's name.
        """
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"{self.token}/" if self.token else "")

    def path_within(self, path: str, host: str | None, origin: str | None) -> str | None:
        """The path of a request without the token; None for a request that is to be refused.

        Parameters
        ----------
        path : str
            As the request has it.
        host, origin : str or None
            The headers of the request. A page of another site may send a browser here, with that
            site as its origin, or under a name of its own that it has made lead to this machine.
        """
        if origin is not None and urlsplit(origin).netloc != host:
            return None
        if self.token is None:
            asked = urlsplit(f"//{host}").hostname if host else None
            return path if asked in LOOPBACK else None
        first, _, rest = path.removeprefix("/").partition("/")
        first = first.partition("?")[0]
        known = secrets.compare_digest(first.encode(), self.token.encode())
        return f"/{rest}" if known else None


def listen(host: str = LOOPBACK[0], port: int | None = None) -> Door:
    """Listen at ``host``: on ``port``, or on :data:`PORT`, or where that is in use on a free one.

    Raises
    ------
    InputError
        If the port that is given is in use or may not be taken, or this machine has no such host.
    """
    token = None if host in LOOPBACK else secrets.token_urlsafe(24)
    for tried in (PORT, 0) if port is None else (port,):
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(
                host, tried, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
        except (OSError, UnicodeError):
            raise InputError(
                f"--host: found {host!r}, expected a name or an address of this machine, as "
                "127.0.0.1"
            ) from None
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(where)
            listener.listen(128)
            return Door(host, listener, token)
        except OSError as error:
            listener.close()
            if error.errno == errno.EADDRNOTAVAIL:
                raise InputError(
                    f"--host: {host} is no address of this machine; leave it out to look from "
                    "this machine alone"
                ) from None
            if port is not None:
                why = "is in use by another program"
                if error.errno != errno.EADDRINUSE:
                    why = f"cannot be taken ({error.strerror})"
                raise InputError(
                    f"--port: {port} {why}; give another, or leave it out for a free one"
                ) from None
    raise SLGaussianError(f"no free port at {host}; end a program that listens there")


@contextmanager
def guarding(door: Door) -> Iterator[None]:
    """A server of viser that is made within the block listens at ``door`` and lets it judge.

    viser offers no other way to give it a socket, or a say in its requests.

    Raises
    ------
    SLGaussianError
        If the server did not come to listen there, so that nobody guards it.
    """
    from websockets.asyncio import server
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    plain, guarded = server.serve, []

    def serve(handler: Any, *_: Any, process_request: Any, **settings: Any) -> Any:
        def judged(connection: Any, request: Any) -> Any:
            headers = request.headers
            hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
            within = None
            if len(hosts) == 1 and len(origins) < 2:
                within = door.path_within(request.path, hosts[0], origins[0] if origins else None)
            if within is None:
                refusal = b"This viewer answers only at the address that its command printed.\n"
                kind = {"Content-Type": "text/plain", "Content-Length": str(len(refusal))}
                status = HTTPStatus.FORBIDDEN
                return Response(status, status.phrase, Headers(kind), refusal)
            request.path = within
            return process_request(connection, request)

        guarded.append(True)
        return plain(handler, sock=door.listener, process_request=judged, **settings)

    server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        server.serve = plain  # type: ignore[misc]
    if not guarded:
        raise SLGaussianError(
            "this version of viser starts its server in a way that cannot be guarded; install the "
            "one that constraints.txt names"
        )
