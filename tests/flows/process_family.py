"""Processes as the kernel lists them: parents, liveness and listening sockets."""

import os
import re
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc")
LISTENING = "0A"
LOOPBACK = ("0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000")
"""127.0.0.1 as the kernel writes it, the same as IPv6 knows it, and ::1."""


def below(process: int) -> dict[int, str]:
    """Return the descendants of a process: start time by process id."""
    children = defaultdict(list)
    begun = {}
    for number in map(int, filter(str.isdigit, os.listdir(PROC))):
        if (fields := read_stat(number)) is not None:
            children[int(fields[1])].append(number)
            begun[number] = fields[19]
    result, waiting = {}, [process]
    while waiting:
        for child in children[waiting.pop()]:
            result[child] = begun[child]
            waiting.append(child)
    return result


def living(processes: dict[int, str]) -> list[str]:
    """Return the command lines of descendants that are still alive."""
    result = []
    for number, begun in processes.items():
        fields = read_stat(number)
        if fields is not None and fields[19] == begun and fields[0] not in "ZX":
            result.append((PROC / f"{number}/cmdline").read_bytes().replace(b"\0", b" ").decode())
    return result


def listening(process: int) -> list[tuple[str, str]]:
    """Return the protocol and address of every socket on which a process listens."""
    local = set()
    for entry in (PROC / f"{process}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            result = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(entry))
            local |= {result[1]} if result else set()
    places = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in (PROC / f"{process}/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[9] in local and (words[3] == LISTENING or table.startswith("udp")):
                places.append((table, words[1]))
    return places


def read_stat(process: int) -> list[str] | None:
    """Return the fields of ``stat`` after the name; None if the process does not exist."""
    try:
        return (PROC / f"{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
