"""What settings are worth against what they cost: rows by setting, fronts, and a proposal.

A row of the spec ``tradeoffs`` is a setting and a scene. Errors go from 0 to 1, less is better:
where something is labelled, what the IoU lacks; of photographs that were held out, the root mean
square difference of the drawn view, as a share of the range; otherwise what the agreement with the
settings as given lacks. The first that all rows have is the one that settings are judged by.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from slgaussian.benchmark.plots import ACCENT, COLORS, MARKERS, SOFT, as_svg
from slgaussian.benchmark.rendering import data_uri, template
from slgaussian.benchmark.report import Report
from slgaussian.benchmark.scores import place_of
from slgaussian.benchmark.speed_error import front
from slgaussian.benchmark.statistics import LEAST, LEVEL, compare
from slgaussian.benchmark.summary import METRICS

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]

GIVEN, SEED = "as given", "seed"
"""Factors of the row that the others are compared with, and of rows that show the noise."""

STAGES = ("read", "geometry", "masks", "supervision", "field")
DIGITS = 3
"""Of an error that is printed: what is the same there is the same on a front."""

QUIET = 0.7
"""Processor seconds a second of wall time below which others had the cores: alone, a stage has 0.9
and more, and as many as there are cores where it runs on all."""

SIDE = 300
"""Width of a picture of the page, pixels."""

ERRORS = {
    "words": "of words: what the IoU of the masks found and the labelled ones lacks to 1",
    "view": "of a new view: root mean square difference from the photograph that was held out, as "
    "a share of the range",
    "change": "by change: what the agreement of its objects with those of the first row lacks to 1",
}
"""The errors, the one that counts first."""

SCORES = ("iou", "miou", "hit_mask", "psnr", "target_abs_rel", "agreement")

TITLES = {metric.key: metric.title for metric in METRICS} | {"agreement": "Agreement"}
"""What a score is called on the page."""


@dataclass(frozen=True)
class Weighed:
    """A setting: means over the scenes of what it gets wrong, and what it costs.

    Attributes
    ----------
    factor, setting, options : str
        As in the spec.
    seconds : {stage: float}
        Of building, medians over scenes.
    query : float or None
        Seconds of a query in a new view, the median over scenes.
    grown : int or None
        Bytes, of the scene that takes most.
    gaussians, kept, objects : float
        Means.
    scores : {column: float}
        Means of those that all scenes have.
    error : float
        By the error that counts.
    errors : {name: float}
        All that are known, names of :data:`ERRORS`.
    scenes : int
    worked : float or None
        Processor seconds of building, the median over scenes.
    wall : bool
        Whether settings are weighed by seconds of wall time, or by those of the processor.
    gain, low, high : float or None
        Mean difference of the error to the first setting, and its interval over places and scenes,
        with :data:`LEAST` of them at least.
    quickest, smallest : bool
        Whether no other setting of as small an error is quicker, or takes less memory.
    """

    factor: str
    setting: str
    options: str
    seconds: Mapping[str, float]
    query: float | None
    grown: int | None
    gaussians: float
    kept: float
    objects: float
    scores: Mapping[str, float]
    error: float
    errors: Mapping[str, float]
    scenes: int
    worked: float | None = None
    wall: bool = True
    gain: float = 0.0
    low: float | None = None
    high: float | None = None
    quickest: bool = False
    smallest: bool = False

    @property
    def build(self) -> float:
        """Seconds from photographs to a field."""
        return sum(self.seconds.values())

    @property
    def whole(self) -> float:
        """Seconds that count: to the first answer, or of the processor to build."""
        if not self.wall and self.worked is not None:
            return self.worked
        return self.build + (self.query or 0.0)

    @property
    def unit(self) -> str:
        """What the seconds that count are of."""
        return "to the first answer" if self.wall else "of the processor, to build"

    @property
    def called(self) -> str:
        """Its name on a page."""
        return self.setting if self.factor == GIVEN else f"{self.factor}: {self.setting}"

    def as_json(self) -> dict[str, Any]:
        """Plain data, for a file."""
        return {**asdict(self), "build_seconds": self.build, "whole_seconds": self.whole}


@dataclass(frozen=True)
class Wanted:
    """What a user wants: seconds from photographs to an answer, MB, an error from 0 to 1."""

    seconds: float | None = None
    memory: float | None = None
    error: float | None = None


@dataclass(frozen=True)
class Proposal:
    """The setting that fits what is wanted, None if none does, and why."""

    chosen: Weighed | None
    said: str

    def as_json(self) -> dict[str, Any]:
        """Plain data, for a file."""
        proposed = None if self.chosen is None else self.chosen.options
        return {"proposed_options": proposed, "why": self.said}


def weigh(rows: Sequence[Row]) -> list[Weighed]:
    """The settings of all scenes, the first one first; rows in the order of the settings.

    They are weighed by seconds of wall time, or, if other programs kept the machine busy meanwhile
    (:data:`QUIET`), by those of the processor.
    """
    worked = [row["processor_seconds"] for row in rows]
    took = sum(row[f"{name}_seconds"] for row in rows for name in STAGES)
    wall = None in worked or sum(filter(None, worked)) >= QUIET * took
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["factor"], row["setting"]), []).append(row)
    if not groups:
        return []
    names = [name for name in ERRORS if all(_errors(row).get(name) is not None for row in rows)]
    first = next(iter(groups.values()))
    weighed = [_weighed(own, first, names, wall) for own in groups.values()]
    values = [-round(one.error, DIGITS) for one in weighed]
    quick = front([one.whole for one in weighed], values)
    small = front([one.grown for one in weighed], values)
    return [
        replace(one, quickest=q, smallest=s)
        for one, q, s in zip(weighed, quick, small, strict=True)
    ]


def _errors(row: Row) -> dict[str, float | None]:
    psnr = row["psnr"]
    return {
        "words": None if row["iou"] is None else 1 - row["iou"],
        "view": None if psnr is None else 10 ** (-psnr / 20),
        "change": None if row["agreement"] is None else 1 - row["agreement"],
    }


def _weighed(
    rows: Sequence[Row], first: Sequence[Row], names: Sequence[str], wall: bool
) -> Weighed:
    errors = {name: float(np.mean([_errors(row)[name] for row in rows])) for name in names}
    leading = names[0]
    gain, low, high = 0.0, None, None
    if rows is not first:
        own, others = ([_errors(row)[leading] or 0.0 for row in of] for of in (rows, first))
        found = compare(own, others, groups=[place_of(row) for row in rows])
        gain = found.difference
        if found.drawn >= LEAST:
            low, high = found.low, found.high
    queries = [row["query_seconds"] for row in rows if row["query_seconds"] is not None]
    worked = [row["processor_seconds"] for row in rows if row["processor_seconds"] is not None]
    grown = [row["grown_bytes"] for row in rows if row["grown_bytes"] is not None]
    return Weighed(
        rows[0]["factor"],
        rows[0]["setting"],
        rows[0]["options"],
        seconds={name: median(row[f"{name}_seconds"] for row in rows) for name in STAGES},
        query=median(queries) if queries else None,
        grown=max(grown, default=None),
        gaussians=_mean(rows, "gaussians"),
        kept=_mean(rows, "kept"),
        objects=_mean(rows, "objects"),
        scores={
            name: _mean(rows, name) for name in SCORES if all(row[name] is not None for row in rows)
        },
        error=errors[leading],
        errors=errors,
        scenes=len(rows),
        worked=median(worked) if worked else None,
        wall=wall,
        gain=gain,
        low=low,
        high=high,
    )


def _mean(rows: Sequence[Row], name: str) -> float:
    return float(np.mean([row[name] for row in rows]))


def noise(weighed: Sequence[Weighed]) -> dict[str, float]:
    """How far the seed alone moves each error; 0 without rows that change it."""
    first, own = weighed[0], [one for one in weighed if one.factor == SEED]
    return {
        name: max((abs(one.errors[name] - first.errors[name]) for one in own), default=0.0)
        for name in first.errors
    }


def propose(weighed: Sequence[Weighed], wanted: Wanted) -> Proposal:
    """The setting that fits what is wanted best.

    With a wanted error the quickest whose error is no greater. Otherwise the one of the least error
    among those that are quick and small enough; of several whose errors, all that are known, are
    the same within :func:`noise`, or as printed, the quickest.
    """
    known = [one for one in weighed if one.factor != SEED]
    fitting = [one for one in known if not list(_misses(one, wanted))]
    if not fitting:
        return Proposal(None, _nearest(known, wanted))
    if wanted.error is not None:
        chosen = min(fitting, key=lambda one: one.whole)
        return Proposal(chosen, f"it is the quickest with an error of at most {wanted.error:g}")
    slack, left = noise(weighed), fitting
    for name in weighed[0].errors:
        least = min(one.errors[name] for one in left)
        most = least + max(slack[name], 10**-DIGITS)
        left = [one for one in left if one.errors[name] <= most]
    chosen = min(left, key=lambda one: one.whole)
    given = (wanted.seconds, "s"), (wanted.memory, "MB")
    bounds = [f"{bound:g} {unit}" for bound, unit in given if bound is not None]
    within = f" of what fits in {' and '.join(bounds)}" if bounds else ""
    more = f", and the quickest of {len(left)} that are no worse beyond noise" if left[1:] else ""
    return Proposal(chosen, f"it has the least error{within}{more}")


def _misses(one: Weighed, wanted: Wanted) -> Iterable[str]:
    if wanted.seconds is not None and one.whole > wanted.seconds:
        yield "seconds"
    if wanted.memory is not None and (one.grown is None or one.grown > 1e6 * wanted.memory):
        yield "memory"
    if wanted.error is not None and one.error > wanted.error:
        yield "error"


def _nearest(known: Sequence[Weighed], wanted: Wanted) -> str:
    """Why nothing fits: what comes nearest to each thing that is wanted."""
    told = []
    if wanted.seconds is not None:
        best = min(known, key=lambda one: one.whole)
        told.append(f"the quickest, {best.called}, takes {best.whole:.2g} s")
    if wanted.memory is not None:
        sizes = [one for one in known if one.grown is not None]
        if not sizes:
            told.append("memory is not known on this system")
        else:
            best = min(sizes, key=lambda one: one.grown or 0)
            told.append(f"the smallest, {best.called}, takes {(best.grown or 0) / 1e6:.0f} MB")
    if wanted.error is not None:
        best = min(known, key=lambda one: one.error)
        told.append(f"the most accurate, {best.called}, has an error of {best.error:.3f}")
    return "no setting of the sweep fits all that is wanted: " + "; ".join(told)


def render_tradeoffs(
    weighed: Sequence[Weighed],
    proposal: Proposal,
    host: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]] = (),
    pictures: Mapping[tuple[str, str], Images] | None = None,
) -> Report:
    """The page, without network and script, and the same as Markdown.

    Parameters
    ----------
    weighed : sequence of Weighed
        The first is what the others are compared with.
    proposal : Proposal
    host : mapping
        ``processor``, and ``elsewhere``: those of results that were made on others.
    failures : sequence of mapping
        ``scene``, ``stage``, ``reason``.
    pictures : {(factor, setting): images}
        Of one scene, by the names of :attr:`~slgaussian.benchmark.evaluate.SceneResult.pictures`.
    """
    shown = {
        "weighed": weighed,
        "first": weighed[0],
        "leading": next(iter(weighed[0].errors)),
        "errors": {name: ERRORS[name] for name in weighed[0].errors},
        "noise": noise(weighed),
        "seeds": sum(one.factor == SEED for one in weighed),
        "proposal": proposal,
        "host": host,
        "failures": failures,
        "stages": STAGES,
        "titles": TITLES,
        "level": LEVEL,
        "least": LEAST,
        "stars": any(one.low is not None for one in weighed),
    }
    html = template("tradeoffs.html.j2").render(
        **shown, plots=charts(weighed, proposal), views=_views(weighed, proposal, pictures or {})
    )
    return Report(html, template("tradeoffs.md.j2").render(**shown))


def charts(weighed: Sequence[Weighed], proposal: Proposal) -> dict[str, str]:
    """Plots as SVG by caption: the error that counts, and that of words or change beside it."""
    leading, *others = weighed[0].errors
    seconds = f"seconds {weighed[0].unit}"
    found = {
        f"error {ERRORS[leading].partition(':')[0]} over {seconds}": _chart(
            weighed, proposal, leading, "whole", seconds
        )
    }
    if all(one.grown for one in weighed):
        found[f"error {ERRORS[leading].partition(':')[0]} over memory"] = _chart(
            weighed, proposal, leading, "megabytes", "memory, MB"
        )
    for name in others:
        found[f"error {ERRORS[name].partition(':')[0]} over {seconds}"] = _chart(
            weighed, proposal, name, "whole", seconds
        )
    return found


def _chart(
    weighed: Sequence[Weighed], proposal: Proposal, error: str, cost: str, label: str
) -> str:
    """One error over one cost, with the front; each factor has a colour and a mark."""
    prices = [one.whole if cost == "whole" else (one.grown or 0) / 1e6 for one in weighed]
    values = [round(one.errors[error], DIGITS) for one in weighed]
    on_front = front(prices, [-value for value in values])
    factors = list(dict.fromkeys(one.factor for one in weighed if one.factor not in (GIVEN, SEED)))
    looks = {
        factor: (COLORS[k % len(COLORS)], MARKERS[(k + k // len(COLORS)) % len(MARKERS)])
        for k, factor in enumerate(factors)
    } | {SEED: (SOFT, "."), GIVEN: (ACCENT, "o")}

    def draw() -> Figure:
        figure = Figure((5.6, 4.6), layout="constrained")
        axes = figure.subplots()
        line = sorted((p, v) for p, v, good in zip(prices, values, on_front, strict=True) if good)
        axes.plot(*zip(*line, strict=True), color=SOFT, lw=0.8, drawstyle="steps-post", zorder=1)
        for factor, (color, marker) in looks.items():
            own = [
                (p, v) for one, p, v in zip(weighed, prices, values, strict=True)
                if one.factor == factor
            ]  # fmt: skip
            if own:
                axes.scatter(
                    *zip(*own, strict=True), color=color, marker=marker, s=38, label=factor,
                    edgecolors="white", linewidths=0.6, zorder=3 if factor == GIVEN else 2,
                )  # fmt: skip
        if proposal.chosen is not None:
            k = list(weighed).index(proposal.chosen)
            axes.scatter(
                prices[k], values[k], s=190, facecolors="none", edgecolors=ACCENT, linewidths=1.4,
                zorder=4, label="proposed",
            )  # fmt: skip
        axes.set(xscale="log", xlabel=label, ylabel=f"error {ERRORS[error].partition(':')[0]}")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.margins(0.1, 0.14)
        axes.grid()
        figure.legend(
            *axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False,
            fontsize=8,
        )  # fmt: skip
        return figure

    return as_svg(draw)


def pictured(weighed: Sequence[Weighed], proposal: Proposal) -> list[Weighed]:
    """The settings that get a picture: as given, as proposed, and the quickest, each once."""
    quickest = min((one for one in weighed if one.factor != SEED), key=lambda one: one.whole)
    wanted = (weighed[0], proposal.chosen, quickest)
    return list({one.called: one for one in wanted if one is not None}.values())


def _views(
    weighed: Sequence[Weighed], proposal: Proposal, pictures: Mapping[tuple[str, str], Images]
) -> list[dict[str, str]]:
    """A new view with the settings as given, as proposed, and with the quickest."""
    first = weighed[0]
    quickest = min((one for one in weighed if one.factor != SEED), key=lambda one: one.whole)
    shown: dict[str, list[str]] = {}
    for one, why in ((first, "as given"), (proposal.chosen, "proposed"), (quickest, "quickest")):
        if one is not None and (one.factor, one.setting) in pictures:
            shown.setdefault(one.called, []).append(why)
    by_name = {one.called: one for one in weighed}
    found: list[dict[str, str]] = []
    for called, reasons in shown.items():
        one, why = by_name[called], ", ".join(reasons)
        images = pictures[one.factor, one.setting]
        frame = _frame(images)
        if not frame:
            continue
        if not found and f"photo/{frame}" in images:
            uri = data_uri(images[f"photo/{frame}"], SIDE * 2)
            found.append({"uri": uri, "caption": f"{frame}: the photograph that was held out"})
        said = f"{why}: {one.whole:.1f} s, error {one.error:.3f}"
        for kind in ("render", "ids"):
            told = said if kind == "render" else f"its objects, {why}"
            found.append({"uri": data_uri(images[f"{kind}/{frame}"], SIDE * 2), "caption": told})
    return found


def _frame(images: Images) -> str:
    """The view that is shown: a target, or halfway."""
    frames = [name.split("/", 1)[1] for name in images if name.startswith("render/")]
    targets = [frame for frame in frames if f"photo/{frame}" in images]
    return next(iter([*targets, *(f for f in frames if f == "halfway"), *frames]), "")
