"""OpenUSD: Gaussians as a ``ParticleField3DGaussianSplat``, and the cameras of their views.

The schema (OpenUSD 26.03, https://openusd.org/release/user_guides/schemas/usdVol/) takes opacities
and standard deviations as they are, unit quaternions, and for each Gaussian all its harmonics, in
the order and with the offset of 3D Gaussian splatting. The stage has x right, y up, z backward, and
a scene unit is a metre. ``usd-core`` writes it: text (.usda), binary (.usdc) or a package (.usdz).

The objects are a primvar, as Gaussians of several prims might be drawn one prim after the other.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.errors import InputError
from slgaussian.extras import install_line
from slgaussian.formats.axes import AXIS_SIGNS, turn_axes
from slgaussian.formats.writable import check_labels, check_writable
from slgaussian.gaussians import Gaussians
from slgaussian.io import write_file
from slgaussian.scene import Camera

if TYPE_CHECKING:
    from pxr import Usd

FOCAL_LENGTH = 35.0
"""Focal length of every camera; apertures are relative to it, so that only their ratio counts."""


def save_usd(
    gaussians: Gaussians,
    path: str | Path,
    labels: np.ndarray | None = None,
    cameras: Mapping[str, Camera] | None = None,
) -> None:
    """Write Gaussians atomically as ``.usda``, ``.usdc`` or ``.usdz``.

    Args:
        gaussians: With harmonics of degree 0 to 3. Their origin is the translation of the scene.
        path: An existing file is replaced.
        labels: int [N], optional. Object of each Gaussian, 0 for none; the primvar ``label``.
        cameras: {name: camera of the world}, optional; cameras of the stage, without skew.

    Raises:
        InputError: If ``usd-core`` is missing or older than 26.3, a number is NaN, infinite or out
            of range, the harmonics are above degree 3, or the file cannot be written.
    """
    try:
        from pxr import Sdf, Usd, UsdGeom, UsdUtils, Vt
        from pxr.UsdVol import ParticleField3DGaussianSplat
    except ImportError as error:
        raise InputError(
            f"{path}: needs usd-core 26.3 or newer ({error}); install it with {install_line('usd')}"
        ) from error
    check_writable(gaussians, "a .usd")
    arrays = turn_axes(gaussians).to_arrays()
    n, terms = arrays["sh"].shape[:2]
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    if gaussians.origin.any():
        world.AddTranslateOp().Set(tuple((gaussians.origin * AXIS_SIGNS).tolist()))
    field = ParticleField3DGaussianSplat.Define(stage, "/World/Gaussians")
    quats = arrays["quats"] / np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
    scales = np.maximum(arrays["scales"], np.finfo(np.float32).tiny)  # readers refuse 0
    field.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(arrays["means"]))
    field.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(quats[:, [1, 2, 3, 0]]))
    field.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(scales))
    field.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(arrays["opacities"]))
    field.CreateRadianceSphericalHarmonicsDegreeAttr(math.isqrt(terms) - 1)
    harmonics = field.CreateRadianceSphericalHarmonicsCoefficientsAttr(
        Vt.Vec3fArray.FromNumpy(arrays["sh"].reshape(-1, 3))
    )
    harmonics.SetMetadata("interpolation", UsdGeom.Tokens.vertex)
    harmonics.SetMetadata("elementSize", terms)
    reach = 3 * scales.max(1, keepdims=True)
    if n:
        corners = [(arrays["means"] - reach).min(0), (arrays["means"] + reach).max(0)]
        field.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack(corners)))
    if labels is not None:
        primvars = UsdGeom.PrimvarsAPI(field)
        label = primvars.CreatePrimvar("label", Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.vertex)
        label.Set(Vt.IntArray.FromNumpy(check_labels(labels, n).astype(np.int32)))
    for number, (name, camera) in enumerate((cameras or {}).items()):
        _add_camera(stage, f"/World/View_{number}", name, camera, gaussians)
    with tempfile.TemporaryDirectory() as folder:
        suffix = Path(path).suffix.lower()
        file = f"{folder}/scene{suffix.replace('z', 'c')}"
        stage.GetRootLayer().Export(file)
        if suffix == ".usdz":
            # The time of the file is in the package; by the clock of the place, it is always this.
            begin = time.mktime((1980, 1, 1, 0, 0, 0, 0, 1, -1))
            os.utime(file, (begin, begin))
            UsdUtils.CreateNewUsdzPackage(file, f"{folder}/scene.usdz")
        write_file(path, Path(folder, f"scene{suffix}").read_bytes())


def _add_camera(
    stage: Usd.Stage, prim: str, name: str, camera: Camera, gaussians: Gaussians
) -> None:
    """Add a camera in the coordinates of the means, with the axes turned on both of its sides."""
    from pxr import Gf, UsdGeom

    added = UsdGeom.Camera.Define(stage, prim)
    added.GetPrim().SetDisplayName(name)
    focal, centre = np.diag(camera.K)[:2], camera.K[:2, 2]
    size = np.array([camera.width, camera.height])
    aperture = FOCAL_LENGTH * size / focal
    offset = FOCAL_LENGTH * (size / 2 - centre) / focal * (1, -1)
    added.CreateFocalLengthAttr(FOCAL_LENGTH)
    added.CreateHorizontalApertureAttr(float(aperture[0]))
    added.CreateVerticalApertureAttr(float(aperture[1]))
    added.CreateHorizontalApertureOffsetAttr(float(offset[0]))
    added.CreateVerticalApertureOffsetAttr(float(offset[1]))
    reach = gaussians.reach(camera)
    near, far = camera.near or reach / 1000, camera.far or reach * 1000
    added.CreateClippingRangeAttr(Gf.Vec2f(near, far))
    turn = np.diag([*AXIS_SIGNS.astype(np.float64), 1.0])
    c2w = turn @ gaussians.localize(camera).c2w @ turn
    added.AddTransformOp().Set(Gf.Matrix4d(c2w.T.tolist()))  # it multiplies rows
