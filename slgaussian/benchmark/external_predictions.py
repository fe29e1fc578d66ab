"""Score masks of other programs: PNG files, or run lengths in Parquet or JSON.

A Parquet file is the ``masks.parquet`` of a run, or another of spec ``masks``; its folder may be
given too. PNG files, white inside the mask, are in a folder as
``<method>/<protocol>/<scene>/<frame>/<query>.png``
(:func:`slgaussian.benchmark.outputs.mask_paths`). A JSON file is a list of
masks, each scored by every protocol::

    [{"method": "mine", "scene": "desk", "frame": "0007.png", "query": "red mug",
      "size": [416, 576], "counts": "01ccQm1W6e...", "point": [130, 88.5]}, ...]

``size`` is height and width, and ``counts`` are COCO run lengths as a string or a list
(:mod:`slgaussian.formats.rle`). The other keys are optional: ``method`` defaults to the name of the
file, and ``point`` is the predicted pixel (x, y). Unknown keys are ignored.

Metrics of relevancies are not computed, and metrics of the point only if it is given.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveInt

from slgaussian.benchmark.annotations import Truth, find_boxes
from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.evaluate import ABSENT, SceneResult, score_frame
from slgaussian.benchmark.outputs import file_name, read_masks
from slgaussian.benchmark.protocols import PROTOCOLS, Answer, Frame, ScoringProtocol
from slgaussian.benchmark.scores import scene_means
from slgaussian.checks import matching, name_parts, namesakes
from slgaussian.errors import InputError
from slgaussian.formats import rle
from slgaussian.formats.documents import check_document, read_json
from slgaussian.formats.images import read_mask
from slgaussian.io import short_repr

NOT_GIVEN = "no mask was given"
"""Note of a row without a mask, which is scored as an empty mask."""

SCORABLE = tuple(name for name, protocol in PROTOCOLS.items() if protocol.scores_masks)
"""Protocols that can score masks."""

Key = tuple[str, str, str, str, str]
"""Method, protocol (empty if a mask is for all), scene, frame and query."""

_Name = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True)
class Prediction:
    """A mask of another program.

    Attributes:
        place: Name in messages.
        read: Function of height and width. Raises InputError if the mask cannot be read, or has
            another size.
        point: (x, y) or None
    """

    place: str
    read: Callable[[int, int], np.ndarray]
    point: tuple[float, float] | None = None


@dataclass
class Predictions:
    """Masks of a folder or file, and counts of the masks that scoring used and missed.

    Attributes:
        place: The folder or file.
        masks: Scene, frame and query are as in the file or in the folder names.
        samples: Number of scored samples with ground truth, of which ``missing`` have no mask.
        empty: Scored masks without a pixel.
        used: Keys of the scored masks.
    """

    place: Path
    masks: Mapping[Key, Prediction]
    samples: int = 0
    missing: list[str] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)
    used: set[Key] = field(default_factory=set)

    @property
    def methods(self) -> dict[str, tuple[str, ...]]:
        """Return the protocols of each method's masks; empty if its masks are for all."""
        by_method: dict[str, dict[str, None]] = {name: {} for name in ROWS}
        for method, protocol, *_ in self.masks:
            by_method.setdefault(method, {})[protocol] = None
        return {name: tuple(filter(None, of)) for name, of in by_method.items() if of}

    @property
    def protocols(self) -> tuple[str, ...]:
        """Return the protocols of the masks in order; the first one if masks are for all."""
        present = {protocol for _, protocol, *_ in self.masks}
        return tuple(name for name in SCORABLE if name in present) or SCORABLE[:1]

    @property
    def extra(self) -> list[str]:
        """List the masks that belong to no sample."""
        keys = (key for key in self.masks if key not in self.used)
        return list(dict.fromkeys(_describe(*key[2:]) for key in keys))

    def find(
        self, names: tuple[str, str, str, str], query: str, rivals: Sequence[str]
    ) -> Key | None:
        """Return the key of the mask of a query; None if there is none.

        Args:
            names: Method, protocol, scene and frame. A frame may lack its folder and suffix, and
                names may be file names.
            rivals: The other judged frames with the file name of the frame.

        Raises:
            InputError: If the mask fits one of them as well.
        """
        method, protocol, scene, frame = names
        parts = name_parts(frame)
        forms = parts[-1], "/".join(parts)
        for of in (protocol, ""):
            group = self._keys_by_frame.get((method, of, file_name(scene), file_name(query)), {})
            by_frame = dict(group.get(parts[-1], {}))
            for form in forms:
                if (key := group.get(file_name(form), {}).get(file_name(form))) is not None:
                    by_frame[form] = key
            entry = matching(str(self.place), frame, by_frame, rivals)
            if entry is not None:
                return by_frame[entry]
        return None

    @cached_property
    def _keys_by_frame(self) -> dict[tuple[str, str, str, str], dict[str, dict[str, Key]]]:
        """Keys by method, protocol, scene and query, by file name of frames, then by frame."""
        groups: dict[tuple[str, str, str, str], dict[str, dict[str, Key]]] = {}
        for key in self.masks:
            method, protocol, scene, frame, query = key
            group = groups.setdefault((method, protocol, file_name(scene), file_name(query)), {})
            group.setdefault(name_parts(frame)[-1], {})[frame] = key
        return groups


@dataclass(frozen=True, eq=False)
class JudgedScene:
    """A scene and its ground truth; ``place`` as in the evaluation's settings."""

    scene: str
    dataset: str
    place: str | None
    truth: Truth

    __repr__ = short_repr


def read_predictions(place: str | Path, protocols: Sequence[str] = ()) -> Predictions:
    """Read the masks of a folder, whose PNG files are opened later, or of a file.

    From a folder or a Parquet file, only those of ``protocols`` are read, if given.

    Raises:
        InputError: If there are no masks, or a JSON file is damaged or has another structure.
    """
    place = Path(place)
    if (place / "masks.parquet").is_file():
        place = place / "masks.parquet"
    if place.suffix == ".parquet":
        return Predictions(place, _read_table(place, protocols or SCORABLE))
    if not place.is_dir():
        return Predictions(place, _read_file(place))
    root = place / "predictions" if (place / "predictions").is_dir() else place
    methods = {file_name(name): name for name in ROWS}
    masks: dict[Key, Prediction] = {}
    for file in sorted(root.glob("*/*/*/*/*.png")):
        folder, protocol, scene, frame, _ = file.relative_to(root).parts
        if protocol in (protocols or SCORABLE):
            key = methods.get(folder, folder), protocol, scene, frame, file.stem
            masks[key] = Prediction(str(file), partial(_read_png, file))
    if not masks:
        raise InputError(
            f"{root}: holds no mask of {' or '.join(protocols or SCORABLE)}; expected "
            "<method>/<protocol>/<scene>/<frame>/<query>.png, a masks.parquet or a JSON file"
        )
    return Predictions(root, masks)


def score_predictions(
    predictions: Predictions, scenes: Iterable[JudgedScene], protocols: Sequence[ScoringProtocol]
) -> Iterator[SceneResult]:
    """Score the masks of each method, scene by scene, and count them in ``predictions``.

    A sample without a mask is scored as an empty mask. Results have no pictures and no times.

    Raises:
        InputError: If a mask is damaged or of another size than the truth, masks overlap in a
            protocol in which the texts of a frame compete, or a protocol cannot score masks.
    """
    for judged in scenes:
        for method, present in predictions.methods.items():
            scored = [protocol for protocol in protocols if not present or protocol.name in present]
            if not scored:
                continue
            rows: list[dict[str, Any]] = []
            masks: dict[tuple[str, str, str], np.ndarray] = {}
            for frame in judged.truth.masks:
                for row, mask in _score_frame(predictions, judged, method, scored, frame):
                    rows.append(row)
                    if mask is not None:
                        masks[row["protocol"], frame, row["query"]] = mask
            leading = [row for row in rows if row["protocol"] == rows[0]["protocol"]]
            means = scene_means(leading)
            yield SceneResult(judged.scene, rows, means, masks, {}, judged.dataset, method)
    if empty := list(dict.fromkeys(predictions.empty)):
        warnings.warn(
            f"{predictions.place}: {len(empty)} of {len(predictions.used)} masks are empty: "
            f"{', '.join(empty[:3])}{', ...' if empty[3:] else ''}",
            stacklevel=2,
        )


def _score_frame(
    predictions: Predictions,
    judged: JudgedScene,
    method: str,
    protocols: Sequence[ScoringProtocol],
    frame: str,
) -> Iterator[tuple[dict[str, Any], np.ndarray | None]]:
    """Yield the rows of the spec ``samples`` of a frame, and the mask of each that has one."""
    truths, boxes = judged.truth.masks[frame], judged.truth.boxes.get(frame, {})
    common: dict[str, Any] = {"dataset": judged.dataset, "scene": judged.scene, "method": method}
    common |= {"place": judged.place, "frame": frame}
    rivals = namesakes(frame, judged.truth.masks)
    answers = {
        protocol.name: _look_up(
            predictions, (method, protocol.name, judged.scene, frame), truths, rivals
        )
        for protocol in protocols
    }
    # The same texts compete in two protocols, and their masks determine which wins.
    labels = _winners(answers["3d-ovs"]) if "3d-ovs" in answers else None
    true_boxes = [find_boxes(mask, boxes.get(text)) for text, mask in truths.items()]
    for protocol in protocols:
        of_protocol = answers[protocol.name]
        masks = [answer for answer, _ in of_protocol.values()]
        queried = Frame(masks, list(truths.values()), true_boxes, labels, external=True)
        queried = queried.within(judged.truth.opaque.get(frame))
        notes = {
            text: {"note": ABSENT if not truths[text].any() else "" if place else NOT_GIVEN}
            for text, (_, place) in of_protocol.items()
        }
        first = protocol is protocols[0]
        for row, scored in score_frame(queried, list(truths), [protocol], None, common, notes):
            if first or truths[row["query"]].any():
                yield row, scored.mask if of_protocol[row["query"]][1] else None


def _look_up(
    predictions: Predictions,
    names: tuple[str, str, str, str],
    truths: Mapping[str, np.ndarray],
    rivals: Sequence[str],
) -> dict[str, tuple[Answer, str]]:
    """Return the answer for each text of a frame, and the name of its mask; empty without one."""
    answers = {}
    for text, truth in truths.items():
        prediction = Prediction("", lambda *size: np.zeros(size, bool))
        if (key := predictions.find(names, text, rivals)) is not None:
            prediction = predictions.masks[key]
            predictions.used.add(key)
        elif truth.any():
            predictions.missing.append(_describe(*names[2:], text))
        predictions.samples += bool(truth.any())
        mask = prediction.read(*truth.shape)
        if key is not None and not mask.any():
            predictions.empty.append(prediction.place)
        answer = Answer(np.zeros((0, 0), np.float32), mask, prediction.point)
        answers[text] = answer, prediction.place
    return answers


def _winners(answers: Mapping[str, tuple[Answer, str]]) -> np.ndarray:
    """Return the winning text k of each pixel as k + 1, int32 [H, W]; InputError for overlaps."""
    texts = list(answers)
    labels = np.zeros(answers[texts[0]][0].mask.shape, np.int32)
    for k, (answer, place) in enumerate(answers.values(), start=1):
        if rival := labels[answer.mask].max(initial=0):
            raise InputError(
                f"{place}: overlaps the mask of {texts[rival - 1]!r}, but by the protocol "
                "3d-ovs texts compete, and each pixel is of one at most; give masks that do not "
                "overlap, or choose --protocol slgaussian"
            )
        labels[answer.mask] = k
    return labels


def _read_png(file: Path, height: int, width: int) -> np.ndarray:
    mask = read_mask(file, kinds=("PNG",), warn=False)
    _check_size(str(file), mask.shape, height, width)
    return mask


def _read_table(file: Path, protocols: Sequence[str]) -> dict[Key, Prediction]:
    masks: dict[Key, Prediction] = {}
    for row in read_masks(file):
        protocol, names = row["protocol"].partition("@")[0], (row["scene"], row["frame"])
        if protocol in protocols:
            place = f"{file}: {_describe(*names, row['query'])}"
            key = row["method"], protocol, *names, row["query"]
            masks[key] = Prediction(place, partial(_decode, row["mask"], place))
    if not masks:
        raise InputError(f"{file}: holds no mask of {' or '.join(protocols)}; expected some")
    return masks


def _decode(mask: rle.RunLengths, place: str, height: int, width: int) -> np.ndarray:
    _check_size(place, mask[:2], height, width)  # before allocating an array of that size
    try:
        return mask.decode()
    except ValueError as error:
        raise InputError(f"{place}: {error}; write the mask again") from None


def _check_size(place: str, size: Sequence[int], height: int, width: int) -> None:
    if tuple(size) != (height, width):
        h, w = size
        raise InputError(
            f"{place}: the mask has {h}x{w} pixels, height first, and its view is judged at "
            f"{height}x{width}; bring it to that size, or say the size of all masks with --size "
            f"{h}x{w}"
        )


class _Entry(BaseModel):
    """A mask in a JSON file."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    scene: _Name
    frame: _Name
    query: _Name
    method: _Name | None = None
    size: Annotated[list[PositiveInt], Field(min_length=2, max_length=2)]
    counts: Any = None
    point: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None

    def decode(self, place: str, height: int, width: int) -> np.ndarray:
        mask = _decode(
            rle.RunLengths(self.size[0], self.size[1], self.counts), place, height, width
        )
        x, y = self.point or (0.0, 0.0)
        # In the first pixel only a mask there confirms that these are not fractions.
        is_fraction = 0 < max(x, y) <= 1 and mask.any() and not mask[:2, :2].any()
        if is_fraction or not (0 <= x <= width and 0 <= y <= height):
            raise InputError(
                f"{place}: its point is {x:g}, {y:g}, expected x, y in pixels of {width}x{height}"
                f"{', not fractions' if is_fraction else ''}"
            )
        return mask


def _read_file(file: Path) -> dict[Key, Prediction]:
    content = read_json(file, "file of masks")
    if not isinstance(content, list) or not content:
        raise InputError(f"{file}: found no list of masks, with scene, frame, query, size, counts")
    masks: dict[Key, Prediction] = {}
    for number, item in enumerate(content):
        entry = check_document(_Entry, item, f"{file}: [{number}]")
        key = entry.method or file.stem, "", entry.scene, entry.frame, entry.query
        place = f"{file}: [{number}], {_describe(*key[2:])}"
        if key in masks:
            raise InputError(f"{place} is there twice")
        point = None if entry.point is None else (entry.point[0], entry.point[1])
        masks[key] = Prediction(place, partial(entry.decode, place), point)
    return masks


def _describe(scene: str, frame: str, query: str) -> str:
    return f"{query!r} in {frame} of {scene}"
