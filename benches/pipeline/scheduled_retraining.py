"""A schedule that is shown running: a Prefect server, and retraining every few seconds.

The first time there are four made-up rooms, after it four more arrive, and a later time learns
those. Printed is what happened when, and which processes are left in the end. None of it needs
anything but this machine.

    python -m benches.pipeline.scheduled_retraining --work /tmp/schedule
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

EVERY = 20
CLI = ("-c", "from flows.cli.app import main; main()")
PATIENCE = 600.0
CONFIG = """\
chunks = "rooms/chunks"
out = "corpus"
models = "models"
store = "store"
size = "96x128"
replicas = 1
held_out = 0.4
steps = 40
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="an empty folder for all files")
    work = parser.parse_args().work.resolve()
    work.mkdir(parents=True)
    (work / "retrain.toml").write_text(CONFIG)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}/api"
    env = {
        **os.environ,
        "PREFECT_HOME": str(work / "prefect"),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
    }
    begin = time.perf_counter()

    def say(text: str) -> None:
        print(f"{time.perf_counter() - begin:6.1f} s  {text}", flush=True)

    add_rooms(work, env, "procedural:0-3")
    say("four rooms are there")
    server = ["-m", "prefect", "server", "start", "--host", "127.0.0.1", "--port", str(port)]
    serve = [*CLI, "retrain", str(work / "retrain.toml"), "--every", str(EVERY)]
    started = [start(server, env, work / "server.log")]
    try:
        wait(lambda: answers(url), started)
        say("the server answers")
        log = work / "retrain.log"
        started.append(start(serve, {**env, "PREFECT_API_URL": url}, log))
        first = wait(lambda: line_with(log, "version 1"), started)
        say(first)
        add_rooms(work, env, "procedural:4-7")
        say("four more rooms are there")
        said = wait(lambda: line_with(log, "version 2"), started)
        idle = log.read_text().count("nothing new")
        say(f"(in between, {idle} times: nothing new)" if idle else "(the next time)")
        say(said)
        say(f"processes: {len(processes(work))}")
    finally:
        for process in reversed(started):
            process.terminate()
        codes = [process.wait(60) for process in reversed(started)]
    say(f"stopped, exit status {codes[0]} and {codes[1]}")
    time.sleep(2)
    say(f"processes left: {len(processes(work))}")


def add_rooms(work: Path, env: dict[str, str], rooms: str) -> None:
    """Add chunks of made-up rooms to those there are."""
    arguments = ["ingest", rooms, "-o", str(work / "rooms"), "--store", str(work / "store")]
    arguments += ["--set", "views=6", "--set", "size=96x128"]
    with (work / "ingest.log").open("ab") as log:
        command = [sys.executable, *CLI, *arguments]
        subprocess.run(command, env=env, stdout=log, stderr=log, check=True)


def start(arguments: list[str], env: dict[str, str], log: Path) -> subprocess.Popen:
    with log.open("wb") as file:
        return subprocess.Popen([sys.executable, *arguments], env=env, stdout=file, stderr=file)


def wait(happened, started: list[subprocess.Popen]):
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = happened()
        if found:
            return found
        if any(process.poll() is not None for process in started):
            raise SystemExit("a process ended early; see the .log files in the folder")
        time.sleep(0.2)
    raise SystemExit(f"nothing happened in {PATIENCE:.0f} s; see the .log files in the folder")


def answers(url: str) -> bool:
    try:
        urllib.request.urlopen(f"{url}/health", timeout=5).close()
    except OSError:
        return False
    return True


def line_with(log: Path, text: str) -> str | None:
    lines = log.read_text(errors="replace").splitlines()
    return next((line for line in lines if line.startswith(text)), None)


def processes(work: Path) -> list[int]:
    """Those that have the folder in their environment, from the kernel."""
    wanted = f"PREFECT_HOME={work / 'prefect'}".encode()
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and wanted in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
        except OSError:
            continue
    return found


if __name__ == "__main__":
    main()
