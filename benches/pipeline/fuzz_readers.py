"""Fuzzing of all readers with damaged files: errors, time and memory.

    python -m benches.pipeline.fuzz_readers [-o docs/measured] [--count 3000] [--only FORMAT]

For each format the bench writes a small valid set of files, damages one file in one to three places
(bits, cuts, insertions, huge, negative or missing numbers, wrong types, lost and repeated keys,
deep nesting, impossible sizes, with corrected checksums), and reads the set in a child process with
1 GiB more address space than it starts with. Refused means an InputError or SpecError of one line
that names a file of the set, or the clip in it. ``--again "ply 17"`` reads one file again, with the
traceback.
"""

from __future__ import annotations

import json
import os
import resource
import select
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import pyarrow as pa
import torch

from benches.common.harness import parser, publish, table
from tests.small_files import FORMATS, new_folder, trial, verdict

ROOM = 2**30
"""Bytes of address space that a child may allocate."""
PATIENCE = 60.0
"""Wall-clock seconds after which reading a file counts as a hang, on a loaded machine."""


@dataclass
class Outcome:
    """Result for one damaged file: ``kind``, one of KINDS, and the message."""

    number: int
    kind: str
    message: str = ""
    seconds: float = 0.0
    bytes: int = 0


KINDS = {
    "accepted": "Accepted",
    "refused": "Refused",
    "other": "Other errors",
    "crashed": "Crashes",
    "hung": "Hangs",
}


def memory_status(name: str) -> int:
    """Return bytes from /proc/self/status, such as ``VmRSS`` (resident) or ``VmHWM`` (its peak)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


def measure(name: str, number: int, seed: int, folder: Path) -> Outcome:
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    before, begun = memory_status("VmRSS"), time.process_time()
    kind, message = verdict(name, number, seed, folder)
    seconds = time.process_time() - begun
    return Outcome(number, kind, message, seconds, max(0, memory_status("VmHWM") - before))


def _child(name: str, first: int, count: int, seed: int, folder: Path, out: int) -> None:
    """Read the files from number ``first``, write a line on each to ``out``, and exit."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)  # decoders print warnings about damaged files
    warnings.simplefilter("ignore")
    limit = memory_status("VmSize") + ROOM
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with os.fdopen(out, "w") as lines:
        FORMATS[name].read(folder)  # so that imports count for no file
        for number in range(first, count):
            outcomes = measure(name, number, seed, folder)
            lines.write(json.dumps(asdict(outcomes)) + "\n")
            lines.flush()
    os._exit(0)


def fuzz(name: str, count: int, seed: int, folder: Path) -> Iterator[Outcome]:
    """Damage ``count`` files of a format and read them; restart the child after a crash or hang."""
    _in_child(lambda: FORMATS[name].make(new_folder(folder)))
    _in_child(lambda: FORMATS[name].read(folder))
    number = 0
    while number < count:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            _child(name, number, count, seed, folder, writing)
        os.close(writing)
        hung = False
        with os.fdopen(reading, "rb", buffering=0) as pipe:
            rest = b""
            while True:
                if not select.select([pipe], [], [], PATIENCE)[0]:
                    hung = True
                    break
                part = pipe.read(65536)
                if not part:
                    break
                *lines, rest = (rest + part).split(b"\n")
                for line in lines:
                    yield Outcome(**json.loads(line))
                    number += 1
        if hung:
            os.kill(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
        if number < count:
            shutil.rmtree(folder)
            _in_child(lambda: FORMATS[name].make(new_folder(folder)))
            yield Outcome(number, "hung" if hung else "crashed", f"status {status}")
            number += 1


def _in_child(work: Callable[[], None]) -> None:
    """Call ``work`` in a child process: threads that it started here would break later forks."""
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        raise RuntimeError("the undamaged set could not be written or read")


def ready() -> None:
    """Limit each library to one thread, before it starts any."""
    cv2.setNumThreads(0)
    torch.set_num_threads(1)
    pa.set_cpu_count(1)


def main() -> None:
    arguments = parser(__doc__, "fuzz.md")
    arguments.add_argument("--count", type=int, default=3000)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--only", choices=FORMATS)
    arguments.add_argument("--again", help="a format and a number, such as 'ply 17'")
    args = arguments.parse_args()
    ready()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "set"
        if args.again:
            name, _, number = args.again.rpartition(" ")
            FORMATS[name].make(new_folder(folder))
            trial(name, int(number), args.seed, folder)
            return
        rows, bad = [], []
        for name in [args.only] if args.only else FORMATS:
            outcomes = list(fuzz(name, args.count, args.seed, folder))
            shutil.rmtree(folder)
            kinds = Counter(outcome.kind for outcome in outcomes)
            row = {"format": name, "files": len(outcomes), **{kind: kinds[kind] for kind in KINDS}}
            row |= {"seconds": max(outcome.seconds for outcome in outcomes)}
            rows.append(row | {"memory": max(outcome.bytes for outcome in outcomes) / 2**20})
            bad += [
                (name, outcome)
                for outcome in outcomes
                if outcome.kind not in ("accepted", "refused")
            ]
    columns = {
        "format": ("Format", str),
        "files": ("Files", ",d"),
        **{kind: (heading, ",d") for kind, heading in KINDS.items()},
        "seconds": ("Slowest, s", ".2f"),
        "memory": ("Memory, MiB", ".0f"),
    }
    command = f"python -m benches.pipeline.fuzz_readers --count {args.count} --seed {args.seed}"
    publish(args.out, "fuzz.md", command, table(rows, columns))
    for name, outcome in bad:
        print(f"{name} {outcome.number}: {outcome.kind}: {outcome.message}")
    raise SystemExit(bool(bad))


if __name__ == "__main__":
    main()
