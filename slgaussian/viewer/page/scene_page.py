"""A field as one HTML page: a file that needs no network, or the live page of the viewer.

The page (``scene.html`` and the scripts next to it) projects Gaussians as
:mod:`slgaussian.rasterize.project` does. Its content security policy permits only its own script
and style, by their digests, and no other resource. A live page (attribute ``data-live``) may also
connect to its server (:mod:`slgaussian.viewer.server`), which answers texts and changes the field.
Names and texts of a field are inserted as text, never as markup or code.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import cv2
import jinja2
import numpy as np

from slgaussian import __version__
from slgaussian.benchmark.pictures import depth_range, encode_jpeg, label_colours
from slgaussian.cameras.quality import Quality, camera_doubt
from slgaussian.edits import Edits
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.geometry.room import find_room
from slgaussian.objects import SceneObject
from slgaussian.rasterize.render_settings import find_settings
from slgaussian.scene import Camera
from slgaussian.viewer.page.answers import PageAnswers, list_texts
from slgaussian.viewer.page.packed import BLOCK_GAUSSIANS, pack_gaussians

SCRIPTS = ("data.js", "order.js", "draw.js", "eye.js", "pick.js", "words.js", "panel.js")
"""Files that are joined, in this order, to one script; ``live.js`` comes first in a live page."""

THUMBNAIL_WIDTH = 360  # width of the thumbnails of views, in pixels

SEVERAL_TEXTS = "Separate several texts with commas: each object gets the text that fits it best."


def scene_page(
    field: SemanticField,
    photographs: Mapping[str, np.ndarray] | None = None,
    texts: Sequence[str] = (),
    live: bool = False,
) -> str:
    """Return the HTML page of a field, without removed objects.

    Args:
        photographs: {view: uint8 [H, W, 3]}, optional. Thumbnails of views; other views show the
            rendered field.
        texts: sequence of str. Texts that the page answers in addition to those of
            :mod:`slgaussian.viewer.page.answers`.
        live: True for a page that :class:`slgaussian.viewer.server.LiveField` answers. It contains
            no answers, and contains removed objects too, so that they can be restored.

    Raises:
        InputError: If there are no Gaussians or no cameras, the encoder is not installed, or it
            cannot use one of the texts.
    """
    if live:
        field = field.with_changes(edits=replace(field.edits, removed=frozenset()))
    looks = {name: field.render(camera) for name, camera in field.cameras.items()}
    origin = field.gaussians.origin
    cameras = {name: camera.relative_to(origin) for name, camera in field.cameras.items()}
    if not looks:
        raise InputError("the field has no cameras, expected at least one to start from")
    pictures = dict(photographs or {})
    drawn_views = [name for name in looks if name not in pictures]
    pictures |= {name: looks[name].rgb for name in drawn_views}
    things = [thing for thing in field.inventory() if thing.gaussians]
    ids = [thing.id for thing in things]
    field = field.drop_hidden()
    labels = field.labels()
    numbers = np.zeros(len(labels), np.int64)
    if ids:
        place = np.searchsorted(ids, labels).clip(0, len(ids) - 1)
        numbers = np.where(np.array(ids)[place] == labels, place + 1, 0)
    gaussians = field.gaussians
    depths = [look.depth for look in looks.values()]
    up = find_room(list(cameras.values()), depths).up
    views = [
        _view(name, camera, look.depth, pictures[name], "rendered" if name in drawn_views else "")
        for (name, camera), look in zip(cameras.items(), looks.values(), strict=True)
    ]
    words = list_texts(field.with_changes(edits=Edits()) if live else field, ids, texts)
    queries, answers = words.pop("texts"), []
    if live:
        words |= {"spellings": {}, "skipped": []}
    elif ids:
        answers = PageAnswers(ids, next(iter(looks.values())).ids).ask(field, queries)
    title = str(field.settings.get("scene") or "scene")
    data, layout, scale_logs = pack_gaussians(gaussians, numbers, 1 if live else 9)
    scene_data = {
        "format": 1,
        "made_by": f"slgaussian {__version__}",
        "title": title,
        "views": views,
        # Positions in the page are relative to this point of the world.
        "origin": origin.tolist(),
        "near": min(find_settings("fast", gaussians.reach(c)).near for c in field.cameras.values()),
        "up": np.asarray(up, np.float64).tolist(),
        "depths": list(depth_range(*depths)),
        "on_black": not gaussians.pixelwise,  # as SemanticField.render
        "stripes": bool(field.edits.removed),
        "things": [_thing(thing, field, labels, list(looks)) for thing in things],
        "guesses": gaussians.guessed is not None and bool(gaussians.guessed.any()),
        **words,
        "words_note": _words_note(words, live),
        "block": BLOCK_GAUSSIANS,
        "layout": layout,
        "scale_logs": list(scale_logs),
        "maps": _base64(_colour_maps()),
        "scene_note": _scene_note(field, gaussians, live),
    }
    script, style = _script(live), _read("scene.css")
    connect = "connect-src 'self'; " if live else ""
    policy = (
        f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'; "
        f"img-src data:; {connect}base-uri 'none'; form-action 'none'"
    )
    return _template().render(
        title=title,
        gaussians=f"{len(gaussians):,}",
        example="red chair" if words["pairs"] or live else "a word from the list below",
        live=live,
        policy=policy,
        style=style,
        script=script,
        about=_escape_json(_to_json(scene_data)),
        packed_gaussians=_base64(data),
        packed_answers=_base64(gzip.compress(_to_json(answers).encode(), 9, mtime=0)),
    )


def _view(
    name: str, camera: Camera, depth: np.ndarray, picture: np.ndarray, note: str
) -> dict[str, Any]:
    middle = depth[depth.shape[0] // 4 : -depth.shape[0] // 4 or None]
    positive = middle[middle > 0]
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    return {
        "name": name,
        "caption": f"{name} ({note})" if note else name,
        "width": camera.width,
        "height": camera.height,
        "fx": fx,
        "fy": fy,
        "cx": cx,
        "cy": cy,
        "c2w": camera.c2w.tolist(),
        "distance": float(np.median(positive)) if positive.size else 1.0,
        "picture": "data:image/jpeg;base64," + _base64(encode_jpeg(picture, THUMBNAIL_WIDTH)),
    }


def _thing(
    thing: SceneObject, field: SemanticField, labels: np.ndarray, views: list[str]
) -> dict[str, Any]:
    guessed = 0.0
    if field.gaussians.guessed is not None:
        guessed = float(field.gaussians.guessed.numpy()[labels == thing.id].mean())
    return {
        "id": thing.id,
        "name": thing.name or "",
        "words": [[text, round(score, 4)] for text, score in thing.words],
        "confidence": round(thing.confidence, 4),
        "colour": label_colours(np.array(thing.id)).tolist(),
        "gaussians": thing.gaussians,
        "views": [views.index(view) for view in thing.views],
        "guessed": round(guessed, 4),
        "size": [float(f"{2 * half:.2g}") for half in thing.box.half_sizes] if thing.box else [],
        "metres": thing.metres is not False,
    }


def _scene_note(field: SemanticField, gaussians: Gaussians, live: bool) -> str:
    """Return the sentences below the panel: origin, quality and limits of the scene."""
    sentences = [f"{len(gaussians):,} Gaussians from {len(field.cameras)} photographs."]
    if "quality" in field.settings:
        quality = Quality(**field.settings["quality"])
        depth = quality.depth[0].upper() + quality.depth[1:]
        sentences.append(f"{depth}, and the depth of the rest is a guess.")
        sentences.append(f"{quality.verdict().sentence().capitalize()}.")
    sentences.append("Areas that no photograph shows stay empty.")
    if field.edits.removed:
        sentences.append("Stripes are empty too, such as areas behind removed objects.")
    if any(camera.estimated for camera in field.cameras.values()):
        sentences.append(
            "The cameras were estimated from the photographs, so sizes are not in metres."
        )
        record = field.settings.get("cameras", {})
        warnings = [camera_doubt(record), *record.get("warnings", [])]
        sentences += [f"Warning: {warning}." for warning in warnings if warning]
    if gaussians.sh.shape[1] > 1:
        sentences.append("Colours do not change with the viewpoint here, but in the field they do.")
    origin = f", computed by slgaussian {__version__} when it wrote this file"
    sentences.append(f"Answers are for whole objects{'' if live else origin}.")
    return " ".join(sentences)


def _to_json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _words_note(words: Mapping[str, Any], live: bool) -> str:
    """Return the sentences that list the texts of the page."""
    if live and not words["pairs"]:
        return f"Any text. {SEVERAL_TEXTS}"
    kinds: dict[str, list[str]] = {}
    for word, kind in words["words"].items():
        kinds.setdefault(kind, []).append(word)
    titles = {"named": "Names", "taught": "Taught", "text": "Texts"}
    titles |= {"thing": "Nouns", "describing": "Describing words"}
    sentences = [
        f"{name}: {', '.join(sorted(kinds[kind]))}."
        for kind, name in titles.items()
        if kind in kinds
    ]
    if words["pairs"]:
        sentences.append(
            "Pairs: a colour with a noun, such as “red chair”, or another describing word with a "
            "common noun."
        )
    sentences.append(SEVERAL_TEXTS)
    return " ".join(sentences)


def _escape_json(text: str) -> str:
    """Escape JSON so that it cannot end its element of the page or begin a comment."""
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _digest(text: str) -> str:
    return f"sha256-{_base64(hashlib.sha256(text.encode()).digest())}"


def _colour_maps() -> bytes:
    """Return the colour maps turbo and inferno, 256 RGBA colours each."""
    ramp = np.arange(256, dtype=np.uint8)[None]
    maps = [cv2.applyColorMap(ramp, name) for name in (cv2.COLORMAP_TURBO, cv2.COLORMAP_INFERNO)]
    return np.concatenate(
        [np.dstack([colours[..., ::-1], np.full_like(ramp, 255)]) for colours in maps]
    ).tobytes()


@cache
def _script(live: bool) -> str:
    return "\n".join(_read(name) for name in (*(("live.js",) if live else ()), *SCRIPTS))


@cache
def _read(name: str) -> str:
    return files(__package__).joinpath(name).read_text("utf-8")


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(_read("scene.html"))
