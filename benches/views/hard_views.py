"""What several photographs give where one is odd, against the same scene without it. A page.

    python -m benches.views.hard_views [-o docs/measured] [--rows FILE] [--rooms 8] [--walk FOLDER]

Cases are those of ``benches/views/twists.py``, on made-up rooms with exact depth and on a way round
inside a stage; with ``--walk`` those that need no room are done to six frames of a posed walk too.
Rows are kept in FILE as they come, and what it holds is not done again.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benches.common.markdown_tables import table
from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from benches.views import twists
from benches.views.built_fields import Row, at_targets, warm_up
from benches.views.numbers_of_views import Job, measured
from slgaussian import datasets
from slgaussian.build import build_field
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.errors import SLGaussianError
from slgaussian.kernels import threads
from slgaussian.predict.view_graph import link_views
from slgaussian.scene import Sample

ROOMS = 8
SIZE, VIEWS, ODD = (156, 208), 6, 2
AROUND, DRIFT = 16, (1.0, 0.06)
WALK, STEP, WALK_SIZE = (0, 100), 2, "at most 240x360"
"""First frames of the windows of a walk, every which frame is a context view, and their size."""

Twist = Callable[[Sample], Sample]


def twisted(seed: int) -> dict[str, Twist]:
    """The cases that any scene can be put to."""

    def views(change: Callable[[twists.Views], twists.Views]) -> Twist:
        return lambda given: replace(given, context=change(given.context))

    def one(change: Callable, place: int = ODD) -> Twist:
        return views(lambda own: twists.changed(own, place, change(own[place])))

    return {
        "given twice": views(lambda own: (*own, replace(own[ODD], name="again"))),
        "saved again, last": views(lambda own: (*own, twists.saved_again(own[ODD]))),
        "saved again, second": views(lambda own: (own[0], twists.saved_again(own[0]), *own[1:])),
        "0.7 times the light": one(lambda view: twists.exposed(view, twists.GAIN)),
        "0.7 times the light, first": one(lambda view: twists.exposed(view, twists.GAIN), 0),
        "another white balance": one(lambda view: twists.exposed(view, twists.TINT)),
        "random order": views(lambda own: twists.shuffled(own, seed)),
        "reversed order": views(lambda own: own[::-1]),
    }


def compared(of: str, plain: Sample, cases: Mapping[str, Sample]) -> Iterator[Row]:
    """A row for each case, with the figures of the plain scene beside its own."""
    before = {f"plain_{key}": value for key, value in figures(plain).items()}
    for name, given in cases.items():
        row = {"of": of, "case": name}
        try:
            after = figures(given)
        except SLGaussianError as error:
            yield row | {"refused": str(error)}
            continue
        yield row | before | after


def figures(given: Sample) -> Row:
    """PSNR, SSIM, depth error, Gaussians and objects of a field, and what was said of its views."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        field = build_field(given)
    said = [str(one.message) for one in told if one.category is UserWarning]
    row = at_targets(given, field.gaussians)
    return row | {"gaussians": len(field.gaussians), "objects": len(field.bank), "said": said}


def room(seed: int) -> Iterator[Row]:
    """The rows of a made-up room."""
    of, given = f"room {seed}", twists.arc(seed, VIEWS, SIZE)
    cases = {name: twist(given) for name, twist in twisted(seed).items()}
    odd = twists.stranger(seed, given, ODD)
    own = given.context
    cases["another place"] = replace(given, context=(*own[:ODD], odd, *own[ODD:]))
    yield from compared(of, given, cases)
    square = given.resized(SIZE[0], SIZE[0])
    turned = {}
    for name, place in (("turned by 90 degrees", ODD), ("turned by 90 degrees, first", 0)):
        across = twists.quarter_turned(square.context[place])
        turned[name] = replace(square, context=twists.changed(square.context, place, across))
    yield from compared(of, square, turned)


def way_round(number: int) -> Iterator[Row]:
    """The rows of a way that comes back to where it began, at the target where it closes."""
    given = twists.loop(number)
    at_end = replace(given, targets=given.targets[:1])
    half = number // 2
    rolled = replace(at_end, context=at_end.context[half:] + at_end.context[:half])
    off = twists.drifted(given, *DRIFT)
    cases = {
        "where it closes": at_end,
        "where it closes, drifting": replace(off, targets=off.targets[:1]),
    }
    yield from compared("loop", rolled, cases)
    middle = replace(given, targets=given.targets[1:])
    drifting = replace(off, targets=off.targets[1:])
    yield from compared("loop", middle, {"opposite, drifting": drifting})


def closed(number: int) -> bool:
    """Whether the last view of the loop gives depth to the first, and the first to it."""
    views = twists.loop(number).context
    links = link_views(views, MatchGraph.of(views), ranged=False).links
    first, last = ([link.source for link in links[k]] for k in (0, -1))
    return number - 1 in first and 0 in last


def window(folder: Path, start: int) -> Iterator[Row]:
    """The rows of six frames of a walk; targets are the frames between."""
    scene = datasets.load("nerfstudio", folder)
    names = sorted(scene.cameras)[start : start + STEP * VIEWS - 1]
    given = scene.sample(names[::STEP], names[1::STEP], WALK_SIZE)
    cases = {name: twist(given) for name, twist in twisted(start).items()}
    yield from compared(f"frame {start}", given, cases)


def jobs(rooms: int, walk: Path | None) -> Iterator[tuple[str, str, Job]]:
    """What is measured: of which part of the page, of what, and how."""
    for seed in range(rooms):
        yield "rooms", str(seed), partial(room, seed)
    yield "loop", str(AROUND), partial(way_round, AROUND)
    if walk is not None:
        for start in WALK:
            yield "walk", str(start), partial(window, walk, start)


def summary(rows: Sequence[Row]) -> list[Row]:
    """A row a case: what it costs against the plain scene, means and the worst of the scenes."""
    found = []
    for case in dict.fromkeys(row["case"] for row in rows):
        every = [row for row in rows if row["case"] == case]
        own = [row for row in every if "refused" not in row]
        line: Row = {"case": case, "scenes": len(every), "refused": len(every) - len(own)}
        line["warned"] = sum(1 for row in own if any("left out" in said for said in row["said"]))
        if own:
            gains = np.array([row["psnr"] - row["plain_psnr"] for row in own])
            line |= {"psnr": float(np.mean([row["psnr"] for row in own])), "gain": gains.mean()}
            line["worst"] = gains.min()
            if len(own) > 1:
                line["spread"] = gains.std(ddof=1)
            for name in ("depth", "gaussians", "objects"):
                if name in own[0]:
                    line[name] = float(np.mean([r[name] / r[f"plain_{name}"] for r in own]))
        found.append(line)
    return found


COLUMNS = {
    "case": ("case", str),
    "scenes": ("scenes", "d"),
    "psnr": ("PSNR", ".2f"),
    "gain": ("change", "+.2f"),
    "spread": ("spread", ".2f"),
    "worst": ("worst", "+.2f"),
    "depth": ("depth error, times", ".2f"),
    "gaussians": ("Gaussians, times", ".3f"),
    "objects": ("objects, times", ".2f"),
    "warned": ("left out", "d"),
    "refused": ("refused", "d"),
}


def summary_table(rows: Sequence[Row]) -> str:
    """The summary as Markdown; a column that no case has is left out."""
    lines = summary(rows)
    return table(lines, {k: v for k, v in COLUMNS.items() if any(k in line for line in lines)})


def said(rows: Iterable[Row]) -> list[str]:
    """What was said of each case, once."""
    told = {
        f"{row['case']}: {sentence}"
        for row in rows
        for sentence in ([row["refused"]] if "refused" in row else row["said"])
        if "left out" in sentence or "refused" in row
    }
    return sorted(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, help="folder for hard_views.md")
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--rooms", type=int, default=ROOMS)
    parser.add_argument("--walk", type=data_folder("transforms.json"))
    given = parser.parse_args()
    threads.limit()
    warm_up()
    parts = measured(jobs(given.rooms, given.walk), given.rows)
    words = ["python -m benches.views.hard_views -o docs/measured"]
    words += [f"--rooms {given.rooms}"] if given.rooms != ROOMS else []
    words += ["--walk FOLDER"] if given.walk else []
    publish(
        "views/hard_views.md.j2",
        given.out and given.out / "hard_views.md",
        command=" ".join(words),
        tables={name: summary_table(rows) for name, rows in parts.items()},
        said={name: said(rows) for name, rows in parts.items()},
        closed=closed(AROUND),
        rooms=given.rooms,
        views=VIEWS,
        around=AROUND,
        drift=DRIFT,
    )


if __name__ == "__main__":
    main()
