"""What the tracker ``sam2-video`` remembers: frames with labels, as SAM 2 conditions on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from slgaussian.kernels.threads import inside
from slgaussian.masks.memory import check_labels
from slgaussian.masks.sam_image import normalised
from slgaussian.scene import View


@dataclass(frozen=True, eq=False)
class _Frame:
    labels: np.ndarray
    features: dict[str, Any]


@dataclass(eq=False)
class VideoMemory:
    """Frames and their labels, and the network that finds the same objects in new ones.

    See :class:`slgaussian.masks.sam2_video.Sam2Video`. ``batch`` objects are asked about at a time.
    """

    network: Any
    batch: int
    _frames: list[_Frame] = field(default_factory=list, init=False)
    _encoded: list[tuple[np.ndarray, dict[str, Any]]] = field(default_factory=list, init=False)

    def add(self, view: View, labels: np.ndarray) -> None:
        """Remember a frame; InputError if labels are not int32 of its size, or negative."""
        check_labels(view, labels)
        self._frames.append(_Frame(labels.copy(), self._features(view)))

    @torch.inference_mode()
    def propagate(self, view: View) -> np.ndarray:
        """Labels int32 [H, W] for ``view``, 0 where no object is."""
        features = self._features(view)
        size = view.image.shape[:2]
        best = torch.zeros(size, device=self.network.device)
        labels = torch.zeros(size, dtype=torch.int32, device=self.network.device)
        with inside(self.network):
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
        for image, features in self._encoded:
            if np.array_equal(image, view.image):
                return features
        side = self.network.image_size
        pixels = normalised(view.image, (side, side)).to(self.network.device)
        with torch.inference_mode(), inside(self.network):
            out = self.network.get_image_features(pixels, return_dict=True)
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
        found: dict[int, torch.Tensor] = {}
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

        device, side = self.network.device, self.network.image_size
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
            self.network(session, frame_idx=position)
        logits = self.network(session, frame_idx=len(shown)).pred_masks
        return logits.reshape(len(numbers), *logits.shape[-2:]).float()
