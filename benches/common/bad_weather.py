"""A faulty HTTP server: a proxy that fails some of the requests.

A random generator with a seed draws the fault of each request in order of arrival.
"""

from __future__ import annotations

import http.client
import random
import socket
import struct
import threading
import time
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

FAULTS = (
    "500",
    "500 when done",
    "503 slow down",
    "time-out",
    "reset",
    "cut short",
    "less than said",
)
"""Outcomes of a request.

With ``500 when done`` and the last three, the server executes the request. ``cut short`` closes the
connection in the middle of the answer's body; ``less than said`` sends half of the body, with the
length of that half.
"""

_XML = "<?xml version='1.0' encoding='UTF-8'?><Error><Code>{}</Code><Message>{}</Message></Error>"
_DROPPED = {"connection", "transfer-encoding", "keep-alive", "content-length"}


class BadWeather:
    """A proxy on loopback in front of ``server``; ``url`` is its address.

    Args:
        server: URL of the server.
        share: Fraction of the requests that fail.
        hang: Seconds until the connection of a request that times out is closed.
        faults: tuple of str. Some of :data:`FAULTS`.

    Attributes:
        met: Counter. Number of requests by fault; ``""``: no fault.
        full: bool. Whether to refuse all writes, as a server with a full disk does.
    """

    def __init__(
        self,
        server: str,
        share: float,
        seed: int = 0,
        hang: float = 5.0,
        faults: tuple[str, ...] = FAULTS,
    ) -> None:
        place = urlsplit(server)
        self.target = (place.hostname, place.port)
        self.share, self.hang, self.faults = share, hang, faults
        self.met: Counter[str] = Counter()
        self.full = False
        self.dice, self.lock = random.Random(seed), threading.Lock()
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """Stop listening."""
        self.server.shutdown()
        self.server.server_close()

    def fault(self) -> str:
        """Draw the outcome of the next request."""
        with self.lock:
            outcome = self.dice.choice(self.faults) if self.dice.random() < self.share else ""
            self.met[outcome] += 1
        return outcome


def _handler(weather: BadWeather) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle_one_request(self) -> None:
            try:
                super().handle_one_request()
            except OSError:  # whoever asked is gone
                self.close_connection = True

        def do_GET(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            if weather.full and self.command in ("PUT", "POST"):
                self.answer(507, [], _error("XMinioStorageFull", "no room"))
                return
            fault = weather.fault()
            if fault == "500":
                self.answer(500, [], _error("InternalError", "try again"))
            elif fault == "503 slow down":
                self.answer(503, [], _error("SlowDown", "please reduce your request rate"))
            elif fault == "time-out":
                time.sleep(weather.hang)
                self.close_connection = True
            else:
                status, headers, data = self.passed_on(body)
                if fault == "500 when done":
                    self.answer(500, [], _error("InternalError", "try again"))
                elif fault == "reset":
                    self.reset()
                elif fault in ("cut short", "less than said") and len(data) < 2:
                    self.reset()  # nothing to cut
                elif fault == "cut short":
                    self.answer(status, headers, data, len(data) // 2)
                elif fault == "less than said":
                    self.answer(status, headers, data[: len(data) // 2])
                else:
                    self.answer(status, headers, data)

        do_PUT = do_POST = do_HEAD = do_DELETE = do_GET

        def passed_on(self, body: bytes) -> tuple[int, list[tuple[str, str]], bytes]:
            server = http.client.HTTPConnection(*weather.target, timeout=60)
            try:
                server.request(self.command, self.path, body, dict(self.headers.items()))
                answer = server.getresponse()
                headers = [(k, v) for k, v in answer.getheaders() if k.lower() not in _DROPPED]
                if self.command == "HEAD" and answer.getheader("Content-Length"):
                    headers.append(("Content-Length", answer.getheader("Content-Length", "")))
                return answer.status, headers, answer.read()
            finally:
                server.close()

        def answer(
            self, status: int, headers: list[tuple[str, str]], data: bytes, sent: int | None = None
        ) -> None:
            self.send_response_only(status)
            for name, value in headers:
                self.send_header(name, value)
            if "content-length" not in {name.lower() for name, _ in headers}:
                self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(data[:sent])
            self.close_connection |= sent is not None

        def reset(self) -> None:
            # This makes the kernel send a reset instead of a regular end.
            now = struct.pack("ii", 1, 0)
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, now)
            self.close_connection = True

        def log_message(self, *args: object) -> None:
            pass

    return Handler


def _error(code: str, message: str) -> bytes:
    return _XML.format(code, message).encode()
