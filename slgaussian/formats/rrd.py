"""Recordings of Rerun: Gaussians as ``GaussianSplats3D``, and the cameras of their views.

``rerun-sdk`` 0.41 (https://www.rerun.io/docs/reference/types/archetypes/gaussian_splats3d) writes
them, at no time of any timeline. The recording keeps our axes. Colours have 8 bits from 0 to 1 and
harmonics 16-bit floats; Rerun calls its archetype unstable.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.extras import install_line
from slgaussian.formats.writable import check_labels, check_writable
from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.io import write_file
from slgaussian.scene import Camera


def save_rrd(
    gaussians: Gaussians,
    path: str | Path,
    labels: np.ndarray | None = None,
    cameras: Mapping[str, Camera] | None = None,
) -> None:
    """Write Gaussians atomically as a recording: ``world/gaussians`` and ``world/views/NAME``.

    Args:
        gaussians: With harmonics of degree 0 to 3. Their origin is a component of ``world``.
        path: An existing file is replaced.
        labels: int [N], optional. Object of each Gaussian, 0 for none; the component ``label``.
        cameras: {name: camera of the world}, optional; each is a pinhole, relative to the origin.

    Raises:
        InputError: If ``rerun-sdk`` is missing or too old, a number is NaN, infinite or out of
            range, the harmonics are above degree 3, or the file cannot be written.
    """
    try:
        import rerun as rr
        from rerun.archetypes import GaussianSplats3D
    except ImportError as error:
        raise InputError(
            f"{path}: needs rerun-sdk 0.41 or newer ({error}); install it with "
            f"{install_line('rerun')}"
        ) from error
    check_writable(gaussians, "an .rrd")
    arrays = gaussians.to_arrays()
    n, terms = arrays["sh"].shape[:2]
    rgba = np.column_stack([arrays["sh"][:, 0] * SH_C0 + 0.5, arrays["opacities"]])
    harmonics = np.zeros((n, 15, 3), np.float16)
    harmonics[:, : terms - 1] = arrays["sh"][:, 1:]
    quats = arrays["quats"] / np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
    splats = GaussianSplats3D(
        arrays["means"],
        scales=arrays["scales"],
        quaternions=quats[:, [1, 2, 3, 0]],
        colors=np.rint(rgba.clip(0, 1) * 255).astype(np.uint8),
        sh_coefficients=harmonics if terms > 1 else None,
        spherical_harmonics_degree=math.isqrt(terms) - 1,
    )
    digest = hashlib.sha256(b"".join(arrays[name].tobytes() for name in sorted(arrays)))
    with tempfile.TemporaryDirectory() as folder:
        # Rerun draws recordings of one id as one scene.
        stream = rr.RecordingStream(
            "slgaussian", recording_id=digest.hexdigest(), send_properties=False
        )
        stream.save(f"{folder}/scene.rrd")
        stream.log(
            "world", rr.ViewCoordinates.RDF, rr.AnyValues(origin=gaussians.origin), static=True
        )
        stream.log("world/gaussians", splats, static=True)
        if labels is not None:
            stream.log("world/gaussians", rr.AnyValues(label=check_labels(labels, n)), static=True)
        for name, camera in (cameras or {}).items():
            local = gaussians.localize(camera)
            pose = rr.Transform3D(translation=local.c2w[:3, 3], mat3x3=local.c2w[:3, :3])
            pinhole = rr.Pinhole(
                image_from_camera=camera.K, resolution=[camera.width, camera.height]
            )
            entity = f"world/views/{rr.escape_entity_path_part(name)}"
            stream.log(entity, pose, pinhole, static=True)
        stream.disconnect()
        write_file(path, Path(folder, "scene.rrd").read_bytes())
