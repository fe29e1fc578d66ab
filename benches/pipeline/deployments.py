"""The deployments of `prefect.yaml`, shown running: a server, a pool, a worker, and a kill.

Each deployment is run once on a few small made-up rooms. Then a report by two processes is begun
and its worker killed with `kill -9`; printed is which processes are left. None of it needs anything
but this machine.

    python -m benches.pipeline.deployments --work /tmp/deployments
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import tomllib
import urllib.request
from pathlib import Path
from typing import Any

from benches.pipeline.scheduled_retraining import CONFIG, add_rooms, answers, processes, start, wait

PREFECT = ("-m", "prefect", "--no-prompt")
REPORT = {"out": "scores", "store": "store", "size": "64x96", "rooms": "0-0"}
RETRAIN = tomllib.loads(CONFIG)
LESSONS = {name: RETRAIN[name] for name in ("chunks", "out", "store", "size", "replicas")}
RUNS = {
    "slgaussian/report": REPORT,
    "slgaussian-supervise/lessons": LESSONS,
    "slgaussian-retrain/retrain": RETRAIN,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="an empty folder for all files")
    work = parser.parse_args().work.resolve()
    work.mkdir(parents=True)
    shutil.copy(Path(__file__).parents[2] / "prefect.yaml", work)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}/api"
    env = {
        **os.environ,
        "PREFECT_HOME": str(work / "prefect"),
        "PREFECT_API_URL": url,
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
    }
    begin = time.perf_counter()

    def say(text: str) -> None:
        print(f"{time.perf_counter() - begin:6.1f} s  {text}", flush=True)

    def prefect(*words: str) -> str:
        command = [sys.executable, *PREFECT, *words]
        done = subprocess.run(command, cwd=work, env=env, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"prefect {' '.join(words)}: {done.stdout}{done.stderr}")
        return done.stdout

    add_rooms(work, env, "procedural:0-3")
    server = ["-m", "prefect", "server", "start", "--host", "127.0.0.1", "--port", str(port)]
    started = [start(server, env, work / "server.log")]
    try:
        wait(lambda: answers(url), started)
        say("the server answers")
        prefect("work-pool", "create", "slgaussian", "--type", "process")
        told = prefect("deploy", "--all")
        say(f"a pool, and {told.count('successfully created')} deployments")
        worker = start([*PREFECT, "worker", "start", "--pool", "slgaussian"], env, work / "w.log")
        started.append(worker)
        for name, config in RUNS.items():
            told = prefect(*run(name, config), "--watch").strip().splitlines()[-1]
            say(f"{name}: {told}")
        say(f"{logged(url)} lines of our logs are in Prefect")
        more = {"out": "more", "rooms": "1-20", "runner": "processes"}
        prefect(*run("slgaussian/report", REPORT | more))
        log = work / "more" / "log.jsonl"
        wait(lambda: log.exists() and '"done"' in log.read_text(), started)
        say(f"a report is on, by two processes; processes: {len(processes(work))}")
        worker.send_signal(signal.SIGKILL)
        wait(lambda: len(processes(work)) == 1, started[:1])
        say("the worker is killed; processes left: 1, the server")
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(60)
    time.sleep(2)
    say(f"stopped; processes left: {len(processes(work))}")


def run(name: str, config: dict[str, Any]) -> tuple[str, ...]:
    """Return the words of Prefect's command that run a deployment with this configuration."""
    return "deployment", "run", name, "--param", f"config={json.dumps(config)}"


def logged(url: str) -> int:
    """How many of the newest 200 log lines that Prefect has are ours."""
    asked = json.dumps({"limit": 200, "sort": "TIMESTAMP_DESC"}).encode()
    request = urllib.request.Request(
        f"{url}/logs/filter", asked, {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=30) as answer:
        lines = json.load(answer)
    return sum(line["name"].startswith("slgaussian") for line in lines)


if __name__ == "__main__":
    main()
