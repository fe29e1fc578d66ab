"""The encoder ``clip``: CLIP (Radford et al., ICML 2021) of ``transformers``.

Regions are encoded as in LangSplat and the paper: pixels outside the region are black, the bounding
box is cut out, padded with black to a centred square, and resized bilinearly. Texts are encoded
without a prompt template.

CLIP embeddings lie in a narrow cone: cosines between texts are mostly 0.6 to 0.9, between texts and
images 0.1 to 0.4. The constants that depend on this are published ones and were not tuned here:
LERF's four phrases, temperature 10 and threshold 0.5 (Kerr et al., ICCV 2023), and, for combining
the views of one object, CLIP's learnt softmax temperature (:attr:`Clip.soft`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
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
from slgaussian.language import Encoder
from slgaussian.language.configs import CLIP, ClipConfig
from slgaussian.language.vocabulary import excerpt

if TYPE_CHECKING:
    from slgaussian.geometry.room import Surroundings

MEAN, STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
"""CLIP's mean and standard deviation of RGB in [0, 1]; the files of a model may override them."""


def _convert(files: ModelFiles) -> Any:
    from slgaussian.language.open_clip import load_open_clip

    return load_open_clip(files)


class Clip(ClipConfig, Encoder):
    """CLIP embeddings of regions and texts, ``projection_dim`` axes (512 for a ViT-B).

    Results are the same bytes on one machine, whatever else is encoded in the same call: texts are
    encoded one by one, regions in padded batches. Another ``batch`` changes vectors by about 1e-7.

    With crops ``context``, which is not in the paper and takes twice the time, a vector is the
    normalised mean of those of the masked region and of its whole bounding box: walls are hard to
    recognise without context. ``bfloat16`` takes a third of the time on CPUs with native support,
    is slower on others, and changes cosines by up to 1e-3.

    Attributes:
        device: PyTorch device; "auto" is "cuda" if available, else "cpu". On other devices than the
            CPU the image tower always runs in bfloat16.

    Raises:
        InputError: If a setting is invalid, or the tokenizer is missing or belongs to another
            model; also as :func:`slgaussian.components.pretrained.load_pretrained`.
    """

    FAMILY: ClassVar[Family] = Family("clip", "CLIPModel", ("clip",), CLIP, _convert)
    name: ClassVar[str] = "clip"
    canonical: ClassVar[tuple[str, ...]] = ("object", "things", "stuff", "texture")

    device: str = "auto"
    _network: Any = PrivateAttr()
    _words: Any = PrivateAttr()
    _colours: list[torch.Tensor] = PrivateAttr()

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        self._network = load_pretrained(self.model, self.FAMILY, self.device)
        self._words = self._load_words()
        self._colours = _colours(find_model(self.model))

    @property
    def network(self) -> Any:
        """The ``transformers`` model, on its device."""
        return self._network

    @property
    def soft(self) -> float:
        """Learnt temperature of CLIP's softmax over cosines, 0.01 in the published models."""
        return float((-self.network.logit_scale).exp())

    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """See :class:`slgaussian.language.Encoder`; ``around`` is ignored."""
        starts = range(0, len(masks), self.batch)
        vectors = [self._pictures(image, masks[i : i + self.batch]) for i in starts]
        return np.concatenate([np.zeros((0, self._width), np.float32), *vectors])

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Encode texts as unit vectors float32 [Q, C].

        Raises:
            InputError: If a text is empty, too long for the model, or not valid Unicode.
        """
        vectors = [self._text(text) for text in texts]
        return np.concatenate([np.zeros((0, self._width), np.float32), *vectors])

    @property
    def _width(self) -> int:
        return self.network.config.projection_dim

    def _pictures(self, image: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Encode at most ``batch`` regions as unit vectors."""
        side = self.network.config.vision_config.image_size
        device, (mean, std) = self.network.device, self._colours
        reduced = device.type != "cpu" or self.precision == "bfloat16"
        total = np.zeros((len(masks), self._width))
        for context in (False,) if self.crops == "masked" else (False, True):
            pixels = np.zeros((self.batch, side, side, 3), np.uint8)
            for picture, mask in zip(pixels, masks, strict=False):
                picture[:] = region_crop(image, mask, side, context)
            values = (torch.from_numpy(pixels).permute(0, 3, 1, 2) / 255 - mean) / std
            precision = torch.autocast(device.type, torch.bfloat16, enabled=reduced)
            with torch.inference_mode(), precision, inside(self.network):
                features = self.network.get_image_features(values.to(device))
            total += _unit(features)[: len(masks)]
        return (total / np.linalg.norm(total, axis=1, keepdims=True)).astype(np.float32)

    def _text(self, text: str) -> np.ndarray:
        query = f"query {excerpt(text)!r}"
        if not text.strip():
            raise InputError(f"{query}: is empty; describe an object, as in 'red ball'")
        try:
            tokens = self._words(text)["input_ids"]
        except (TypeError, ValueError):  # lone surrogates
            raise InputError(f"{query}: is not valid text; write it anew") from None
        limit = self.network.config.text_config.max_position_embeddings
        if len(tokens) > limit:
            raise InputError(
                f"{query}: has {len(tokens)} tokens, but the model reads at most {limit}; say it "
                "in fewer words"
            )
        with torch.inference_mode(), inside(self.network):
            batch = torch.tensor([tokens], device=self.network.device)
            features = self.network.get_text_features(batch)
        return _unit(features).astype(np.float32)

    def _load_words(self) -> Any:
        """Load the tokenizer and check that it belongs to the network."""
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
        # Old configurations have 2 here; the model then ends texts at their largest token.
        ends = (config.eos_token_id, config.vocab_size - 1 if config.eos_token_id == 2 else None)
        if words.eos_token_id not in ends or len(words) > config.vocab_size:
            raise InputError(
                f"tokenizer {place}: has {len(words)} tokens and ends texts with "
                f"{words.eos_token_id}, but the model has {config.vocab_size} and reads up to "
                f"{config.eos_token_id}; give the tokenizer of this model"
            )
        return words


def _unit(output: Any) -> np.ndarray:
    """Normalise the output of the network, float64; ``transformers`` 5 wraps it in an object."""
    vectors = getattr(output, "pooler_output", output).double().cpu().numpy()
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _colours(files: ModelFiles) -> list[torch.Tensor]:
    """Read the mean and standard deviation by which a model normalises colours, each [3, 1, 1]."""
    if files.checkpoint is None:
        file, keys = files.folder / PREPROCESSOR, ("image_mean", "image_std")
    else:
        file, keys = files.folder / OPEN_CLIP_CONFIG, ("mean", "std")
    config: Mapping[str, Any] = read_json(file) if file.is_file() else {}
    if files.checkpoint is not None:
        config = table_in(config, "preprocess_cfg", file)
    values = [config.get(key, default) for key, default in zip(keys, (MEAN, STD), strict=True)]
    try:
        return [torch.tensor(value, dtype=torch.float32).reshape(3, 1, 1) for value in values]
    except (TypeError, ValueError, RuntimeError):
        raise InputError(
            f"{file}: {' and '.join(keys)} are {values!r:.80}, expected three numbers each; get it "
            "again"
        ) from None


def region_crop(image: np.ndarray, mask: np.ndarray, side: int, context: bool) -> np.ndarray:
    """Crop one region.

    Args:
        image: uint8 [H, W, 3]
        mask: bool [H, W]. Not empty.
        side: Side of the crop, pixels.
        context: If true, the rest of the bounding box is not blackened.

    Returns:
        uint8 [side, side, 3]: Of an odd number of padding pixels, the smaller half is above or on
            the left.
    """
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    window = np.s_[y : y + h, x : x + w]
    longest = max(w, h)
    square = np.zeros((longest, longest, 3), np.uint8)
    top, left = (longest - h) // 2, (longest - w) // 2
    patch = image[window] if context else image[window] * mask[window][..., None]
    square[top : top + h, left : left + w] = patch
    return cv2.resize(square, (side, side), interpolation=cv2.INTER_LINEAR)
