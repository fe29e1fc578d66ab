"""`slgaussian benchmark --sweep`: settings and numbers of views as methods of one report."""

import re
from collections import Counter

import command
import pyarrow.parquet as pq
import pytest
from command import save_photographs, score

from flows.read_config import make_settings
from flows.sweep import combinations
from slgaussian.errors import InputError
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore

pytestmark = pytest.mark.usefixtures("server")

ROOM = {
    **command.ROOM,
    "options": {"seed": 1, "objects": 4, "views": 5},
    "context": ["view_01", "view_03"],
    "targets": ["view_02"],
}
SMALL = {"size": "64x96", "replicas": 1}
DEPTHS = "planesweep.depth_candidates"
NAME = "slgaussian, views={}, depth_candidates=16"


@pytest.fixture(scope="module")
def swept(tmp_path_factory, server):
    """Sweep a room over few depths and 2, 3 and more views than it has."""
    folder = tmp_path_factory.mktemp("sweep")
    values = {"scenes": [ROOM], "out": folder / "out", **SMALL}
    values["sweep"] = ["views=2,3,40", f"{DEPTHS}=16"]
    settings = make_settings(values, "test")
    return folder, settings, score(settings, ArtifactStore(folder / "store"))


def test_sweep_queries_each_combination_alike(swept):
    folder, _, finished = swept
    samples = pq.read_table(folder / "out" / "samples.parquet").to_pylist()
    calls = {}
    for row in samples:
        calls.setdefault(row["method"], set()).add((row["frame"], row["query"]))
    assert list(calls) == ["slgaussian", *(NAME.format(v) for v in (2, 3))]
    assert all(queries == calls["slgaussian"] for queries in calls.values())
    psnr = [result.scene_metrics["psnr"] for result in finished.results]
    assert len(set(psnr)) == 3
    costs = pq.read_table(folder / "out" / "times.parquet").to_pylist()
    assert len({(row["method"], row["build_seconds"]) for row in costs}) == 3
    assert len({row["build_seconds"] for row in costs}) == 3
    (failure,) = finished.failures
    assert failure.scene == f"room: {NAME.format(40)}"
    assert "found 4 context views" in failure.reason


def test_sweep_reuses_stages_without_the_setting(swept):
    folder, *_ = swept
    records = Records(ArtifactStore(folder / "store")).all()
    times = Counter(record.stage for some in records for record in some)
    assert (times["ingest"], times["truth"], times["geometry"]) == (2, 2, 3)


@pytest.mark.parametrize(
    ("sweep", "sentence"),
    [
        (["views=1,2"], "views: found '1', expected a number from 2"),
        ([f"{DEPTHS}=16,16"], "expected FIELD=a,b,c with different values"),
        (["replica=1"], "found no setting 'replica'; did you mean 'replicas'"),
        (["mvsplat.precision=float32"], "no component is 'mvsplat'"),
    ],
)
def test_sweep_refuses_unusable_fields(sweep, sentence):
    settings = make_settings({"rooms": "0", "sweep": sweep, **SMALL}, "test")
    with pytest.raises(InputError) as error:
        combinations(settings)
    assert sentence in str(error.value)


def test_benchmark_holds_out_the_middle_photograph(slg, refusal, tmp_path):
    folder = save_photographs(tmp_path, 64, 96, [f"view_{k:02d}" for k in range(3)])
    cameras = ["--cameras", folder / "transforms.json"]
    out = ["-o", tmp_path / "out", "--store", tmp_path / "store"]
    words = ["--sweep", f"{DEPTHS}=16", "--set", "near=0.8", "--set", "far=12"]
    status, _, errors = slg("benchmark", folder, *cameras, *words, *out)
    assert status == 0 and "view_01.png is held out" in errors
    page = (tmp_path / "out" / "report.md").read_text("utf-8")
    errors = re.findall(r"^\| (slgaussian[^|]*) \| – \| ([\d.]+) \|", page, re.MULTILINE)
    assert len(dict(errors)) == 2 and all(float(psnr) > 15 for _, psnr in errors)
    two = [folder / "view_00.png", folder / "view_02.png"]
    assert "found 2 photographs, expected at least three" in refusal("benchmark", *two, *out)
    assert "given without photographs" in refusal("benchmark", *cameras, *out)
