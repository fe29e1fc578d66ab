"""The server that the tool starts by itself."""

import re

import pytest
from process_family import LOOPBACK, PROC, listening


@pytest.mark.skipif(not (PROC / "self/net/tcp").exists(), reason="asks the kernel in /proc")
def test_it_listens_on_loopback_only(server):
    """The process and its threads."""
    port = int(re.search(r":(\d+)/", server.url)[1])
    assert listening(server.process.pid) == [("tcp", f"{LOOPBACK[0]}:{port:04X}")]
