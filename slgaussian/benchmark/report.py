"""What a benchmark leaves behind: one HTML page to look at, tables and masks to score again.

Everything written here depends on its arguments alone: same results, same bytes.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pyarrow as pa

from data_specs import load_spec
from slgaussian.benchmark.evaluate import (
    ALONG_THE_WAY,
    ERROR_TOP,
    NOT_UNDERSTOOD,
    SceneResult,
)
from slgaussian.benchmark.pictures import encode_jpeg
from slgaussian.benchmark.scores import score_table
from slgaussian.errors import InputError
from slgaussian.store import encode_table, write_atomic

PICTURE_WIDTH = 520
"""Pictures in the report are at most this wide, pixels."""

SHOWN_QUERIES = 6
"""Queries of a scene that get pictures: half of them the best answered, half the worst."""

LARGEST_THING = 0.2
"""Share of an image above which what was found is no picture to open the page with."""


@dataclass(frozen=True)
class Metric:
    """A column of the summary: how a scene metric is called and printed."""

    key: str
    title: str
    digits: int
    help: str


METRICS = (
    Metric("iou", "IoU", 3, "mean over queries of one mask each against the labelled mask"),
    Metric("hit_mask", "Point in mask", 2, "share of queries whose point lies on the object"),
    Metric("hit_box", "Point in box", 2, "the same against the object's box, as LERF counts"),
    Metric("hit_peak", "Peak in box", 2, "any of the most relevant pixels, as LangSplat counts"),
    Metric("miou", "mIoU", 3, "all queries compete for each pixel; mean class IoU, whole image"),
    Metric("psnr", "PSNR", 1, "dB, rendered novel view against the photograph"),
    Metric("ssim", "SSIM", 3, "rendered novel view against the photograph"),
    Metric(
        "abs_rel", "Depth abs-rel", 3, "context views, all pixels with true depth; less is better"
    ),
    Metric("delta125", "δ < 1.25", 3, "share of pixels whose depth is within 25 %"),
    Metric("bad2", "bad-2.0", 3, "rectified pairs: share of pixels over 2 px off; less is better"),
    Metric(
        "target_abs_rel", "Novel abs-rel", 3, "depth rendered at the novel view; less is better"
    ),
)


TIMES_HERE = "<!-- how long it took -->"
"""Where :func:`with_times` puts what differs from run to run."""


def render_report(
    results: Sequence[SceneResult],
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]] = (),
) -> str:
    """One self-contained HTML page: no network, no script, the same bytes from run to run.

    Parameters
    ----------
    results : sequence of SceneResult
        Their times are not shown.
    manifest : mapping
        Versions and settings, nested mappings allowed.
    failures : sequence of mapping
        Scenes left out: ``scene``, ``stage``, ``reason`` (the columns of ``failures.parquet``).
    """
    shown = [m for m in METRICS if any(m.key in r.scene_metrics for r in results)]
    scenes = [_scene(result, f"scene-{i}") for i, result in enumerate(results)]
    return template("report.html.j2").render(
        metrics=shown,
        scenes=scenes,
        hero=_hero(results, scenes),
        means={m.key: _macro_mean(results, m.key) for m in shown},
        protocol=_protocol(results),
        failures=failures,
        manifest=flatten(manifest),
        error_top=ERROR_TOP,
        times_here=TIMES_HERE,
    )


def with_times(
    page: str,
    times: Mapping[str, float],
    scene_times: Mapping[str, Mapping[str, float]],
    host: Mapping[str, str],
) -> str:
    """The page of :func:`render_report` with what is true of one run on one machine only.

    ``times`` are seconds by stage, ``scene_times`` those of the evaluation by scene, and ``host``
    says where it ran.
    """
    section = template("times.html.j2").render(
        times=times, scene_times=scene_times, host=flatten(host)
    )
    return page.replace(TIMES_HERE, section)


def write_samples(results: Sequence[SceneResult], out: str | Path) -> None:
    """Write ``samples.parquet`` and ``samples.csv`` into folder ``out``: a row a sample.

    Columns are those of the data spec ``samples``. Beside them ``scores.parquet`` and
    ``scores.csv``, what the samples amount to, of the spec ``scores``.
    """
    rows = [row for result in results for row in result.rows]
    samples = pa.Table.from_pylist(rows, schema=load_spec("samples").schema)
    for name, table in (("samples", samples), ("scores", score_table(rows))):
        _write(Path(out) / f"{name}.parquet", encode_table(table))
        text = io.StringIO()
        writer = csv.DictWriter(text, table.column_names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(table.to_pylist())
        _write(Path(out) / f"{name}.csv", text.getvalue().encode())


def write_predictions(
    rows: Sequence[Mapping[str, Any]],
    predictions: Mapping[tuple[str, str, str], bytes],
    out: str | Path,
) -> None:
    """Write every mask to ``out/<method>/<protocol>/<scene>/<frame>/<query>.png``, white = found.

    ``predictions`` are PNG files by protocol, frame and query, as ``rows`` have them. The protocol
    goes without its version, and the frame is named as its label file is, without folder and
    ending; all names are made safe for any file system by :func:`file_name`. A protocol without
    masks has no folder.
    """
    for row in rows:
        png = predictions.get(_key(row))
        if png is not None:
            protocol, frame = row["protocol"].partition("@")[0], Path(row["frame"]).stem
            folder = map(file_name, (row["method"], protocol, row["scene"], frame))
            _write(Path(out, *folder, f"{file_name(row['query'])}.png"), png)


def file_name(text: str) -> str:
    """A file name for any text: ASCII letters, digits, space, ``.``, ``-`` and ``_``.

    A text that has nothing else keeps its looks, as the class masks of 3D-OVS do; any other gets a
    hash of itself at the end, so that different texts keep different names.
    """
    safe = re.sub(r"[^A-Za-z0-9._ -]+", "_", text).strip(" .")[:80]
    if safe and safe == text:
        return safe
    return f"{safe}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def template(name: str) -> jinja2.Template:
    """The template of that file name beside this module."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slgaussian.benchmark", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(name)


def _scene(result: SceneResult, anchor: str) -> dict[str, Any]:
    """What the template needs of one scene, pictures encoded."""
    images = {name: _data_uri(picture) for name, picture in result.pictures.items()}

    def frames(kind: str) -> list[str]:
        return [name.split("/", 1)[1] for name in images if name.startswith(f"{kind}/")]

    return {
        "name": result.scene,
        "anchor": anchor,
        "metrics": result.scene_metrics,
        "images": images,
        "inputs": frames("input"),
        "targets": frames("photo"),
        "path": [frame for frame in ALONG_THE_WAY if f"render/{frame}" in images],
        "queries": _choose(_leading(result)),
        "rows": _leading(result),
    }


def _leading(result: SceneResult) -> list[dict[str, Any]]:
    """The rows of the first protocol, which the page shows."""
    return [row for row in result.rows if row["protocol"] == result.rows[0]["protocol"]]


def _key(row: Mapping[str, Any]) -> tuple[str, str, str]:
    """Of the row's mask among the predictions."""
    return row["protocol"], row["frame"], row["query"]


def _choose(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The best and the worst answered queries, best first, each in the first frame that has it.

    Queries without truth come after those with, in their order; those that are not understood
    have nothing to show.
    """
    answered = [row for row in rows if row["score"] is not None]
    truthful = [row for row in answered if row["iou"] is not None]
    first = {row["query"]: row for row in reversed(truthful)}
    scored = sorted(first.values(), key=lambda row: (-row["iou"], row["query"]))
    unscored = [row for row in answered if row["iou"] is None and row["query"] not in first]
    if len(scored) > SHOWN_QUERIES:
        half = SHOWN_QUERIES // 2
        scored = scored[:half] + scored[-half:]
    return scored + unscored[: SHOWN_QUERIES - len(scored)]


def _hero(
    results: Sequence[SceneResult], scenes: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any] | None:
    """The scene and row whose pictures open the page: the best found thing, not a wall or floor."""
    best, chosen = -1.0, None
    for result, scene in zip(results, scenes, strict=True):
        for row in scene["queries"]:
            share = result.predictions[_key(row)].mean()
            value = (row["iou"] or 0.0) + (0 < share < LARGEST_THING)
            if value > best:
                best, chosen = value, {"scene": scene, "row": row}
    return chosen


def _macro_mean(results: Sequence[SceneResult], key: str) -> float:
    """Unweighted mean over the scenes that have the metric, as LangSplat averages its scenes."""
    return float(np.mean([r.scene_metrics[key] for r in results if key in r.scene_metrics]))


def _protocol(results: Sequence[SceneResult]) -> dict[str, Any]:
    """What was asked and how, in a few words each."""
    rows = [row for result in results for row in _leading(result)]
    said = "method", "protocol", "selection", "threshold", "share", "filter", "temperature"
    asked = {
        key: ", ".join(sorted({"none" if row[key] is None else str(row[key]) for row in rows}))
        for key in (*said, "canonical")
    }
    return asked | {
        "scored": sum(row["iou"] is not None for row in rows),
        "unscored": sum(row["iou"] is None for row in rows),
        "unknown": sum(row["note"].startswith(NOT_UNDERSTOOD) for row in rows),
    }


def flatten(tree: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """The leaves of nested mappings as text, keys joined by dots."""
    flat: list[tuple[str, str]] = []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat += flatten(value, f"{prefix}{key}.")
        else:
            flat.append((f"{prefix}{key}", str(value)))
    return flat


def _data_uri(picture: np.ndarray) -> str:
    data = encode_jpeg(picture, PICTURE_WIDTH)
    return f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


def _write(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, data)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a folder you may write to"
        ) from error
