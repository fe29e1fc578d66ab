"""Addresses that the viewer listens at, and requests that it refuses."""

import socket

import pytest

from slgaussian.errors import InputError
from slgaussian.viewer.auth import PORT, Access, listen

LOCAL = ("127.0.0.1:8080", "localhost:9000", "[::1]:8080", "localhost")


def access(token: str | None) -> Access:
    return Access("127.0.0.1" if token is None else "0.0.0.0", socket.socket(), token)


@pytest.mark.parametrize(
    ("host", "origin", "enters"),
    [
        *((host, None, True) for host in LOCAL),
        *((host, f"http://{host}", True) for host in LOCAL),
        ("127.0.0.1:8080", "http://evil.example", False),  # a page elsewhere that connects here
        ("127.0.0.1:8080", "http://127.0.0.1:9999", False),  # or at another port
        ("127.0.0.1:8080", "null", False),  # or of a file
        ("evil.example:8080", "http://evil.example:8080", False),  # a name that leads here
        ("127.0.0.1.evil.example", None, False),
        ("", None, False),
        (None, None, False),
        ("[", None, False),
    ],
)
def test_on_loopback_this_machine_comes_in_and_other_sites_do_not(host, origin, enters):
    assert access(None).path_within("/a?b", host, origin) == ("/a?b" if enters else None)


@pytest.mark.parametrize(
    ("path", "within"),
    [("/tok", "/"), ("/tok/", "/"), ("/tok/a/b?c", "/a/b?c"), ("/tok?x=1", "/")]
    + [(path, None) for path in ("/", "/to", "/token/", "//tok/", "/TOK/", "/?tok", "/\u00e9")]
    + [("/a/../tok/", None)],
)
def test_elsewhere_the_token_is_needed(path, within):
    guarded = access("tok")
    assert guarded.path_within(path, "10.0.0.3:8080", None) == within
    assert guarded.path_within("/tok/", "10.0.0.3:8080", "http://evil.example") is None
    assert guarded.path_within("/tok/", "10.0.0.3:8080", "http://10.0.0.3:8080") == "/"


def test_tokens_are_long_and_new_each_time_and_only_where_needed():
    opened = [listen("0.0.0.0") for _ in range(2)]
    tokens = [one.token for one in opened]
    assert len(set(tokens)) == 2 and all(len(token) >= 32 for token in tokens)
    for one in opened:
        assert one.token in one.address and f":{one.port}/" in one.address
        one.listener.close()
    local = listen()
    assert local.token is None and local.address == f"http://127.0.0.1:{local.port}/"
    assert local.listener.getsockname()[0] == "127.0.0.1"
    local.listener.close()


def test_a_port_in_use_and_a_host_elsewhere_are_named():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"--port {port}: .*in use"):
            listen(port=port)
    first, second = listen(), listen()
    assert first.port != second.port and second.port != PORT
    for one in (first, second):
        one.listener.close()
    for host in ("no.such.host.invalid", "203.0.113.7", "a" * 300, ""):
        with pytest.raises(InputError, match="--host"):
            listen(host)
