"""Score masks of any program: a folder of PNG files, or a JSON file of run lengths.

A folder is as a benchmark writes it, ``<method>/<protocol>/<scene>/<frame>/<query>.png``
(:func:`slgaussian.benchmark.outputs.mask_place`), white where something was found. A JSON file is a
list of masks, each of which every protocol scores::

    [{"method": "mine", "scene": "desk", "frame": "0007.png", "query": "red mug",
      "size": [416, 576], "counts": "01ccQm1W6e...", "point": [130, 88.5], "score": 0.83,
      "seconds": 0.21}, ...]

``size`` is height and width, and ``counts`` are run lengths as COCO writes them, as text or as a
list (:mod:`slgaussian.formats.rle`). The others need not be there: ``method`` is the name of the
file then, ``point`` the pixel (x, y) where it is, ``score`` how sure the method is of it, 0 to 1,
and ``seconds`` what the answer took. Other keys are ignored.

Whatever follows from relevancies has no score, and what follows from the point only if it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveInt, ValidationError

from slgaussian.benchmark.annotations import Truth, boxes_of
from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.evaluate import ABSENT, SceneResult
from slgaussian.benchmark.outputs import file_name, mask_place
from slgaussian.benchmark.protocols import PROTOCOLS, Answer, Frame, How, ScoringProtocol
from slgaussian.benchmark.scores import of_first_protocol, scene_means
from slgaussian.errors import InputError
from slgaussian.formats import rle, strict_json
from slgaussian.formats.images import read_mask
from slgaussian.io import short_repr
from slgaussian.storage.specs import load_spec

NOT_GIVEN = "no mask was given"
"""Note of a row that is scored as an empty mask, because there is none."""

NO_RELEVANCY = np.zeros((0, 0), np.float32)

SCORABLE = tuple(name for name, one in PROTOCOLS.items() if one.scores_masks)
"""The protocols by which masks can be scored."""

Key = tuple[str, ...]
_Name = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True)
class Prediction:
    """A mask that another program made.

    Attributes
    ----------
    where : str
        What it is called in messages.
    scene, frame, query : str
        As they stand in the file or in the folders' names.
    read : function (height, width) -> bool [height, width]
        Raises InputError if it cannot be read, or has another size.
    point : (x, y) or None
    score, seconds : float or None
    """

    where: str
    scene: str
    frame: str
    query: str
    read: Callable[[int, int], np.ndarray]
    point: tuple[float, float] | None = None
    score: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Predictions:
    """All masks of a folder or file.

    Attributes
    ----------
    place : Path
        Where they are.
    methods : {method: tuple of str}
        The protocols whose masks each has; none where its masks are for any.
    masks : {key: Prediction}
    keys : function (row) -> tuple of keys
        By which the mask of a row, of the columns of the data spec ``samples``, may be known.
    """

    place: Path
    methods: Mapping[str, tuple[str, ...]]
    masks: Mapping[Key, Prediction]
    keys: Callable[[Mapping[str, Any]], tuple[Key, ...]]

    @property
    def protocols(self) -> tuple[str, ...]:
        """The protocols of the masks, in the order of all; the first where masks are for any."""
        found = {name for has in self.methods.values() for name in has}
        return tuple(name for name in SCORABLE if name in found) or SCORABLE[:1]

    def key(self, row: Mapping[str, Any]) -> Key | None:
        """Return the key of the mask of a row; None if there is none."""
        return next((key for key in self.keys(row) if key in self.masks), None)


@dataclass(frozen=True, eq=False)
class JudgedScene:
    """A scene and its truth.

    Attributes
    ----------
    scene, dataset : str
    place : str or None
        As :class:`slgaussian.benchmark.evaluate.EvaluationSettings` has it.
    truth : Truth
        Its frames and queries are those that are asked.
    """

    scene: str
    dataset: str
    place: str | None
    truth: Truth

    __repr__ = short_repr


@dataclass
class Tally:
    """Counts of the masks of some predictions.

    ``asked`` samples have a truth, of which ``missing`` have no mask (those that
    ``missing_of`` names first). ``used`` are the keys of masks that were asked for; ``scenes``,
    ``frames`` and ``queries`` the names that are known. ``seconds`` by scene, frame, query and
    method, where they were given.
    """

    asked: int = 0
    missing: int = 0
    missing_of: list[str] = field(default_factory=list)
    used: set[Key] = field(default_factory=set)
    scenes: set[str] = field(default_factory=set)
    frames: set[tuple[str, str]] = field(default_factory=set)
    seconds: dict[tuple[str, str, str, str], float] = field(default_factory=dict)

    def unknown(self, predictions: Predictions) -> dict[str, list[str]]:
        """Name the masks that nothing asked for: ``scenes``, ``frames`` and ``queries`` by name."""
        found: dict[str, dict[str, None]] = {"scenes": {}, "frames": {}, "queries": {}}
        for key, one in predictions.masks.items():
            if key in self.used:
                continue
            if one.scene not in self.scenes:
                found["scenes"][one.scene] = None
            elif (one.scene, one.frame) not in self.frames:
                found["frames"][f"{one.frame} of {one.scene}"] = None
            else:
                found["queries"][f"{one.query} in {one.frame} of {one.scene}"] = None
        return {what: list(names) for what, names in found.items() if names}


def read_predictions(place: str | Path, protocols: Sequence[str] = ()) -> Predictions:
    """Read the masks in a folder, or in a JSON file. Those of a folder are not opened yet.

    Of a folder those of ``protocols`` alone, if any is named.

    Raises
    ------
    InputError
        If there is none, or a JSON file is damaged or not as this module describes it.
    """
    place = Path(place)
    if place.is_dir():
        return _folder(place, protocols)
    if not place.exists():
        raise InputError(
            f"{place}: no such file or folder; expected a folder of masks or a JSON file of them"
        )
    return _file(place)


def score_predictions(
    predictions: Predictions,
    scenes: Iterable[JudgedScene],
    protocols: Sequence[ScoringProtocol],
    tally: Tally,
) -> Iterator[SceneResult]:
    """Score the masks of each method in each scene, a scene at a time.

    A sample without a mask is scored as an empty one. Results have no pictures and no times.

    Raises
    ------
    InputError
        If a mask is damaged or of another size than the truth, the texts of a frame compete by a
        protocol and their masks overlap, or masks say nothing by a protocol.
    """
    for judged in scenes:
        tally.scenes |= {judged.scene, file_name(judged.scene)}
        for frame in judged.truth.masks:
            for scene in (judged.scene, file_name(judged.scene)):
                tally.frames |= {(scene, name) for name in _names(frame)}
        for method, has in predictions.methods.items():
            own = [one for one in protocols if not has or one.name in has]
            if own:
                yield _score_scene(predictions, judged, method, own, tally)


def _score_scene(
    predictions: Predictions,
    judged: JudgedScene,
    method: str,
    protocols: Sequence[ScoringProtocol],
    tally: Tally,
) -> SceneResult:
    common = {"dataset": judged.dataset, "scene": judged.scene, "method": method}
    rows: list[dict[str, Any]] = []
    masks: dict[tuple[str, str, str], np.ndarray] = {}
    for frame, truths in judged.truth.masks.items():
        boxes = judged.truth.boxes.get(frame, {})
        by_protocol = {
            protocol.name: _look_up(
                predictions, {**common, "frame": frame, "protocol": protocol.label}, truths, tally
            )
            for protocol in protocols
        }
        # By both protocols the same texts compete, and theirs are the masks that say which wins.
        competing = by_protocol.get("3d-ovs")
        labels = None if competing is None else _winners(competing, list(truths), method)
        for protocol in protocols:
            known = by_protocol[protocol.name]
            answers = [
                Answer(NO_RELEVANCY, mask, None if one is None else one.point)
                for one, mask in known
            ]
            asked = Frame(
                answers,
                list(truths.values()),
                [boxes_of(mask, boxes.get(text)) for text, mask in truths.items()],
                labels,
                external=True,
            )
            scores = protocol.score(asked, How("given"))
            for text, scored, (one, mask) in zip(truths, scores, known, strict=True):
                absent = not truths[text].any()
                if absent and protocol is not protocols[0]:
                    continue
                x, y = scored.point or (None, None)
                notes = [NOT_GIVEN] * (one is None and not absent) + [ABSENT] * absent
                row = {
                    **common,
                    "place": judged.place,
                    "frame": frame,
                    "query": text,
                    "protocol": protocol.label,
                    **dict(zip(("height", "width"), mask.shape, strict=True)),
                    **asdict(How("given")),
                    **scored.scores,
                    "score": None if one is None else one.score,
                    "point_x": x,
                    "point_y": y,
                    "note": "; ".join(notes),
                }
                rows.append({name: row.get(name) for name in load_spec("samples").columns})
                if one is not None:
                    masks[protocol.label, frame, text] = mask
    means = scene_means(of_first_protocol(rows))
    return SceneResult(judged.scene, rows, means, masks, {}, {}, judged.dataset, method)


def _look_up(
    predictions: Predictions,
    row: Mapping[str, str],
    truths: Mapping[str, np.ndarray],
    tally: Tally,
) -> list[tuple[Prediction | None, np.ndarray]]:
    """Return the prediction for each text of a frame, and its mask, empty where there is none."""
    known: list[tuple[Prediction | None, np.ndarray]] = []
    scene, frame = row["scene"], row["frame"]
    for text, truth in truths.items():
        key = predictions.key({**row, "query": text})
        tally.asked += bool(truth.any())
        if key is None:
            known.append((None, np.zeros_like(truth)))
            if truth.any():
                tally.missing += 1
                tally.missing_of.append(f"{text} in {frame} of {scene}")
            continue
        tally.used.add(key)
        one = predictions.masks[key]
        known.append((one, one.read(*truth.shape)))
        if one.seconds is not None:
            tally.seconds[scene, frame, text, row["method"]] = one.seconds
    return known


def _winners(
    known: Sequence[tuple[Prediction | None, np.ndarray]], texts: Sequence[str], method: str
) -> np.ndarray:
    """Return which of the texts wins, int32 [H, W], k + 1; InputError if two do."""
    labels = np.zeros(known[0][1].shape, np.int32)
    for k, (one, mask) in enumerate(known):
        if one is not None and (taken := labels[mask]).any():
            other = texts[int(taken[taken > 0][0]) - 1]
            raise InputError(
                f"{one.where}: overlaps the mask of {other!r} by {method}, but by the protocol "
                "3d-ovs texts compete, and each pixel is of one at most; give masks that do not "
                "overlap, or choose --protocol slgaussian"
            )
        labels[mask] = k + 1
    return labels


def _names(frame: str) -> set[str]:
    """Return the names of a frame: with folder and ending, or without, or as a file."""
    stem = Path(frame).stem
    return {frame, stem, file_name(stem)}


def _folder(place: Path, protocols: Sequence[str]) -> Predictions:
    root = place / "predictions" if (place / "predictions").is_dir() else place
    called = {file_name(name): name for name in ROWS}
    masks: dict[Key, Prediction] = {}
    methods: dict[str, list[str]] = {}
    others: set[str] = set()
    for file in sorted(root.glob("*/*/*/*/*.png")):
        key = file.relative_to(root).parts
        folder, protocol, scene, frame, name = key
        if protocol not in (protocols or SCORABLE):
            others.add(protocol)
            continue
        masks[key] = Prediction(str(file), scene, frame, name.removesuffix(".png"), _png(file))
        has = methods.setdefault(called.get(folder, folder), [])
        if protocol not in has:
            has.append(protocol)
    if not masks:
        but = f", but of {', '.join(sorted(others)[:5])}" if others else ""
        raise InputError(
            f"{root}: holds no mask of {' or '.join(protocols or SCORABLE)}{but}; expected "
            "<method>/<protocol>/<scene>/<frame>/<query>.png, or a JSON file of masks"
        )
    folders = {called.get(key[0], key[0]): key[0] for key in masks}
    ordered = [*(name for name in ROWS if name in methods), *(n for n in methods if n not in ROWS)]

    def keys(row: Mapping[str, Any]) -> tuple[Key, ...]:
        folder = folders[row["method"]]
        _, *safe = mask_place(row).parts
        protocol = row["protocol"].partition("@")[0]
        plain = protocol, row["scene"], Path(row["frame"]).stem, f"{row['query']}.png"
        return (folder, *safe), (folder, *plain)

    return Predictions(root, {name: tuple(methods[name]) for name in ordered}, masks, keys)


def _check_size(where: str, found: Sequence[int], height: int, width: int) -> None:
    if tuple(found) != (height, width):
        h, w = found
        raise InputError(
            f"{where}: the mask has {h}x{w} pixels, height first, and its view is judged at "
            f"{height}x{width}; bring it to that size, or say the size of all masks with --size "
            f"{h}x{w}"
        )


def _png(file: Path) -> Callable[[int, int], np.ndarray]:
    def read(height: int, width: int) -> np.ndarray:
        mask = read_mask(file, kinds=("PNG",))
        _check_size(str(file), mask.shape, height, width)
        return mask

    return read


def _file(place: Path) -> Predictions:
    try:
        content = strict_json.parse(place.read_bytes())
    except OSError as error:
        raise InputError(f"{place}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{place}: is not valid JSON ({error})") from error
    if not isinstance(content, list) or not content:
        raise InputError(
            f"{place}: expected a list of masks, each with scene, frame, query, size and counts, "
            f"found {'an empty one' if content == [] else type(content).__name__}"
        )
    masks: dict[Key, Prediction] = {}
    for number, entry in enumerate(content):
        where = f"{place}: [{number}]"
        method, one = _entry(entry, where, place.stem)
        key = method, one.scene, one.frame, one.query
        if key in masks:
            raise InputError(f"{where}: {one.query!r} in {one.frame} of {one.scene} is there twice")
        masks[key] = one

    def keys(row: Mapping[str, Any]) -> tuple[Key, ...]:
        frame = row["frame"]
        names = dict.fromkeys((frame, Path(frame).with_suffix("").as_posix(), Path(frame).stem))
        return tuple((row["method"], row["scene"], name, row["query"]) for name in names)

    return Predictions(place, dict.fromkeys((key[0] for key in masks), ()), masks, keys)


def _entry(entry: Any, where: str, file: str) -> tuple[str, Prediction]:
    """Return the method of a mask, and the mask."""
    try:
        one = _Entry.model_validate(entry)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "a mask"
        value = "missing" if first["type"] == "missing" else f"{first['input']!r:.60}"
        raise InputError(f"{where}: {place} is {value}; {first['msg']}") from None
    height, width = one.size
    called = f"{where}, {one.query!r} in {one.frame} of {one.scene}"

    def read(rows: int, columns: int) -> np.ndarray:
        _check_size(called, (height, width), rows, columns)  # before anything of that size is made
        try:
            return rle.decode(one.counts, rows, columns)
        except ValueError as bad:
            raise InputError(f"{called}: {bad}; write the mask again") from None

    point = None if one.point is None else (float(one.point[0]), float(one.point[1]))
    return one.method or file, Prediction(
        called, one.scene, one.frame, one.query, read, point, one.score, one.seconds
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
    score: Annotated[float, Field(ge=0, le=1)] | None = None
    seconds: Annotated[float, Field(ge=0)] | None = None
