"""What the commands about the things of a field do: list, take out, remove, teach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flows.cli.drawings import PICTURES, check_drawing, write_picture
from flows.cli.questions import EVEN, opened, refusals, sorted_out
from flows.cli.viewpoints import Choice
from slgaussian.benchmark import pictures
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply
from slgaussian.io import write_file
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.query import Rules, ask
from slgaussian.storage.field_folder import check_target
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import packed
from slgaussian.things import Thing

UNITS = {
    True: "Sizes are in metres.",
    False: "Sizes are in scene units, which are not metres: the cameras were found.",
    None: "Sizes are in scene units, those of the given cameras.",
}


def inventory(
    folder: Path,
    texts: Sequence[str],
    out: Path | None,
    crops: Path | None,
    settings: Mapping[str, Any],
    words: Path | None,
) -> list[dict[str, Any]]:
    """Every thing of a field; as a table or a picture in ``out``, and cut out in folder ``crops``.

    ``settings`` and ``words`` as in :func:`flows.cli.questions.ask`.

    Returns
    -------
    list of dict
        One a thing, as ``data_specs/things.toml`` has it. And one a text that was refused:
        ``text``, ``refused``.

    Raises
    ------
    InputError
        If anything given cannot be used, or every text is refused.
    """
    table = out is not None and out.suffix.lower() == ".parquet"
    if out is not None and not table:
        if out.suffix.lower() not in PICTURES:
            raise InputError(
                f"{out}: found {out.suffix or 'no suffix'!r}, expected the name of a table to end "
                f"in .parquet, or that of a picture in {' or '.join(PICTURES)}"
            )
        check_drawing(out, film=False)
    rules, field = opened(folder, settings, words)
    asked, refused = sorted_out(field, texts) if texts else ([], {})
    things = field.inventory(asked or None, **rules)
    rows = [_row(thing) for thing in things]
    if crops is not None or (out is not None and not table):
        cuts = _cut_out(folder, field, things)
        if crops is not None:
            _write_crops(crops, things, cuts)
        if out is not None and not table:
            tiles = [(_caption(thing), cut) for thing, cut in zip(things, cuts, strict=True)]
            write_picture(out, pictures.contact_sheet(tiles, side=112, columns=8))
    if out is not None and table:
        made = pa.Table.from_pylist(rows, schema=load_spec("things").schema)
        write_file(out, packed("things", made, str(out))[1])
    return rows + [{"text": text, "refused": why} for text, why in refused.items()]


def listed(rows: Sequence[Mapping[str, Any]]) -> str:
    """What :func:`inventory` found, as a table."""
    things = [row for row in rows if "id" in row]
    said = [_words(row) for row in things]
    wide = max(map(len, ["best words", *said]))
    lines = [f"object  {'best words':<{wide}}  sure   size             seen in"]
    for row, words in zip(things, said, strict=True):
        size = " x ".join(f"{2 * half:.2f}" for half in row["half_sizes"] or ())
        views = ", ".join(row["views"])
        lines.append(
            f"{row['id']:>6}  {words:<{wide}}  {row['confidence']:.2f}  {size:<18} {views}"
        )
    if any(row["relevancies"][:1] <= [EVEN] for row in things):
        lines.append("(in brackets: no text fits better than the canonical phrases do)")
    if things:
        lines.append(UNITS[things[0]["metres"]])
    return "\n".join(lines + refusals(rows))


def take_out(
    folder: Path, what: str, out: Path, settings: Mapping[str, Any], words: Path | None
) -> dict[str, Any]:
    """Write the Gaussians of what a text, a name or an id means: ``.ply``, or a field folder.

    Returns
    -------
    dict
        ``found``, the (id, relevancy) of it; ``gaussians``, how many; nothing is written of none.
    """
    ply = out.suffix.lower() == ".ply"
    if not ply:
        check_target(out)
    rules, field = opened(folder, settings, words)
    found = meant(field, what, rules)
    alone = field.dropped().only(id_ for id_, _ in found)
    if not len(alone.gaussians):
        return {"found": [], "gaussians": 0}
    if ply:
        save_ply(alone.gaussians, out, alone.labels())
    else:
        alone.save(out)
    return {"found": found, "gaussians": len(alone.gaussians)}


def remove(
    folder: Path,
    what: Sequence[str],
    out: Path,
    settings: Mapping[str, Any],
    words: Path | None,
) -> list[dict[str, Any]]:
    """Write the field without the Gaussians of what texts, names or ids mean, to another folder.

    Returns
    -------
    list of dict
        One a text: ``text``, ``found`` (id, relevancy), ``gaussians`` that are gone; then one of
        all: ``open``, the share of the context views' pixels where nothing is known now, and was
        before. Nothing is written if nothing is found of any.
    """
    if out.resolve() == folder.resolve():
        raise InputError(
            f"{out}: is the field itself, and what is removed does not come back; choose another "
            "folder"
        )
    check_target(out)
    rules, field = opened(folder, settings, words)
    labels, gone = field.labels(), set[int]()
    rows: list[dict[str, Any]] = []
    for text in what:
        found = meant(field, text, rules)
        ids = {id_ for id_, _ in found} - gone
        gone |= ids
        count = int(np.isin(labels, list(ids)).sum())
        rows.append({"text": text, "found": found, "gaussians": count})
    if gone:
        without = field.without(gone).dropped()
        without.save(out)
        before, after = (
            np.concatenate([f.render(camera).unknown.ravel() for camera in f.cameras.values()])
            for f in (field, without)
        )
        rows.append({"open": float((after & ~before).mean())})
    return rows


def teach(folder: Path, word: str, at: tuple[int, int], view: str | None) -> dict[str, Any]:
    """Teach the field in ``folder`` that a word means what is at a pixel of a view.

    Returns
    -------
    dict
        ``object``; ``examples``, how many the word has now; ``found``, the (id,
        relevancy) of what it means in the scene.
    """
    field = SemanticField.load(folder)
    (viewpoint,) = Choice([view] if view else ()).of_field(folder, field)
    x, y = at
    width, height = viewpoint.camera.width, viewpoint.camera.height
    if not (0 <= x < width and 0 <= y < height):
        raise InputError(
            f"--at {x} {y}: is outside view {viewpoint.name!r}, which is {width} pixels wide and "
            f"{height} high"
        )
    id_ = int(field.render(viewpoint.camera).ids[y, x])
    if not id_:
        raise InputError(
            f"--at {x} {y}: view {viewpoint.name!r} shows no object there; point at one, which "
            "`slgaussian render` draws"
        )
    taught = field.teach(word, id_)
    taught.save_edits(folder)
    return {"object": id_, "examples": taught.taught.examples(word), "found": taught.find(word)}


def forget(folder: Path, word: str) -> None:
    """Let the field in ``folder`` forget a taught word."""
    SemanticField.load(folder).forget(word).save_edits(folder)


def told(found: Sequence[tuple[int, float]]) -> str:
    """Objects and relevancies, for people."""
    return ", ".join(f"{id_} ({score:.3f})" for id_, score in found)


def meant(
    field: SemanticField, what: str, rules: Mapping[str, Any]
) -> tuple[tuple[int, float], ...]:
    """Return the objects that a text means: that of this id, those of this name, or those it fits.

    None where the scene as a whole answers the text with "not here".
    """
    there = {int(id_) for id_ in field.bank.ids} - field.removed
    if what.strip().isdecimal():
        if int(what) not in there:
            raise InputError(
                f"{what!r}: is no object of the field; `slgaussian objects` lists them"
            )
        return ((int(what), 1.0),)
    labels = field.labels()
    labels = np.where(np.isin(labels, list(field.removed)), 0, labels)
    seen = ObjectMap(labels[None], field.bank.ids)
    (answer,) = ask([what], seen, field.reader, Rules(**rules))
    return () if answer.verdict == "not here" else field.find(what, **rules)


def _row(thing: Thing) -> dict[str, Any]:
    box = thing.box
    return {
        "id": thing.id,
        "name": thing.name,
        "words": [text for text, _ in thing.words],
        "relevancies": [relevancy for _, relevancy in thing.words],
        "confidence": thing.confidence,
        "gaussians": thing.gaussians,
        "centre": None if box is None else box.centre.tolist(),
        "axes": None if box is None else box.axes.ravel().tolist(),
        "half_sizes": None if box is None else box.half_sizes.tolist(),
        "metres": thing.metres,
        "views": list(thing.views),
    }


def _words(row: Mapping[str, Any]) -> str:
    pairs = list(zip(row["words"], row["relevancies"], strict=True))
    good = [f"{text} {relevancy:.3f}" for text, relevancy in pairs if relevancy > EVEN]
    said = ", ".join(good) if good else ", ".join(f"({text} {r:.3f})" for text, r in pairs[:1])
    return said if row["name"] is None else f"{row['name']!r}: {said}"


def _caption(thing: Thing) -> str:
    fits = thing.words and thing.words[0][1] > EVEN
    return f"{thing.id} {thing.name or (thing.words[0][0] if fits else '')}".strip()


def _cut_out(folder: Path, field: SemanticField, things: Sequence[Thing]) -> list[np.ndarray]:
    """What each thing looks like in the view that shows most of it."""
    if field.bank.boxes is None:
        raise InputError(
            f"{folder}: its memory bank does not know where the objects are, so they cannot be "
            "drawn; leave out --crops and the picture, or build the field again"
        )
    seen = [field.render(camera) for camera in field.cameras.values()]
    rows = np.searchsorted(field.bank.ids, [thing.id for thing in things])
    return pictures.cut_out(
        [view.rgb for view in seen],
        [view.ids for view in seen],
        field.bank.ids[rows],
        field.bank.boxes[rows],
    )


def _write_crops(folder: Path, things: Sequence[Thing], cuts: Sequence[np.ndarray]) -> None:
    """One picture a thing, ``ID.png``."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); name a folder") from error
    for thing, cut in zip(things, cuts, strict=True):
        if cut.size:
            write_picture(folder / f"{thing.id}.png", cut)
