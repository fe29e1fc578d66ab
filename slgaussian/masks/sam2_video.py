"""The tracker ``sam2-video``: SAM 2 on videos (Ravi et al., ICLR 2025) of ``transformers``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from pydantic import PrivateAttr
from torch.nn import functional as F

from slgaussian.components.pretrained import Family, load_pretrained
from slgaussian.kernels.threads import inside
from slgaussian.masks.configs import Sam2VideoConfig
from slgaussian.masks.sam import normalise

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView


class Sam2Video(Sam2VideoConfig):
    """Tracks objects from view to view as SAM 2 tracks objects through a video.

    Remembered frames are its conditioning frames; the mask of each object there is a prompt. A new
    view is the frame after them. Objects are tracked independently, so each pixel takes the object
    with the largest logit, and none where no logit is positive; ties go to the lowest id. Neither
    camera nor depth is used. Memory: 100 MiB for each remembered view, 60 MiB for each object of a
    batch.

    Attributes:
        device: PyTorch device; "auto" is "cuda" if available, else "cpu".

    Raises:
        InputError: If ``batch`` is below 1, or as
            :func:`slgaussian.components.pretrained.load_pretrained`.
    """

    FAMILY: ClassVar[Family] = Family(
        "sam2-video", "Sam2VideoModel", ("sam2_video",), "facebook/sam2.1-hiera-tiny"
    )

    device: str = "auto"
    final: ClassVar[bool] = False
    repeatable: ClassVar[bool] = True
    _network: Any = PrivateAttr()
    _labels: list[np.ndarray] = PrivateAttr(default_factory=list)
    _remembered: list[dict[str, Any]] = PrivateAttr(default_factory=list)
    _encoded: tuple[np.ndarray, dict[str, Any]] | None = PrivateAttr(None)

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        self._network = load_pretrained(self.model, self.FAMILY, self.device)

    def add(self, frame: SeenView, labels: np.ndarray) -> None:
        """Remember a frame; see :class:`slgaussian.masks.MaskTracker`."""
        self._labels.append(labels.copy())
        self._remembered.append(self._features(frame.image))

    @torch.inference_mode()
    def propagate(self, frame: SeenView) -> np.ndarray:
        """Return labels int32 [H, W] of a view; see :class:`slgaussian.masks.MaskTracker`."""
        features = self._features(frame.image)
        size = frame.image.shape[:2]
        best = torch.zeros(size, device=self._network.device)
        labels = torch.zeros(size, dtype=torch.int32, device=self._network.device)
        with inside(self._network):
            for number, logit in sorted(self._track(features).items()):
                enlarged = F.interpolate(logit[None, None], size, mode="bilinear")[0, 0]
                wins = enlarged > best
                best = torch.where(wins, enlarged, best)
                labels[wins] = number
        return labels.cpu().numpy()

    def _features(self, image: np.ndarray) -> dict[str, Any]:
        """Encode an image uint8 [H, W, 3], resized to the network's square input.

        Those of the latest image are cached: its labels are usually remembered next.
        """
        if self._encoded is not None and np.array_equal(self._encoded[0], image):
            return self._encoded[1]
        side = self._network.image_size
        pixels = normalise(image, (side, side)).to(self._network.device)
        with torch.inference_mode(), inside(self._network):
            out = self._network.get_image_features(pixels, return_dict=True)
        features = {
            "vision_feats": out.fpn_hidden_states,
            "vision_pos_embeds": out.fpn_position_encoding,
        }
        self._encoded = image.copy(), features
        return features

    def _track(self, features: dict[str, Any]) -> dict[int, torch.Tensor]:
        """Compute logits float32 [h, w] of every remembered object in a new frame."""
        logits: dict[int, torch.Tensor] = {}
        for frames, numbers in self._groups().items():
            for start in range(0, len(numbers), self.batch):
                batch = numbers[start : start + self.batch]
                logits.update(zip(batch, self._infer(frames, batch, features), strict=True))
        return logits

    def _groups(self) -> dict[tuple[int, ...], list[int]]:
        """Group objects by the frames that show them, so that none is tracked into another."""
        frames_of: dict[int, list[int]] = {}
        for index, labels in enumerate(self._labels):
            for number in np.unique(labels[labels > 0]).tolist():
                frames_of.setdefault(number, []).append(index)
        groups: dict[tuple[int, ...], list[int]] = {}
        for number in sorted(frames_of):
            groups.setdefault(tuple(frames_of[number]), []).append(number)
        return groups

    def _infer(
        self, frames: Sequence[int], numbers: Sequence[int], features: dict[str, Any]
    ) -> torch.Tensor:
        """Compute logits float32 [N, h, w] of N objects in the frame of ``features``."""
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

        device, side = self._network.device, self._network.image_size
        encoded = [self._remembered[index] for index in frames] + [features]
        session = Sam2VideoInferenceSession(
            inference_device=device,
            inference_state_device=device,
            dtype=torch.float32,  # the default, a string, is refused
            max_vision_features_cache_size=len(encoded),
        )
        for position, frame_features in enumerate(encoded):
            # The session counts frames and does not read those with cached features.
            session.add_new_frame(torch.empty(0), position)
            session.cache.cache_vision_features(position, frame_features)
        for position, index in enumerate(frames):
            labels = torch.from_numpy(self._labels[index])
            for number in numbers:
                mask = (labels == number)[None, None].float()
                mask = F.interpolate(mask, (side, side), mode="bilinear", antialias=True) >= 0.5
                session.add_mask_inputs(session.obj_id_to_idx(number), position, mask)
            session.obj_with_new_inputs = list(numbers)
            self._network(session, frame_idx=position)
        logits = self._network(session, frame_idx=len(frames)).pred_masks
        return logits.reshape(len(numbers), *logits.shape[-2:]).float()
