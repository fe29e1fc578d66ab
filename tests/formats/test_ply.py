""".ply files: exact round trips, and files of other programs."""

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from slgaussian.errors import InputError
from slgaussian.formats.ply import load_ply, save_ply
from slgaussian.gaussians import Gaussians

EPS = 2.0**-24
"""Relative round-off of float32."""


def make_gaussians(n=50, count=16, seed=0, **given) -> Gaussians:
    g = torch.Generator().manual_seed(seed)
    quats = torch.randn(n, 4, generator=g)
    parts = {
        "means": torch.randn(n, 3, generator=g) * 10,
        "scales": torch.exp(torch.randn(n, 3, generator=g) * 3 - 4),
        "quats": quats / quats.norm(dim=1, keepdim=True),
        "opacities": torch.rand(n, generator=g),
        "sh": torch.randn(n, count, 3, generator=g),
        "source": torch.randperm(n, generator=g).int() + 1000,
    }
    return Gaussians(**{**parts, **given})


def columns(n=5, count=4) -> dict[str, np.ndarray]:
    """Return columns as another program writes them, in another order."""
    rng = np.random.default_rng(3)
    names = [*(f"rot_{i}" for i in range(4)), "opacity", "z", "y", "x"]
    names += [f"f_rest_{i}" for i in reversed(range(3 * (count - 1)))]
    names += [f"scale_{i}" for i in range(3)] + [f"f_dc_{i}" for i in range(3)]
    return {name: rng.normal(size=n) for name in names}


def write(path, data, kind="f4", text=False, order="<"):
    table = np.empty(len(next(iter(data.values()))), [(name, kind) for name in data])
    for name, values in data.items():
        table[name] = values
    element = PlyElement.describe(table, "vertex")
    PlyData([element], text=text, byte_order="=" if text else order).write(str(path))
    return path


@pytest.mark.parametrize(("count", "width"), [(1, 0), (4, 4), (16, 4)])
def test_gaussians_round_trip(tmp_path, count, width):
    features = torch.rand(50, width) if width else None
    original = make_gaussians(count=count, features=features)
    labels = np.arange(50) % 7
    save_ply(original, tmp_path / "a.ply", labels, full=True)
    restored, extra = load_ply(tmp_path / "a.ply")
    for name in ("means", "sh", "source", *(["features"] if width else [])):
        assert torch.equal(getattr(restored, name), getattr(original, name)), name
    assert width or restored.features is None
    assert all(
        value.dtype == dict(original.items())[name].dtype for name, value in restored.items()
    )
    # What is stored is rounded once: the logarithm by EPS of itself, which is that relative error
    # of the scale, and the value by EPS again. Twice that leaves room for exp and sigmoid.
    log = original.scales.double().log().abs()
    relative = (restored.scales.double() / original.scales.double() - 1).abs()
    assert (relative <= 2 * EPS * (1 + log)).all()
    assert (restored.opacities.double() - original.opacities.double()).abs().max() <= EPS
    assert (restored.quats - original.quats).abs().max() <= 4 * EPS  # as unit as float32 made them
    assert extra["label"].tolist() == labels.tolist()
    assert extra["label"].dtype == np.int32
    assert extra.keys() == {"label"}


def test_ply_round_trip_keeps_extreme_opacities_and_scales(tmp_path):
    ends = torch.tensor([0, 1.5e-45, 1e-30, 1e-6, 0.5, 1 - 1e-6, 1 - 2**-24, 1])
    save_ply(
        make_gaussians(8, opacities=ends, scales=ends[:, None].repeat(1, 3)), tmp_path / "a.ply"
    )
    restored, _ = load_ply(tmp_path / "a.ply")
    for values in (restored.opacities, restored.scales[:, 0]):
        assert torch.equal(values[[0, 1, 6, 7]], ends[[0, 1, 6, 7]])
        assert (values / ends - 1).abs()[1:].max() < 5e-6  # EPS of a logarithm of 69


@pytest.mark.parametrize(("count", "full"), [(1, False), (4, False), (16, False), (4, True)])
def test_save_ply_writes_standard_properties_in_order(tmp_path, count, full):
    original = make_gaussians(count=count, features=torch.rand(50, 2))
    save_ply(original, tmp_path / "a.ply", np.arange(50), full)
    file = PlyData.read(str(tmp_path / "a.ply"))
    vertex, rest = file["vertex"], 3 * count - 3 if full else 45
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(rest)]
    names += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    own = ["f_sem_0", "f_sem_1", "source", "label"] if full else []
    assert [p.name for p in vertex.properties] == names + own
    assert (file.byte_order, file.text) == ("<", False)
    assert {p.val_dtype for p in vertex.properties} == {"f4"}
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    assert b"comment" not in header and len(body) == 50 * 4 * len(names + own)
    assert full or len(body) == 50 * 248
    for channel in range(3):  # all of red first
        for term in range(1, rest // 3 + 1):
            stored = vertex[f"f_rest_{channel * rest // 3 + term - 1}"]
            expected = original.sh[:, term, channel] if term < count else torch.zeros(50)
            np.testing.assert_array_equal(stored, expected)
    np.testing.assert_allclose(np.exp(vertex["scale_1"]), original.scales[:, 1], rtol=1e-5)
    opacity = 1 / (1 + np.exp(-vertex["opacity"].astype(np.float64)))
    np.testing.assert_allclose(opacity, original.opacities, atol=1e-7)
    np.testing.assert_array_equal(vertex["rot_0"], original.quats[:, 0])  # w comes first
    restored, _ = load_ply(tmp_path / "a.ply")
    assert torch.equal(restored.sh, original.sh)  # without the padding


def test_save_ply_writes_integers_that_float32_cannot_hold(tmp_path):
    source = torch.tensor([2**24, 2**24 + 1, 2**31 - 1], dtype=torch.int32)
    labels = np.array([2**24, 0, -1])
    save_ply(make_gaussians(3, source=source), tmp_path / "a.ply", labels, full=True)
    vertex = PlyData.read(str(tmp_path / "a.ply"))["vertex"]
    assert [vertex[name].dtype.kind for name in ("source", "label")] == ["i", "f"]
    restored, extra = load_ply(tmp_path / "a.ply")
    assert torch.equal(restored.source, source)
    assert extra["label"].tolist() == [2**24, 0, -1]


@pytest.mark.parametrize(
    ("count", "kind", "form"),
    [(1, "f8", {"text": True}), (4, "f4", {"order": ">"}), (16, "f8", {"order": "<"})],
)
def test_load_ply_reads_any_encoding_and_column_order(tmp_path, count, kind, form):
    data = columns(count=count)
    restored, extra = load_ply(write(tmp_path / "a.ply", data, kind, **form))
    stored = {name: values.astype(kind).astype(np.float64) for name, values in data.items()}

    def stack(names) -> np.ndarray:
        return np.stack([stored[name] for name in names], 1).astype(np.float32)

    np.testing.assert_array_equal(restored.means, stack("xyz"))
    if count > 1:
        rest = stack(f"f_rest_{i}" for i in range(3 * (count - 1)))  # all of red first
        np.testing.assert_array_equal(restored.sh[:, 1:].mT.reshape(5, -1), rest)
    assert all(tensor.is_contiguous() for tensor in (restored.means, restored.sh, restored.quats))
    np.testing.assert_allclose(restored.scales[:, 2], np.exp(stored["scale_2"]), rtol=1e-6)
    np.testing.assert_allclose(restored.opacities, 1 / (1 + np.exp(-stored["opacity"])), rtol=1e-6)
    quats = stack(f"rot_{i}" for i in range(4))
    expected = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    np.testing.assert_allclose(restored.quats, expected, atol=2e-7)
    assert restored.source.tolist() == [0, 1, 2, 3, 4] and restored.features is None and extra == {}


def test_load_ply_returns_unknown_properties_in_their_type(tmp_path):
    data = columns(3)
    kinds = [(name, ">f4") for name in data] + [("id", ">u2"), ("nx", ">f4"), ("source", ">f8")]
    table = np.empty(3, kinds)
    for name, values in data.items():
        table[name] = values
    table["id"], table["nx"], table["source"] = [1, 2, 65535], 5, [0.5, 1, 2]
    PlyData([PlyElement.describe(table, "vertex")], byte_order=">").write(str(tmp_path / "a.ply"))
    restored, extra = load_ply(tmp_path / "a.ply")
    assert extra.keys() == {"id", "source"}  # half a pixel is no source
    assert extra["id"].dtype == np.dtype("=u2")
    assert extra["id"].tolist() == [1, 2, 65535]
    extra["id"][:] = 0  # apart from the file
    assert restored.source.tolist() == [0, 1, 2]


def test_ply_round_trip_without_gaussians(tmp_path):
    save_ply(make_gaussians(0, count=4), tmp_path / "a.ply", np.zeros(0, np.int32), full=True)
    restored, extra = load_ply(tmp_path / "a.ply")
    assert (len(restored), tuple(restored.sh.shape)) == (0, (0, 1, 3))
    assert extra["label"].shape == (0,)


def spoil(name, row, value):
    def change(data):
        data[name][row] = value

    return change


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (spoil("f_rest_5", 1, np.inf), "vertex 1 has f_rest_5 inf"),
        (spoil("scale_1", 4, 1000), "vertex 4 has scale_1 1000.0"),
        (spoil("y", 0, 1e300), "vertex 0 has y 1e"),
        (lambda d: d.pop("f_rest_8"), "has 8 properties f_rest_"),
        (lambda d: d.pop("scale_2"), "holds 2D Gaussians, which have no scale_2"),
        (lambda d: d.pop("opacity"), "lacks opacity and has rot_0"),
        (lambda d: d.update(packed_position=np.ones(5)), "`npx .*splat-transform a.ply plain.ply`"),
        (lambda d: [d[f"rot_{i}"].__setitem__(2, 0) for i in range(4)], r"vertex 2 .*\(0, 0, 0, 0"),
        (lambda d: [d.pop(n) for n in list(d) if n not in "xyz"], "lacks f_dc_0, .* has z, y, x"),
        (lambda d: d.update(filter_3D=np.ones(5)), "has filter_3D, by which"),
    ],
)
def test_load_ply_error_names_invalid_property_or_vertex(tmp_path, change, sentence):
    data = columns()
    change(data)
    with pytest.raises(InputError, match=sentence) as error:
        load_ply(write(tmp_path / "a.ply", data, "f8"))
    assert str(error.value).startswith(str(tmp_path / "a.ply"))


NORMALS, DC = ["nx", "ny", "nz"], ["f_dc_0", "f_dc_1", "f_dc_2"]
SCALES, ROTATIONS = ["scale_0", "scale_1", "scale_2"], ["rot_0", "rot_1", "rot_2", "rot_3"]
REST = [f"f_rest_{i}" for i in range(45)]
HEADERS: dict[str, tuple[list[str], list[str]]] = {
    "3DGS": ([], ["x", "y", "z", *NORMALS, *DC, *REST, "opacity", *SCALES, *ROTATIONS]),
    "nerfstudio": (
        ["Generated by Nerstudio 1.1.5", "Vertical Axis: z"],
        ["x", "y", "z", *NORMALS, *DC, *REST, "opacity", *SCALES, *ROTATIONS],
    ),
    "gsplat, degree 1": ([], ["x", "y", "z", *DC, *REST[:9], "opacity", *SCALES, *ROTATIONS]),
    "splat-transform": ([], ["x", "y", "z", *SCALES, *DC, "opacity", *ROTATIONS, *REST[:24]]),
    "DA3 and MVSplat": ([], ["x", "y", "z", *NORMALS, *DC, "opacity", *SCALES, *ROTATIONS]),
}
"""Comments and properties, by the sources of each program, read on 2026-11-28."""


@pytest.mark.parametrize(("comments", "names"), HEADERS.values(), ids=HEADERS)
def test_load_ply_reads_the_header_of_each_program(tmp_path, comments, names):
    rng = np.random.default_rng(0)
    data = {name: rng.normal(size=20) for name in names}
    content = PlyData.read(str(write(tmp_path / "a.ply", data)))
    content.comments = comments
    content.write(str(tmp_path / "b.ply"))
    gaussians, extra = load_ply(tmp_path / "b.ply")
    stored = {name: values.astype("f4") for name, values in data.items()}
    assert extra == {}
    np.testing.assert_array_equal(gaussians.means, np.stack([stored[name] for name in "xyz"], 1))
    np.testing.assert_array_equal(gaussians.sh[:, 0], np.stack([stored[name] for name in DC], 1))
    terms = sum(name in data for name in REST) // 3
    assert gaussians.sh.shape[1] == terms + 1
    if terms:
        np.testing.assert_array_equal(gaussians.sh[:, 2, 1], stored[f"f_rest_{terms + 1}"])
    logits = gaussians.opacities.double().logit()
    np.testing.assert_allclose(logits, stored["opacity"], atol=1e-5)
    np.testing.assert_allclose(gaussians.scales[:, 1].log(), stored["scale_1"], atol=1e-5)


@pytest.mark.parametrize(
    ("count", "opacity", "linear"),
    [
        (1000, np.linspace(0.01, 1, 1000), True),
        (999, np.linspace(0.01, 1, 999), False),
        (1000, np.linspace(-0.01, 1, 1000), False),
        (1000, np.zeros(1000), False),  # all half transparent
    ],
)
def test_load_ply_takes_opacities_for_logits_unless_they_are_none(
    tmp_path, recwarn, count, opacity, linear
):
    data = columns(count) | {"opacity": opacity}
    gaussians, _ = load_ply(write(tmp_path / "a.ply", data))
    expected = opacity if linear else 1 / (1 + np.exp(-opacity))
    np.testing.assert_allclose(gaussians.opacities, expected, atol=1e-6)
    assert ["taken as they are" in str(warning.message) for warning in recwarn] == [True] * linear


def test_load_ply_refuses_what_gaussforge_compressed(tmp_path):
    gaussforge = pytest.importorskip("gaussforge", reason="needs gaussforge of PyPI")
    data = write(tmp_path / "a.ply", columns(count=16)).read_bytes()
    packed = gaussforge.GaussForge().convert(data, "ply", "compressed.ply")["data"]
    (tmp_path / "a.ply").write_bytes(packed)
    with pytest.raises(InputError, match=r"is a compressed \.ply of PlayCanvas"):
        load_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("comment", ["SplatRenderMode: mip", "postshot.anti_aliasing=1"])
def test_load_ply_refuses_gaussians_trained_with_antialiasing(tmp_path, comment):
    content = PlyData.read(str(write(tmp_path / "a.ply", columns())))
    content.comments = ["Generated by nerfstudio", "postshot.anti_aliasing=0"]
    content.write(str(tmp_path / "b.ply"))
    load_ply(tmp_path / "b.ply")
    content.comments = [comment]
    content.write(str(tmp_path / "b.ply"))
    with pytest.raises(InputError, match=f"has {comment}, by which"):
        load_ply(tmp_path / "b.ply")


def test_load_ply_refuses_damaged_file_in_one_sentence(tmp_path):
    path = tmp_path / "a.ply"
    complete = write(path, columns(3)).read_bytes()
    header = b"ply\nformat binary_little_endian 1.0\n"
    vast = b"ply\nformat ascii 1.0\nelement vertex 99999999999999\nend_header\n"
    twice = (
        header + b"element vertex 1\nproperty float x\nproperty float x\nend_header\n" + bytes(8)
    )
    vast_binary = complete.replace(b"element vertex 3", b"element vertex 99999999999")
    wild = (b"\x89PNG\r\n\x1a\n", vast, vast_binary, twice)
    cut = [complete[:length] for length in (0, 30, len(complete) // 2, len(complete) - 30)]
    for data, sentence in [
        *((data, "is not a whole .ply file") for data in (*cut, *wild)),
        (header + b"element face 0\nend_header\n", "has no element vertex, only face"),
        (None, "cannot be read"),
    ]:
        path.unlink() if data is None else path.write_bytes(data)
        with pytest.raises(InputError) as error:
            load_ply(path)
        assert str(error.value).startswith(f"{path}: {sentence}")


@pytest.mark.parametrize(
    ("given", "labels", "sentence"),
    [
        ({"sh": torch.zeros(50, 25, 3)}, None, "found 25 coefficients a colour"),
        ({"means": torch.full((50, 3), torch.nan)}, None, r"means\[0\]: holds NaN"),
        ({}, np.zeros(49, int), r"labels: found int64 \(49,\), expected .*\(50,\)"),
        ({}, np.zeros(50), "labels: found float64"),
        ({}, np.full(50, 2**31), "labels: found 2147483648"),
    ],
)
def test_failed_save_ply_keeps_the_old_file(tmp_path, given, labels, sentence):
    save_ply(make_gaussians(3), tmp_path / "a.ply")
    before = (tmp_path / "a.ply").read_bytes()
    with pytest.raises(InputError, match=sentence):
        save_ply(make_gaussians(**given), tmp_path / "a.ply", labels, full=True)
    with pytest.raises(InputError, match="cannot be written"):
        save_ply(make_gaussians(3), tmp_path / "nowhere" / "a.ply")
    assert (tmp_path / "a.ply").read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]
