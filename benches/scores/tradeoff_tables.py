"""The words, tables and chart of ``docs/measured/tradeoffs.md``."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from benches.common.chart_style import BLUE, FAINT, GREEN, INK, ORANGE, PINK, STYLE
from benches.common.markdown_tables import Table, count, hundredths, ms, thousandths
from slgaussian.benchmark.statistics import LEAST, LEVEL, compare

DEFAULT = ("defaults", "defaults")
"""Factor and name of the row that all others are compared with."""

NOISE = "seed"
PRUNED = "Gaussians kept"

PICTURE = "Query IoU, depth error and memory of every row, over its seconds; presets are named"

LOOKS = {
    "size": (BLUE, "o"),
    "depth candidates": (ORANGE, "s"),
    "replicas": (PINK, "v"),
    "codes": (GREEN, "D"),
    "lifting": ("#56B4E9", "^"),
    "together": ("#7a5200", "X"),
    "precision": ("#E69F00", "P"),
    NOISE: ("#999999", "."),
}
"""Colour and marker of a factor."""


LABELS = {
    "fast": ((9, -5), "left"),
    "balanced": ((-8, -15), "right"),
    "accurate": ((-8, 5), "right"),
}
"""Where the name of a preset stands beside its star, points, and how it is aligned."""

KEPT_SHARE = 0.85
"""Of the defaults' IoU and mIoU that the preset `fast` keeps at least."""

HEADINGS = {"iou": "IoU", "miou": "mIoU", "abs_rel": "depth error"}
"""What is compared with the first row."""


def signed(value: float) -> str:
    return f"{value:+.3f}"


def between(ends: tuple[float, float]) -> str:
    return f"{ends[0]:+.3f} to {ends[1]:+.3f}"


def ratio(value: float) -> str:
    return f"{100 * value:.0f} %"


_NAMED = {"factor": ("factor", str), "name": ("row", str)}

COSTS = Table(
    "What every row costs",
    "Processor seconds by stage, as others used the machine too; means over all scenes. *Build* is "
    "their sum, from photographs to field, and *of first* what that is of the first row's. *First* "
    "is rendering a new view and asking one text, *further* one more text in it. *Memory* is the "
    "most that a stage took beyond what the process held when it began, MB, in the scene that "
    "takes most.",
    _NAMED
    | {
        "geometry": ("geometry, s", hundredths),
        "masks": ("masks, s", hundredths),
        "supervision": ("supervision, s", hundredths),
        "field": ("field, s", hundredths),
        "build": ("build, s", hundredths),
        "share": ("of first", ratio),
        "first": ("first query, ms", ms),
        "further": ("further, ms", ms),
        "memory": ("memory, MB", count),
        "gaussians": ("Gaussians", count),
        "objects": ("objects", count),
    },
)
ERRORS = Table(
    "What every row gets wrong",
    "In views between the two photographs; means over scenes. *Depth* is the mean relative error "
    "of the rendered depth, *label* the share of pixels of true things that do not have the id "
    "which the thing mostly has in the context views, *IoU*, *point* and *mIoU* those of the "
    "queries by the protocol `slgaussian`.",
    _NAMED
    | {
        "office_abs_rel": ("office depth", thousandths),
        "office_psnr": ("PSNR", hundredths),
        "office_iou": ("IoU", thousandths),
        "office_hit": ("point", hundredths),
        "office_miou": ("mIoU", thousandths),
        "rooms_abs_rel": ("rooms depth", thousandths),
        "rooms_psnr": ("PSNR", hundredths),
        "rooms_label_error": ("label", thousandths),
        "rooms_iou": ("IoU", thousandths),
        "rooms_hit": ("point", hundredths),
        "rooms_miou": ("mIoU", thousandths),
    },
)
DIFFERENCES = Table(
    "What is beyond noise",
    f"Differences to the first row, means over all scenes, with {100 * LEVEL:.0f} % intervals of a "
    "paired bootstrap over scenes; better is more IoU and mIoU, and less error of depth. Stars "
    "mark intervals without 0. The office pairs are of one building and one walk, so that the "
    "intervals are rather too narrow.",
    _NAMED
    | {
        key: cell
        for score, heading in HEADINGS.items()
        for key, cell in (
            (f"{score}_gain", (heading, signed)),
            (f"{score}_ends", ("interval", between)),
            (f"{score}_beyond", ("", str)),
        )
    },
)
KEPT = Table(
    "Gaussians kept",
    "One office pair, as pruning takes long: every Gaussian is tried. No pixel of the views that "
    "it is given, the two photographs or also one halfway between them, may change by more than "
    "the bound, in colour or in codes; what they do not see goes, though the view that is asked in "
    "may show it. *Field* has the pruning in it; errors are those of that view.",
    {"name": ("row", str)}
    | {key: COSTS.columns[key] for key in ("field", "build", "first", "gaussians", "memory")}
    | {
        "psnr": ("PSNR", hundredths),
        "abs_rel": ("depth", thousandths),
        "iou": ("IoU", thousandths),
        "hit": ("point", hundredths),
        "miou": ("mIoU", thousandths),
    },
)
"""A table of its own: its rows are of one scene."""

MEANS = (
    "geometry", "masks", "supervision", "field", "build", "first", "further", "gaussians",
    "objects",
)  # fmt: skip


def summary(made: dict, first: dict) -> dict:
    """One row of the tables from what its scenes gave, compared with those of the defaults."""
    scenes, others = made["scenes"], first["scenes"]
    row: dict = {name: made[name] for name in ("factor", "name", "preset")}
    row |= {key: mean(scenes, key) for key in MEANS}
    row["share"] = row["build"] / mean(others, "build")
    row["memory"] = max(scene["memory"] for scene in scenes)
    for kind in ("office", "rooms"):
        own = [scene for scene in scenes if scene["kind"] == kind]
        for score in ("abs_rel", "psnr", "label_error", "iou", "hit", "miou"):
            value = mean(own, score)
            if not math.isnan(value):
                row[f"{kind}_{score}"] = value
    row |= {score: mean(scenes, score) for score in ("iou", "hit", "miou", "psnr", "abs_rel")}
    if made is not first and len(scenes) >= LEAST:
        for score in HEADINGS:
            found = compare([s[score] for s in scenes], [s[score] for s in others])
            row[f"{score}_gain"] = found.difference
            row[f"{score}_ends"] = found.low, found.high
            row[f"{score}_beyond"] = "*" if found.low > 0 or found.high < 0 else ""
    return row


def mean(scenes: Sequence[dict], key: str) -> float:
    values = [scene[key] for scene in scenes if key in scene]
    return float(np.mean(values)) if values else math.nan


def summaries(made: Sequence[dict]) -> list[dict]:
    """The rows of all scenes."""
    return [summary(one, made[0]) for one in made if one["factor"] != PRUNED]


def pruned(made: Sequence[dict]) -> list[dict]:
    """The rows of one scene, and the first row on the same."""
    own = [one for one in made if one["factor"] == PRUNED]
    if not own:
        return []
    names = {scene["scene"] for scene in own[0]["scenes"]}
    first = made[0] | {"scenes": [s for s in made[0]["scenes"] if s["scene"] in names]}
    return [summary(one, first) for one in (first, *own)]


def page(made: Sequence[dict], command: str, machine: str) -> str:
    rows = summaries(made)
    kinds = [scene["kind"] for scene in made[0]["scenes"]]
    tables = "\n".join(table.markdown(rows) for table in (COSTS, ERRORS, DIFFERENCES))
    few = pruned(made)
    kept = KEPT.markdown(few) if few else ""
    return f"""# Speed against error

Made by `{command} -o docs/measured` on {machine}:
{kinds.count("office")} office pairs (540 x 360) and
{kinds.count("rooms")} made-up rooms (720 x 520, by default shrunk to 576 x 416), one setting
changed at a time from the defaults, and a few together. The answers of every row are resized to the
default size and judged there, so that the loss of a small image counts. The bank of a field holds
float16 and its Gaussians hold float32. `original` is no larger than the default for an office pair.

![{PICTURE}](tradeoffs.svg)

{presets_said(rows)}

{noise_said(rows)}

{found_said(rows)}

Other pages measure the precision and candidates of [MVSplat](mvsplat.md), the cut-offs of the
[rasteriser](rasterizer.md), [trackers and copies](masks.md) on 50 rooms, and [codes](codes.md) on
many more scenes.

{tables}
{kept}"""


def picked(rows: Sequence[dict]) -> dict[str, dict]:
    """The row of each preset, as :func:`presets_said` puts the rules into words."""
    first = rows[0]
    settings = [row for row in rows if row["factor"] not in (NOISE, "precision")]
    good = [
        row for row in settings if all(row[s] >= KEPT_SHARE * first[s] for s in ("iou", "miou"))
    ]
    sound = [row for row in settings if not worse_scores(row)]
    best = max(map(answers_well, sound))
    as_good = [row for row in sound if answers_well(row) >= best - noise_of(rows)]
    found = {"fast": min(good, key=whole_seconds), "balanced": first}
    return found | {"accurate": min(as_good, key=whole_seconds)}


def answers_well(row: dict) -> float:
    return row["iou"] + row["miou"]


def whole_seconds(row: dict) -> float:
    """From photographs to the first answer."""
    return row["build"] + row["first"]


def noise_of(rows: Sequence[dict]) -> float:
    """How far rows that differ in the seed alone are apart, in :func:`answers_well`."""
    own = [answers_well(row) for row in rows if row["factor"] in (NOISE, DEFAULT[0])]
    return max(own) - min(own)


def worse_scores(row: dict) -> list[str]:
    """Those beyond noise."""
    return [
        score
        for score in HEADINGS
        if row.get(f"{score}_beyond") and (row[f"{score}_gain"] > 0) == (score == "abs_rel")
    ]


def presets_said(rows: Sequence[dict]) -> str:
    """By which rules presets are picked, and what each costs and loses, a sentence each."""
    said = [
        "## The presets",
        "",
        '`--preset NAME`, or `preset = "NAME"` in a file, is a row of the tables below. '
        "A rule picks each:",
        "",
        f"- `fast`: the least time from photographs to the first answer (*build* and *first "
        f"query*) of all rows that keep {ratio(KEPT_SHARE)} of the defaults' IoU and mIoU;",
        "- `balanced`: the defaults;",
        "- `accurate`: of all rows that lose no IoU, mIoU or depth beyond noise, those whose IoU + "
        f"mIoU is within the difference between seeds ({noise_of(rows):.3f}) of the greatest; the "
        "quickest of these.",
        "",
    ]
    for preset, row in picked(rows).items():
        of = "the defaults" if row["name"] == DEFAULT[1] else f"*{row['factor']}: {row['name']}*"
        costs = (
            f"{row['build']:.1f} s to build ({ratio(row['share'])} of the defaults), "
            f"{1e3 * row['first']:.0f} ms for a first query, {row['memory']:,.0f} MB"
        )
        lost = "; ".join(
            f"{heading} {row[f'{score}_gain']:+.3f} ({between(row[f'{score}_ends'])})"
            for score, heading in HEADINGS.items()
            if f"{score}_gain" in row
        )
        against = f" Against `balanced`: {lost}." if lost else ""
        wrong = "" if row["preset"] == preset else " **The file of the preset says otherwise.**"
        said.append(f"- `{preset}` is {of}: {costs}.{against}{wrong}")
    accurate = picked(rows)["accurate"]
    if accurate["build"] < rows[0]["build"] and "exact" in accurate["name"]:
        said += [
            "",
            "`accurate` is not slower than the defaults, because `exact` has less to do: each "
            "Gaussian holds the number of its object, and no codes are drawn, mixed and decoded. "
            "The defaults use the ID codes of the paper. A lifting that learns needs them, and "
            "they cost almost nothing in scores.",
        ]
    return "\n".join(said)


def noise_said(rows: Sequence[dict]) -> str:
    """How far results are apart that should be the same."""
    own = [row["iou"] for row in rows if row["factor"] in (NOISE, DEFAULT[0])]
    if len(own) < 2:
        return ""
    return (
        f"**Noise.** {len(own)} seeds, which draw other codes, have IoU from {min(own):.3f} to "
        f"{max(own):.3f}, so a difference of {max(own) - min(own):.3f} means nothing. A change of "
        "depth or of size moves the borders of objects a little, and can change the answer of a "
        "single query much. The intervals show what that amounts to over the scenes."
    )


def found_said(rows: Sequence[dict]) -> str:
    """Which single changes are beyond noise, and which nothing can be said against."""
    singles = [row for row in rows if row["factor"] not in ("together", NOISE, DEFAULT[0])]
    worse, better = [], []
    for row in singles:
        bad = worse_scores(row)
        good = [s for s in HEADINGS if row.get(f"{s}_beyond") and s not in bad]
        for scores, told in ((bad, worse), (good, better)):
            if scores:
                listed = ", ".join(HEADINGS[score] for score in scores)
                told.append(f"{row['factor']}: {row['name']} ({listed})")
    return (
        f"**Beyond noise.** Single changes that are worse: {'; '.join(worse) or 'none'}. Better: "
        f"{'; '.join(better) or 'none'}. With so many comparisons one in twenty stars is chance."
    )


# The chart.


def chart(made: Sequence[dict]) -> bytes:
    """SVG: what every row is worth, over what it costs, with the best of each price joined."""
    rows = summaries(made)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.5, 4.4), layout="constrained")
        iou, depth, memory = figure.subplots(1, 3)
        draw(iou, rows, "build", "iou", most=True)
        iou.set(title="Query IoU", xlabel="seconds of the processor to build")
        draw(depth, rows, "build", "abs_rel", most=False)
        depth.set(title="Depth error", xlabel="seconds of the processor to build")
        draw(memory, rows, "memory", "iou", most=True)
        memory.set(title="Query IoU", xlabel="memory, MB")
        figure.legend(
            *iou.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False
        )
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def draw(axes: Axes, rows: Sequence[dict], x: str, y: str, most: bool) -> None:
    axes.grid(color=FAINT)
    axes.margins(0.09, 0.12)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    front = best_by_price(rows, x, y, max if most else min)
    axes.plot(*zip(*front, strict=True), color=INK, lw=0.8, drawstyle="steps-post", label="front")
    for factor, (color, marker) in LOOKS.items():
        own = [(row[x], row[y]) for row in rows if row["factor"] == factor]
        if own:
            axes.scatter(*zip(*own, strict=True), color=color, marker=marker, s=28, label=factor)
    for name, row in picked(rows).items():
        axes.scatter(row[x], row[y], color=INK, marker="*", s=110, zorder=3)
        beside, side = LABELS[name]
        axes.annotate(
            name, (row[x], row[y]), beside, textcoords="offset points", ha=side, zorder=4,
            bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8},
        )  # fmt: skip


def best_by_price(
    rows: Sequence[dict], x: str, y: str, better: Callable[[float, float], float]
) -> list[tuple[float, float]]:
    """The Pareto front: what is better than everything that costs as much or less."""
    front: list[tuple[float, float]] = []
    for price, worth in sorted((row[x], row[y]) for row in rows):
        if not front or (worth != front[-1][1] and better(worth, front[-1][1]) == worth):
            front.append((price, worth))
    return front
