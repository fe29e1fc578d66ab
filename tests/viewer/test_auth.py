"""Addresses that the viewer listens at, and requests that it refuses."""

import socket

import pytest

from slgaussian.errors import InputError
from slgaussian.viewer.auth import PORT, Access, listen


def access(token: str | None) -> Access:
    return Access("127.0.0.1" if token is None else "0.0.0.0", socket.socket(), token)


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:9000", "[::1]:8080", "localhost"])
def test_on_loopback_this_machine_comes_in(host):
    assert access(None).path_within("/a?b", host, None) == "/a?b"
    assert access(None).path_within("/", host, f"http://{host}") == "/"


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:8080", "http://evil.example"),  # a page elsewhere that connects here
        ("127.0.0.1:8080", "http://127.0.0.1:9999"),  # or at another port
        ("127.0.0.1:8080", "null"),  # or of a file
        ("evil.example:8080", "http://evil.example:8080"),  # a name that leads here
        ("127.0.0.1.evil.example", None),
        ("", None),
        (None, None),
    ],
)
def test_on_loopback_other_sites_do_not(host, origin):
    assert access(None).path_within("/", host, origin) is None


@pytest.mark.parametrize(
    ("path", "within"),
    [
        ("/tok", "/"),
        ("/tok/", "/"),
        ("/tok/a/b?c", "/a/b?c"),
        ("/tok?x=1", "/"),
        ("/", None),
        ("/to", None),
        ("/token/", None),
        ("//tok/", None),
        ("/TOK/", None),
        ("/?tok", None),
        ("/a/../tok/", None),
        ("/\u00e9", None),
    ],
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


def test_a_port_in_use_is_named_and_another_taken_only_if_none_was_asked_for():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"--port {port}: .*in use"):
            listen(port=port)
    first, second = listen(), listen()
    assert first.port != second.port and second.port != PORT
    for one in (first, second):
        one.listener.close()


@pytest.mark.parametrize("host", ["no.such.host.invalid", "203.0.113.7", "a" * 300, ""])
def test_a_host_that_is_none_of_this_machine_is_refused(host):
    with pytest.raises(InputError, match="--host"):
        listen(host)
