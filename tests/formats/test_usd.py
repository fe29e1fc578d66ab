"""Files of OpenUSD, opened and validated by usd-core and by NVIDIA's validator of assets."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from slgaussian.formats.axes import turn_axes
from slgaussian.formats.usd import save_usd
from slgaussian.gaussians import Gaussians
from slgaussian.scene import Camera
from tests.formats.test_compact import make_gaussians

FAR = np.array([500000.25, -30, 5000000.5])
LABELS = np.arange(500) % 7


def make_cameras() -> dict[str, Camera]:
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_euler("xyz", (10, -20, 30), degrees=True).as_matrix()
    c2w[:3, 3] = FAR + (1, -0.5, -3)
    K = np.array([[70.0, 0, 30], [0, 60, 25], [0, 0, 1]])
    return {"a b.jpg": Camera(K, c2w, 64, 48, near=0.5)}


@pytest.fixture(params=[(".usda", 0), (".usdc", 3), (".usdz", 1)], ids=str)
def scene(request, tmp_path):
    """Write a scene; return it, the path of its file, and the stage that usd-core opens."""
    Usd = pytest.importorskip("pxr.Usd", reason="needs the extra usd: pip install usd-core")
    suffix, degree = request.param
    gaussians = replace(make_gaussians(degree=degree), origin=FAR)
    path = tmp_path / f"scene{suffix}"
    save_usd(gaussians, path, LABELS, make_cameras())
    return gaussians, path, Usd.Stage.Open(str(path))


def test_save_usd_writes_numbers_that_usd_core_reads_back(scene):
    from pxr import UsdGeom, UsdVol

    gaussians, _, stage = scene
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1)
    prim = stage.GetDefaultPrim().GetChild("Gaussians")
    field = UsdVol.ParticleField3DGaussianSplat(prim)
    degree = field.GetRadianceSphericalHarmonicsDegreeAttr().Get()
    harmonics = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    translation = UsdGeom.Xformable(stage.GetDefaultPrim()).GetLocalTransformation()
    read = Gaussians.from_arrays(
        {
            "means": np.array(field.GetPositionsAttr().Get()),
            "scales": np.array(field.GetScalesAttr().Get()),
            "quats": np.array([(q.real, *q.imaginary) for q in field.GetOrientationsAttr().Get()]),
            "opacities": np.array(field.GetOpacitiesAttr().Get()),
            "sh": harmonics.reshape(500, (degree + 1) ** 2, 3),
            "source": np.arange(500, dtype=np.int32),
            "origin": np.array(translation.ExtractTranslation()),
        }
    )
    restored = turn_axes(read)
    assert restored.origin.tolist() == FAR.tolist()
    for name in ("means", "scales", "opacities", "sh"):
        assert torch.equal(getattr(restored, name), getattr(gaussians, name)), name
    quats = gaussians.quats / gaussians.quats.norm(dim=1, keepdim=True)
    assert (restored.quats - quats).abs().max() < 1e-6
    assert np.array_equal(UsdGeom.PrimvarsAPI(prim).GetPrimvar("label").Get(), LABELS)


def test_save_usd_writes_cameras_that_project_as_ours(scene):
    from pxr import Gf, UsdGeom

    gaussians, _, stage = scene
    camera = make_cameras()["a b.jpg"]
    prim = stage.GetDefaultPrim().GetChild("View_0")
    assert prim.GetDisplayName() == "a b.jpg"
    frustum = UsdGeom.Camera(prim).GetCamera(0).frustum
    assert frustum.nearFar.min == pytest.approx(0.5)
    matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    for point in gaussians.means[:20].double().numpy() + FAR:
        local = camera.c2w[:3, :3].T @ (point - camera.center)
        expected = (camera.K @ local)[:2] / local[2]
        x, y, _ = matrix.Transform(Gf.Vec3d(*(point * (1, -1, -1))))
        pixel = (x + 1) / 2 * camera.width, (1 - y) / 2 * camera.height
        np.testing.assert_allclose(pixel, expected, atol=1e-3)


def test_save_usd_passes_the_validators_of_usd_core_and_nvidia(scene):
    from pxr import UsdValidation

    _, _, stage = scene
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert UsdValidation.ValidationContext(validators).Validate(stage) == []
    nvidia = pytest.importorskip(
        "omni.asset_validator", reason="needs omniverse-asset-validator of PyPI"
    )
    engine = nvidia.ValidationEngine()
    engine.enable_rule(nvidia.GaussianSplatSchemaChecker)
    issues = engine.validate(stage).issues()
    # Text is slower than binary, it says.
    wrong = [issue for issue in issues if "large array lengths" not in issue.message]
    assert [(issue.message, issue.at) for issue in wrong] == []


def test_save_usd_writes_the_same_bytes_at_any_time(scene):
    gaussians, path, _ = scene
    again = path.with_stem("again")
    save_usd(gaussians, again, LABELS, make_cameras())
    assert again.read_bytes() == path.read_bytes()
    if path.suffix == ".usdz":
        (member,) = zipfile.ZipFile(path).infolist()
        assert member.date_time == (1980, 1, 1, 0, 0, 0)
