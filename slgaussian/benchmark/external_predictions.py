"""Score masks of other programs: a folder of PNG files, or a JSON file of run lengths.

A folder has the layout of a benchmark's masks, ``<method>/<protocol>/<scene>/<frame>/<query>.png``
(:func:`slgaussian.benchmark.outputs.mask_path`), white inside the mask. A JSON file is a list of
masks, each scored by every protocol::

    [{"method": "mine", "scene": "desk", "frame": "0007.png", "query": "red mug",
      "size": [416, 576], "counts": "01ccQm1W6e...", "point": [130, 88.5]}, ...]

``size`` is height and width, and ``counts`` are COCO run lengths as a string or a list
(:mod:`slgaussian.formats.rle`). The other keys are optional: ``method`` defaults to the name of the
file, and ``point`` is the predicted pixel (x, y). Unknown keys are ignored.

Metrics of relevancies are not computed, and metrics of the point only if it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveInt

from slgaussian.benchmark.annotations import Truth, boxes_of
from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.documents import check_document, read_json
from slgaussian.benchmark.evaluate import ABSENT, SceneResult, score_frame
from slgaussian.benchmark.outputs import file_name
from slgaussian.benchmark.protocols import PROTOCOLS, Answer, Frame, ScoringProtocol
from slgaussian.benchmark.scores import of_first_protocol, scene_means
from slgaussian.errors import InputError
from slgaussian.formats import rle
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
        where: Name in messages.
        read: function (height, width) -> bool [height, width]. Raises InputError if the mask cannot
            be read, or has another size.
        point: (x, y) or None
    """

    where: str
    read: Callable[[int, int], np.ndarray]
    point: tuple[float, float] | None = None


@dataclass(frozen=True)
class Predictions:
    """Masks of a folder or file.

    Attributes:
        place: The folder or file.
        masks: {key: Prediction}. Scene, frame and query as written in the file or in the folder
            names.
    """

    place: Path
    masks: Mapping[Key, Prediction]

    @property
    def methods(self) -> dict[str, tuple[str, ...]]:
        """Return the protocols of each method's masks; empty if its masks are for all."""
        by_method: dict[str, dict[str, None]] = {}
        for method, protocol, *_ in self.masks:
            by_method.setdefault(method, {})[protocol] = None
        order = [*(name for name in ROWS if name in by_method), *by_method]
        return {name: tuple(filter(None, by_method[name])) for name in dict.fromkeys(order)}

    @property
    def protocols(self) -> tuple[str, ...]:
        """Return the protocols of the masks in order; the first one if masks are for all."""
        present = {protocol for _, protocol, *_ in self.masks}
        return tuple(name for name in SCORABLE if name in present) or SCORABLE[:1]

    def key(self, method: str, protocol: str, scene: str, frame: str, query: str) -> Key | None:
        """Return the key of the mask of a query; None if there is none.

        A frame may lack its folder and suffix, and names may be file names.
        """
        path = Path(frame)
        frames = (frame, path.with_suffix("").as_posix(), path.stem)
        names = [(scene, name, query) for name in frames]
        names.append((file_name(scene), file_name(path.stem), file_name(query)))
        keys = ((method, of, *name) for of in (protocol, "") for name in names)
        return next((key for key in keys if key in self.masks), None)


@dataclass(frozen=True, eq=False)
class JudgedScene:
    """A scene and its ground truth.

    Attributes:
        place: See :class:`slgaussian.benchmark.evaluate.EvaluationSettings`.
        truth: Its frames and queries are evaluated.
    """

    scene: str
    dataset: str
    place: str | None
    truth: Truth

    __repr__ = short_repr


@dataclass
class Tally:
    """Counts of used and missing masks.

    ``asked`` is the number of samples with ground truth, of which those in ``missing`` have no
    mask. ``used`` are the keys of evaluated masks.
    """

    asked: int = 0
    missing: list[str] = field(default_factory=list)
    used: set[Key] = field(default_factory=set)

    def unused(self, predictions: Predictions) -> list[str]:
        """List the masks that belong to no sample."""
        keys = (key for key in predictions.masks if key not in self.used)
        return list(dict.fromkeys(_called(*key[2:]) for key in keys))


def read_predictions(place: str | Path, protocols: Sequence[str] = ()) -> Predictions:
    """Read the masks of a folder, whose files are opened later, or of a JSON file.

    From a folder, only those of ``protocols`` are read, if given.

    Raises:
        InputError: If there are no masks, or a JSON file is damaged or has another structure.
    """
    place = Path(place)
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
            "<method>/<protocol>/<scene>/<frame>/<query>.png, or a JSON file of masks"
        )
    return Predictions(root, masks)


def score_predictions(
    predictions: Predictions,
    scenes: Iterable[JudgedScene],
    protocols: Sequence[ScoringProtocol],
    tally: Tally,
) -> Iterator[SceneResult]:
    """Score the masks of each method, scene by scene.

    A sample without a mask is scored as an empty mask. Results have no pictures and no times.

    Raises:
        InputError: If a mask is damaged or of another size than the truth, masks overlap in a
            protocol in which the texts of a frame compete, or a protocol cannot score masks.
    """
    for judged in scenes:
        for method, present in predictions.methods.items():
            scored = [protocol for protocol in protocols if not present or protocol.name in present]
            rows: list[dict[str, Any]] = []
            masks: dict[tuple[str, str, str], np.ndarray] = {}
            for frame in judged.truth.masks if scored else ():
                for row, mask in _score_frame(predictions, judged, method, scored, frame, tally):
                    rows.append(row)
                    if mask is not None:
                        masks[row["protocol"], frame, row["query"]] = mask
            if scored:
                means = scene_means(of_first_protocol(rows))
                yield SceneResult(judged.scene, rows, means, masks, {}, judged.dataset, method)


def _score_frame(
    predictions: Predictions,
    judged: JudgedScene,
    method: str,
    protocols: Sequence[ScoringProtocol],
    frame: str,
    tally: Tally,
) -> Iterator[tuple[dict[str, Any], np.ndarray | None]]:
    """Yield the rows of the spec ``samples`` of a frame, and the mask of each that has one."""
    truths, boxes = judged.truth.masks[frame], judged.truth.boxes.get(frame, {})
    common: dict[str, Any] = {"dataset": judged.dataset, "scene": judged.scene, "method": method}
    common |= {"place": judged.place, "frame": frame}
    answers = {
        protocol.name: _look_up(
            predictions, (method, protocol.name, judged.scene, frame), truths, tally
        )
        for protocol in protocols
    }
    # The same texts compete in two protocols, and their masks determine which wins.
    labels = _winners(answers["3d-ovs"]) if "3d-ovs" in answers else None
    true_boxes = [boxes_of(mask, boxes.get(text)) for text, mask in truths.items()]
    for protocol in protocols:
        of_protocol = answers[protocol.name]
        masks = [answer for answer, _ in of_protocol.values()]
        queried = Frame(masks, list(truths.values()), true_boxes, labels, external=True)
        notes = {
            text: {"note": ABSENT if not truths[text].any() else "" if where else NOT_GIVEN}
            for text, (_, where) in of_protocol.items()
        }
        for row, scored in score_frame(queried, list(truths), [protocol], None, common, notes):
            text = row["query"]
            if protocol is protocols[0] or truths[text].any():
                yield row, scored.mask if of_protocol[text][1] else None


def _look_up(
    predictions: Predictions,
    names: tuple[str, str, str, str],
    truths: Mapping[str, np.ndarray],
    tally: Tally,
) -> dict[str, tuple[Answer, str]]:
    """Return the answer for each text of a frame, and the name of its mask; empty without one."""
    nothing = np.zeros((0, 0), np.float32)
    answers = {}
    for text, truth in truths.items():
        key = predictions.key(*names, text)
        tally.asked += bool(truth.any())
        if key is None:
            answers[text] = Answer(nothing, np.zeros_like(truth), None), ""
            if truth.any():
                tally.missing.append(_called(*names[2:], text))
            continue
        tally.used.add(key)
        prediction = predictions.masks[key]
        answer = Answer(nothing, prediction.read(*truth.shape), prediction.point)
        answers[text] = answer, prediction.where
    return answers


def _winners(answers: Mapping[str, tuple[Answer, str]]) -> np.ndarray:
    """Return the winning text k of each pixel as k + 1, int32 [H, W]; InputError for overlaps."""
    texts, masks = list(answers), [answer.mask for answer, _ in answers.values()]
    labels = np.zeros(masks[0].shape, np.int32)
    for k, mask in enumerate(masks):
        if (rivals := labels[mask]).any():
            rival = texts[int(rivals.max()) - 1]
            raise InputError(
                f"{answers[texts[k]][1]}: overlaps the mask of {rival!r}, but by the protocol "
                "3d-ovs texts compete, and each pixel is of one at most; give masks that do not "
                "overlap, or choose --protocol slgaussian"
            )
        labels[mask] = k + 1
    return labels


def _read_png(file: Path, height: int, width: int) -> np.ndarray:
    mask = read_mask(file, kinds=("PNG",))
    _check_size(str(file), mask.shape, height, width)
    return mask


def _check_size(where: str, size: Sequence[int], height: int, width: int) -> None:
    if tuple(size) != (height, width):
        h, w = size
        raise InputError(
            f"{where}: the mask has {h}x{w} pixels, height first, and its view is judged at "
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

    def read(self, where: str, height: int, width: int) -> np.ndarray:
        _check_size(where, self.size, height, width)  # before allocating an array of that size
        try:
            return rle.decode(self.counts, height, width)
        except ValueError as bad:
            raise InputError(f"{where}: {bad}; write the mask again") from None


def _read_file(place: Path) -> dict[Key, Prediction]:
    content = read_json(place, "file of masks")
    if not isinstance(content, list) or not content:
        raise InputError(f"{place}: found no list of masks, with scene, frame, query, size, counts")
    masks: dict[Key, Prediction] = {}
    for number, entry in enumerate(content):
        where = f"{place}: [{number}]"
        mask = check_document(_Entry, entry, where)
        key = mask.method or place.stem, "", mask.scene, mask.frame, mask.query
        where = f"{where}, {_called(*key[2:])}"
        if key in masks:
            raise InputError(f"{where} is there twice")
        point = None if mask.point is None else (mask.point[0], mask.point[1])
        masks[key] = Prediction(where, partial(mask.read, where), point)
    return masks


def _called(scene: str, frame: str, query: str) -> str:
    return f"{query!r} in {frame} of {scene}"
