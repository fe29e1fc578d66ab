"""Trackers with settings of their own, by command and by flow."""

import numpy as np
import pytest
from command import ROOM, room_sample, run, said
from pipelines import calls_of, keyed

from flows.read_config import make_settings, read_toml
from flows.scene import scene_task
from slgaussian.build import build_field
from slgaussian.components.component import Component
from slgaussian.components.method import Method
from slgaussian.errors import InputError
from slgaussian.masks.configs import folder_digest
from slgaussian.storage.store import ArtifactStore
from tasks.artifacts import sample_to_arrays
from tasks.context import RunContext
from tasks.scene import geometry, masks


@pytest.fixture
def ids(tmp_path):
    """A folder of the true ids."""
    folder = tmp_path / "ids"
    folder.mkdir()
    for view in room_sample().context:
        np.save(folder / f"{view.name}.npy", view.instances)
    return folder


def test_a_field_has_the_given_objects_and_says_so(ids):
    method = Method(tracker="precomputed", settings={"precomputed": {"folder": ids}})
    field = build_field(room_sample(), method)
    truth = np.unique([view.instances for view in room_sample().context])
    np.testing.assert_array_equal(field.bank.ids, truth[truth > 0])
    assert field.settings["tracker"] == "precomputed"
    assert field.settings["precomputed"] == {"folder": folder_digest(ids), "geometry": None}


def test_the_folder_is_known_by_its_content_and_refused_if_it_changes(ids, tmp_path, monkeypatch):
    values = {"scenes": [ROOM], "tracker": "precomputed", "precomputed": {"folder": str(ids)}}
    settings = make_settings(values, "test")
    method = settings.built_by
    steps = calls_of(scene_task(settings, method, settings.scenes[0]), monkeypatch)
    local = {"folder": folder_digest(ids), "geometry": None}
    assert keyed(steps["masks"])["tracker"] == {"precomputed": local}
    assert keyed(steps["field"])["method"]["precomputed"] == local
    assert steps["masks"]["tracker"].places() == {"folder": str(ids)}

    store = ArtifactStore(tmp_path / "store")
    context = RunContext(store)
    sample = store.put("sample", sample_to_arrays(room_sample()))
    base = geometry.compute(context, sample, method.predictor, 0)
    output = masks.compute(context, sample, base, method.proposer, method.tracker, 5, "views")
    labels = store.get(output)["labels"]
    np.testing.assert_array_equal(labels, [view.instances for view in room_sample().context])
    np.save(ids / "view_00.npy", np.zeros((64, 64), np.int32))
    with pytest.raises(InputError, match="was changed after the run had begun"):
        masks.compute(context, sample, base, method.proposer, method.tracker, 5, "views")
    rerun = Component.of("tracker", "precomputed", {"folder": ids})
    output = masks.compute(context, sample, base, method.proposer, rerun, 5, "views")
    assert output.meta["objects"] > 0


def test_tables_of_a_file_are_anchored_and_a_hyphen_is_an_underscore(tmp_path):
    (tmp_path / "model").mkdir()
    config = tmp_path / "run.toml"
    config.write_text(
        'tracker = "sam2-video"\n[sam2_video]\nmodel = "model"\nbatch = 4\n'
        '[precomputed]\nfolder = "ids"\n'
    )
    read = read_toml(config, {})
    local = {"model": str(tmp_path / "model"), "batch": 4}
    assert read.component_values()["sam2-video"] == local
    assert read.precomputed.folder == tmp_path / "ids"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--set", "tracker=sam2-video"], "sam2-video model: none given; give a folder, or a name"),
        (["--set", "tracker=precomputed"], "precomputed folder: none given"),
        (
            ["--set", "tracker=precomputed", "--set", "precomputed.folder=no"],
            "there is no folder 'no'",
        ),
        (["--set", "sam2_video.batch=4"], "settings of 'sam2_video' are given, but no part"),
    ],
)
def test_a_run_that_cannot_be_does_not_begin(tmp_path, monkeypatch, capsys, words, sentence):
    config = tmp_path / "run.toml"
    config.write_text('[[scenes]]\nname = "a"\ncontext = ["1", "2"]\n')
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")  # never asked
    assert run(monkeypatch, "run", config, "--store", tmp_path / "store", *words) == 2
    assert sentence in said(capsys)
