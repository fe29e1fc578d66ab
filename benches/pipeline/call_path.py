"""Count the files and functions that a command enters, and its calls across files.

``python benches/pipeline/call_path.py [field | run]`` builds the field of two photographs of a
small procedural room, or runs a configuration with that scene, in this process, and records every
call in all threads. It counts the files and functions of this project that are entered, and the
distinct pairs of a caller and a callee in different files, ignoring foreign functions between them
and calls during imports. It measures the tree that is first in ``PYTHONPATH``. Run the command once
before, because kernels compile slowly while calls are recorded.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import tempfile
import threading
import tomllib
from pathlib import Path
from types import CodeType, FrameType

import slgaussian
from benches.common.small_rooms import write_rooms

TREE = Path(slgaussian.__file__).resolve().parents[1]
PACKAGES = tuple(f"{TREE / package}{os.sep}" for package in ("slgaussian", "flows", "tasks"))


class CallPath:
    """Entered functions, as file and name, and pairs of caller and callee in different files."""

    def __init__(self) -> None:
        self.functions: set[tuple[str, str]] = set()
        self.crossings: set[tuple[tuple[str, str], tuple[str, str]]] = set()
        self.files: dict[CodeType, str] = {}

    def watch(self, frame: FrameType | None, event: str, _: object) -> None:
        """Record a call; callback of :func:`sys.setprofile`."""
        if event != "call" or not (file := self._file(frame)) or _is_module(frame):
            return
        callee = file, frame.f_code.co_qualname
        self.functions.add(callee)
        while (frame := frame.f_back) is not None and not self._file(frame):
            pass
        if frame is not None and self._file(frame) != file and not _is_module(frame):
            self.crossings.add(((self._file(frame), frame.f_code.co_qualname), callee))

    def _file(self, frame: FrameType) -> str:
        """Return the file of a frame, relative to the tree; empty if it is not in the packages."""
        if (code := frame.f_code) not in self.files:
            file = code.co_filename
            ours = file.startswith(PACKAGES)
            self.files[code] = file.removeprefix(f"{TREE}{os.sep}") if ours else ""
        return self.files[code]


def _is_module(frame: FrameType) -> bool:
    return frame.f_code.co_name == "<module>"


def words_of(command: str, folder: Path) -> list[str]:
    """Write photographs of a room; return the arguments of a command on them."""
    config, out = write_rooms(folder, 1), ["-o", str(folder / "out")]
    if command == "run":
        return ["run", str(config), *out, "--workers", "1", "--store", str(folder / "store")]
    room = folder / "room_0000"
    photographs = [str(room / f"view_{number:02d}.png") for number in (0, 2)]
    return ["field", *photographs, "--cameras", str(room / "transforms.json"), *out]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("command", nargs="?", choices=("field", "run"), default="field")
    args = parser.parse_args()
    path = CallPath()
    script = tomllib.loads((TREE / "pyproject.toml").read_text())["project"]["scripts"]
    module, _, function = script["slgaussian"].partition(":")
    start = getattr(importlib.import_module(module), function)
    with tempfile.TemporaryDirectory() as folder:
        sys.argv = ["slgaussian", *words_of(args.command, Path(folder).resolve())]
        threading.setprofile(path.watch)
        sys.setprofile(path.watch)
        try:
            start()
        except SystemExit as end:
            if end.code:
                raise
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
    files = {file for file, _ in path.functions}
    print(
        f"{args.command}: {len(files)} files, {len(path.functions)} functions, "
        f"{len(path.crossings)} pairs of caller and callee across files"
    )


if __name__ == "__main__":
    main()
