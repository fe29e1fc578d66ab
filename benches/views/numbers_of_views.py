"""The page about numbers of context views, with its chart:

    python -m benches.views.numbers_of_views DATA [-o docs/measured] [--rows FILE]

DATA holds ``office``, ``office_walk``, ``fern`` and ``places``. Rows are kept in FILE as they come,
and what it holds is not done again: for new code take a new FILE.
"""

from __future__ import annotations

import argparse
import io
import json
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benches.common.chart_style import BLUE, FAINT, GREEN, INK, ORANGE, STYLE
from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from benches.views import built_fields, labelled_targets, outward, spread
from benches.views.built_fields import Row
from slgaussian.io import write_atomic
from slgaussian.kernels import threads

LOOKS = {
    "walk": (ORANGE, "s"),
    "fern": (BLUE, "o"),
    "places": ("#CC79A7", "v"),
    "rooms": (GREEN, "D"),
}
"""Colour and marker of what a line of the chart is of."""

NUMBERS = {"walk": outward.NUMBERS, **dict.fromkeys(("fern", "places", "rooms"), spread.NUMBERS)}

Job = Callable[[], Iterable[Row]]


def jobs(data: Path, every: int, rooms: int) -> Iterator[tuple[str, str, Job]]:
    """What is measured: of which part of the page, of what, and how."""
    walk, numbers = data / "office_walk", outward.NUMBERS
    for start in outward.windows(walk, numbers, every):
        yield "walk", str(start), partial(outward.window, walk, numbers, start)
    yield "fern", "", partial(spread.fern, data / "fern", spread.NUMBERS)
    more = spread.places(data / "places")
    for name in more:
        yield "places", name, partial(spread.place, data / "places" / name, spread.NUMBERS)
    yield "labels", "office", partial(labelled_targets.office, data, labelled_targets.NUMBERS)
    for name in more:
        folder = data / "places" / name
        yield "labels", name, partial(labelled_targets.place, folder, labelled_targets.NUMBERS)
    for seed in range(rooms):
        yield "rooms", str(seed), partial(spread.room, seed, spread.NUMBERS)


def measured(todo: Iterable[tuple[str, str, Job]], file: Path | None) -> dict[str, list[Row]]:
    """The rows of each part, those of ``file`` without work."""
    known: dict[tuple[str, str], list[Row]] = {}
    if file is not None and file.exists():
        for line in file.read_text().splitlines():
            part, of, rows = json.loads(line)
            known[part, of] = rows
    found: dict[str, list[Row]] = {}
    for part, of, job in todo:
        if (part, of) not in known:
            known[part, of] = list(job())
            print(f"{part} {of}: {len(known[part, of])} rows", flush=True)
            if file is not None:
                with file.open("a") as lines:
                    lines.write(json.dumps([part, of, known[part, of]]) + "\n")
        found.setdefault(part, []).extend(known[part, of])
    return found


def chart(parts: dict[str, list[Row]]) -> bytes:
    """SVG: gain over two views, depth error, Gaussians and seconds over the number of views."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.2), layout="constrained")
        gain, depth, grown, seconds = figure.subplots(1, 4)
        for part, (color, marker) in LOOKS.items():
            lines = built_fields.summary(parts[part], NUMBERS[part])
            look = {"color": color, "marker": marker, "lw": 1.6, "ms": 5}
            _draw(gain, lines, lambda line: line.get("gain", 0.0), look | {"label": part})
            _draw(depth, [line for line in lines if "depth" in line], lambda o: o["depth"], look)
            _draw(grown, lines, lambda line: line["grown"], look)
            _draw(seconds, lines, lambda line: line["seconds"], look)
        gain.axhline(0, color=INK, lw=0.8)
        gain.set(title="PSNR over two views, dB")
        depth.set(title="Depth error at the targets", ylim=(0, None))
        grown.set(title="Gaussians, times", ylim=(0, None))
        seconds.set(title="CPU seconds", ylim=(0, None))
        figure.legend(
            *gain.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False
        )
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def _draw(axes: Axes, lines: list[Row], of: Callable[[Row], float], look: dict) -> None:
    axes.grid(color=FAINT)
    axes.set(xlabel="context views", xticks=sorted({n for own in NUMBERS.values() for n in own}))
    axes.plot([line["views"] for line in lines], [of(line) for line in lines], **look)


def command(every: int, rooms: int) -> str:
    """What makes the page again."""
    words = ["python -m benches.views.numbers_of_views DATA -o docs/measured"]
    words += [f"--every {every}"] if every != outward.EVERY else []
    words += [f"--rooms {rooms}"] if rooms != spread.ROOMS else []
    return " ".join(words)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "data", type=data_folder("office", "office_walk", "fern/poses_bounds.npy", "places")
    )
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--every", type=int, default=outward.EVERY)
    parser.add_argument("--rooms", type=int, default=spread.ROOMS)
    given = parser.parse_args()
    threads.limit()
    built_fields.warm_up()
    parts = measured(jobs(given.data, given.every, given.rooms), given.rows)
    tables = {
        part: built_fields.summary_table(parts[part], numbers) for part, numbers in NUMBERS.items()
    }
    tables["labels"] = labelled_targets.summary_table(parts["labels"], labelled_targets.NUMBERS)
    refused = {part: built_fields.reasons(parts[part]) for part in NUMBERS}
    windows = len({row["of"] for row in parts["walk"]})
    if given.out is not None:
        write_atomic(given.out / "views.svg", chart(parts))
    publish(
        "views/views.md.j2",
        given.out and given.out / "views.md",
        command=command(given.every, given.rooms),
        tables=tables,
        refused=refused,
        windows=windows,
        rooms=given.rooms,
        every=given.every,
    )


if __name__ == "__main__":
    main()
