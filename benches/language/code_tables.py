"""The words and the picture of ``docs/measured/codes.md``."""

import io

import matplotlib
import matplotlib.ticker
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benches.common.chart_style import BLUE, FAINT, GREEN, ORANGE, STYLE
from benches.common.markdown_tables import Table, count, hundredths, ms

PICTURE = "Label error of code strategies against the time of a view, and a part of one view"
COLOURS = {"exact": GREEN, "grid": ORANGE, "separated": BLUE}
MARKERS = {3: "o", 2: "s", 1: "^"}
WINDOW = np.s_[120:330, 150:430]


def percent(value: float) -> str:
    return f"{100 * value:.2f}"


def whole(value: float) -> str:
    return f"{value:.0f}"


TABLES = {
    "errors": Table(
        "Label error",
        "Per cent of the pixels of novel views. *Wrong* is all that differs from the truth, no "
        "object where there is one included; *added* is that less what `exact` has wrong too, "
        "which is the geometry's doing: below 0 where looking at neighbours mends some of it. "
        "*Third* are wrong pixels that read an object with at most 5 % of the light there: the "
        "halo. *Differ* are those that read another object than `exact`. *Nearest alone* is the "
        "paper's decode, each pixel for itself. *AUC*: how probable it is that a wrong pixel has "
        "less confidence than a right one; *doubted*: share of the wrong pixels among the tenth "
        "with least confidence.",
        {
            "objects": ("objects", whole),
            "method": ("codes, numbers", str),
            "wrong": ("wrong", percent),
            "added": ("added", percent),
            "third": ("third", percent),
            "differ": ("differ", percent),
            "plain": ("nearest alone: wrong", percent),
            "plain_third": ("third", percent),
            "auc": ("AUC", hundredths),
            "doubted": ("doubted", hundredths),
        },
    ),
    "times": Table(
        "Time",
        "Milliseconds of one core for a view of 416x576 with 60 objects and half a million "
        "Gaussians, medians of a race; a second core halves *draw*, and nothing else is parallel. "
        "*Draw* is colours and codes in one pass, *read* from there to ids and "
        "confidence. *Every code* compares each pixel with every code, in NumPy, row by row, and "
        "does not look at neighbours; *ratio* is that over *read*. *Table* is made once for a "
        "scene.",
        {
            "method": ("codes, numbers", str),
            "draw": ("draw", ms),
            "read": ("read", ms),
            "both": ("both", ms),
            "all": ("every code", ms),
            "ratio": ("ratio", hundredths),
            "table": ("table", ms),
        },
    ),
    "placing": Table(
        "Placing codes",
        "Per cent of the mixtures of neighbours, by how much border they share, that are nearest "
        "to a third object's code; CPU seconds to find who is whose neighbour and to place the "
        "codes of `separated`. Three numbers a code.",
        {
            "objects": ("objects", whole),
            "pairs": ("pairs", count),
            "grid": ("grid", percent),
            "separated": ("separated", percent),
            "seconds": ("CPU s", hundredths),
        },
    ),
    "auto": Table(
        "As few numbers as needed",
        "What `dimension = auto` takes on average, so that at most 1 % of the mixtures of "
        "neighbours read as a third object (three numbers if none do), and what is left.",
        {
            "objects": ("objects", whole),
            "dimension": ("numbers", hundredths),
            "misread": ("mixtures, %", percent),
            "seconds": ("CPU s", hundredths),
        },
    ),
    "office": Table(
        "Photographs",
        "Per cent of the pixels of the target views of DATA; labels of the context views are found "
        "in the photographs, not given. *Wrong* counts pixels labelled by hand whose object mostly "
        "lies, read exactly, on another category: most of it is not the codes' doing.",
        {
            "method": ("codes, numbers", str),
            "objects": ("objects", whole),
            "differ": ("differ from exact", percent),
            "wrong": ("wrong", percent),
            "plain_differ": ("nearest alone: differ", percent),
            "plain_wrong": ("wrong", percent),
        },
    ),
}


def page(
    tables: dict[str, list[dict]], rooms: int, command: str, machine: str, picture: str
) -> str:
    """Markdown of all ``tables``, by the keys of ``TABLES``."""
    body = "\n".join(TABLES[key].markdown(tables[key]) for key in TABLES if key in tables)
    return f"""# ID codes, measured

Made by `{command}` on {machine}.

A Gaussian carries the code of its object. A rendered pixel is a mixture of codes, and it shows the
object whose code is nearest. Three ways to choose codes are compared:

- `grid`, the way of the paper: random points of an even grid;
- `separated`: a search gives neighbours codes whose mixtures stay away from every other code;
- `exact`: no codes. The rasteriser adds up the light of each object and keeps the greatest.

There are {rooms} made-up rooms for each number of objects, with two novel views each. Above 20
objects, objects are cut into pieces. The context views have their true labels. So the error comes
from codes and decoding, and from geometry, which is all of the error of `exact`.

![{PICTURE}]({picture})

{verdict(tables)}

{body}"""


def verdict(tables: dict[str, list[dict]]) -> str:
    """What the tables say, in a few sentences."""
    errors = {(row["objects"], row["method"]): row for row in tables["errors"]}
    most = max(objects for objects, _ in errors)
    times = {row["method"]: row for row in tables["times"]}
    grid, ours, exact = (errors[most, name] for name in ("grid, 3", "separated, 3", "exact"))
    three = times["separated, 3"]["both"]
    return (
        f"**What to take.** With {most:.0f} objects the geometry makes {percent(exact['wrong'])} % "
        f"of the pixels wrong. `grid` adds {percent(grid['added'])} %, and `separated` adds "
        f"{percent(ours['added'])} %. If each pixel is decoded alone, as in the paper, they add "
        f"{percent(grid['plain'] - exact['wrong'])} and {percent(ours['plain'] - exact['wrong'])} "
        "%. So `separated` with three numbers is the default. `exact` has no error of its own and "
        f"takes {100 * times['exact']['both'] / three:.0f} % of the time, but only the cpu backend "
        "draws it, and a Gaussian carries exactly one object. Two numbers a code take "
        f"{100 * times['separated, 2']['both'] / three:.0f} % of the time of three, and one takes "
        f"{100 * times['separated, 1']['both'] / three:.0f} %, because the rasteriser sums four "
        "channels at a time, and with colours and depth each of these needs eight or fewer."
    )


def picture(
    errors: list[dict], times: list[dict], crops: dict[str, tuple[np.ndarray, np.ndarray]]
) -> bytes:
    """PNG: errors over objects and over time, and a part of one view."""
    with matplotlib.rc_context({**STYLE, "font.size": 9, "axes.titlesize": 10}):
        figure = Figure(figsize=(11, 6.6), layout="constrained", dpi=100)
        upper, lower = figure.subfigures(2, 1, height_ratios=(1.6, 1))
        left, middle, right = upper.subplots(1, 3)
        _draw_counts(left, errors, "plain", "Nearest code alone: wrong pixels")
        _draw_counts(middle, errors, "wrong", "With a look at neighbours")
        middle.sharey(left)
        _draw_times(right, errors, times)
        _draw_crops(lower, crops)
        out = io.BytesIO()
        figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _draw_counts(axes: Axes, errors: list[dict], key: str, title: str) -> None:
    for method in dict.fromkeys(row["method"] for row in errors):
        name, _, dimension = method.partition(", ")
        mine = [row for row in errors if row["method"] == method]
        axes.plot(
            [row["objects"] for row in mine], [100 * row[key] for row in mine],
            color=COLOURS[name], marker=MARKERS[int(dimension or 3)], ms=5,
            ls="-" if dimension in ("", "3") else ":", label=method,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xticks([row["objects"] for row in errors if row["method"] == "exact"])
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:.0f}")
    axes.xaxis.set_minor_locator(matplotlib.ticker.NullLocator())
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.grid(color=FAINT)
    axes.set_title(title)
    axes.set_xlabel("objects")
    axes.set_ylabel("per cent")
    if key == "plain":
        axes.legend(frameon=False, fontsize=8)


def _draw_times(axes: Axes, errors: list[dict], times: list[dict]) -> None:
    objects = min({row["objects"] for row in errors}, key=lambda n: abs(n - 60))
    spent = {row["method"]: row for row in times}
    for row in errors:
        if row["objects"] != objects:
            continue
        name, _, dimension = row["method"].partition(", ")
        at = 1e3 * spent[row["method"]]["both"], 100 * row["wrong"]
        axes.plot(*at, color=COLOURS[name], marker=MARKERS[int(dimension or 3)], ms=7)
    axes.margins(0.12, 0.12)
    axes.set_xlim(left=0)
    axes.grid(color=FAINT)
    axes.set_title("Error against time, 60 objects")
    axes.set_xlabel("draw and read a view, ms of one core")
    axes.set_ylabel("wrong pixels, per cent")


def _draw_crops(figure: Figure, crops: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    colours = np.random.default_rng(3).uniform(0.45, 1, (1024, 3))
    colours[0] = 0
    for axes, (name, (ids, wrong)) in zip(
        figure.subplots(1, len(crops)), crops.items(), strict=True
    ):
        shown = np.where(wrong[..., None], (0.85, 0, 0), colours[ids % len(colours)])
        axes.imshow(shown[WINDOW], interpolation="nearest")
        axes.set_axis_off()
        axes.set_title(name, fontsize=9)
