"""Who is told of a night: a command or an address; one that fails is a sentence and no more."""

import json
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from flows import hooks

FACTS = {"event": "refused", "said": "no gain", "night": 3}


@pytest.fixture
def heard():
    """A server, and what was posted to it; it refuses what comes to /no."""
    bodies = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            bodies.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(500 if self.path == "/no" else 204)
            self.end_headers()

        def log_message(self, *args):
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", bodies
    server.shutdown()
    server.server_close()


def test_an_address_is_posted_to(heard, tmp_path):
    url, bodies = heard
    assert hooks.tell(f"{url}/secret", FACTS, tmp_path) == ""
    assert bodies == [FACTS]
    said = hooks.tell(f"{url}/no", FACTS, tmp_path)
    assert said.startswith("hook 127.0.0.1: HTTP Error 500")
    said = hooks.tell("http://127.0.0.1:9/secret", FACTS, tmp_path)
    assert said.startswith("hook 127.0.0.1: ") and "secret" not in said


def test_a_command_gets_it_on_its_standard_input(tmp_path):
    file = tmp_path / "told.sh"
    file.write_text('#!/bin/sh\necho "$1 $SLGAUSSIAN_EVENT $SLGAUSSIAN_SAID" > told; cat >> told\n')
    file.chmod(0o755)
    assert hooks.tell(f"{file} 'to ada'", FACTS, tmp_path) == ""
    first, second = (tmp_path / "told").read_text().split("\n", 1)
    assert first == "to ada refused no gain" and json.loads(second) == FACTS


@pytest.mark.parametrize(
    ("hook", "said"),
    [
        ("sh -c 'echo nobody there >&2; exit 3'", "hook sh: ended with status 3 (nobody there)"),
        ("/nowhere/told", "hook /nowhere/told: cannot be run (No such file or directory)"),
        ("'", 'hook "\'": is no command (No closing quotation)'),
        ("", "hook '': is no command (list index out of range)"),
    ],
)
def test_a_hook_that_fails_is_a_sentence(hook, said, tmp_path):
    assert hooks.tell(hook, FACTS, tmp_path) == said


def test_a_hook_is_not_waited_for_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(hooks, "PATIENCE", 0.2)
    # What it leaves running holds its output open.
    said = hooks.tell("sh -c 'sleep 5 & sleep 5'", FACTS, tmp_path)
    assert said == "hook sh: not done within 0 s"
