"""A wire to a server that goes dead after so many bytes, as when a cable is pulled."""

import contextlib
import socket
import threading
from urllib.parse import urlsplit


class Forwarder:
    """Passes connections on to a server, until ``limit`` bytes in all went to it.

    From then on, what comes is taken and kept back; :attr:`reached` tells.
    """

    def __init__(self, server: str, limit: int) -> None:
        target = urlsplit(server)
        self.target = (target.hostname, target.port)
        self.left = limit
        self.lock = threading.Lock()
        self.reached = threading.Event()
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.socket.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self.socket.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self.socket.accept()
                server = socket.create_connection(self.target)
                for source, sink, counted in ((client, server, True), (server, client, False)):
                    args = (source, sink, counted)
                    threading.Thread(target=self._pass, args=args, daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket, counted: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if counted:
                    with self.lock:
                        data = data[: self.left]
                        self.left -= len(data)
                        if not self.left:
                            self.reached.set()
                sink.sendall(data)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_RDWR)
