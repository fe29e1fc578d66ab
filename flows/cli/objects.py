"""List, extract, remove and teach the objects of a field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flows.cli.drawings import PICTURES, check_drawing, write_picture
from flows.cli.query import EVEN, open_field, refusals, sort_texts
from flows.cli.text import aligned
from flows.cli.viewpoints import Choice
from slgaussian.benchmark import pictures
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply
from slgaussian.io import write_file
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.query import Rules, ask
from slgaussian.storage.encoding import packed
from slgaussian.storage.field_folder import check_target
from slgaussian.storage.specs import load_spec
from slgaussian.things import Thing

UNITS = {
    True: "Sizes are in metres.",
    False: "Sizes are in scene units, which are not metres: the cameras were found.",
    None: "Sizes are in scene units, those of the given cameras.",
}

Hits = tuple[tuple[int, float], ...]
"""Ids of objects with their relevancies."""


def inventory(
    folder: Path,
    texts: Sequence[str],
    out: Path | None,
    crops: Path | None,
    settings: Mapping[str, Any],
    words: Path | None,
) -> list[dict[str, Any]]:
    """Return every object of a field; as a table or a picture in ``out``, cut out in ``crops``.

    ``settings`` and ``words`` as in :func:`flows.cli.query.ask`.

    Returns
    -------
    list of dict
        One an object, as ``data_specs/things.toml`` has it. And one a text that was refused:
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
    rules, field = open_field(folder, settings, words)
    asked, refused = sort_texts(field, texts) if texts else ([], {})
    things = field.inventory(asked or None, **rules)
    rows = [_row(thing) for thing in things]
    if out is not None and table:
        arrow = pa.Table.from_pylist(rows, schema=load_spec("things").schema)
        write_file(out, packed("things", arrow, str(out))[1])
    if crops is not None or (out is not None and not table):
        cuts = _cut_out(folder, field, things)
        if crops is not None:
            _write_crops(crops, things, cuts)
        if out is not None and not table:
            tiles = [(_caption(thing), cut) for thing, cut in zip(things, cuts, strict=True)]
            write_picture(out, pictures.contact_sheet(tiles, side=112, columns=8))
    return rows + [{"text": text, "refused": reason} for text, reason in refused.items()]


def objects_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Tabulate the rows of :func:`inventory`."""
    things = [row for row in rows if "id" in row]
    lines = [("object", "best words", "sure", "size", "seen in")]
    for row in things:
        size = " x ".join(f"{2 * half:.2f}" for half in row["half_sizes"] or ())
        sure = f"{row['confidence']:.2f}"
        lines.append((str(row["id"]), _best_words(row), sure, size, ", ".join(row["views"])))
    notes = refusals(rows)
    if things:
        notes.insert(0, UNITS[things[0]["metres"]])
    if any(row["relevancies"][:1] <= [EVEN] for row in things):
        notes.insert(0, "(in brackets: no text fits better than the canonical phrases do)")
    return "\n".join([aligned(lines, "><><<"), *notes])


def write_alone(
    folder: Path, text: str, out: Path, settings: Mapping[str, Any], words: Path | None
) -> bool:
    """Write the Gaussians of what a text, a name or an id means: ``.ply``, or a field folder.

    Returns False, and writes nothing, if the scene has none of it; prints what was taken.
    """
    ply = out.suffix.lower() == ".ply"
    if not ply:
        check_target(out)
    rules, field = open_field(folder, settings, words)
    hits = objects_meant(field, text, rules)
    alone = field.dropped().only(id_ for id_, _ in hits)
    if not len(alone.gaussians):
        print(f"nothing found for {text!r}, so nothing is written")
        return False
    if ply:
        save_ply(alone.gaussians, out, alone.labels())
    else:
        alone.save(out)
    print(f"objects  {_listed(hits)}\n{len(alone.gaussians):,} Gaussians  {out}")
    return True


def write_without(
    folder: Path,
    texts: Sequence[str],
    out: Path,
    settings: Mapping[str, Any],
    words: Path | None,
) -> bool:
    """Write the field without the Gaussians of what texts, names or ids mean, to another folder.

    Prints a line a text, and the share of the context views' pixels where nothing is known now,
    and was before. Writes nothing if nothing is found of any text.

    Returns
    -------
    bool
        True if something was found for every text.

    Raises
    ------
    InputError
        If anything given cannot be used, or ``out`` is the field itself.
    """
    if out.resolve() == folder.resolve():
        raise InputError(
            f"{out}: is the field itself, and what is removed does not come back; choose another "
            "folder"
        )
    check_target(out)
    rules, field = open_field(folder, settings, words)
    hits = {text: objects_meant(field, text, rules) for text in texts}
    labels, removed = field.labels(), set[int]()
    for text, objects in hits.items():
        ids = {id_ for id_, _ in objects} - removed
        removed |= ids
        count = int(np.isin(labels, list(ids)).sum())
        meaning = f"objects {_listed(objects)}" if objects else "nothing found"
        print(f"{text!r}: {meaning}, {count:,} Gaussians")
    if removed:
        without = field.without(removed).dropped()
        without.save(out)
        before, after = (
            np.concatenate([f.render(camera).unknown.ravel() for camera in f.cameras.values()])
            for f in (field, without)
        )
        opened = float((after & ~before).mean())
        print(f"open in the context views: {100 * opened:.1f} % of the pixels\n{out}")
    return all(hits.values())


def teach_word(
    folder: Path, word: str, at: tuple[int, int] | None, view: str | None, forget: bool
) -> str:
    """Teach the field that a word means what is at a pixel of a view, or let it forget the word.

    Returns a message for people; InputError if the pixel, view or word cannot be used.
    """
    if forget == (at is not None):
        raise InputError("say either where it is, with --at X Y, or --forget")
    field = SemanticField.load(folder)
    if at is None:
        field.forget(word).save_edits(folder)
        return f"{word!r} is forgotten"
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
    return (
        f"{word!r} is object {id_}\nexamples  {taught.taught.examples(word)}\n"
        f"it means  {_listed(taught.find(word))}"
    )


def objects_meant(field: SemanticField, text: str, rules: Mapping[str, Any]) -> Hits:
    """Return the objects that a text means: that of this id, those of this name, or those it fits.

    None where the scene as a whole answers the text with "not here".
    """
    there = {int(id_) for id_ in field.bank.ids} - field.removed
    if text.strip().isdecimal():
        if int(text) not in there:
            raise InputError(
                f"{text!r}: is no object of the field; `slgaussian objects list` has them"
            )
        return ((int(text), 1.0),)
    labels = field.labels()
    labels = np.where(np.isin(labels, list(field.removed)), 0, labels)
    seen = ObjectMap(labels[None], field.bank.ids)
    (answer,) = ask([text], seen, field.reader, Rules(**rules))
    return () if answer.verdict == "not here" else field.find(text, **rules)


def _listed(hits: Hits) -> str:
    return ", ".join(f"{id_} ({score:.3f})" for id_, score in hits)


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


def _best_words(row: Mapping[str, Any]) -> str:
    pairs = list(zip(row["words"], row["relevancies"], strict=True))
    good = [f"{text} {relevancy:.3f}" for text, relevancy in pairs if relevancy > EVEN]
    words = ", ".join(good) if good else ", ".join(f"({text} {r:.3f})" for text, r in pairs[:1])
    return words if row["name"] is None else f"{row['name']!r}: {words}"


def _caption(thing: Thing) -> str:
    fits = thing.words and thing.words[0][1] > EVEN
    return f"{thing.id} {thing.name or (thing.words[0][0] if fits else '')}".strip()


def _cut_out(folder: Path, field: SemanticField, things: Sequence[Thing]) -> list[np.ndarray]:
    """Return how each object looks in the view that shows most of it, uint8 [H, W, 3]."""
    if field.bank.boxes is None:
        raise InputError(
            f"{folder}: its memory bank does not know where the objects are, so they cannot be "
            "drawn; leave out --crops and the picture, or build the field again"
        )
    views = [field.render(camera) for camera in field.cameras.values()]
    rows = np.searchsorted(field.bank.ids, [thing.id for thing in things])
    return pictures.cut_out(
        [view.rgb for view in views],
        [view.ids for view in views],
        field.bank.ids[rows],
        field.bank.boxes[rows],
    )


def _write_crops(folder: Path, things: Sequence[Thing], cuts: Sequence[np.ndarray]) -> None:
    """Write one picture an object, ``ID.png``."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); name a folder") from error
    for thing, cut in zip(things, cuts, strict=True):
        if cut.size:
            write_picture(folder / f"{thing.id}.png", cut)
