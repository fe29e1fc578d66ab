"""The tracker ``sam2-video``: SAM 2 on videos (Ravi et al., ICLR 2025) out of ``transformers``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import PrivateAttr

from slgaussian.components.pretrained import Family, load_pretrained
from slgaussian.masks.configs import Sam2VideoConfig
from slgaussian.masks.video_memory import VideoMemory

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView


class Sam2Video(Sam2VideoConfig):
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
        If ``batch`` is below 1, or as :func:`slgaussian.components.pretrained.load_pretrained`.
    """

    FAMILY: ClassVar[Family] = Family(
        "sam2-video", "Sam2VideoModel", ("sam2_video",), "facebook/sam2.1-hiera-tiny"
    )

    device: str = "auto"
    final: ClassVar[bool] = False
    repeatable: ClassVar[bool] = True
    _memory: VideoMemory = PrivateAttr()

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        network = load_pretrained(self.model, self.FAMILY, self.device)
        self._memory = VideoMemory(network, self.batch)

    def add(self, seen: SeenView, labels: np.ndarray) -> None:
        """Remember a frame; see :class:`slgaussian.masks.MaskTracker`.

        Raises
        ------
        InputError
            If the labels are not int32 of the view's size, or negative.
        """
        self._memory.add(seen.view, labels)

    def propagate(self, seen: SeenView) -> np.ndarray:
        """Labels int32 [H, W] for a view; see :class:`slgaussian.masks.MaskTracker`."""
        return self._memory.propagate(seen.view)
