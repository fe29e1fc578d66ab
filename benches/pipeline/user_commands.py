"""All user commands end to end: exit statuses and digests of their outputs.

Run ``record`` before and after a change that should not affect outputs, then list the differences
with ``diff``. Each command runs in its own process, from a plain install in a new environment
unless ``--program`` names another one. Without ``--data`` (a folder with ``office``) the steps on
photographs are skipped; ``--only`` selects groups.

    python -m benches.pipeline.user_commands record WORK before.json --data DATA
    python -m benches.pipeline.user_commands diff before.json after.json
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from benches.common.photograph_pairs import data_folder
from benches.common.small_rooms import write_rooms

ROOT = Path(__file__).resolve().parents[2]
TIMED = re.compile(r"(times\..*|report\.(html|md)|.*\.mp4|\d{6}\.(parquet|claim)|current\.\w+)")
"""Files that contain times or dates: their existence is recorded, but not their bytes."""
LIMIT = 3600.0
"""Time limit of a command, seconds."""


@dataclass(frozen=True)
class Result:
    """Outcome of one command.

    Attributes:
        status: Exit status; negative if a signal ended it.
        files: dict of str to str. SHA-256 of each file, by its path in the folder that the command
            wrote.
        stdout: SHA-256 of its standard output if that is the result (``--json``, ``--help``), else
            empty.
    """

    command: str
    status: int
    files: dict[str, str] = field(default_factory=dict)
    stdout: str = ""


@dataclass
class Recorder:
    """Run commands of one program in one folder, and record their results."""

    program: list[str]
    work: Path
    env: dict[str, str]
    results: dict[str, Result] = field(default_factory=dict)

    def run(self, name: str, *words: object, out: str = "", answer: bool = False) -> Result:
        """Run ``slgaussian WORDS``; record its status, digests under ``out``, and output."""
        arguments = [str(word) for word in words]
        begin = time.monotonic()
        done = subprocess.run(
            [*self.program, *arguments],
            cwd=self.work,
            env=self.env,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=LIMIT,
        )
        log = self.work / "logs" / (re.sub(r"\W+", "_", name) + ".log")
        log.parent.mkdir(exist_ok=True)
        log.write_bytes(done.stdout + done.stderr)
        stdout = hashlib.sha256(done.stdout).hexdigest() if answer else ""
        result = self.record(name, arguments, done.returncode, out, stdout)
        print(f"{time.monotonic() - begin:7.1f} s  status {result.status}  {name}", flush=True)
        return result

    def record(
        self, name: str, arguments: list[str], status: int, out: str = "", stdout: str = ""
    ) -> Result:
        """Record the outcome of a command that has ended."""
        files = digests(self.work / out) if out else {}
        self.results[name] = Result(shlex.join(arguments), status, files, stdout)
        return self.results[name]


def digests(path: Path) -> dict[str, str]:
    """Return the SHA-256 of a file, or of each file under a folder, by relative path.

    For a file that contains times, only its existence is recorded.
    """
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    return {str(p.relative_to(path)) if p != path else p.name: _digest(p) for p in files}


def _digest(path: Path) -> str:
    if TIMED.fullmatch(path.name):
        return "present"
    return hashlib.sha256(path.read_bytes()).hexdigest()


# The groups. Each writes below a folder of its own, so that any of them can run alone.


def helps(recorder: Recorder, _data: Path | None) -> None:
    """Run ``--help`` of the program and of each command."""
    recorder.run("help", "--help", answer=True)
    listing = (recorder.work / "logs" / "help.log").read_text()
    for command in re.findall(r"^  ([a-z]+)  +\S", listing, re.MULTILINE):
        recorder.run(f"help {command}", command, "--help", answer=True)


def demo(recorder: Recorder, _data: Path | None) -> None:
    """Run the demo with its defaults, and again from its store."""
    for name in ("demo", "demo again"):
        recorder.run(name, "demo", "-o", "demo/out", "--store", "demo/store", out="demo/out")


def office(recorder: Recorder, data: Path | None) -> None:
    """Run three labelled scenes with all methods, score masks, and compare two runs."""
    if data is None:
        return
    pairs = json.loads((data / "office" / "pairs.json").read_text())
    index = recorder.work / "office" / "pairs.json"
    index.parent.mkdir(exist_ok=True)
    index.write_text(json.dumps(dict(list(pairs.items())[:3])))
    source = ["--data", data / "office", "--pairs", index, "--labels", data / "office" / "labels"]
    store = ["--store", "office/store"]
    recorder.run(
        "office", "benchmark", *source, "--against", "all", *store, "-o", "office/out",
        out="office/out",
    )  # fmt: skip
    fast = ["--preset", "fast", "-o", "office/fast"]
    recorder.run("office fast", "benchmark", *source, *store, *fast, out="office/fast")
    recorder.run(
        "score",
        "score",
        "office/out/masks.parquet",
        *source,
        "-o",
        "office/score",
        out="office/score",
    )
    compared = ["office/out", "office/fast", "-o", "office/compare"]
    recorder.run("compare", "compare", *compared, out="office/compare")


def runners(recorder: Recorder, _data: Path | None) -> None:
    """Run scenes by threads and by processes: the same bytes; the tests have clusters."""
    write_rooms(recorder.work / "runners" / "rooms", 2)
    for runner in ("threads", "processes"):
        out = f"runners/{runner}"
        options = ["--runner", runner, "--store", f"{out}_store", "-o", out]
        recorder.run(f"run {runner}", "run", "runners/rooms/rooms.toml", *options, out=out)


def corpus(recorder: Recorder, _data: Path | None) -> None:
    """Make lessons and a training set of chunks, train, promote weights, and refuse others."""
    store = ["--store", "corpus/store"]
    chunks = ["-o", "corpus", *store]
    write_rooms(recorder.work / "corpus" / "rooms", 5, views=6)
    rooms = [f"corpus/rooms/room_{number:04d}" for number in (2, 3, 4)]
    # Of the rooms, the last is held out.
    recorder.run("pack", "ingest", *rooms[1:], *chunks, out="corpus/chunks")
    small = ["--set", "size=64x80", "--set", "most=1", "--set", "replicas=1", *store]
    lessons = ["corpus/chunks", *small, "-o", "corpus/lessons"]
    recorder.run("supervise", "supervise", *lessons, out="corpus/lessons")
    sources = ["corpus/set", "corpus/chunks", *small]
    recorder.run("dataset", "dataset", *sources, out="corpus/set")
    training = ["--lessons", "corpus/lessons", "--steps", "10", *store, "-o", "corpus/trained"]
    recorder.run("train", "train", *training, out="corpus/trained")
    retrain = ["--sources", "corpus/chunks", "--out", "corpus/new", "--models", "corpus/models"]
    retrain += small
    models = "corpus/models"
    recorder.run("retrain", "retrain", *retrain, "--steps", "10", out=models)
    # So few clips never pass the promotion test, so an operator promotes the weights.
    recorder.run("promote", "versions", models, "--use", "1", out=models)
    recorder.run("pack more", "ingest", rooms[0], *chunks, out="corpus/chunks")
    # One step of training does not improve the weights.
    recorder.run("retrain, refused", "retrain", *retrain, "--steps", "1", out=models)
    recorder.run("use none", "versions", models, "--use", "none", out=models)
    recorder.run("versions", "versions", models, answer=True)


def fields(recorder: Recorder, data: Path | None) -> None:
    """Build fields of two and five photographs, with and without cameras; query and export."""
    if data is None:
        folder = recorder.work / "fields"
        write_rooms(folder, 1)
        photographs = sorted((folder / "room_0000").glob("*.png"))
        cameras = folder / "room_0000" / "transforms.json"
        recorder.run(
            "field", "field", *photographs[::2], "--cameras", cameras, "-o", "fields/posed",
            out="fields/posed",
        )  # fmt: skip
        questions(recorder, "fields/posed", cameras, ["wall", "floor"], [])
        return
    images, cameras = data / "office" / "images", data / "office" / "transforms.json"
    pairs = json.loads((data / "office" / "pairs.json").read_text())
    context = [images / Path(name).name for name in next(iter(pairs.values()))["context"]]
    walk = sorted((data / "office_walk" / "images").iterdir())[:5]
    posed = [*context, "--cameras", cameras]
    recorder.run("field posed", "field", *posed, "-o", "fields/posed", out="fields/posed")
    recorder.run("field two", "field", *context, "-o", "fields/two", out="fields/two")
    recorder.run("field five", "field", *walk, "-o", "fields/five", out="fields/five")
    five = [*walk, "--cameras", data / "office_walk" / "transforms.json"]
    recorder.run("field five posed", "field", *five, "-o", "fields/fifth", out="fields/fifth")
    estimate = ["cameras", *context, "-o", "fields/cameras.json"]
    recorder.run("cameras", *estimate, out="fields/cameras.json")
    recorder.run("masks", "masks", *posed, "-o", "fields/ids", out="fields/ids")
    questions(recorder, "fields/posed", cameras, ["blue carpet", "wooden table"], context)


def questions(
    recorder: Recorder, folder: str, cameras: Path, texts: list[str], pictures: list[Path]
) -> None:
    """Run every query command on a field, and export it in each format."""
    out = f"{folder}_answers"
    (recorder.work / out).mkdir()

    def ask(name: str, *words: object, file: str = "", answer: bool = False) -> None:
        words = (*words, "-o", f"{out}/{file}") if file else words
        recorder.run(f"{name} {folder}", *words, out=f"{out}/{file}" * bool(file), answer=answer)

    ask("query", "query", folder, *texts, "--json", answer=True)
    ask("query absent", "query", folder, "purple sofa", "--json", answer=True)
    ask("query unknown", "query", folder, "zyzzyva")
    ask("query picture", "query", folder, texts[0], file="hit.png")
    between = ["--between", "0", "1", "0.5", "--json"]
    ask("query between", "query", folder, texts[0], *between, answer=True)
    if pictures:
        like = ["--like", pictures[0], "--json"]
        ask("query like", "query", folder, *like, answer=True)
    ask("segment", "segment", folder, *texts, file="labels.png")
    ask("segment json", "segment", folder, *texts, "--json", answer=True)
    ask("objects", "objects", "list", folder, "--json", answer=True)
    ask("objects picture", "objects", "list", folder, file="objects.png")
    ask("teach", "objects", "teach", folder, "thing", "--at", "20", "20")
    ask("query taught", "query", folder, "thing", "--json", answer=True)
    ask("forget", "objects", "teach", folder, "thing", "--forget")
    ask("name", "objects", "name", folder, "1", "one")
    ask("query named", "query", folder, "one", "--json", answer=True)
    ask("unname", "objects", "name", folder, "1")
    ask("extract", "objects", "extract", folder, "1", file="one.ply")
    ask("remove", "objects", "remove", folder, "1", file="without")
    ask("render", "render", folder, *between[:-1], file="middle.png")
    for suffix in ("html", "ply", "spz"):
        ask(f"export {suffix}", "export", folder, file=f"scene.{suffix}")
    ask("inspect", "inspect", f"{folder}/gaussians.npz")
    ask("render ply", "render", f"{out}/scene.ply", "--camera", cameras, file="ply.png")


def kill_and_resume(recorder: Recorder, _data: Path | None) -> None:
    """Kill and resume a run, which must equal an undisturbed run."""
    base = recorder.work / "killed"
    config = write_rooms(base / "rooms", 2)
    arguments = ["run", str(config), "--store", "killed/store", "-o", "killed/out"]
    process = subprocess.Popen(
        [*recorder.program, *arguments],
        cwd=recorder.work,
        env=recorder.env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    gaussians = base / "store" / "gaussians"
    wait_until(lambda: gaussians.is_dir() and len(list(gaussians.iterdir())) >= 1, process)
    os.killpg(process.pid, signal.SIGKILL)
    recorder.record("run killed", arguments, process.wait())
    recorder.run("run resumed", *arguments, out="killed/out")
    whole = ["run", str(config), "--store", "killed/whole", "-o", "killed/undisturbed"]
    recorder.run("run undisturbed", *whole, out="killed/undisturbed")


GROUPS: dict[str, Callable[[Recorder, Path | None], None]] = {
    "help": helps,
    "demo": demo,
    "fields": fields,
    "corpus": corpus,
    "runners": runners,
    "killed": kill_and_resume,
    "office": office,
}


def check(results: dict[str, Result]) -> list[str]:
    """List the violations within one recording: exit statuses, and files that must be equal."""
    wrong = [
        f"{name}: exit status {result.status}"
        for name, result in results.items()
        if result.status not in EXPECTED.get(name.split(" fields/")[0], (0,))
    ]
    for group in EQUAL:
        members = [name for name in group if name in results]
        for name in members[1:]:
            for path in differing(results[members[0]].files, results[name].files):
                wrong.append(f"{name}: {path} is not as of {members[0]!r}")
    return wrong


EXPECTED = {
    "query": (0, 3),
    "query absent": (0, 3),
    "query unknown": (1, 2, 3),
    "query between": (0, 3),
    "query picture": (0, 3),
    "query like": (0, 3),
    "query taught": (0, 3),
    "query named": (0, 3),
    "retrain": (3,),
    "retrain, refused": (3, 4),
    "run killed": (-signal.SIGKILL,),
}
"""Allowed exit statuses of commands; 0 for all others."""

EQUAL = (
    ("run threads", "run processes"),
    ("run undisturbed", "run resumed"),
    ("demo", "demo again"),
)
"""Commands whose files must be equal."""


def differing(a: dict[str, str], b: dict[str, str]) -> list[str]:
    """Return the paths with differing digests or in one set only."""
    return sorted(path for path in a.keys() | b.keys() if a.get(path) != b.get(path))


def differences(before: dict[str, Result], after: dict[str, Result]) -> list[str]:
    """Return a line for each difference of two recordings."""
    lines = [f"{name}: only before" for name in before if name not in after]
    lines += [f"{name}: only after" for name in after if name not in before]
    for name in (name for name in before if name in after):
        first, second = before[name], after[name]
        if first.status != second.status:
            lines.append(f"{name}: exit status {first.status}, then {second.status}")
        if first.stdout != second.stdout:
            lines.append(f"{name}: standard output differs")
        for path in differing(first.files, second.files):
            state = {(True, True): "differs", (True, False): "is gone", (False, True): "is new"}
            lines.append(f"{name}: {path} {state[path in first.files, path in second.files]}")
    return lines


def wait_until(happens: Callable[[], bool], process: subprocess.Popen | None = None) -> None:
    """Wait for a condition; raise ``SystemExit`` if ``process`` ends first, or after an hour."""
    end = time.monotonic() + LIMIT
    while not happens():
        if time.monotonic() > end or (process is not None and process.poll() is not None):
            raise SystemExit("what a step waits for did not come; see its logs")
        time.sleep(0.05)


def install(work: Path) -> list[str]:
    """Install the checkout plainly, and return the program."""
    python = work / "venv" / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", work / "venv"], check=True)
        pip = [python, "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", ROOT]
        subprocess.run(pip, check=True)
    return [str(work / "venv" / "bin" / "slgaussian")]


def record_groups(
    program: list[str],
    work: Path,
    data: Path | None,
    groups: list[str],
    variables: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Result]:
    """Run the groups of these names in the folder ``work``; return their results by step.

    ``variables`` are added to the environment, as the address of a Prefect server that runs.
    """
    ours = ("PREFECT_", "SLGAUSSIAN_", "PYTHONPATH", "COLUMNS")
    env = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    env |= {"COLUMNS": "100", "DO_NOT_TRACK": "1", "PREFECT_SERVER_ANALYTICS_ENABLED": "false"}
    env |= variables
    recorder = Recorder(program, work, env)
    for name in groups:
        (work / name).mkdir(exist_ok=True)
        GROUPS[name](recorder, data)
    return recorder.results


def main() -> None:
    """Record, or compare two recordings; the exit status is 1 for violations or differences."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True, dest="command")
    record = commands.add_parser("record", help="run everything, and write a recording")
    record.add_argument("work", type=Path, help="an empty folder for all files")
    record.add_argument("out", type=Path, help="the recording, JSON")
    record.add_argument("--data", type=data_folder("office/pairs.json", "office_walk"))
    record.add_argument("--program", nargs="+", help="a program that is installed already")
    record.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS))
    diff = commands.add_parser("diff", help="list the differences of two recordings")
    diff.add_argument("before", type=Path)
    diff.add_argument("after", type=Path)
    args = parser.parse_args()
    if args.command == "diff":
        before, after = (
            {name: Result(**result) for name, result in json.loads(path.read_text()).items()}
            for path in (args.before, args.after)
        )
        lines = differences(before, after)
    else:
        work = args.work.resolve()
        work.mkdir(parents=True, exist_ok=True)
        data = args.data.resolve() if args.data else None
        results = record_groups(args.program or install(work), work, data, args.only)
        args.out.write_text(json.dumps({k: vars(v) for k, v in results.items()}, indent=1))
        lines = check(results)
    print("\n".join(lines) or "nothing")
    sys.exit(bool(lines))


if __name__ == "__main__":
    main()
