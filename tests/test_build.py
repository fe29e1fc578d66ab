"""`build_field`: settings of components, and their record in the field."""

import hashlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slgaussian import datasets
from slgaussian.build import build_field
from slgaussian.cameras.quality import Quality
from slgaussian.components.method import Method
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.gaussians import source_depths
from slgaussian.scene import Sample
from slgaussian.viewer.page.scene_page import scene_page

NAMES = {
    "predictor": "planesweep",
    "proposer": "regions",
    "tracker": "geometric",
    "encoder": "lexicon",
    "codes": "separated",
    "lifting": "hard",
}


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"mvsplat": {}}, "found some of 'mvsplat', expected only those .* 'planesweep'"),
        ({"planesweep": {"nearest": 1.0}}, "unknown key 'planesweep.nearest'"),
        ({"planesweep": {"depth_candidates": 4}}, "planesweep depth_candidates: found 4"),
    ],
)
def test_settings_that_no_part_takes_are_one_sentence(settings, sentence):
    with pytest.raises(InputError, match=sentence):
        Method(settings=settings).check()


def test_files_are_written_down_by_content(tmp_path):
    file = tmp_path / "weights.ckpt"
    file.write_bytes(b"weights")
    settings = {"mvsplat": {"checkpoint": str(file), "precision": "bfloat16"}}
    digest = hashlib.sha256(b"weights").hexdigest()
    expected = {"checkpoint": digest, "precision": "bfloat16"}
    assert Method("mvsplat", settings=settings).identity()["mvsplat"] == expected
    assert settings["mvsplat"]["checkpoint"] == str(file)


def test_the_predictor_gets_its_settings_and_the_field_says_so(tmp_path):
    room = datasets.load("procedural", seed=1, objects=4, views=3, height=64, width=96)
    sample = room.sample(["view_00", "view_02"], near=0.9, far=20.0)
    depths = {}
    for candidates in (33, 144):
        options = {"planesweep": {"depth_candidates": candidates}}
        field = build_field(sample, Method(replicas=1, settings=options))
        field.save(tmp_path / "field")
        settings = dict(SemanticField.load(tmp_path / "field").settings)
        settings.pop("lexicon", None)  # names the classifier where its weights are installed
        quality, account = settings.pop("quality"), SimpleNamespace(**settings.pop("account"))
        assert account.gaussians_kept == len(field.gaussians) < account.gaussians_made
        assert 0 < account.change_mean < account.change_rms < 1 < account.change_greatest
        nbytes = sum(array.nbytes for array in field.gaussians.to_arrays().values())
        assert account.bytes_gaussians == nbytes
        assert 2 * 32 <= account.depths_tried <= account.depths_possible == 2 * candidates
        assert (account.replicas_computed, account.replicas_asked) == (1, 1)
        assert settings.pop("verdict") == Quality(**quality).verdict()._asdict()
        assert quality["judged"] is False and 0.5 < quality["overlap"] < 1
        assert settings == {
            "scene": sample.scene,
            **NAMES,
            "replicas": 1,
            "votes": "views",
            "seed": 0,
            "keep": "needed",
            "bank": "groups",
            **options,
        }
        cameras = [view.camera for view in sample.context]
        depths[candidates] = source_depths(field.gaussians, cameras)
    assert (depths[33] != depths[144]).any()


@pytest.fixture(scope="module")
def pair() -> Sample:
    return datasets.load("stereo").sample(context=["left", "right"], size=(120, 168))


@pytest.fixture(scope="module")
def field(pair) -> SemanticField:
    return build_field(pair, Method(replicas=1))


def collect_bytes(field: SemanticField) -> dict[str, bytes]:
    """Return all arrays of a field and an answer as bytes."""
    arrays = {f"Gaussians {name}": t.numpy() for name, t in field.gaussians.items()}
    arrays |= {f"bank {name}": getattr(field.bank, name) for name in ("ids", "codes", "features")}
    view = field.render(next(iter(field.cameras.values())))
    answer = view.query("red")
    arrays |= {"ids": view.ids, "mask": answer.mask, "relevancy": answer.relevancy}
    return {name: array.tobytes() for name, array in arrays.items()}


def test_a_name_reaches_no_byte(pair, field):
    views = tuple(replace(view, name=f"other {view.name}") for view in pair.context)
    renamed = build_field(replace(pair, scene="renamed", context=views), Method(replicas=1))
    assert collect_bytes(renamed) == collect_bytes(field)


def test_the_seed_reaches_the_codes_and_not_the_depth(pair, field):
    other = build_field(pair, Method(replicas=1, seed=1))
    first, second = collect_bytes(field), collect_bytes(other)
    assert second["bank codes"] != first["bank codes"]
    assert second["bank features"] == first["bank features"]


def test_a_field_keeps_what_it_needs_or_all(pair, field):
    merged, unmerged = field, build_field(pair, Method(replicas=1, keep="all"))
    height, width = pair.context[0].image.shape[:2]
    sources = unmerged.gaussians.source.numpy()
    assert len(np.unique(sources)) == 2 * height * width
    assert len(merged.gaussians) < 0.95 * len(unmerged.gaussians)
    account = unmerged.settings["account"]
    assert account["gaussians_made"] == account["gaussians_kept"] == len(sources)
    assert account["change_greatest"] == 0
    # Who is left has the object of the pixel that it came from, and no object is gone.
    labels = np.zeros(2 * height * width, np.int32)
    labels[sources] = unmerged.labels()
    assert np.array_equal(merged.labels(), labels[merged.gaussians.source.numpy()])
    assert set(merged.labels()) == set(unmerged.labels())
    with pytest.raises(InputError, match="keep: found 'al', expected one of needed, all"):
        Method(keep="al")


def test_one_number_says_what_a_second_view_confirms():
    scene = datasets.load("procedural", seed=1, views=2, height=96, width=128)
    sample = scene.sample(list(scene.cameras))
    field = build_field(sample, Method(keep="all"))
    quality = Quality(**field.settings["quality"])
    guessed, source = field.gaussians.guessed.numpy(), field.gaussians.source.numpy()
    pixels = 2 * 96 * 128
    assert len(np.unique(source[~guessed])) / pixels == pytest.approx(quality.confirmed, abs=1e-4)
    assert 0.2 < quality.confirmed < 0.98
    outside = []
    for view, other in zip(sample.context, sample.context[::-1], strict=True):
        at, _ = other.camera.project(view.camera.unproject(view.depth))
        outside.append(((at < -4) | (at > np.array([128, 96]) + 4)).any(-1))
    alone = np.stack(outside).ravel()[source]
    assert alone.sum() > 100 and guessed[alone].mean() > 0.98
    sentence = f"nother view confirms {quality.confirmed:.0%} of the pixels"
    assert sentence in quality.summary()
    assert f"A{sentence}, and the depth of the rest is a guess." in scene_page(field)
