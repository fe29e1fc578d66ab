"""The viewer's server: refusals, answers, changes of the field, and its page in a browser."""

import base64
import json
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from contextlib import contextmanager

import numpy as np
import pytest
import uvicorn
from starlette.testclient import TestClient

from slgaussian.field import SemanticField
from slgaussian.language.rules import Rules
from slgaussian.viewer.auth import Access, listen
from slgaussian.viewer.page.packed import morton_order
from slgaussian.viewer.page.scene_page import scene_page
from slgaussian.viewer.server import MAX_BODY_BYTES, LiveField, app
from tests.flows.command import read_error as command_output
from tests.flows.command import run
from tests.square import BLUE, GREEN, RED, YELLOW, square_field
from tests.viewer.test_page import enter, window_point

IDS = [RED, GREEN, BLUE, YELLOW]


@pytest.fixture(scope="module")
def field() -> SemanticField:
    return square_field("separated")


@pytest.fixture
def folder(field, tmp_path):
    field.save(tmp_path / "wall")
    return tmp_path / "wall"


@pytest.fixture
def client(folder):
    return make_client(folder, None)


def make_client(folder, token: str | None, url: str = "http://127.0.0.1:8080") -> TestClient:
    live_field = LiveField(SemanticField.load(folder), folder)
    return TestClient(app("<p>page", Access(url, socket.socket(), token), live_field), url)


def post(client: TestClient, name: str, **body) -> dict:
    response = client.post(f"/api/{name}", json=body)
    assert response.status_code == 200, response.text
    return response.json()


def test_requests_of_foreign_sites_get_403(client, folder):
    """See test_auth.py; here, that each request is checked, and has one origin."""
    evil = {"Origin": "http://evil.example"}
    twice = [("Origin", "http://127.0.0.1:8080"), ("Origin", "http://evil.example")]
    assert client.get("/").text == "<p>page"
    for headers in (evil, twice):
        removal = client.post("/api/remove", json={"object": RED}, headers=headers)
        for response in (client.get("/", headers=headers), removal):
            assert response.status_code == 403 and "only at the address" in response.text
    assert post(client, "state")["removed"] == []
    remote = make_client(folder, "tok", "http://10.0.0.3:8080")
    assert remote.get("/tok/").text == remote.get("/tok").text == "<p>page"
    assert remote.post("/tok/api/state", json={}).status_code == 200
    for path in ("/", "/api/state", "/tok/field.json", "/tok//etc/passwd", "/tok/api/save"):
        assert remote.get(path).status_code in (403, 404, 405)


@pytest.mark.parametrize(
    ("name", "body", "error"),
    [
        ("remove", {"object": 99}, "object 99: is not in the field"),
        ("remove", {"object": "4"}, "object: found '4'"),
        ("remove", {"object": True}, "object: found True"),
        ("remove", [], "expected one"),
        ("teach", {"word": " ", "object": RED}, "word"),
        ("teach", {"object": RED}, "word"),
        ("query", {"texts": "red"}, "texts: found 'red'"),
        ("query", {"texts": [1]}, "texts.0: found"),
    ],
)
def test_invalid_requests_get_400_and_change_nothing(client, name, body, error):
    response = client.post(f"/api/{name}", json=body)
    assert response.status_code == 400 and error in response.json()["error"]
    state = post(client, "state")
    assert not state["undo"] and not state["unsaved"]


def test_oversized_and_malformed_requests_get_an_error(client):
    assert client.post("/api/query", content=b" " * (MAX_BODY_BYTES + 1)).status_code == 413
    assert client.post("/api/query", content=b"{").status_code == 400


def test_answers_equal_those_of_the_field(client, field):
    texts = ["red", "yellow square", "red xyzzy", "xyzzy", "not red"]
    *answers, refused = post(client, "query", texts=texts)["answers"]
    ids = sorted(IDS)
    for text, answer in zip(texts, answers, strict=False):
        relevancies = field.reader.relevancies([text], Rules())[0]
        expected = relevancies[np.searchsorted(field.bank.ids, ids)]
        np.testing.assert_allclose(answer["scores"], expected, atol=1e-6)
        assert [ids[k] for k in answer["taken"]] == [id_ for id_, _ in field.find(text)]
        assert answer["kind"] == field.reader.understood(text).kind
    for text, answer in zip(texts[2:4], answers[2:], strict=True):
        assert answer["unknown"] == ["xyzzy"] and not answer["shown"]
        assert answer["summary"] == f"cannot tell: {field.reader.understood(text).untold}"
    assert "'not'" in refused["refused"] and "scores" not in refused


def test_changes_are_undone_and_saved_as_by_the_commands(
    client, field, folder, tmp_path, monkeypatch
):
    post(client, "teach", word="zorp", object=GREEN)
    post(client, "name", word="the zerp", object=GREEN)
    state = post(client, "remove", object=YELLOW)
    ids = sorted(IDS)
    assert state["names"] == ["the zerp" if id_ == GREEN else "" for id_ in ids]
    assert state["words"][ids.index(GREEN)][0][0] == "zorp" and state["taught"] == ["zorp"]
    assert state["removed"] == [YELLOW] and state["unsaved"] and state["undo"]
    bits = np.frombuffer(base64.b64decode(state["gone"]), np.uint8)
    removed = np.unpackbits(bits, bitorder="little")[: len(field.gaussians)].astype(bool)
    order = morton_order(field.gaussians.means.numpy())
    np.testing.assert_array_equal(removed, field.without([YELLOW]).hidden[order])
    for text, id_ in (("zorp", GREEN), ("The Zerp", GREEN)):
        (answer,) = post(client, "query", texts=[text])["answers"]
        assert answer["kind"] == ("taught" if text == "zorp" else "named")
        assert answer["scores"][ids.index(YELLOW)] == 0
        assert np.argmax(answer["scores"]) == ids.index(id_)

    assert not post(client, "save")["unsaved"]
    by_commands = tmp_path / "by_commands"
    field.save(by_commands)
    x, y = field.render(field.cameras["a"]).query("green").point
    assert run(monkeypatch, "objects", "teach", by_commands, "zorp", "--at", x, y) == 0
    taught = SemanticField.load(by_commands)
    taught.rename(GREEN, "the zerp").without([YELLOW]).save_edits(by_commands)
    for name in ("words.npz", "edits.npz"):
        assert (folder / name).read_bytes() == (by_commands / name).read_bytes()

    state = post(client, "undo")
    assert state["removed"] == [] and state["gone"] == "" and state["unsaved"]
    assert post(client, "remove", object=YELLOW)["removed"] == [YELLOW]
    assert post(client, "restore", object=YELLOW)["removed"] == []
    for _ in range(5):
        state = post(client, "undo")
    assert state["taught"] == [] and not any(state["names"]) and not state["undo"]
    post(client, "save")
    assert not (folder / "words.npz").exists() and not (folder / "edits.npz").exists()


def test_failed_saves_and_views_name_the_cause(client, folder, tmp_path, monkeypatch, capsys):
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        port = occupied.getsockname()[1]
        assert run(monkeypatch, "view", folder, "--port", port) == 2
        assert f"--port {port}: cannot listen" in command_output(capsys)
    assert run(monkeypatch, "view", tmp_path) == 2
    assert "field.json" in command_output(capsys)
    post(client, "remove", object=RED)
    (folder / "field.json").unlink()
    response = client.post("/api/save", json={})
    assert response.status_code == 400 and "field.json" in response.json()["error"]
    assert post(client, "state")["unsaved"]


@contextmanager
def command(source):
    """Run ``view`` in a process; yields the process and the address that it printed."""
    child = subprocess.Popen(
        [sys.executable, "-c", "from flows.cli.app import main; main()", "view", str(source)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield child, child.stdout.readline().strip()
    finally:
        child.kill()
        child.communicate()


@pytest.mark.whole
@pytest.mark.parametrize(("signum", "changed"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_signals_stop_the_command(folder, signum, changed):
    with command(folder) as (child, address):
        assert address.startswith("http://127.0.0.1:")
        assert "data-live" in urllib.request.urlopen(address, timeout=30).read(200).decode()
        if changed:
            body = json.dumps({"object": RED}).encode()
            urllib.request.urlopen(f"{address}api/remove", body, timeout=30)
        child.send_signal(signum)
        stdout, stderr = child.communicate(timeout=30)
        assert (child.returncode, stdout) == (0, "")
        last = "stopped; changes were not saved" if changed else "stopped"
        # Messages of compilation may come first.
        assert stderr.splitlines()[-3:] == ["Ctrl-C stops it", "", last]


@contextmanager
def serve_page(folder):
    """Serve the page of a folder from this process; yields its live field and address."""
    live_field, access = LiveField(SemanticField.load(folder), folder), listen()
    config = uvicorn.Config(
        app(scene_page(live_field.field, live=True), access, live_field),
        log_config=None,
        lifespan="off",
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [access.listener]})
    thread.start()
    try:
        yield live_field, access.address
    finally:
        server.should_exit = True
        thread.join()


def test_page_asks_and_changes_the_field(browser, folder):
    answer = "document.getElementById('answer').textContent"
    status = "document.getElementById('status').textContent"
    with serve_page(folder) as (live_field, address), browser.open(address, 900, 600) as tab:
        tab.wait("globalThis.slgaussian !== undefined", 120)

        enter(tab, "xyzzy")
        assert "xyzzy" in tab.wait(answer)
        tab.evaluate("document.getElementById('words').select()")
        tab.type("red")
        tab.press("Enter")
        assert "xyzzy" not in tab.wait(f"{answer}.includes('score') && {answer}")
        tab.wait("!slgaussian.busy")
        assert tab.evaluate("slgaussian.mode") == 3
        camera = next(iter(live_field.field.cameras.values()))
        view = live_field.field.render(camera)
        assert view.query("red").summary in tab.evaluate(answer)
        assert tab.evaluate("slgaussian.asked[0].taken") == [live_field.ids.index(RED)]
        # Without Enter, one request follows a pause, not one for each letter.
        requests = len(tab.requests)
        tab.evaluate("document.getElementById('words').select()")
        for letter in "blue":
            tab.press(letter)
        tab.wait(f"{answer}.includes('“blue”')")
        assert tab.requests[requests:] == [f"{address}api/query"]
        tab.press("Escape")
        tab.wait(f"{answer} === '' && !slgaussian.busy && slgaussian.mode === 0")

        middle = window_point(tab, camera, *view.query("yellow").point)
        tab.click(*middle)
        card = tab.wait("document.getElementById('card').textContent")
        assert f"Object {YELLOW}" in card and "yellow" in card and "Size 0.49" in card
        tab.wait("!slgaussian.busy")
        x, y = round(middle[0]), round(middle[1])
        before = tab.settle()[y, x].astype(int)

        tab.click_on("#word")
        tab.type("Anna's")
        tab.press("Enter")
        tab.wait("document.querySelector('#card h3').textContent.includes(\"Anna's\")")
        assert live_field.field.edits.names == {YELLOW: "Anna's"}
        tab.click_on("#word")
        tab.type("zorp")
        tab.click_on("#teach")
        tab.wait("document.getElementById('card').textContent.includes('zorp')")
        assert list(live_field.field.edits.taught) == ["zorp"]
        tab.click_on("#teach")  # without a word
        tab.wait(f"{status}.includes('word')")

        tab.click_on("#remove")
        tab.wait("document.getElementById('remove').textContent === 'Bring back'")
        tab.wait("!slgaussian.busy")
        assert np.abs(tab.settle()[y, x].astype(int) - before).sum() > 100
        enter(tab, "zorp")
        tab.wait(f"{answer}.includes('zorp')")
        selected = f"slgaussian.asked[0].taken.includes({live_field.ids.index(YELLOW)})"
        assert not tab.evaluate(selected)
        tab.click_on("#undo")
        # The page asks again, and the word's example is back.
        tab.wait(selected)
        tab.click_on("#clear")
        tab.wait("!slgaussian.busy")
        assert np.abs(tab.settle()[y, x].astype(int) - before).sum() < 20

        assert tab.evaluate(status) == "Changes are not saved."
        tab.click_on("#keep")
        tab.wait(f"{status}.startsWith('Saved')")
        assert tab.evaluate("document.getElementById('keep').disabled")
        saved = SemanticField.load(folder)
        assert saved.edits.names == {YELLOW: "Anna's"} and "zorp" in saved.edits.taught
        assert not live_field.unsaved
        assert all(url.startswith((address, "data:image/jpeg")) for url in tab.requests)
        policy = tab.evaluate("document.querySelector('meta[http-equiv]').content")
        assert "connect-src 'self'" in policy and "unsafe" not in policy
        (refusal,) = [entry for entry in tab.complaints if "favicon" not in entry]
        assert refusal.endswith(f"(Bad Request) {address}api/teach")
