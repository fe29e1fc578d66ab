"""The tracker ``sam2-video``: SAM 2 on videos (Ravi et al., ICLR 2025) out of ``transformers``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch.nn import functional as F

from slgaussian.kernels.threads import inside
from slgaussian.masks.memory import check_labels
from slgaussian.masks.regions import check_image
from slgaussian.masks.sam import normalised
from slgaussian.parts.pretrained import Family, load_pretrained, model_digest
from slgaussian.parts.settings import check_settings, setting
from slgaussian.scene import View


@dataclass(frozen=True, eq=False)
class _Frame:
    labels: np.ndarray
    features: dict[str, Any]


@dataclass(eq=False)
class Sam2Video:
    """Carries labels from view to view as SAM 2 carries objects through a video.

    Remembered frames are its conditioning frames: the mask of every object there is its prompt.
    A new view is the frame after them. Objects do not know of each other, so each pixel goes to the
    object with the largest logit, and to none where no logit is positive; of equal ones the lowest
    id has it. Neither camera nor depth is read. Views may differ in size.

    Each image is encoded once. Objects are asked about in batches, so memory does not grow with
    their number: 100 MiB a remembered view, and 60 MiB for each object of a batch. A view asked for
    again gives the same answer until another frame is remembered.

    Attributes
    ----------
    model : path or str
        Folder, or name on the Hugging Face hub. Has no default.
    batch : int
        Objects that are tracked at a time.
    device : str
        As PyTorch names it; "auto" is "cuda" where there is one, else "cpu".

    Raises
    ------
    InputError
        If ``batch`` is below 1, or as :func:`slgaussian.parts.pretrained.load_pretrained`.
    """

    FAMILY: ClassVar[Family] = Family(
        "sam2-video", "Sam2VideoModel", ("sam2_video",), "facebook/sam2.1-hiera-tiny"
    )

    model: str | Path | None = setting(
        None, "Pretrained model: folder, or name on the Hugging Face hub.", content=model_digest
    )
    batch: int = setting(16, "Objects tracked together: memory goes with it.", low=1)
    device: str = "auto"
    final: ClassVar[bool] = False
    _frames: list[_Frame] = field(default_factory=list, init=False)
    _encoded: list[tuple[np.ndarray, dict[str, Any]]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        check_settings(self, "sam2-video")
        self._network = load_pretrained(self.model, self.FAMILY, self.device)

    def add(self, view: View, labels: np.ndarray, depth: np.ndarray | None = None) -> None:
        """Remember a frame; see :class:`slgaussian.masks.MaskTracker`.

        Raises
        ------
        InputError
            If the labels are not int32 of the view's size, or negative.
        """
        check_labels(view, labels)
        self._frames.append(_Frame(labels.copy(), self._features(view)))

    @torch.inference_mode()
    def propagate(self, view: View, depth: np.ndarray | None = None) -> np.ndarray:
        """Labels int32 [H, W] for ``view``; see :class:`slgaussian.masks.MaskTracker`."""
        features = self._features(view)
        size = view.image.shape[:2]
        best = torch.zeros(size, device=self._network.device)
        labels = torch.zeros(size, dtype=torch.int32, device=self._network.device)
        with inside(self._network):
            for number, logit in sorted(self._tracked(features).items()):
                enlarged = F.interpolate(logit[None, None], size, mode="bilinear")[0, 0]
                wins = enlarged > best
                best = torch.where(wins, enlarged, best)
                labels[wins] = number
        return labels.cpu().numpy()

    def _features(self, view: View) -> dict[str, Any]:
        """The encoded image, the network's square whatever its shape; known images are not again.

        Of images that are no frames only the latest is kept: its labels are mostly remembered next.
        """
        check_image(view.image)
        for image, features in self._encoded:
            if np.array_equal(image, view.image):
                return features
        side = self._network.image_size
        pixels = normalised(view.image, (side, side)).to(self._network.device)
        with torch.inference_mode(), inside(self._network):
            out = self._network.get_image_features(pixels, return_dict=True)
        features = {
            "vision_feats": out.fpn_hidden_states,
            "vision_pos_embeds": out.fpn_position_encoding,
        }
        used = [frame.features for frame in self._frames]
        self._encoded = [known for known in self._encoded if any(known[1] is u for u in used)]
        self._encoded.append((view.image.copy(), features))
        return features

    def _tracked(self, features: dict[str, Any]) -> dict[int, torch.Tensor]:
        """Logits float32 [h, w] of every remembered object in a new frame."""
        found = {}
        for shown, numbers in self._groups().items():
            for start in range(0, len(numbers), self.batch):
                batch = numbers[start : start + self.batch]
                logits = self._ask(shown, batch, features)
                found.update(zip(batch, logits, strict=True))
        return found

    def _groups(self) -> dict[tuple[int, ...], list[int]]:
        """The frames that show an object -> the objects that just these frames show, ascending.

        The network runs a frame for all objects of a session: those of one group are all prompted
        there, never tracked into a frame of the past.
        """
        shown: dict[int, list[int]] = {}
        for index, frame in enumerate(self._frames):
            for number in np.unique(frame.labels[frame.labels > 0]).tolist():
                shown.setdefault(number, []).append(index)
        groups: dict[tuple[int, ...], list[int]] = {}
        for number in sorted(shown):
            groups.setdefault(tuple(shown[number]), []).append(number)
        return groups

    def _ask(
        self, shown: Sequence[int], numbers: Sequence[int], features: dict[str, Any]
    ) -> torch.Tensor:
        """Logits float32 [N, h, w], in the frame of ``features``, of some objects."""
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

        device, side = self._network.device, self._network.image_size
        encoded = [self._frames[index].features for index in shown] + [features]
        session = Sam2VideoInferenceSession(
            inference_device=device,
            inference_state_device=device,
            dtype=torch.float32,  # its default, a string, is refused by its own calls
            max_vision_features_cache_size=len(encoded),
        )
        for position, known in enumerate(encoded):
            # The network counts frames, and reads none whose features are there.
            session.add_new_frame(torch.empty(0), position)
            session.cache.cache_vision_features(position, known)
        for position, index in enumerate(shown):
            labels = torch.from_numpy(self._frames[index].labels)
            for number in numbers:
                mask = (labels == number)[None, None].float()
                mask = F.interpolate(mask, (side, side), mode="bilinear", antialias=True) >= 0.5
                session.add_mask_inputs(session.obj_id_to_idx(number), position, mask)
            session.obj_with_new_inputs = list(numbers)
            self._network(session, frame_idx=position)
        logits = self._network(session, frame_idx=len(shown)).pred_masks
        return logits.reshape(len(numbers), *logits.shape[-2:]).float()
