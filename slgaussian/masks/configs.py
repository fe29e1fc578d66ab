"""Configs of the mask proposers and trackers, and presets of automatic mask generation."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, InstanceOf
from pydantic.json_schema import SkipJsonSchema

from slgaussian.components.config import ComponentConfig, File
from slgaussian.components.pretrained import model_digest
from slgaussian.io import file_digest

PROPOSERS = {
    "regions": "slgaussian.masks.configs:RegionsConfig",
    "sam": "slgaussian.masks.configs:SamConfig",
    "sam2": "slgaussian.masks.configs:Sam2Config",
    "precomputed": "slgaussian.masks.configs:PrecomputedMasksConfig",
}
TRACKERS = {
    "geometric": "slgaussian.masks.configs:GeometricConfig",
    "sam2-video": "slgaussian.masks.configs:Sam2VideoConfig",
    "precomputed": "slgaussian.masks.configs:PrecomputedConfig",
}

MODEL = "Pretrained model: folder, or name on the Hugging Face hub."

Level = Literal["s", "m", "l"]
"""Level of a mask: part, object or group."""

MAP_SUFFIXES = (".png", ".npy")
"""Suffixes of id maps."""

DEPTH_SUFFIXES = (".npz", ".png", ".npy", ".pfm", ".tiff", ".tif")
"""Suffixes of depth files."""

LEVELS: tuple[Level, ...] = ("s", "m", "l")
"""The levels of a point's masks in the order of the model's outputs: part, object, group."""

Program = Literal["sam", "sam2", "grouping"]
"""The names of :data:`PRESETS`."""


@dataclass(frozen=True)
class Automatic:
    """Settings of automatic mask generation. The defaults are those of SAM's own program.

    Attributes:
        points: Prompted points along each side of the image.
        predicted_iou, stability: Thresholds of a mask: of the IoU that the model predicts
            (exclusive), and of its stability, the IoU of its logits thresholded at +1 and -1.
        box_iou: IoU threshold of non-maximum suppression of boxes, by predicted IoU.
        visible: Threshold of :func:`slgaussian.masks.automatic.mostly_visible`; None disables it.
    """

    points: int = 32
    predicted_iou: float = 0.88
    stability: float = 0.95
    box_iou: float = 0.7
    visible: float | None = None


PRESETS: dict[Program, Automatic] = {
    "sam": Automatic(),
    "sam2": Automatic(predicted_iou=0.8),
    "grouping": Automatic(points=64, predicted_iou=0.7, visible=0.8),
}
"""Settings by name: of SAM and SAM 2; of Gaussian Grouping, which the paper follows. Settings that
a program is not known to change are those of SAM."""


class RegionsConfig(ComponentConfig, title="regions"):
    """Object-like regions of an image: watershed leaves, merged into a tree, cut at one height."""

    target = "slgaussian.masks.regions:Regions"


class AutomaticConfig(ComponentConfig):
    """Config of a proposer that prompts a pretrained model with a grid of points."""

    model: Annotated[str | Path | None, File(model_digest)] = Field(None, description=MODEL)
    preset: Program | SkipJsonSchema[InstanceOf[Automatic]] = Field(
        "grouping", description="Settings of mask generation: sam, sam2 or grouping."
    )
    points: int | None = Field(
        None, ge=1, description="Points prompted along each side; by default those of the preset."
    )
    level: Literal["s", "m", "l", "all"] = Field(
        "all", description="Level of masks: s (parts), m (objects), l (groups) or all."
    )
    batch: int = Field(16, ge=1, description="Points prompted together; memory grows with it.")


class SamConfig(AutomaticConfig, title="sam"):
    """Masks by SAM; folders and hub names like ``facebook/sam-vit-base``, ``-large``, ``-huge``."""

    target: ClassVar[str] = "slgaussian.masks.sam:Sam"


class Sam2Config(AutomaticConfig, title="sam2"):
    """Masks by SAM 2; folders and hub names like ``facebook/sam2.1-hiera-tiny`` or ``-large``."""

    target: ClassVar[str] = "slgaussian.masks.sam:Sam2"


class GeometricConfig(ComponentConfig, title="geometric"):
    """Propagates labels from remembered frames to a view by cameras and predicted depth."""

    target = "slgaussian.masks.geometric:GeometricTracker"


class Sam2VideoConfig(ComponentConfig, title="sam2-video"):
    """Tracks objects from view to view as SAM 2 tracks objects through a video."""

    target = "slgaussian.masks.sam2_video:Sam2Video"

    model: Annotated[str | Path | None, File(model_digest)] = Field(None, description=MODEL)
    batch: int = Field(16, ge=1, description="Objects tracked together; memory grows with it.")


def folder_digest(folder: Path | str, suffixes: tuple[str, ...] = MAP_SUFFIXES) -> str:
    """Compute the SHA-256, hexadecimal, of names and contents of a folder of id maps."""
    folder = Path(folder)
    digest = hashlib.sha256()
    # Symbolic links to folders are followed, as views may be named through them.
    names = glob("**/*", root_dir=folder, recursive=True, include_hidden=True)
    for name in sorted(name for name in names if name.endswith(suffixes)):
        digest.update(f"{Path(name).as_posix()} {file_digest(folder / name)}\n".encode())
    return digest.hexdigest()


def masks_digest(place: Path | str) -> str:
    """Compute the SHA-256, hexadecimal, of a COCO file, or of the other masks of a folder."""
    from slgaussian.formats.mask_layouts import recognise_layout

    layout, where = recognise_layout(Path(place))
    return file_digest(where) if layout == "coco" else folder_digest(place)


def geometry_digest(place: Path | str) -> str:
    """Compute the SHA-256, hexadecimal, of a depth file, or of a folder of depth files."""
    suffixes = (*DEPTH_SUFFIXES, ".json")  # cameras beside maps
    return folder_digest(place, suffixes) if Path(place).is_dir() else file_digest(place)


class PrecomputedConfig(ComponentConfig, title="precomputed"):
    """Labels from masks of another program with consistent ids across views.

    The predictor and the proposer of this name share the table of settings; each reads its own
    field.
    """

    target = "slgaussian.masks.precomputed:Precomputed"

    folder: Annotated[Path | None, File(masks_digest)] = Field(
        None,
        description="Masks of another program, for tracker and proposer: folder of id maps (PNG or "
        "NPY), of Gaussian Grouping or LangSplat, or COCO's JSON.",
    )
    geometry: Annotated[Path | None, File(geometry_digest)] = Field(
        None,
        description="Depth of another program, for the predictor: NPZ, or a folder with one file "
        "per view.",
    )


class PrecomputedMasksConfig(PrecomputedConfig, title="precomputed"):
    """Masks of each view from files of SAM, LangSplat or an annotation program."""

    target = "slgaussian.masks.precomputed:PrecomputedProposer"
