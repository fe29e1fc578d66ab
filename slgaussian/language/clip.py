"""The encoder ``clip``: CLIP (Radford et al., ICML 2021) out of ``transformers``.

Regions are encoded as LangSplat does, and so the paper: see :mod:`slgaussian.language.crops`. Texts
are encoded as they are, without a template around them.

Cosines of CLIP lie in a narrow cone: of texts with each other mostly between 0.6 and 0.9, of texts
with pictures between 0.1 and 0.4. What cuts them is set from what is published, and not measured
here: LERF's four phrases, temperature 10 and threshold 0.5 (Kerr et al., ICCV 2023), and for the
looks at one thing the softmax temperature that CLIP itself learnt (:attr:`Clip.soft`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from pydantic import PrivateAttr

from slgaussian.components.pretrained import (
    OPEN_CLIP_CONFIG,
    PREPROCESSOR,
    Family,
    ModelFiles,
    find_model,
    find_tokenizer,
    load_pretrained,
    load_tokenizer,
    read_json,
    table_in,
)
from slgaussian.errors import InputError
from slgaussian.kernels.threads import inside
from slgaussian.language.configs import CLIP, ClipConfig

if TYPE_CHECKING:
    from slgaussian.geometry.room import Surroundings

MEAN, STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
"""Mean and deviation of CLIP's colours, in [0, 1]; a model's own files may say others."""


def _converted(files: ModelFiles) -> Any:
    from slgaussian.language.open_clip import load_open_clip

    return load_open_clip(files)


class Clip(ClipConfig):
    """Regions and texts by CLIP, in one space of ``projection_dim`` axes (512 for a ViT-B).

    The same input gives the same bytes on the same machine, whatever else is encoded with it:
    texts go through the network one by one, regions ``batch`` by ``batch``, the last batch filled
    up. Another batch changes vectors by about 1e-7.

    Fields are those of :class:`slgaussian.language.configs.ClipConfig`. With crops ``context`` a
    vector is the mean of that of the region alone and of that of its whole bounding box, made a
    unit vector again: walls and such say little without their surroundings. It takes twice the
    time, and is not what the paper does. ``bfloat16`` takes a third of the time where the CPU has
    it, is slower elsewhere, and changes cosines by up to 1e-3.

    Attributes
    ----------
    device : str
        As PyTorch names it; "auto" is "cuda" where there is one, else "cpu". Off the CPU the image
        tower always computes in bfloat16.

    Raises
    ------
    InputError
        If a setting is none of these, there is no tokenizer, it belongs to another model, or as
        :func:`slgaussian.components.pretrained.load_pretrained`.
    """

    FAMILY: ClassVar[Family] = Family("clip", "CLIPModel", ("clip",), CLIP, _converted)
    name: ClassVar[str] = "clip"
    calibration: ClassVar[None] = None
    canonical: ClassVar[tuple[str, ...]] = ("object", "things", "stuff", "texture")

    device: str = "auto"
    _network: Any = PrivateAttr()
    _words: Any = PrivateAttr()
    _colours: tuple[torch.Tensor, torch.Tensor] = PrivateAttr()

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        self._network = load_pretrained(self.model, self.FAMILY, self.device)
        self._words = self._load_words()
        self._colours = _colours(find_model(self.model))

    @property
    def network(self) -> Any:
        """The model of ``transformers``, on its device."""
        return self._network

    @property
    def soft(self) -> float:
        """The temperature of the model's own softmax over cosines: 0.01 in the published ones."""
        return float((-self.network.logit_scale).exp())

    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """Unit vectors of regions.

        Parameters
        ----------
        image : uint8 [H, W, 3]
            sRGB.
        masks : bool [M, H, W]
            The regions, each with at least one pixel; they may overlap.
        around : Surroundings, optional
            Not looked at.

        Returns
        -------
        float32 [M, C]

        Raises
        ------
        InputError
            If image and masks do not match, or a mask is empty.
        """
        from slgaussian.language.crops import check_regions

        check_regions(self.name, image, masks)
        vectors = [
            self._pictures(image, masks[start : start + self.batch])
            for start in range(0, len(masks), self.batch)
        ]
        return np.concatenate([np.zeros((0, self._width), np.float32), *vectors])

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C] of texts.

        Raises
        ------
        InputError
            If a text is empty, longer than the model reads, or cannot be read at all.
        """
        vectors = [self._text(text) for text in texts]
        return np.concatenate([np.zeros((0, self._width), np.float32), *vectors])

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """None: any word has a vector, though a rare one may mean little to the model."""
        return ()

    def unused_words(self, text: str) -> Mapping[str, str]:
        """None: every word counts."""
        return {}

    def read_as(self, text: str) -> str:
        """The text itself."""
        return text

    @property
    def _width(self) -> int:
        return self.network.config.projection_dim

    def _pictures(self, image: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Unit vectors of at most ``batch`` regions."""
        from slgaussian.language.crops import region_crop

        side = self.network.config.vision_config.image_size
        kinds = (False,) if self.crops == "masked" else (False, True)
        total = np.zeros((len(masks), self._width))
        for context in kinds:
            pixels = np.zeros((self.batch, side, side, 3), np.uint8)
            for picture, mask in zip(pixels, masks, strict=False):
                picture[:] = region_crop(image, mask, side, context)
            mean, std = self._colours
            values = (torch.from_numpy(pixels).permute(0, 3, 1, 2) / 255 - mean) / std
            kind = self.network.device.type
            reduced = kind != "cpu" or self.precision == "bfloat16"
            precision = torch.autocast(kind, torch.bfloat16, enabled=reduced)
            with torch.inference_mode(), precision, inside(self.network):
                found = self.network.get_image_features(values.to(self.network.device))
            total += _unit(found)[: len(masks)]
        return (total / np.linalg.norm(total, axis=1, keepdims=True)).astype(np.float32)

    def _text(self, text: str) -> np.ndarray:
        excerpt = text if len(text) <= 60 else text[:57] + "..."
        if not text.strip():
            raise InputError(f"query {excerpt!r}: is empty; describe an object, as in 'red ball'")
        try:
            tokens = self._words(text)["input_ids"]
        except (TypeError, ValueError):  # halves of surrogate pairs, which no file can hold
            raise InputError(f"query {excerpt!r}: is not valid text; write it anew") from None
        limit = self.network.config.text_config.max_position_embeddings
        if len(tokens) > limit:
            raise InputError(
                f"query {excerpt!r}: has {len(tokens)} tokens, but the model reads at most "
                f"{limit}; say it in fewer words"
            )
        if self._words.eos_token_id in tokens[:-1]:
            raise InputError(f"query {excerpt!r}: cannot be read by the tokenizer; use other words")
        token_batch = torch.tensor([tokens], device=self.network.device)
        with torch.inference_mode(), inside(self.network):
            features = self.network.get_text_features(token_batch)
        return _unit(features).astype(np.float32)

    def _load_words(self) -> Any:
        """The tokenizer, checked against the network."""
        place = self.tokenizer
        if place is None:
            place = find_model(self.model).folder
            try:
                find_tokenizer(place)
            except InputError:
                raise InputError(
                    f"model {self.model}: has no tokenizer beside it; put its tokenizer.json, or "
                    "vocab.json and merges.txt, there, or say where they are, as in "
                    f"--set clip.tokenizer={self.FAMILY.example}"
                ) from None
        words = load_tokenizer(place, "CLIPTokenizer")
        config = self.network.config.text_config
        # 2 stands for the greatest token of a text in configurations older than this number.
        ends = (config.eos_token_id, config.vocab_size - 1 if config.eos_token_id == 2 else None)
        if words.eos_token_id not in ends or len(words) > config.vocab_size:
            raise InputError(
                f"tokenizer {place}: has {len(words)} tokens and ends texts with "
                f"{words.eos_token_id}, but the model has {config.vocab_size} and reads up to "
                f"{config.eos_token_id}; give the tokenizer of this model"
            )
        return words


def _unit(output: Any) -> np.ndarray:
    """Unit vectors float64 of what the network gives: from version 5 on, it says more as well."""
    vectors = getattr(output, "pooler_output", output).double().cpu().numpy()
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _colours(files: ModelFiles) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and deviation that colours are normalised by, each [3, 1, 1]."""
    import torch

    if files.checkpoint is None:
        file, keys = files.folder / PREPROCESSOR, ("image_mean", "image_std")
        config: Mapping[str, Any] = read_json(file) if file.is_file() else {}
    else:
        file, keys = files.folder / OPEN_CLIP_CONFIG, ("mean", "std")
        config = table_in(read_json(file), "preprocess_cfg", file) if file.is_file() else {}
    values = [config.get(key, default) for key, default in zip(keys, (MEAN, STD), strict=True)]
    try:
        mean, std = (torch.tensor(value, dtype=torch.float32).reshape(3, 1, 1) for value in values)
        if not (mean.isfinite().all() and std.isfinite().all() and (std > 0).all()):
            raise ValueError
    except (TypeError, ValueError, RuntimeError):
        raise InputError(
            f"{file}: {keys[0]} and {keys[1]} are {values[0]!r} and {values[1]!r}, expected three "
            "numbers each; get it again"
        ) from None
    return mean, std
