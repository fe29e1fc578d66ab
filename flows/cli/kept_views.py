"""What views of fields showed, kept in the user's cache: whoever asks again reads no Gaussians.

A view is known by all that it depends on, so that a kept one is the same, to the byte, as one drawn
anew. The cache is that of :class:`slgaussian.storage.local_copies.LocalCache`, with its bound.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from slgaussian.field import FieldView, SemanticField
from slgaussian.kernels import threads
from slgaussian.scene import Camera
from slgaussian.storage.field_folder import read_about
from slgaussian.storage.local_copies import kept_arrays

SEEN = ("rgb", "ids", "confidence", "alpha", "depth")
"""What is kept of a view."""


def seen(folder: Path, field: SemanticField, camera: Camera) -> FieldView:
    """A field as ``camera`` sees it: :meth:`SemanticField.render`, or what it gave before.

    ``field`` is that of ``folder``, maybe taught, named or removed in; nothing else of it may
    differ.
    """

    def drawn() -> dict[str, np.ndarray]:
        view = field.render(camera)
        return {name: getattr(view, name) for name in SEEN}

    arrays = kept_arrays(f"views/{_known_by(folder, field, camera)}.npz", drawn)
    return FieldView(**arrays, field=field, camera=camera)


def _known_by(folder: Path, field: SemanticField, camera: Camera) -> str:
    """A digest of all that the picture depends on: content, camera, code and processor."""
    about, _ = read_about(folder)
    said = {
        "content": dict(about.digests),
        "settings": dict(about.settings),
        "removed": sorted(field.removed),
        "K": camera.K.tolist(),
        "c2w": camera.c2w.tolist(),
        "size": [camera.width, camera.height],
        "code": threads.sources().whole,
        "processor": threads.processor(),
    }
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
