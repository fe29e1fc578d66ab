"""Arguments, tables, timing and pages of benches.

A page of ``docs/measured`` is written by hand, except for blocks that benches write with
``-o docs/measured``: the bench NAME writes the text between ``<!-- NAME -->`` and
``<!-- end of NAME -->``. A block begins with date, commit, machine and command; tables follow.
"""

from __future__ import annotations

import argparse
import platform
import re
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from pathlib import Path

import numba
import numpy as np
import torch

from slgaussian.io import write_atomic
from slgaussian.kernels import threads

ROOT = Path(__file__).parents[2]
CODE = ("slgaussian", "flows", "tasks", "data_specs", "benches")

Format = str | Callable[[object], str]
"""A format specification such as ``.2f``, or a function from a value to a string."""

ROUNDS, LEAST_ROUNDS, SECONDS = 11, 3, 8.0
"""Rounds of :func:`times_in_turn`, and the smallest number if they exceed this many seconds."""


def parser(doc: str | None, page: str = "") -> argparse.ArgumentParser:
    """Return a parser that prints the docstring of a bench, with ``-o`` if it writes to a page."""
    arguments = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if page:
        arguments.add_argument(
            "-o", "--out", type=Path, help=f"folder whose {page} gets the tables"
        )
    return arguments


def describe_measurement() -> str:
    """Return date, commit and machine as a sentence, which begins each block of a page.

    Raises:
        subprocess.CalledProcessError: Outside a clone of the repository.
    """
    commit = _git("rev-parse", "--short", "HEAD")
    if _git("status", "--porcelain", "--", *CODE):
        commit += " with changes"
    return f"Measured on {date.today()}, commit {commit}, on {machine()}."


def machine() -> str:
    """Return processor, cores and versions, without the name of the machine."""
    name, cores = threads.processor().rsplit(", ", 1)
    return (
        f"{cores} ({platform.machine()}, {name}), Python "
        f"{platform.python_version()}, torch {torch.__version__}, Numba {numba.__version__}"
    )


def _git(*words: str) -> str:
    command = ["git", "-C", str(ROOT), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def table(rows: Sequence[Mapping], columns: Mapping[str, tuple[str, Format]]) -> str:
    """Return a Markdown table.

    Args:
        rows: sequence of mapping. A missing key gives an empty cell.
        columns: mapping of str to (str, Format). Heading and format of each key. Numbers are
            aligned on the right, ``str`` on the left.
    """
    heads = [heading for heading, _ in columns.values()]
    cells = [
        [
            (how(row[key]) if callable(how) else format(row[key], how)) if key in row else ""
            for key, (_, how) in columns.items()
        ]
        for row in rows
    ]
    rule = ["---" if how is str else "--:" for _, how in columns.values()]
    return "\n".join(f"| {' | '.join(line)} |" for line in (heads, rule, *cells))


def ms(seconds: float) -> str:
    """Format seconds as milliseconds, to three digits."""
    return f"{1e3 * seconds:,.0f}" if seconds >= 0.1 else f"{1e3 * seconds:.3g}"


def error(value: float) -> str:
    """Format a small number as in 1.2e-3."""
    return f"{value:.1e}".replace("e-0", "e-") if value else "0"


def publish(out: Path | None, page: str, command: str, *parts: str) -> None:
    """Print paragraphs and tables, and write them into their block of a page.

    Args:
        out: Folder of the page; None prints only.
        page: File name, such as ``words.md``. A new block is appended.
        command: Command that repeats this, such as ``python -m benches.language.words_known DATA``.
    """
    name = command.split()[2].rpartition(".")[2]
    stamp = describe_measurement().removesuffix(".") + f", by `{command}`."
    block = "\n\n".join((f"<!-- {name} -->", stamp, *parts, f"<!-- end of {name} -->"))
    print(block)
    if out is None:
        return
    out.mkdir(parents=True, exist_ok=True)
    file = out / page
    text = file.read_text("utf-8") if file.exists() else f"# {page.removesuffix('.md').title()}\n"
    blocks = re.compile(f"<!-- {name} -->.*?<!-- end of {name} -->", re.DOTALL)
    text = blocks.sub(lambda _: block, text) if blocks.search(text) else f"{text}\n{block}\n"
    write_atomic(file, text.encode())


def times_in_turn(
    contenders: Mapping[str, Callable[[], object]],
    clock: Callable[[], float] = time.perf_counter,
    pick: Callable = np.median,
) -> dict[str, float]:
    """Return median seconds of functions, run in turn so that other load affects all equally.

    Args:
        contenders: mapping of str to callable. Functions to time; each runs once before that.
        pick: Statistic over rounds; ``min`` excludes interruptions by other processes.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for work in contenders.values():
        work()
    start = time.perf_counter()
    for turn in range(ROUNDS):
        if turn >= LEAST_ROUNDS and time.perf_counter() - start > SECONDS:
            break
        for name, work in contenders.items():
            begin = clock()
            work()
            seconds[name].append(clock() - begin)
    return {name: float(pick(spent)) for name, spent in seconds.items()}
