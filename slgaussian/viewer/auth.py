"""Access control of the viewer: its address, access token, and checks of requests.

The web server alone would check no token and would answer requests from pages of other sites, so
the socket is bound here, and every request passes :class:`Guard` first.
"""

from __future__ import annotations

import errno
import secrets
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from slgaussian.errors import InputError, SLGaussianError

PORT = 8080
"""Default port; if it is in use, a free one is chosen."""

LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True)
class Access:
    """A socket that listens, and the rule for requests to it.

    Attributes
    ----------
    host : str
        As the user gave it.
    listener : socket
    token : str or None
        First part of the path of every request; None on loopback.
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
        """URL to open in a browser; the name of the machine stands for "all its addresses"."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"{self.token}/" if self.token else "")

    def path_within(self, path: str, host: str | None, origin: str | None) -> str | None:
        """Return the path of a request without the token, or None to refuse the request.

        Parameters
        ----------
        path : str
            As the request has it.
        host, origin : str or None
            The headers of the request. A page of another site may send a browser here, with that
            site as its origin, or under a name of its own that it has made lead to this machine.
        """
        try:
            hostname = urlsplit(f"//{host}").hostname if host else None
            if origin is not None and urlsplit(origin).netloc != host:
                return None
        except ValueError:  # no address at all, as "["
            return None
        if self.token is None:
            return path if hostname in LOOPBACK else None
        first, _, rest = path.removeprefix("/").partition("/")
        first = first.partition("?")[0]
        valid = secrets.compare_digest(first.encode(), self.token.encode())
        return f"/{rest}" if valid else None


def listen(host: str = LOOPBACK[0], port: int | None = None) -> Access:
    """Listen at ``host``: on ``port``, or on :data:`PORT`, or where that is in use on a free one.

    Raises
    ------
    InputError
        If the port that is given is in use or may not be taken, or this machine has no such host.
    """
    token = None if host in LOOPBACK else secrets.token_urlsafe(24)
    for tried in (PORT, 0) if port is None else (port,):
        try:
            family, kind, protocol, _, sockaddr = socket.getaddrinfo(
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
            listener.bind(sockaddr)
            listener.listen(128)
            return Access(host, listener, token)
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


class Guard:
    """ASGI middleware that refuses, with 403, what :meth:`Access.path_within` refuses."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self.app, self.access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, with its path below the token."""
        hosts, origins = (
            [value.decode("latin-1") for key, value in scope["headers"] if key == name]
            for name in (b"host", b"origin")
        )
        within = None
        if len(hosts) == 1 and len(origins) < 2:
            within = self.access.path_within(scope["path"], hosts[0], *(origins or [None]))
        if within is None:
            refusal = "This viewer answers only at the address that its command printed.\n"
            await PlainTextResponse(refusal, 403)(scope, receive, send)
            return
        path = {"path": within, "raw_path": within.encode()}
        await self.app({**scope, **path}, receive, send)
