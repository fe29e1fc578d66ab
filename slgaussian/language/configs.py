"""Configs of the encoders and code strategies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from slgaussian.components.config import ComponentConfig, File
from slgaussian.components.pretrained import model_digest, tokenizer_digest

CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
"""The model of LangSplat and the paper."""

MOST_DIMENSIONS = 3
"""Most numbers a code: channels that are rendered."""

Dimension = Annotated[int, Field(ge=1, le=MOST_DIMENSIONS)]


class LexiconConfig(ComponentConfig, title="lexicon"):
    """Regions and texts by the words of an explicit vocabulary, without weights of its own."""

    target = "slgaussian.language.lexicon:Lexicon"

    classifier: Literal["auto", "lite0", "none"] = Field(
        "auto",
        validate_default=True,
        description="What tells nouns that look does not tell: lite0, an ImageNet classifier of "
        "a package of its own; none; or auto, lite0 where that is installed.",
    )

    @field_validator("classifier")
    @classmethod
    def _installed(cls, name: str) -> str:
        from slgaussian.language.weights import INSTALL, find_weights

        if name == "none" or find_weights() is not None:
            return "none" if name == "none" else "lite0"
        if name == "lite0":
            raise ValueError(f"lite0 is not installed; get it with {INSTALL}")
        return "none"


class ClipConfig(ComponentConfig, title="clip"):
    """Regions and texts by CLIP, in one space of ``projection_dim`` axes (512 for a ViT-B)."""

    target = "slgaussian.language.clip:Clip"

    model: Annotated[str | Path, File(model_digest)] = Field(
        CLIP,
        description="CLIP: folder, name on the Hugging Face hub, or open_clip's file or folder.",
    )
    tokenizer: Annotated[str | Path | None, File(tokenizer_digest)] = Field(
        None,
        description="CLIP's tokenizer if not beside its model: folder, or name on the hub.",
    )
    crops: Literal["masked", "context"] = Field(
        "masked",
        description="What CLIP sees of a region: masked, itself on black, or context, also what "
        "is around it.",
    )
    batch: int = Field(4, ge=1, description="Regions encoded together: memory goes with it.")
    precision: Literal["float32", "bfloat16"] = Field(
        "float32", description="Of CLIP's image tower on a CPU: float32 or bfloat16."
    )


class GridConfig(ComponentConfig, title="grid"):
    """The paper's codes: points of an even grid, at random."""

    target = "slgaussian.language.codes:Grid"

    dimension: Dimension = Field(3, description="Numbers a code, 1 to 3.")
    decode: Literal["settled", "nearest"] = Field(
        "settled",
        description="How pixels are read: settled, where borders ask those around, or nearest, as "
        "the paper.",
    )


class SeparatedConfig(ComponentConfig, title="separated"):
    """Every second point of a grid, as on a chessboard, given to objects by simulated annealing."""

    target = "slgaussian.language.codes:Separated"

    dimension: Dimension | Literal["auto"] = Field(
        3, description="Numbers a code, 1 to 3, or 'auto': as few as the scene needs."
    )
    error: float = Field(
        0.01,
        ge=0,
        le=1,
        description="With 'auto': mixtures of neighbours that may read as a third object.",
    )
