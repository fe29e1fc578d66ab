"""A method of another package in a run, and `slgaussian score` on masks of a run."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from slgaussian.benchmark.external_predictions import SCORABLE
from slgaussian.benchmark.protocols import PROTOCOLS
from tests.flows.command import ROOM, room, settings, write_photographs

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "tests" / "benchmark" / "other_method"
SIZE = ("--size", "64x64")


@pytest.fixture(scope="module")
def labelled(tmp_path_factory) -> Path:
    """Photographs of the small room with cameras, two polygons on the middle one, and an index."""
    folder = tmp_path_factory.mktemp("set")
    scene = room()
    write_photographs(folder, {f"{name}.png": scene.read(name) for name in scene.cameras})
    (target,) = ROOM["targets"]
    instances = scene.read(target).instances
    sizes = {i: (instances == i).sum() for i in scene.phrases}
    largest = sorted(sizes, key=lambda i: -sizes[i])[:3]
    objects = []
    for number in largest:
        rows, columns = np.nonzero(instances == number)
        (x0, x1), (y0, y1) = ((int(v.min()), int(v.max())) for v in (columns, rows))
        polygon = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
        box = [x0, y0, x1, y1]
        text = scene.phrases[number]
        objects.append({"category": text, "segmentation": polygon, "bbox": box})
    (folder / "labels").mkdir()
    info = {"name": f"{target}.png", "width": 64, "height": 64}
    (folder / "labels" / f"{target}.json").write_text(
        json.dumps({"info": info, "objects": objects})
    )
    queries = [*dict.fromkeys(one["category"] for one in objects), "purple elephant"]
    entry = {"context": [f"{n}.png" for n in ROOM["context"]], "target": [f"{target}.png"]}
    index = {
        "version": 2,
        "format": "nerfstudio",
        "rule": {},
        "scenes": {"desk": {**entry, "categories": queries}},
        "left_out": {},
    }
    (folder / "pairs.json").write_text(json.dumps(index))
    return folder


def data(folder: Path, pairs: bool = True) -> list:
    index = ["--pairs", folder / "pairs.json"] if pairs else []
    return ["--data", folder, *index, "--labels", folder / "labels", *SIZE]


def benchmark(labelled: Path, package: Path, out: Path) -> None:
    """Run the benchmark in a new process, in which the package is installed."""
    words = ["benchmark", *data(labelled), *settings(near=0.8, far=12, replicas=1)]
    words += ["--against", "colours", "-o", out, "--store", out.parent / "store"]
    argv = ["slgaussian", *map(str, words)]
    code = f"import sys; sys.argv = {argv}\nfrom flows.cli.app import main; main()"
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (ROOT, package)))}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def run_out(labelled, tmp_path_factory, server) -> Path:
    out = tmp_path_factory.mktemp("made") / "run"
    benchmark(labelled, PACKAGE, out)
    return out


def samples(folder: Path, table: str = "samples") -> dict:
    rows = pq.read_table(folder / f"{table}.parquet").to_pylist()
    names = ("method", "protocol", "scene", "frame", "query")
    return {tuple(row[name] for name in names): row for row in rows}


def masks(folder: Path) -> dict:
    return samples(folder, "masks")


def test_benchmark_reports_a_method_of_another_package(run_out):
    rows = [row for key, row in samples(run_out).items() if key[0] == "colours"]
    assert {row["protocol"].partition("@")[0] for row in rows} == PROTOCOLS.keys()
    assert any(row["iou"] for row in rows)
    (value,) = [
        row["value"]
        for row in pq.read_table(run_out / "scores.parquet").to_pylist()
        if (row["method"], row["protocol"], row["metric"]) == ("colours", "slgaussian@2", "iou")
    ]
    page = (run_out / "report.md").read_text()
    (line,) = [line for line in page.splitlines() if line.startswith("| colours |")][:1]
    assert f"{value:.3f}" in line
    described = json.loads((run_out / "manifest.json").read_text())["methods"]
    assert described["colours"].startswith("colours of colours ")


def test_benchmark_repeats_answers_of_a_changed_package(labelled, run_out, tmp_path):
    package = shutil.copytree(PACKAGE, tmp_path / "package")
    code = (package / "colours.py").read_text()
    (package / "colours.py").write_text(code.replace("within: float = 0.75", "within: float = 0.9"))
    out = run_out.parent / "again"
    benchmark(labelled, package, out)
    before, after = samples(run_out), samples(out)
    assert before.keys() == after.keys()
    changed = {key[0] for key in before if before[key] != after[key]}
    assert changed == {"colours"}


def test_score_repeats_the_scores_of_a_run(labelled, run_out, tmp_path, slg):
    out = tmp_path / "scored"
    status, printed, errors = slg("score", run_out, *data(labelled), "-o", out)
    assert status == 0 and "missing" not in errors and "left out" not in errors
    of_run, rescored = samples(run_out), samples(out)
    scorable = {key for key in of_run if key[1].partition("@")[0] in SCORABLE}
    assert rescored.keys() == scorable
    assert {key[0] for key in scorable} == {"slgaussian", "colours"}
    for key in scorable:
        for name in ("dataset", "place", "iou", "boundary_iou", "class_iou", "accuracy"):
            assert rescored[key][name] == of_run[key][name], (key, name)
    kept = {key: row for key, row in masks(run_out).items() if key in scorable}
    assert masks(out) == kept and kept
    # So are those of the same masks as PNG files, where others have them so.
    pngs = tmp_path / "pngs"
    status, printed_pngs, _ = slg("export", run_out / "masks.parquet", "-o", pngs)
    assert status == 0 and f"{len(masks(run_out))} masks" in printed_pngs
    assert slg("score", pngs, *data(labelled), "-o", tmp_path / "of_pngs")[0] == 0
    assert samples(tmp_path / "of_pngs") == rescored
    table = {line.split("  ")[0]: line for line in printed.split("\n\n")[0].splitlines()}
    ious = [row["iou"] for key, row in rescored.items() if key[:2] == ("colours", "slgaussian@2")]
    assert f"{np.mean([iou for iou in ious if iou is not None]):.3f}" in table["colours"]
    assert "protocol slgaussian@2" in printed
    # The folder is one that compare reads, and it finds no difference.
    status, printed, _ = slg("compare", run_out, out)
    assert status == 0 and "IoU that changed most" not in printed
    assert "+0.000" in printed and "+0.001" not in printed


def test_score_reads_run_lengths_and_labels_without_an_index(labelled, run_out, tmp_path, slg):
    entries = []
    for key, row in samples(run_out).items():
        *_, frame, query = key
        if key[:2] != ("colours", "slgaussian@2") or row["iou"] is None:
            continue
        mask = masks(run_out)[key]
        # Without an index the scene is called as the folder is.
        point = [row["point_x"], row["point_y"]] if row["point_x"] is not None else None
        entry = {"scene": labelled.name, "frame": frame, "query": query}
        counts = mask["counts"]
        entries.append({**entry, "size": [64, 64], "counts": counts, "point": point})
    (tmp_path / "mine.json").write_text(json.dumps(entries[:-1] + [{**entries[0], "frame": "x"}]))
    out = tmp_path / "out"
    words = ("score", tmp_path / "mine.json", *data(labelled, pairs=False), "-o", out)
    status, _, errors = slg(*words)
    last = entries[-1]["query"]
    count = f"missing: 1 of {len(entries)} samples have no mask and count as an empty one: "
    assert status == 0 and count in errors and f" in x of {labelled.name}\n" in errors
    of_run = samples(run_out)
    for key, row in samples(out).items():
        assert key[:3] == ("mine", "slgaussian@2", labelled.name)
        if key[-1] == last:
            assert (row["iou"], row["hit_box"]) == (0, None)
            continue
        theirs = of_run["colours", "slgaussian@2", "desk", *key[-2:]]
        names = ["iou", "boundary_iou", "point_x"]
        names += ["hit_mask", "hit_box"] if row["point_x"] is not None else []
        assert [row[name] for name in names] == [theirs[name] for name in names]
    # A second time with fewer masks leaves none of the first.
    (tmp_path / "mine.json").write_text(json.dumps(entries[:1]))
    assert slg(*words)[0] == 0
    assert len(masks(out)) == 1


def test_score_refuses_unusable_input(labelled, run_out, tmp_path, refusal):
    empty, other, out = tmp_path / "empty", tmp_path / "other.json", tmp_path / "out"
    empty.mkdir()
    entry = {"scene": "a", "frame": "b", "query": "c", "size": [1, 1], "counts": [1]}
    other.write_text(json.dumps([entry]))
    arguments = data(labelled)
    for words, sentence in (
        ((run_out, *arguments, "--protocol", "highest-pixel"), "which masks do not have"),
        ((run_out, *arguments, "--protocol", "langsplt"), "did you mean 'langsplat'"),
        ((run_out, *arguments[:-1], "32x32"), "has 64x64 pixels, height first, and its view is"),
        ((run_out, *arguments[:-1], "original"), "size: found 'original', expected HEIGHTxWIDTH"),
        ((empty, *arguments), "holds no mask of slgaussian or langsplat"),
        ((other, *arguments), "no mask belongs to a query (found 'c' in b of a)"),
        ((run_out, "--data", labelled), "data format 'nerfstudio' has no labels of its own"),
        ((run_out,), "nothing to do"),
    ):
        assert sentence in refusal("score", *words, "-o", out)
        assert not out.exists()
    before = (run_out / "samples.parquet").read_bytes()
    assert "has the results of a run" in refusal("score", run_out, *arguments, "-o", run_out)
    assert (run_out / "samples.parquet").read_bytes() == before
