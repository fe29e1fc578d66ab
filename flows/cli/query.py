"""Ask a field, or give each pixel the text that fits it best; answers as text and pictures."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from flows.cli.drawings import check_drawing, drawing, write_ids
from flows.cli.text import aligned
from flows.cli.viewpoints import Choice, Viewpoint
from flows.settings import RULES, Method, checked, files_of, layered, preset_values
from slgaussian.errors import InputError
from slgaussian.field import FieldView, SemanticField
from slgaussian.formats import images
from slgaussian.kernels import threads
from slgaussian.language.query import QueryResult, Rules
from slgaussian.language.taught import TaughtWords, encoder_identity
from slgaussian.scene import Camera
from slgaussian.storage.field_folder import read_about
from slgaussian.storage.local_copies import kept_arrays

EVEN = 0.5
"""Relevancy of what fits a text as well as it fits the canonical phrases."""

VERDICTS = ("found", "not sure", "not here")
"""Best first."""

NOTHING = "no text fits"
"""Label of pixels that fit no text better than the canonical phrases."""

RENDERED = ("rgb", "ids", "confidence", "alpha", "depth")
"""Arrays of a view that the user's cache keeps."""


def ask(
    folder: Path,
    texts: Sequence[str],
    choice: Choice,
    out: Path | None,
    settings: Mapping[str, Any],
    words: Path | None = None,
    like: Sequence[Path] = (),
) -> list[dict[str, Any]]:
    """Ask the field in ``folder`` and draw the answers to ``out``, if given.

    Parameters
    ----------
    folder : path
    texts : sequence of str
    choice : Choice
        Viewpoints.
    out : path, optional
        Picture or film.
    settings : mapping
        Fields of :class:`slgaussian.language.query.Rules`, ``preset``, and by the name of the
        field's encoder a table that says where its files are now.
    words : path, optional
        File of taught words that the field takes for this.
    like : sequence of path
        Pictures of things that are asked for too.

    Returns
    -------
    list of dict
        One a viewpoint and text: ``text``, ``view``, ``verdict`` (``found``, ``not sure``, ``not
        here``; None if refused), whether that is ``found``, ``summary`` of both in a line,
        ``confidence`` (``mask``, ``point``) or None, for what that is ``uncalibrated`` or None,
        ``score``, ``objects`` (``id``, ``relevancy``), of what is not here those most like it,
        ``point`` [x, y] and ``pixels`` of the mask, None and 0 if it is not here, what
        the text is ``read_as``, ``unknown`` words, ``unused`` ones (word: why), who answered
        (``kind``: ``known``, ``named``, ``taught``, ``unknown``, ``picture``) by how many
        ``examples``, what a name or a taught word would mean otherwise (``instead_of``), why it was
        ``refused`` or None, ``picture`` path or None.

    Raises
    ------
    InputError
        If anything given cannot be used, or every text is refused.
    """
    if out is not None:
        check_drawing(out, choice.film)
    rules, field = open_field(folder, settings, words)
    crops = [_read_picture(file) for file in like]
    asked, refused = sort_texts(field, texts) if texts else ([], {})
    answers = []
    with drawing(out, choice.film) as draw:
        for viewpoint in choice.of_field(folder, field):
            view = _rendered(folder, field, viewpoint.camera)
            results = view.query_all(asked, **rules) if asked else []
            hits = dict(zip(asked, results, strict=True))
            hits |= {
                str(file): replace(view.like(*crop, **rules), text=str(file))
                for file, crop in zip(like, crops, strict=True)
            }
            for text in [*texts, *map(str, like)]:
                answer = _refusal(text, refused[text]) if text in refused else _answer(hits[text])
                picture = None if out is None else str(out)
                answers.append({"view": viewpoint.name, **answer, "picture": picture})
            if out is not None:
                rows = [_hit_panels(viewpoint, view, hit) for hit in hits.values()]
                from slgaussian.benchmark import pictures

                draw(np.concatenate([pictures.side_by_side(row) for row in rows]))
    return answers


def segment_views(
    folder: Path,
    texts: Sequence[str],
    choice: Choice,
    out: Path | None,
    settings: Mapping[str, Any],
    words: Path | None = None,
) -> list[dict[str, Any]]:
    """Give every object that a viewpoint shows the text that fits it best, and draw that.

    A text gets the label of its place among ``texts``, from 1. Objects whose best relevancy is not
    above ``threshold``, 0.5 if it is left out, get 0, as do pixels that show none. With ``out``
    ``labels.png`` the labels of one viewpoint also go to ``labels.ids.png``, a grey PNG with 16
    bits. ``settings`` and ``words`` as in :func:`ask`.

    Returns
    -------
    list of dict
        One a text that is not refused, then that of no text: ``text``, or None, ``label``,
        ``share`` of the pixels of all viewpoints, mean ``relevancy`` of these, best ``verdict`` of
        a query for it in the viewpoints, ``objects`` by id; and one a text that was refused:
        ``text``, ``refused``.

    Raises
    ------
    InputError
        If anything given cannot be used, or every text is refused.
    """
    if out is not None:
        check_drawing(out, choice.film)
    rules, field = open_field(folder, settings, words)
    asked, refused = sort_texts(field, texts)
    numbers = np.array([0] + [texts.index(text) + 1 for text in asked], np.int32)
    pixels, total = np.zeros(len(texts) + 1), np.zeros(len(texts) + 1)
    objects: list[set[int]] = [set() for _ in pixels]
    verdicts: list[set[str | None]] = [set() for _ in pixels]
    viewpoints = choice.of_field(folder, field)
    if out is not None and not choice.film and len(viewpoints) > 1:
        raise InputError("--view: -o writes the labels of one view; give one, or leave out -o")
    with drawing(out, choice.film) as draw:
        for viewpoint in viewpoints:
            view = _rendered(folder, field, viewpoint.camera)
            hits = view.query_all(asked, **rules)
            for number, hit in zip(numbers[1:], hits, strict=True):
                verdicts[number].add(hit.verdict)
            best = np.stack([hit.relevancy for hit in hits]).max(0)
            labels = numbers[view.segment(asked, **rules)]
            pixels += np.bincount(labels.ravel(), minlength=len(pixels))
            total += np.bincount(labels.ravel(), best.ravel(), minlength=len(pixels))
            for label in np.unique(labels):
                objects[label].update(np.unique(view.ids[labels == label]).tolist())
            if out is not None:
                draw(_labels_picture(viewpoint, view, labels, texts, asked))
    if out is not None and not choice.film:
        write_ids(out.with_suffix(".ids.png"), labels)
    rows = [
        {
            "text": texts[label - 1] if label else None,
            "label": int(label),
            "share": pixels[label] / pixels.sum(),
            "relevancy": total[label] / pixels[label] if pixels[label] else None,
            "verdict": next((v for v in VERDICTS if v in verdicts[label]), None),
            "objects": sorted(objects[label] - {0}),
        }
        for label in [*numbers[1:], 0]
    ]
    return rows + [{"text": text, "refused": reason} for text, reason in refused.items()]


def exit_status(answers: Sequence[Mapping[str, Any]]) -> int:
    """Return the exit status of :func:`ask`: 0 if each text is found in a viewpoint, 3 if not.

    1 if a text is refused.
    """
    if any(answer["refused"] for answer in answers):
        return 1
    texts = {answer["text"] for answer in answers}
    return 0 if {answer["text"] for answer in answers if answer["found"]} == texts else 3


def answers_text(answers: Sequence[Mapping[str, Any]], film: bool = False) -> str:
    """Describe the answers of :func:`ask` for people; of a film a block a text, not a frame."""
    blocks = []
    for text in dict.fromkeys(answer["text"] for answer in answers if film):
        frames = [answer for answer in answers if answer["text"] == text]
        scores = [answer["score"] for answer in frames if not answer["refused"]]
        if not scores:
            blocks.append(f"{text!r} is {frames[0]['summary']}")
            continue
        sure, unsure = (sum(a["verdict"] == verdict for a in frames) for verdict in VERDICTS[:2])
        line = (
            f"{text!r} found in {sure} of {len(frames)} frames, not sure in {unsure}, "
            f"score {min(scores):.3f} to {max(scores):.3f}"
        )
        blocks.append("\n".join([line, *_words_used(frames[0])]))
    for answer in answers if not film else ():
        if answer["refused"]:
            blocks.append(f"{answer['text']!r} is {answer['summary']}")
            continue
        lines = [f"{answer['text']!r} in {answer['view']}"] if len(answers) > 1 else []
        lines.append(answer["summary"])
        if answer["point"] or answer["objects"]:
            ids = ", ".join(f"{o['id']} ({o['relevancy']:.3f})" for o in answer["objects"])
            lines.append(f"score  {answer['score']:.3f}  (0.5 is as good as any phrase)")
            if answer["point"]:
                lines.append("point  x {}, y {}".format(*answer["point"]))
            lines.append(f"{'objects' if answer['point'] else 'most like it'}  {ids or 'none'}")
        blocks.append("\n".join(lines + _words_used(answer)))
    return ("\n" if film else "\n\n").join(dict.fromkeys(blocks))


def texts_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Tabulate the rows of :func:`segment_views`."""
    lines = [("label", "text", "pixels", "relevancy", "verdict", "objects")]
    for row in (row for row in rows if "label" in row):
        mean = "" if row["relevancy"] is None else f"{row['relevancy']:.3f}"
        share, ids = f"{100 * row['share']:.1f} %", ", ".join(map(str, row["objects"]))
        text = NOTHING if row["text"] is None else row["text"]
        lines.append((str(row["label"]), text, share, mean, row["verdict"] or "", ids))
    return "\n".join([aligned(lines, "><>><<"), *refusals(rows)])


def _rendered(folder: Path, field: SemanticField, camera: Camera) -> FieldView:
    """Render the field of ``folder``, maybe taught, named or removed in, or take it as it was.

    The user's cache keeps views by all that their pixels depend on: content, camera, code and
    processor. Who asks a view again reads no Gaussians: 1.1 s in place of 2.8 for an office.
    """

    def arrays() -> dict[str, np.ndarray]:
        view = field.render(camera)
        return {name: getattr(view, name) for name in RENDERED}

    about, _ = read_about(folder)
    inputs = {
        "content": dict(about.digests),
        "settings": dict(about.settings),
        "removed": sorted(field.removed),
        "camera": [camera.K.tolist(), camera.c2w.tolist(), camera.width, camera.height],
        "code": threads.sources().whole,
        "processor": threads.processor(),
    }
    key = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
    return FieldView(**kept_arrays(f"views/{key}.npz", arrays), field=field, camera=camera)


def _answer(hit: QueryResult) -> dict[str, Any]:
    here = hit.verdict != "not here"
    return {
        "text": hit.text,
        "found": hit.found,
        "verdict": hit.verdict,
        "summary": hit.summary,
        "confidence": None if hit.confidence is None else asdict(hit.confidence),
        "uncalibrated": hit.uncalibrated or None,
        "score": hit.score,
        "point": list(hit.point) if here and hit.point is not None else None,
        "objects": [{"id": id_, "relevancy": score} for id_, score in hit.objects],
        "pixels": int(hit.mask.sum()) if here else 0,
        "read_as": hit.understood.read_as,
        "unknown": list(hit.unknown),
        "unused": dict(hit.understood.unused),
        "kind": hit.kind,
        "examples": hit.understood.examples,
        "instead_of": hit.understood.instead_of or None,
        "refused": None,
    }


def _refusal(text: str, reason: str) -> dict[str, Any]:
    return {
        "text": text,
        "found": False,
        "verdict": None,
        "summary": f"refused: {reason}",
        "confidence": None,
        "uncalibrated": None,
        "score": None,
        "point": None,
        "objects": [],
        "pixels": 0,
        "read_as": None,
        "unknown": [],
        "unused": {},
        "kind": "unknown",
        "examples": 0,
        "instead_of": None,
        "refused": reason,
    }


def _words_used(answer: Mapping[str, Any]) -> list[str]:
    """Describe the words of a text that count for its answer, if not all do."""
    if answer["kind"] == "picture":
        return ["asked by picture"]
    if answer["kind"] in ("named", "taught"):
        count = answer["examples"]
        lines = [f"a taught word: {count} example{'' if count == 1 else 's'}"]
        if answer["kind"] == "named":
            lines = ["a name that you gave"]
        known = answer["instead_of"]
        return [*lines, f"not as the encoder knows it: {known}"] if known else lines
    lines = []
    if answer["unknown"]:
        lines.append(f"not known and left out: {', '.join(answer['unknown'])}")
    for reason in dict.fromkeys(answer["unused"].values()):
        words = [word for word, other in answer["unused"].items() if other == reason]
        lines.append(f"set aside: {', '.join(words)} ({reason})")
    return [*lines, f"so this looked for: {answer['read_as']}"] if lines else []


def _read_picture(file: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a photograph, upright, uint8 [H, W, 3]; where it is opaque, bool [H, W], if not all."""
    from PIL import ImageOps

    try:
        with images.opened(file) as image:
            pixels = np.asarray(ImageOps.exif_transpose(image).convert("RGBA"))
    except (OSError, ValueError) as bad:
        raise images.unreadable(file, bad) from None
    opaque = pixels[..., 3] >= 128
    if not opaque.any():
        raise InputError(f"{file}: is transparent everywhere; give a picture that shows a thing")
    return np.ascontiguousarray(pixels[..., :3]), None if opaque.all() else opaque


def refusals(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line for each text that was refused."""
    return [f"{row['text']!r} is refused: {row['refused']}" for row in rows if row.get("refused")]


def _hit_panels(
    viewpoint: Viewpoint, view: FieldView, hit: QueryResult
) -> list[tuple[str, np.ndarray]]:
    from slgaussian.benchmark import pictures

    relevancy = pictures.paint_relevancy(hit.relevancy, view.rgb)
    where = view.rgb
    if hit.verdict == "found":
        where = pictures.draw_point(
            pictures.draw_outline(where, hit.mask, pictures.PREDICTED), hit.point
        )
    elif hit.verdict == "not sure":
        where = pictures.draw_dashed(where, hit.mask, pictures.PREDICTED)
    return [
        (viewpoint.caption, view.rgb),
        (f"relevancy of {hit.text!r}", relevancy),
        (hit.summary, where),
    ]


def _labels_picture(
    viewpoint: Viewpoint,
    view: FieldView,
    labels: np.ndarray,
    texts: Sequence[str],
    asked: Sequence[str],
) -> np.ndarray:
    from slgaussian.benchmark import pictures

    painted = pictures.spotlight(pictures.paint_labels(labels, view.rgb), labels > 0)
    shares = np.bincount(labels.ravel(), minlength=len(texts) + 1) / labels.size
    entries = [(texts.index(text) + 1, text) for text in asked] + [(0, NOTHING)]
    legend = [
        (pictures.label_colors(np.array(label)), f"{text}  {100 * shares[label]:.1f} %")
        for label, text in entries
    ]
    row = pictures.side_by_side([(viewpoint.caption, view.rgb), ("the text that fits", painted)])
    return pictures.with_legend(row, legend)


def open_field(
    folder: Path, settings: Mapping[str, Any], words: Path | None = None, rules: bool = True
) -> tuple[dict[str, Any], SemanticField]:
    """Return the rules among ``settings``, and the field with its encoder ready to be asked.

    Of a preset, the rules count. With ``words``, a file of taught ones, it knows those too.

    Raises
    ------
    InputError
        If a setting is unknown, does not fit or has no effect, as rules where ``rules`` is false,
        or the folder, the encoder's files or the words cannot be read.
    """
    values = dict(settings)
    preset = preset_values(values.pop("preset"), "query") if "preset" in values else {}
    fields = checked(Method, layered(preset, values), "query").model_dump(exclude_unset=True)
    chosen = {name: value for name, value in fields.items() if name in RULES}
    Rules(**chosen)
    field = SemanticField.load(folder, later=True)
    encoder = field.settings["encoder"]
    places = fields[encoder] if encoder in values else {}
    fixed = values.keys() - (RULES if rules else set()) - {encoder}
    fixed |= {f"{encoder}.{k}" for k in places if f"{encoder}.{k}" not in files_of("encoder")}
    for name in sorted(fixed):
        raise InputError(
            f"{folder}: {name} is given, but the field is built, and its encoder is {encoder!r}: "
            f"only {'rules of queries and ' * rules}files of this encoder can be given"
        )
    field = replace(field, places={**field.places, **places})
    field.encoder  # noqa: B018  (what is missing is said before anything is drawn)
    if words is not None:
        field = field.taking(TaughtWords.load(words, encoder_identity(field.settings)))
    return chosen, field


def sort_texts(field: SemanticField, texts: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Return the texts that can be asked, each once, and the reason of each that cannot.

    InputError if none can.
    """
    refused = {}
    for text in dict.fromkeys(texts):
        try:
            field.reader.understood(text)
        except InputError as error:
            refused[text] = str(error)
    asked = [text for text in dict.fromkeys(texts) if text not in refused]
    if not asked:
        raise InputError("; ".join(refused.values()))
    return asked, refused
