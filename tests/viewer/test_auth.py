"""Addresses of the viewer, and its access control."""

import socket

import pytest

from slgaussian.errors import InputError
from slgaussian.viewer.auth import PORT, Access, listen

LOCAL = ("127.0.0.1:8080", "localhost:9000", "[::1]:8080", "localhost")


def access(token: str | None) -> Access:
    return Access("127.0.0.1" if token is None else "0.0.0.0", socket.socket(), token)


@pytest.mark.parametrize(
    ("host", "origin", "admitted"),
    [
        *((host, None, True) for host in LOCAL),
        *((host, f"http://{host}", True) for host in LOCAL),
        ("127.0.0.1:8080", "http://evil.example", False),  # a page of another site
        ("127.0.0.1:8080", "http://127.0.0.1:9999", False),  # another port
        ("127.0.0.1:8080", "null", False),  # a local file
        ("evil.example:8080", "http://evil.example:8080", False),  # DNS rebinding
        ("127.0.0.1.evil.example", None, False),
        ("", None, False),
        (None, None, False),
        ("[", None, False),
    ],
)
def test_loopback_admits_only_local_origins(host, origin, admitted):
    assert access(None).path_within("/a?b", host, origin) == ("/a?b" if admitted else None)


@pytest.mark.parametrize(
    ("path", "within"),
    [("/tok", "/"), ("/tok/", "/"), ("/tok/a/b?c", "/a/b?c"), ("/tok?x=1", "/")]
    + [(path, None) for path in ("/", "/to", "/token/", "//tok/", "/TOK/", "/?tok", "/\u00e9")]
    + [("/a/../tok/", None)],
)
def test_other_hosts_need_the_token(path, within):
    guarded = access("tok")
    assert guarded.path_within(path, "10.0.0.3:8080", None) == within
    assert guarded.path_within("/tok/", "10.0.0.3:8080", "http://evil.example") is None
    assert guarded.path_within("/tok/", "10.0.0.3:8080", "http://10.0.0.3:8080") == "/"


def test_tokens_are_long_and_random_and_absent_on_loopback():
    remote, local = [listen("0.0.0.0") for _ in range(2)], listen()
    tokens = [server.token for server in remote]
    assert len(set(tokens)) == 2 and all(len(token) >= 32 for token in tokens)
    for server in remote:
        assert server.token in server.address and f":{server.port}/" in server.address
    assert local.token is None and local.address == f"http://127.0.0.1:{local.port}/"
    assert local.listener.getsockname()[0] == "127.0.0.1"
    for server in (*remote, local):
        server.listener.close()


def test_listen_raises_input_error_for_occupied_ports_and_foreign_hosts():
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        port = occupied.getsockname()[1]
        with pytest.raises(InputError, match=f"--port {port}: .*in use"):
            listen(port=port)
    first, second = listen(), listen()
    assert first.port != second.port and second.port != PORT
    for server in (first, second):
        server.listener.close()
    for host in ("no.such.host.invalid", "203.0.113.7", "a" * 300, ""):
        with pytest.raises(InputError, match="--host"):
            listen(host)
