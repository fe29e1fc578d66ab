"""Speed of queries, beside the way of LangSplat: a feature a pixel, decoded by a network.

    python -m benches.language.query_cost [-o docs/measured]

A field of 60 objects with features of 512 numbers, seen at 416 x 576; texts are encoded already.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from scipy.spatial import cKDTree

from benches.common.harness import ms, parser, publish, table, times_in_turn
from benches.common.photograph_pairs import load_samples
from slgaussian.field import FieldView, SemanticField
from slgaussian.gaussians import source_depths
from slgaussian.kernels import threads
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.language.bank import MemoryBank
from slgaussian.language.query import Rules
from slgaussian.predict import load_predictor
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera, Sample
from slgaussian.semantic import load_lifting
from slgaussian.semantic.decode import Decoder

OBJECTS, WIDTH, TEXTS = 60, 512, 100
LAYERS = (3, 16, 32, 64, 128, 256, 256, WIDTH)
"""LangSplat's decoder, from the code of a pixel to its feature."""
BLOCK = 16_384
"""Pixels that the decoder takes at a time, so that its layers stay in the cache."""


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class Drawn:
    """An encoder as wide as CLIP that draws a direction for each text: only its speed counts."""

    name, canonical = "drawn", ("object", "things", "stuff", "texture")
    calibration = None

    def encode_regions(self, image: np.ndarray, masks: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        seeds = [list(text.encode()) for text in texts]
        drawn = [np.random.default_rng(seed).normal(size=WIDTH) for seed in seeds]
        return unit(np.array(drawn)).astype(np.float32)

    def unknown_words(self, text: str) -> tuple[str, ...]:
        return ()

    def unused_words(self, text: str) -> dict[str, str]:
        return {}

    def read_as(self, text: str) -> str:
        return text


class DrawnField(SemanticField):
    encoder = Drawn()


def make_field(sample: Sample) -> SemanticField:
    """The Gaussians of two photographs, parted into :data:`OBJECTS` lumps of space."""
    gaussians = load_predictor("planesweep")(sample)
    rng = np.random.default_rng(0)
    means = gaussians.means.numpy()
    middles = means[rng.choice(len(means), OBJECTS, replace=False)]
    cameras = [view.camera for view in sample.context]
    depths = source_depths(gaussians, cameras)
    points = np.stack([c.unproject(depth) for c, depth in zip(cameras, depths, strict=True)])
    labels = cKDTree(middles).query(points)[1].astype(np.int32) + 1
    label_maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    codes = load_codes("separated")(label_maps, rng)
    features = unit(rng.normal(size=(OBJECTS, 2, WIDTH)))
    present = label_maps.areas() > 0
    features = (features * present[..., None]).astype(np.float32)
    bank = MemoryBank(label_maps.ids, codes, features, present)
    lifted = load_lifting("hard")(gaussians, label_maps, bank)
    names = {view.name: view.camera for view in sample.context}
    return DrawnField(lifted, bank, names, {})


class LangSplatWay:
    """A feature a pixel: rendered codes through the decoder, and every pixel scored."""

    def __init__(self, encoder: Drawn) -> None:
        torch.manual_seed(0)
        layers: list[torch.nn.Module] = []
        for a, b in pairwise(LAYERS):
            layers += [torch.nn.Linear(a, b), torch.nn.ReLU()]
        self.decoder = torch.nn.Sequential(*layers[:-1]).eval()
        self.canonical = torch.from_numpy(encoder.encode_text(encoder.canonical))

    @torch.inference_mode()
    def decode(self, codes: torch.Tensor) -> torch.Tensor:
        """Unit features [P, 512] of codes [P, 3]."""
        out = torch.empty(len(codes), WIDTH)
        for block in range(0, len(codes), BLOCK):
            decoded = self.decoder(codes[block : block + BLOCK])
            out[block : block + BLOCK] = torch.nn.functional.normalize(decoded, dim=-1)
        return out

    @torch.inference_mode()
    def score(self, features: torch.Tensor, texts: torch.Tensor) -> torch.Tensor:
        """Relevancy [P, Q] of every pixel to texts [Q, 512]: the least over canonical phrases."""
        out = torch.empty(len(features), len(texts))
        for block in range(0, len(features), BLOCK):
            part = features[block : block + BLOCK]
            strongest = (part @ self.canonical.T).amax(-1, keepdim=True)
            out[block : block + BLOCK] = torch.sigmoid(10 * (part @ texts.T - strongest))
        return out


def speed_rows(field: SemanticField, camera: Camera) -> list[dict]:
    texts = [f"text {i}" for i in range(TEXTS)]
    field.reader.gaps(texts, Rules())  # so that they are encoded already
    decoder = Decoder(field.bank)
    image = rasterize(field.gaussians, field.gaussians.features, camera)
    drawn = image.values.numpy()
    shape = drawn.shape[:2]
    alpha = np.ones(shape, np.float32)
    rgb = np.zeros((*shape, 3), np.uint8)

    def fresh() -> FieldView:
        return FieldView(rgb, *decoder(drawn), alpha, alpha, field)

    def answer(view: FieldView, text: str) -> object:
        hit = view.query(text)
        return hit.mask, hit.relevancy, hit.point, hit.objects

    turn = iter(range(10**9))

    def first() -> None:
        answer(fresh(), texts[next(turn) % TEXTS])

    def further() -> None:
        # Of a view that was never asked where this object is: its point is not known yet.
        ready._objects._points.clear()
        answer(ready, texts[next(turn) % TEXTS])

    def hundred() -> None:
        [hit.objects for hit in ready.query_all(texts)]

    def hundred_drawn() -> None:
        [(hit.mask, hit.relevancy, hit.point) for hit in ready.query_all(texts)]

    def new() -> None:
        answer(field.render(camera), texts[next(turn) % TEXTS])

    ready = fresh()
    ours = {
        "first": first,
        "further": further,
        "hundred": hundred,
        "drawn": hundred_drawn,
        "segment": lambda: ready.segment(texts),
        "new": new,
    }
    clocks = time.perf_counter, time.process_time
    ours_found = [times_in_turn(ours, clock, min) for clock in clocks]

    # Ours is done by now: threads that PyTorch keeps spinning, waiting for work, would slow it.
    other = LangSplatWay(field.encoder)
    codes = image.values[..., :3].reshape(-1, 3).contiguous()
    features = other.decode(codes)
    vectors = torch.from_numpy(field.encoder.encode_text(texts))

    def their_new() -> None:
        values = torch.cat([field.gaussians.colors(), field.gaussians.features[:, :3]], 1)
        seen = rasterize(field.gaussians, values, camera).values[..., 3:].reshape(-1, 3)
        other.score(other.decode(seen.contiguous()), vectors[:1])

    theirs = {
        "first": lambda: other.score(other.decode(codes), vectors[:1]),
        "further": lambda: other.score(features, vectors[:1]),
        "hundred": lambda: other.score(features, vectors),
        "segment": lambda: other.score(features, vectors).argmax(-1),
        "new": their_new,
    }
    names = {
        "first": "first query of a rendered view, decoding included",
        "further": "each further query",
        "hundred": f"{TEXTS} texts at once: scores and objects",
        "drawn": f"the same, {TEXTS} masks, images and points drawn",
        "segment": f"one image of the best of {TEXTS} texts",
        "new": "new view rendered and queried",
    }
    theirs_found = [times_in_turn(theirs, clock, min) for clock in clocks]
    rows = []
    for key, what in names.items():
        row = {"what": what, "ours": ours_found[0][key], "ours_cpu": ours_found[1][key]}
        if key in theirs:
            row |= {"theirs": theirs_found[0][key], "theirs_cpu": theirs_found[1][key]}
            row["ratio"] = row["theirs_cpu"] / row["ours_cpu"]
        rows.append(row)
    return rows


COLUMNS = {
    "what": ("what", str),
    "ours": ("ours, ms", ms),
    "ours_cpu": ("processor, ms", ms),
    "theirs": ("LangSplat's way, ms", ms),
    "theirs_cpu": ("processor, ms", ms),
    "ratio": ("times less", ".0f"),
}


def main() -> None:
    asked = parser(__doc__, "waiting.md").parse_args()
    threads.limit(1)
    (sample,) = load_samples(None).values()
    rows = speed_rows(make_field(sample), sample.targets[0].camera)
    command = "python -m benches.language.query_cost"
    publish(asked.out, "waiting.md", command, table(rows, COLUMNS))


if __name__ == "__main__":
    main()
