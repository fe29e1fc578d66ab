"""What `slgaussian field --add` does: more photographs for a field that there is."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from flows.cli.fields import made
from flows.cli.posing import posed_sample
from flows.settings import files_of, make_settings
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.parts.identity import file_digest
from slgaussian.parts.method import OWN, Method
from slgaussian.parts.part import Part
from slgaussian.parts.registry import KINDS
from slgaussian.scene import Sample
from slgaussian.semantic.same_objects import with_ids_of
from slgaussian.storage.derived import Derived, keeping
from slgaussian.storage.field_folder import About, check_target, read_about
from slgaussian.storage.origin import Origin, read_origin

ANEW = "build the field anew with `slgaussian field` and all of its photographs"
OTHER = "is not what the field was built with; give that one, or build the field anew"


def add(
    photos: Sequence[str], cameras: Path | None, out: Path | None, options: Mapping[str, Any]
) -> Path:
    """Add photographs to a field: as of all of them at once, but that objects keep their ids.

    What was derived of single photographs and pairs is reused, the rest depends on all of them.

    Parameters
    ----------
    photos : sequence of str
        The new ones and, last, the folder of the field.
    cameras : path, optional
        Where the cameras of all photographs are, if not where they were.
    out : path, optional
        Folder for the field; that of the field itself if left out, which stays if anything fails.
        Taught words, names and hidden objects go along.
    options : mapping
        Where files of its parts are: such places are not kept with a field.

    Raises
    ------
    InputError
        If a new photograph cannot be used or placed, one of the field is gone or another one, or
        the folder is no field or does not say what it was built from.
    SpecError
        If the field is damaged, or of another version.
    """
    *new, last = photos
    folder = Path(last)
    about, places, origin, known = _opened(folder, new)
    target = folder if out is None else out
    check_target(target)
    method = _method(about, places, options)
    _check_old(origin, folder)
    _check_new(new, origin, folder)
    old = {place: name for name, place, _ in origin.photographs}
    before = SemanticField.load(folder)
    if cameras is None and origin.cameras is not None:
        cameras = Path(origin.cameras)
    settings = make_settings(dict(origin.settings), "field")
    derived, start = Derived(known), time.perf_counter()
    with keeping(derived):
        sample, taken = posed_sample([*old, *new], cameras, origin.refine, settings)
        added = {name: place for name, place in taken.items() if place not in old}
        _check_fits(sample, added, about, folder)
        now = Origin.of(taken, cameras, origin.refine, origin.settings)
        again = {old[place]: name for name, place in taken.items() if place in old}
        settled = partial(_settled, before, views=again)
        made(sample, method, now, derived, target, start, settled)
    print(f"{len(added)} added; reused {derived.summary()}", file=sys.stderr)
    return target


def _settled(
    before: SemanticField, after: SemanticField, views: Mapping[str, str]
) -> SemanticField:
    """The field ``after`` with the ids of ``before``, and what the user changed there.

    What was named or hidden and is no object of its own any more is said.
    """
    whole = before.changed(removed=frozenset())  # what is hidden has ids too
    settled = with_ids_of(whole, after, views)
    ids = set(settled.bank.ids.tolist())
    for id_ in sorted({*before.names, *before.removed} - ids):
        known = f" ({before.names[id_]!r})" if id_ in before.names else ""
        what = "shown again" if id_ in before.removed else "without its name"
        print(
            f"object {id_}{known} is {what}: with the new photographs it is no object of its own; "
            "look at what there is with `slgaussian objects`",
            file=sys.stderr,
        )
    return settled.changed(
        taught=before.taught,
        names={id_: name for id_, name in before.names.items() if id_ in ids},
        removed=before.removed & ids,
    )


def _opened(
    folder: Path, new: Sequence[str]
) -> tuple[About, dict[str, str], Origin, dict[str, Any]]:
    """The field in a folder, where its encoder's files are, and what it was built from."""
    if folder.is_file():
        raise InputError(
            f"{folder}: is a file, expected the folder of a field that `slgaussian field` wrote; "
            "name it last, as in slgaussian field --add new.jpg field/"
        )
    about, places = read_about(folder)
    if not new:
        raise InputError(
            f"--add: found {folder} and no photograph, expected some before the field, as in "
            f"slgaussian field --add new.jpg {folder}"
        )
    found = read_origin(folder)
    if found is None:
        raise InputError(
            f"{folder}: does not say which photographs it was built from, as fields of `slgaussian "
            f"field` do; {ANEW}"
        )
    return about, places, *found


def _method(about: About, places: Mapping[str, str], options: Mapping[str, Any]) -> Method:
    """What the field was built by, with its files at the places given."""
    _check_options(about, options)
    parts: dict[str, Any] = {}
    for kind in KINDS:
        name = about.settings[kind]
        found = dict(places) if kind == "encoder" else {}
        for key, place in options.get(_table(name), {}).items():
            found[key] = str(Path(place).resolve()) if Path(place).exists() else str(place)
        part = parts[kind] = Part.stored(kind, about.settings, found)
        for key, known in part.files.items():
            if not known.place:
                raise InputError(
                    f"the field's {KINDS[kind].called} {name!r} needs its {key}, which is not "
                    f"stored with a field; say where it is, as in --{name}-{key} PLACE"
                )
        part.values(OTHER)
    shared = {name: about.settings[name] for name in OWN if name in about.settings}
    return Method(**parts, **shared)


def _check_options(about: About, options: Mapping[str, Any]) -> None:
    """InputError unless all options say where files of the field's parts are."""
    tables = {_table(about.settings[kind]) for kind in KINDS}
    asked = [
        f"{name}.{key}" if isinstance(own, dict) else name
        for name, own in options.items()
        for key in (own if isinstance(own, dict) else [""])
    ]
    for name in asked:
        if name not in files_of(*KINDS) or name.split(".")[0] not in tables:
            option = name.replace(".", "-").replace("_", "-")
            raise InputError(
                f"--{option}: with --add a field keeps the settings that it was built with; leave "
                "it out, or build the field anew"
            )


def _table(part: str) -> str:
    """What the options of a part are called by."""
    return part.replace("-", "_")


def _check_old(origin: Origin, folder: Path) -> None:
    """InputError unless the photographs of a field are where they were, and the same."""
    for _, place, digest in origin.photographs:
        if digest is None:
            continue
        try:
            same = file_digest(place) == digest
        except OSError as error:
            raise InputError(
                f"{place}: a photograph of {folder} cannot be read ({error.strerror}); put it "
                f"back, or {ANEW}"
            ) from None
        if not same:
            raise InputError(
                f"{place}: was changed after {folder} was built from it; put the former one back, "
                f"or {ANEW}"
            )


def _check_new(new: Sequence[str], origin: Origin, folder: Path) -> None:
    known = {digest: place for _, place, digest in origin.photographs if digest is not None}
    for photo in new:
        if Path(photo).is_file() and (place := known.get(file_digest(photo))) is not None:
            raise InputError(
                f"{photo}: is in {folder} already, as {place}; leave it out, or give another"
            )


def _check_fits(sample: Sample, added: Mapping[str, str], about: About, folder: Path) -> None:
    """InputError unless all that was added is in the sample, whose size is that of the field."""
    there = {view.name for view in sample.context}
    lost = [place for name, place in added.items() if name not in there]
    if lost or not added:
        raise InputError(
            f"{', '.join(lost) or 'the new photographs'}: cannot be placed among those of {folder},"
            " as said above, and nothing was added; take photographs between them and the others "
            "that overlap both by half or more"
        )
    camera = next(iter(about.cameras.values()))
    height, width = sample.context[0].image.shape[:2]
    if (height, width) != (camera.height, camera.width):
        raise InputError(
            f"{', '.join(added.values())}: has another shape, and would bring the views of {folder}"
            f" from {camera.width}x{camera.height} to {width}x{height}; crop it to the shape of "
            f"the others, or {ANEW}"
        )
