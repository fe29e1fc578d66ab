"""A Prefect server as users start it, requests to one, and a webhook."""

import http.server
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
from tiny_clusters import LOOPBACK, free_port, wait_for_port

from flows.runners.server import import_path

PREFECT = [sys.executable, "-m", "prefect", "--no-prompt"]


def post(url: str, content: dict) -> httpx.Response:
    """Post to a server; it answers 503 while its database is locked."""
    for _ in range(20):
        answer = httpx.post(url, json=content, timeout=60)
        if answer.status_code != 503:
            break
        time.sleep(0.5)
    return answer


@contextmanager
def serve_prefect(home: Path, **variables: str) -> Iterator[dict[str, str]]:
    """Start ``prefect server start`` with all its services; yield the environment of its users."""
    port = free_port()
    # Without what other tests set.
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "SLGAUSSIAN_"))}
    env |= {"PREFECT_HOME": str(home), "PREFECT_API_URL": f"http://{LOOPBACK}:{port}/api"}
    env |= {"PREFECT_SERVER_ANALYTICS_ENABLED": "false", "DO_NOT_TRACK": "1"}
    env |= {"PYTHONPATH": import_path(), "PYTHONSAFEPATH": "1", **variables}
    with start_prefect(home, env, "server", "start", "--port", port):
        wait_for_port(port)
        yield env


@contextmanager
def start_prefect(folder: Path, env: dict[str, str], *words: str) -> Iterator[Path]:
    """Run ``prefect WORDS`` in a folder within the block; yield the file of its output."""
    log = folder / f"{words[0]}.log"
    with log.open("wb") as file:
        options = {"cwd": folder, "env": env, "stdout": file, "stderr": file}
        process = subprocess.Popen([*PREFECT, *words], **options, start_new_session=True)
    try:
        yield log
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(60)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def call_prefect(folder: Path, env: dict[str, str], *words: str) -> None:
    """Run ``prefect WORDS`` in a folder."""
    subprocess.run([*PREFECT, *words], cwd=folder, env=env, check=True, timeout=120)


@contextmanager
def receive_json() -> Iterator[tuple[str, queue.Queue]]:
    """Serve a webhook; yield its URL, and a queue of the documents that it received."""
    received: queue.Queue = queue.Queue()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            received.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(201)
            self.end_headers()

        def log_message(self, *words: object) -> None:
            pass

    with http.server.HTTPServer((LOOPBACK, 0), Handler) as hook:
        threading.Thread(target=hook.serve_forever, daemon=True).start()
        yield f"http://{LOOPBACK}:{hook.server_port}", received
        hook.shutdown()
