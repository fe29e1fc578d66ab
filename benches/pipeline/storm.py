"""Stress test: killed processes, damaged inputs, a full disk, and a faulty S3 server.

    python -m benches.pipeline.storm WORK [-o docs/measured] [--scenes 300] [--kills 50]

Two worker processes run scenes of two stages of some milliseconds (`storm_stages`); one scene in
twenty is damaged. Their store is first a folder on a separate disk (tmpfs), then a bucket of moto's
server behind a proxy (`benches.common.bad_weather`) that fails 5 % of the requests: 500, 503,
time-outs, resets, truncated bodies. Processes are killed (SIGKILL) at random, at every tenth kill
the whole run, and for a while the disk, or that of the server, is full. The run is restarted until
only damaged scenes are left out. The store must then equal, byte for byte, that of an undisturbed
run of the undamaged scenes.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

import numpy as np
import s3fs

from benches.common.bad_weather import BadWeather
from benches.common.harness import parser, publish, table
from benches.common.process_cost import family
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore

SHARE = 20
"""Number of scenes per damaged scene."""

BETWEEN = (0.5, 2.0)
"""Range of the random interval between two kills, seconds."""

KILLS_PER_RUN_KILL = 10
"""Number of kills per kill of the whole run."""

FAILING = 0.05
"""Share of the requests that fail."""

FULL = 15.0
"""Duration of the full disk, after half of the kills, seconds."""

DISK = "600m"

PATIENCE = 1800.0
"""Seconds after which the bench gives up."""

DAMAGES: dict[str, Callable[[Path], object]] = {
    "cut short": lambda file: file.write_bytes(file.read_bytes()[:200]),
    "empty": lambda file: file.write_bytes(b""),
    "text": lambda file: file.write_text("no labels"),
    "of another shape": lambda file: np.save(file, np.zeros((3, 3))),
    "not finite": lambda file: np.save(file, np.full_like(np.load(file), np.nan, float)),
    "gone": lambda file: file.unlink(),
}


@dataclass
class Storm:
    """Result: seconds, kills by target, runs, and errors in the final state."""

    seconds: float = 0.0
    kills: Counter[str] = field(default_factory=Counter)
    runs: int = 0
    retried: int = 0
    wrong: list[str] = field(default_factory=list)


def write_scenes(work: Path, count: int) -> tuple[list[Path], dict[str, str]]:
    """Write the files of all scenes; return them, and the damage of some by scene."""
    from benches.pipeline.storm_stages import SHAPE

    folder = work / "scenes"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    files, damaged, kinds = [], {}, cycle(DAMAGES.items())
    for number in range(count):
        file = folder / f"scene_{number:05d}.npy"
        np.save(file, np.random.default_rng(number).integers(0, 9, SHAPE))
        files.append(file)
        if number % SHARE == SHARE // 2:
            damaged[file.stem], damage = next(kinds)
            damage(file)
    return files, damaged


def run(root: str, listed: Path, out: Path, workers: int) -> None:
    """Run the disturbed program: process the scenes of a list."""
    from flows.runners.environment import interruptible, orchestration

    with interruptible(), orchestration(ArtifactStore(root)) as ready:
        from benches.pipeline.storm_stages import storm

        ready()
        failures = storm(root, json.loads(listed.read_text()), workers)
    out.write_text(json.dumps(failures))
    raise SystemExit(bool(failures))


def find_workers(pid: int) -> list[int]:
    """Return the worker processes of a run."""
    workers = []
    for child in family(pid)[1:]:
        with suppress(OSError):
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                workers.append(child)
    return workers


def run_in_storm(
    work: Path,
    store: str,
    listed: Path,
    damaged: Mapping[str, str],
    kills: int,
    env: Mapping[str, str],
    full: Callable[[bool], None],
    seed: int,
) -> Storm:
    """Run until only damaged scenes are left out, with ``kills`` kills and a full disk."""
    storm, dice = Storm(), random.Random(seed)
    out, log = work / "failures.json", work / "storm.log"
    command = [sys.executable, "-m", "benches.pipeline.storm", "--run", store, listed, out]
    start = time.perf_counter()
    filled = kills == 0
    while True:
        if time.perf_counter() - start > PATIENCE:
            raise SystemExit(f"not done within {PATIENCE:.0f} s; see {log}")
        out.unlink(missing_ok=True)
        with log.open("ab") as log_file:
            process = subprocess.Popen(
                list(map(str, command)), stdout=log_file, stderr=log_file, env={**os.environ, **env}
            )
        storm.runs += 1
        while process.poll() is None:
            due = time.perf_counter() + dice.uniform(*BETWEEN)
            while process.poll() is None and time.perf_counter() < due:
                time.sleep(0.05)
            at_work = find_workers(process.pid)
            done = storm.kills.total()
            if not filled and done >= kills // 2:
                filled = True
                full(True)
                threading.Timer(FULL, full, (False,)).start()
            if done >= kills or not at_work or process.poll() is not None:
                continue
            kill_run = done % KILLS_PER_RUN_KILL == KILLS_PER_RUN_KILL - 1
            with suppress(ProcessLookupError):
                os.kill(process.pid if kill_run else dice.choice(at_work), signal.SIGKILL)
                storm.kills["runs" if kill_run else "workers"] += 1
        left_out = json.loads(out.read_text()) if out.exists() else None
        if left_out is None or left_out.keys() - damaged.keys():
            storm.retried += len((left_out or {}).keys() - damaged.keys())
            continue  # killed, or an undamaged scene was left out
        if storm.kills.total() >= kills:
            break
        # If the run ends before all kills are done, repeat it from a store that lost a part.
        lose(ArtifactStore(store), dice)
    storm.seconds = time.perf_counter() - start
    if left_out.keys() != damaged.keys():
        storm.wrong.append(f"left out {sorted(left_out)}, damaged {sorted(damaged)}")
    return storm


def lose(store: ArtifactStore, dice: random.Random) -> None:
    """Remove a third of the artifacts, as a careless user would."""
    names = [file.uri for files in store.walk(["labels"]) for file in files]
    store.remove(dice.sample(names, len(names) // 3))


def content(store: ArtifactStore) -> dict[str, bytes]:
    """Return the content of a store: artifacts by path, and the references of records."""
    content_of = {}
    for records in Records(store).all():
        for record in records:
            ref = record.ref
            content_of[record.file.uri] = repr(ref and (ref.spec, ref.uri, ref.digest)).encode()
    for files in store.walk(["labels"]):
        uris = [file.uri for file in files]
        content_of |= zip(uris, store.map(store.read, uris), strict=True)
    return content_of


def compare(store: str, wanted: Mapping[str, bytes]) -> list[str]:
    content_of = content(ArtifactStore(store))
    return [
        *(f"not there: {name}" for name in wanted.keys() - content_of.keys()),
        *(f"too much: {name}" for name in content_of.keys() - wanted.keys()),
        *(
            f"other bytes: {name}"
            for name in wanted.keys() & content_of
            if wanted[name] != content_of[name]
        ),
    ]


def in_a_folder(work: Path, listed: Path, args: argparse.Namespace, calm: bool) -> Storm:
    """Run the stress test on a folder, on a small disk that is full for a while."""
    store, filler = work / "disk" / ("calm" if calm else "storm"), work / "disk" / "filler"

    def full(now: bool) -> None:
        if not now:
            filler.unlink(missing_ok=True)
            return
        with suppress(OSError), filler.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))

    damaged, kills = ({}, 0) if calm else (args.damaged, args.kills)
    return run_in_storm(work, str(store), listed, damaged, kills, {}, full, args.seed)


def in_a_bucket(work: Path, listed: Path, args: argparse.Namespace, calm: bool) -> Storm:
    """Run the stress test on a bucket, whose server fails requests and is full for a while."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = ["-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with (work / "moto.log").open("ab") as log:
        moto = subprocess.Popen([sys.executable, *words], stdout=log, stderr=log)
    weather = BadWeather(f"http://127.0.0.1:{port}", 0.0, args.seed, hang=4.0)
    env = {
        "AWS_ENDPOINT_URL": weather.url,
        "AWS_ACCESS_KEY_ID": "AKIAEXAMPLE",
        "AWS_SECRET_ACCESS_KEY": "none",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
        # The default time-out of 30 seconds would take too long with so many faults.
        "FSSPEC_S3": '{"config_kwargs": {"read_timeout": 2}}',
        "XDG_CACHE_HOME": str(work / "cache"),
        "SLGAUSSIAN_CACHE_SIZE": "0",
    }
    try:
        while True:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/moto-api/", timeout=5).close()
                break
            except OSError:
                time.sleep(0.2)
        os.environ.update(env)
        s3fs.S3FileSystem.clear_instance_cache()  # of another proxy, perhaps
        ArtifactStore("s3://storm/slg").fs.mkdir("storm")
        weather.share = 0.0 if calm else FAILING
        damaged, kills = ({}, 0) if calm else (args.damaged, args.kills)

        def full(now: bool) -> None:
            weather.full = now

        storm = run_in_storm(work, "s3://storm/slg", listed, damaged, kills, env, full, args.seed)
        weather.share = 0.0
        storm.wrong += compare("s3://storm/slg", args.wanted)
    finally:
        weather.close()
        moto.terminate()
        moto.wait()
    failed = weather.met.total() - weather.met[""]
    print(f"requests: {weather.met.total()}, failed: {failed} {dict(weather.met)}", flush=True)
    return storm


COLUMNS = {
    "store": ("store", str),
    "scenes": ("scenes", ",d"),
    "damaged": ("damaged", "d"),
    "alone": ("alone, s", ".0f"),
    "storm": ("storm, s", ".0f"),
    "workers": ("workers killed", "d"),
    "killed": ("runs killed", "d"),
    "runs": ("runs", "d"),
    "again": ("scenes left for a later run", "d"),
    "files": ("files", str),
}


def in_own_namespace(words: list[str]) -> None:
    """Restart in a private mount namespace, in which disks can be mounted."""
    command = ["unshare", "--user", "--map-root-user", "--mount"]
    if "SLG_STORM" not in os.environ:
        os.environ["SLG_STORM"] = "1"
        os.execvp(command[0], [*command, sys.executable, "-m", "benches.pipeline.storm", *words])


def main() -> None:
    arguments = parser(__doc__, "scale.md")
    arguments.add_argument("work", type=Path, nargs="?", help="folder for scenes and stores")
    arguments.add_argument("--scenes", type=int, default=300)
    arguments.add_argument(
        "--in-bucket", type=int, default=60, help="so many of them; each is slow"
    )
    arguments.add_argument("--kills", type=int, default=50, help="of each store")
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--only", choices=("folder", "bucket"))
    arguments.add_argument(
        "--run", nargs=3, metavar=("STORE", "SCENES", "OUT"), help="used by itself"
    )
    args = arguments.parse_args()
    if args.run:
        run(args.run[0], Path(args.run[1]), Path(args.run[2]), 2)
    in_own_namespace(sys.argv[1:])
    work = args.work.resolve()
    shutil.rmtree(work / "cache", ignore_errors=True)
    for log in ("storm.log", "moto.log"):
        (work / log).unlink(missing_ok=True)
    (work / "disk").mkdir(parents=True, exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(work / "disk")]
    subprocess.run(mount, check=True)
    files, damaged = write_scenes(work, args.scenes)
    rows, wrong = [], []
    for name, count, weather in (
        ("folder", args.scenes, in_a_folder),
        ("bucket", args.in_bucket, in_a_bucket),
    ):
        if args.only not in (None, name):
            continue
        some = files[:count]
        args.damaged = {scene.stem: damaged[scene.stem] for scene in some if scene.stem in damaged}
        everything, intact = work / "all.json", work / "whole.json"
        everything.write_text(json.dumps(list(map(str, some))))
        intact.write_text(json.dumps([str(f) for f in some if f.stem not in args.damaged]))
        shutil.rmtree(work / "disk" / "calm", ignore_errors=True)
        calm = in_a_folder(work, intact, args, calm=True)
        args.wanted = content(ArtifactStore(work / "disk" / "calm"))
        if weather is in_a_bucket:
            calm = in_a_bucket(work, intact, args, calm=True)
        print(f"{name}: a run left alone took {calm.seconds:.0f} s", flush=True)
        storm = weather(work, everything, args, calm=False)
        if weather is in_a_folder:
            storm.wrong += compare(str(work / "disk" / "storm"), args.wanted)
        rows.append(
            {
                "store": name,
                "scenes": count,
                "damaged": len(args.damaged),
                "alone": calm.seconds,
                "storm": storm.seconds,
                "workers": storm.kills["workers"],
                "killed": storm.kills["runs"],
                "runs": storm.runs,
                "again": storm.retried,
                "files": f"{len(storm.wrong)} differ" if storm.wrong else "equal",
            }
        )
        wrong += calm.wrong + storm.wrong
        print(rows[-1], flush=True)
    publish(args.out, "scale.md", "python -m benches.pipeline.storm WORK", table(rows, COLUMNS))
    print("\n".join(wrong[:20]))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
