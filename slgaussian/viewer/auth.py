"""Access control of the viewer: its address, access token, and checks of requests.

The web server itself checks no token, and answers requests that pages of other sites send. So this
module binds the socket, and every request passes :class:`Guard` first.
"""

from __future__ import annotations

import secrets
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from slgaussian.errors import InputError

PORT = 8080  # default port; if it is in use, a free one is chosen

LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True)
class Access:
    """A listening socket, and the rule by which requests to it are refused.

    Attributes:
        host: Name or address from the command line.
        token: First part of the path of every valid request; None on loopback.
    """

    host: str
    listener: socket.socket
    token: str | None

    @property
    def port(self) -> int:
        """Port of the socket."""
        return int(self.listener.getsockname()[1])

    @property
    def address(self) -> str:
        """URL to open in a browser, with the machine's name if the host is a wildcard address."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"{self.token}/" if self.token else "")

    def path_within(self, path: str, host: str | None, origin: str | None) -> str | None:
        """Return the path of a request without the token, or None to refuse the request.

        Args:
            path: Path of the request, with the token.
            host, origin: Headers of the request. A page of another site can make a browser send
                requests here: with that site as origin, or by a host name that resolves to this
                machine (DNS rebinding).
        """
        try:
            hostname = urlsplit(f"//{host}").hostname if host else None
            if origin is not None and urlsplit(origin).netloc != host:
                return None
        except ValueError:  # not an address, such as "["
            return None
        if self.token is None:
            return path if hostname in LOOPBACK else None
        first, _, rest = path.removeprefix("/").partition("/")
        first = first.partition("?")[0]
        valid = secrets.compare_digest(first.encode(), self.token.encode())
        return f"/{rest}" if valid else None


def listen(host: str = LOOPBACK[0], port: int | None = None) -> Access:
    """Listen at ``host`` on ``port``; by default on :data:`PORT`, or a free port if it is in use.

    Raises:
        InputError: If the given port is in use or not permitted, or ``host`` is no address of this
            machine.
    """
    token = None if host in LOOPBACK else secrets.token_urlsafe(24)
    for candidate in (PORT, 0) if port is None else (port,):
        try:
            family, *_, address = socket.getaddrinfo(
                host, candidate, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            return Access(host, socket.create_server(address, family=family), token)
        except (OSError, UnicodeError) as error:
            problem = getattr(error, "strerror", None) or error
    raise InputError(
        f"--host {host} --port {port or PORT}: cannot listen there ({problem}); give an address of "
        "this machine and a free port, or leave both out"
    )


class Guard:
    """ASGI middleware that answers 403 to requests that :meth:`Access.path_within` refuses."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self.app, self.access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on to the application, with the token removed from its path."""
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
