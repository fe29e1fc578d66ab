"""The server that the tool starts by itself."""

import os
import re
from pathlib import Path

import pytest

LISTENING = "0A"
LOOPBACK = "0100007F"  # 127.0.0.1, as the kernel writes it


@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="asks the kernel in /proc")
def test_it_listens_on_loopback_only(server):
    """All that the process and its threads listen on, and not only what was meant."""
    process = Path(f"/proc/{server.process.pid}")
    own = set()
    for entry in (process / "fd").iterdir():
        found = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(entry))
        own |= {found[1]} if found else set()
    places = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in (process / "net" / table).read_text().splitlines()[1:]:
            words = line.split()
            if words[9] in own and (words[3] == LISTENING or table.startswith("udp")):
                places.append((table, words[1]))
    port = int(re.search(r":(\d+)/", server.url)[1])
    assert places == [("tcp", f"{LOOPBACK}:{port:04X}")]
