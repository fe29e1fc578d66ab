"""One sample of a clip: its views, decoded and brought to one size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from slgaussian.datasets import licences
from slgaussian.datasets.re10k import Clip
from slgaussian.parts.identity import KnownFile
from slgaussian.scene import Sample, View
from slgaussian.storage.provenance import saying
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import sample_to_arrays
from tasks.chunks import Framing, read_chunk
from tasks.context import RunContext
from tasks.stage import stage


@dataclass(frozen=True)
class Frames:
    """A sample by the frames of its clip."""

    sample: str
    clip: str
    context: tuple[int, ...]
    targets: tuple[int, ...]


@stage("framed", version=2)
def framed(
    run: RunContext, chunk: KnownFile | ArtifactRef, frames: Frames, framing: Framing
) -> ArtifactRef:
    """A sample of a chunk: spec ``sample``. ``meta["url"]`` is that of its video."""
    clip = read_chunk(run, chunk)[frames.clip]
    context = framed_views(clip, frames.context, framing)
    targets = framed_views(clip, frames.targets, framing)
    sample = Sample(frames.sample, context, targets)
    licence = "" if isinstance(chunk, ArtifactRef) else licences.stated(Path(chunk.place))
    with saying(clip.url, licence):
        return run.store.put("sample", sample_to_arrays(sample), {"url": clip.url})


def framed_views(clip: Clip, frames: Sequence[int], framing: Framing) -> tuple[View, ...]:
    """Frames of a clip, decoded and framed; InputError if one cannot be decoded."""
    height, width = framing.size
    found = [clip.view(frame).resized(height, width) for frame in frames]
    return tuple(replace(v, camera=v.camera.ranged(framing.near, framing.far)) for v in found)
