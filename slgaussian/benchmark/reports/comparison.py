"""Comparison of runs: settings, methods, and differences of scores.

Only common samples are compared: the same query of the same frame, by the same version of a
protocol, evaluated at the same size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import ascii_uppercase
from typing import Any

from slgaussian.benchmark.reports import model
from slgaussian.benchmark.reports.score_tables import (
    difference_tables,
    fold_protocols,
    method_tables,
    protocol_scores,
)
from slgaussian.benchmark.scores import Difference, Rows, differences, sample_key
from slgaussian.errors import InputError
from slgaussian.formats.documents import read_json
from slgaussian.storage.encoding import decode_table
from slgaussian.storage.specs import load_spec

Row = Mapping[str, Any]

MAX_LISTED = 3
"""Largest number of scenes with differing data that are listed by name."""

SUMMARY = (
    "Only common samples are compared: the same query in the same frame of the same scene, by the "
    "same protocol at the same size."
)


@dataclass(frozen=True)
class Run:
    """Samples of a run, and its manifest, which may be empty."""

    folder: Path
    rows: Rows
    manifest: Mapping[str, Any]

    @property
    def by_method(self) -> dict[str, Rows]:
        """Return the samples of each method, ours first."""
        return {name: self.rows.where(method=name) for name in self.rows.values("method")}


def read_run(folder: str | Path) -> Run:
    """Read the output folder of a run.

    Raises:
        InputError: If ``samples.parquet`` is missing or cannot be read, or the manifest is invalid.
        SpecError: If a table is damaged or breaks its spec.
    """
    folder = Path(folder)
    file, manifest_file = folder / "samples.parquet", folder / "manifest.json"
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read ({error.strerror}), expected a folder that benchmark, run or "
            "demo wrote"
        ) from error
    manifest = read_json(manifest_file, "document") if manifest_file.exists() else {}
    if not isinstance(manifest, dict):
        raise InputError(f"{manifest_file}: found no JSON object; run the benchmark again")
    samples = decode_table(data, load_spec("samples"), str(file), "run it again")
    return Run(folder, Rows(samples), manifest)


def compare_runs(runs: Sequence[Run]) -> tuple[model.Report, list[dict[str, Any]]]:
    """Compare each run with the first, and rank their methods.

    Returns:
        The report, and the scores of each later run minus the first on common samples, as plain
        data. A row has the ``run``, ``method``, ``dataset``, ``protocol`` and ``metric``; the mean
        ``difference`` over the ``scenes``, with its interval, ``low`` to ``high``, None for a
        single place; and whether it ``decides``: it is of the first score of the first protocol of
        the data.

    Raises:
        InputError: If there are fewer than 2 or more than 26 runs, or one is given twice.
    """
    if not 2 <= len(runs) <= len(ascii_uppercase):
        raise InputError(
            f"compare: found {len(runs)} run{'s' if runs[1:] else ''}, expected 2 to "
            f"{len(ascii_uppercase)}"
        )
    folders = [run.folder.resolve() for run in runs]
    for run, folder in zip(runs, folders, strict=True):
        if folders.count(folder) > 1:
            raise InputError(f"compare: {run.folder} is given twice; give each folder once")
    named = dict(zip(ascii_uppercase, runs, strict=False))
    sections = [model.Section("Runs", [_runs_table(named)])]
    manifests = {letter: run.manifest for letter, run in named.items() if run.manifest}
    block: model.Block = model.Prose("No known difference in settings, versions or data.")
    if settings := differing_settings(list(manifests.values())):
        heads = [model.Column(name, is_text=True) for name in ("Setting", *manifests)]
        block = model.Table(heads, settings)
    sections.append(model.Section("Configuration", [block]))
    if tables := rank_methods(named):
        sections.append(model.Section("Scores", fold_protocols(tables)))
    (base, first), *later = named.items()
    rows, compared = [], dict[str, list[Difference]]()
    for letter, run in later:
        for method, baseline, samples in _pair_methods(first, run):
            found = differences(samples, baseline)
            compared[f"{method}, {letter}" if later[1:] else method] = found
            rows += [{"run": str(run.folder), "method": method, **row} for row in _as_rows(found)]
    if tables := difference_tables(compared):
        title = f"Differences: {'each run' if later[1:] else later[0][0]} minus {base}"
        sections.append(model.Section(title, fold_protocols(tables)))
    return model.Report("Comparison of runs", [model.Prose(SUMMARY)], sections), rows


def _as_rows(compared: Sequence[Difference]) -> Iterator[dict[str, Any]]:
    ranking: dict[str, tuple[str, str]] = {}
    for d in compared:
        first_score = d.protocol, protocol_scores(d.protocol)[0].metric
        row: dict[str, Any] = {n: getattr(d, n) for n in ("dataset", "protocol", "metric")}
        row["decides"] = ranking.setdefault(d.dataset, first_score) == (d.protocol, d.metric)
        row["difference"] = d.gain.difference
        has_interval = d.gain.independent_samples > 1
        row |= {n: getattr(d.gain, n) if has_interval else None for n in ("low", "high")}
        yield {**row, "scenes": d.gain.samples, "samples": d.samples}


def list_losses(runs: Sequence[Run], rows: Sequence[Row], tolerance: float) -> list[str]:
    """Describe what later runs lost: scenes of the first, or more than ``tolerance`` of a score.

    ``rows`` are those of :func:`compare_runs`; those that decide count.

    Raises:
        InputError: If none decides for a run, as it has no scored query in common with the first.
    """
    first, *later = runs
    expected = set(first.rows.values("scene"))
    lost = []
    for run in later:
        deciding = [row for row in rows if row["decides"] and row["run"] == str(run.folder)]
        if not deciding:
            raise InputError(
                f"compare: {run.folder} has no scored query in common with {first.folder}, so "
                "nothing is checked; give runs of the same scenes, queries and size"
            )
        if absent := sorted(expected - set(run.rows.values("scene"))):
            names = ", ".join(absent[:MAX_LISTED])
            lost.append(f"{run.folder}: lacks {len(absent)} of {len(expected)} scenes, as {names}")
        for row in deciding:
            if row["difference"] < -tolerance:
                loss = f"lost {-row['difference']:.4f} {row['metric']} on {row['dataset']}"
                scenes = model.count_text(row["scenes"], "scene")
                sure = f"{scenes} of one place: no interval"
                if row["low"] is not None:
                    bounds = f"{row['low']:+.4f} to {row['high']:+.4f}"
                    sure = f"interval of the difference {bounds}, {scenes}"
                lost.append(f"{run.folder}: {row['method']} {loss} ({sure})")
    return lost


def _runs_table(named: Mapping[str, Run]) -> model.Table:
    """List the runs, and the number of samples that each shares with the first."""
    first = named["A"]
    rows = []
    for letter, run in named.items():
        pairs: list[tuple[Row, Row]] = []
        for _, mine, baseline in _pair_methods(first, run):
            theirs = {sample_key(row): row for row in baseline}
            pairs += [(row, theirs[key]) for row in mine if (key := sample_key(row)) in theirs]
        changed = sum({**a, "method": ""} != {**b, "method": ""} for a, b in pairs)
        scenes = len(run.rows.values("scene"))
        counts = (scenes, len(run.by_method), len(run.rows), len(pairs), changed)
        rows.append([letter, str(run.folder), *map(str, counts)])
    folder = model.Column("Folder", is_text=True)
    heads = ["", folder, "Scenes", "Methods", "Samples", "Common with A", "Changed"]
    return model.Table(heads, rows)


def _pair_methods(first: Run, second: Run) -> Iterator[tuple[str, Rows, Rows]]:
    """Pair the samples of each common method; without one, those of their first methods."""
    earlier, later = first.by_method, second.by_method
    shared = [name for name in earlier if name in later]
    for name in shared:
        yield name, earlier[name], later[name]
    if not shared and earlier and later:
        (name, rows), (rival, rival_rows) = next(iter(earlier.items())), next(iter(later.items()))
        yield f"{rival} − {name}", rows, rival_rows


def differing_settings(manifests: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """List the differing leaves of manifests: the name, and the value in each.

    Data are listed in one line: the scenes that are missing or differ in a manifest from the
    first manifest that contains them.
    """
    leaves = [model.flatten({**manifest, "data": {}}) for manifest in manifests]
    names = dict.fromkeys(name for by_name in leaves for name in by_name)
    lines = [[name, *(by_name.get(name, model.NO_VALUE) for by_name in leaves)] for name in names]
    data = [manifest.get("data", {}) for manifest in manifests]
    first: dict[str, Any] = {}
    for by_scene in data:
        first = by_scene | first
    texts = []
    for by_scene in data:
        scenes = [scene for scene, content in first.items() if by_scene.get(scene) != content]
        rest = f" and {len(scenes) - MAX_LISTED} more" if scenes[MAX_LISTED:] else ""
        texts.append(", ".join(scenes[:MAX_LISTED]) + rest or "none")
    lines.append(["data: missing or different scenes", *texts])
    return [line for line in lines if len(set(line[1:])) > 1]


def rank_methods(named: Mapping[str, Run]) -> list[model.Table]:
    """Rank the methods of all runs by their scores on the common samples.

    For each data set, only runs that contain it are used. A scene is used if its ground truth is
    equal, as far as the manifests record it.
    """
    by_dataset: dict[str, dict[str, Rows]] = {}
    for letter, run in named.items():
        for dataset in run.rows.values("dataset"):
            by_dataset.setdefault(dataset, {})[letter] = run.rows.where(dataset=dataset)
    common: list[Row] = []
    for by_run in by_dataset.values():
        truths: dict[str, set[str]] = {}
        for letter in by_run:
            for scene, data in named[letter].manifest.get("data", {}).items():
                truths.setdefault(scene, set()).update(filter(None, [data.get("truth")]))
        shared = set.intersection(*(set(map(sample_key, rows)) for rows in by_run.values()))
        common += [
            {**row, "method": f"{row['method']}, {letter}"}
            for letter, rows in by_run.items()
            for row in rows
            if sample_key(row) in shared and len(truths.get(row["scene"], ())) < 2
        ]
    return method_tables(Rows.from_rows(common))
