"""Open a field to ask it: with rules, files of its encoder, taught words, and views seen before."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flows.settings import RULES, Method, checked, files_of, layered, preset_values
from slgaussian.errors import InputError
from slgaussian.field import FieldView, SemanticField
from slgaussian.kernels import threads
from slgaussian.language.query import Rules
from slgaussian.language.taught import TaughtWords, encoder_identity
from slgaussian.scene import Camera
from slgaussian.storage.field_folder import read_about
from slgaussian.storage.local_copies import kept_arrays

RENDERED = ("rgb", "ids", "confidence", "alpha", "depth")
"""Arrays of a view that the user's cache holds."""


def open_field(
    folder: Path, settings: Mapping[str, Any], words: Path | None = None, rules: bool = True
) -> tuple[dict[str, Any], SemanticField]:
    """Return the rules among ``settings``, and the field with its encoder ready to be asked.

    Parameters
    ----------
    folder : path
    settings : mapping
        Fields of :class:`slgaussian.language.query.Rules`, ``preset``, of which the rules count,
        and by the name of the field's encoder a table of where its files are now.
    words : path, optional
        File of taught words that the field takes for this.
    rules : bool
        Whether rules have an effect.

    Raises
    ------
    InputError
        If a setting is unknown, does not fit or has no effect, or the folder, the encoder's files
        or the words cannot be read.
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
    field.encoder  # noqa: B018  (an encoder that is missing is an error before anything is drawn)
    if words is not None:
        field = field.taking(TaughtWords.load(words, encoder_identity(field.settings)))
    return chosen, field


def sort_texts(field: SemanticField, texts: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Return the texts that can be asked, each once, and the reason of each that cannot.

    InputError if there are texts and none can.
    """
    refused = {}
    for text in dict.fromkeys(texts):
        try:
            field.reader.understood(text)
        except InputError as error:
            refused[text] = str(error)
    asked = [text for text in dict.fromkeys(texts) if text not in refused]
    if texts and not asked:
        raise InputError("; ".join(refused.values()))
    return asked, refused


def refusals(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line for each row of a text that was refused."""
    return [f"{row['text']!r} is refused: {row['refused']}" for row in rows if row.get("refused")]


def render_view(folder: Path, field: SemanticField, camera: Camera) -> FieldView:
    """Render the field of ``folder``, or take the view from the user's cache.

    The cache knows views by all that their pixels depend on: content, camera, code and processor.
    A view that is asked again reads no Gaussians: 1.1 s in place of 2.8 for an office.
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
