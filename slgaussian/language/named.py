"""The encoder ``named``: an oracle that is told what objects are, for experiments.

Its vectors come from a table of names, so that everything after the encoders can be tried on the
real distribution of a model's vectors without the model, and without its errors: an object has the
vector of its true name, and a text is the name that it spells.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import PrivateAttr

from slgaussian.errors import InputError
from slgaussian.language.configs import NamedConfig
from slgaussian.storage.encoding import unpacked

if TYPE_CHECKING:
    from slgaussian.geometry.room import Surroundings
    from slgaussian.labels import LabelMaps
    from slgaussian.scene import Sample

CANONICAL = ("object", "things", "stuff", "texture")
"""The paper's; those of them that a table holds are what texts compete with."""

ANY_NAME = "any name"
"""What texts compete with where the table holds none of :data:`CANONICAL`: the mean of its vectors,
the direction that its names have in common. Of the 1203 names of LVIS by a real CLIP, 0.2 % of all
pairs of different names then have a relevancy above 0.5; four names drawn at random in its place
let 9 to 23 % of them through, and the four nearest to the mean 1.4 %."""


class Named(NamedConfig):
    """An oracle that is told what objects are, with vectors by name.

    See the module.

    Attributes
    ----------
    table : path
        ``.npz`` with ``names`` str [M] and ``features`` float [M, C]. Has no default.

    Raises
    ------
    InputError
        If there is no such file, it holds something else, a feature is NaN or zero, or a name is
        there twice. Case, underscores and white space make no difference between names.
    """

    name: ClassVar[str] = "named"
    calibration: ClassVar[None] = None

    _rows: dict[str, int] = PrivateAttr()
    _vectors: np.ndarray = PrivateAttr()

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        table = self.table
        if table is None:
            raise InputError("named table: none given; give the .npz, as in --set named.table=FILE")
        names, features = _read(Path(table))
        self._rows = {_normal(name): row for row, name in enumerate(names)}
        if len(self._rows) != len(names):
            twice = next(n for i, n in enumerate(names) if self._rows[_normal(n)] != i)
            raise InputError(f"named table {table}: the name {str(twice)!r} is there twice")
        features = features.astype(np.float64)
        lengths = np.linalg.norm(features, axis=1, keepdims=True)
        wrong = ~((lengths > 0) & np.isfinite(lengths)).ravel()
        if wrong.any():
            raise InputError(
                f"named table {table}: the vector of {str(names[wrong][0])!r} is zero or not "
                "finite, expected a direction"
            )
        self._vectors = features / lengths

    @cached_property
    def canonical(self) -> tuple[str, ...]:
        """What texts compete with."""
        return tuple(name for name in CANONICAL if name in self._rows) or (ANY_NAME,)

    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """InputError: pixels do not tell what a region is called.

        :func:`slgaussian.language.bank.build_bank` takes names in place of it.
        """
        raise InputError("named: does not look at images; give build_bank the names of objects")

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C] of names; InputError for one that the table does not hold."""
        return np.stack([np.zeros(self._vectors.shape[1]), *map(self._vector, texts)])[1:].astype(
            np.float32
        )

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """None: a text is a name of the table or refused."""
        self._vector(text)
        return ()

    def unused_words(self, text: str) -> Mapping[str, str]:
        """None: every word counts."""
        return {}

    def read_as(self, text: str) -> str:
        """The text itself."""
        return text

    def _vector(self, text: str) -> np.ndarray:
        name = _normal(text)
        if name in self._rows:
            return self._vectors[self._rows[name]]
        if name == ANY_NAME:
            mean = self._vectors.mean(0)
            return mean / np.linalg.norm(mean)
        near = difflib.get_close_matches(name[:60], self._rows, 3, 0.0)
        raise InputError(
            f"query {text[:60]!r}: is no name of the table; those spelled most like it are "
            f"{', '.join(map(repr, near))}"
        )


def true_names(sample: Sample, label_maps: LabelMaps) -> dict[int, str]:
    """What the truth calls each object: the name of the instance that most of its pixels show.

    Over all context views that know their instances. Objects of which most pixels show something
    without a name are left out.

    Raises
    ------
    InputError
        If the sample has no names, or no view knows its instances.
    """
    known = [
        (view.instances, labels)
        for view, labels in zip(sample.context, label_maps.labels, strict=True)
        if view.instances is not None
    ]
    if not known or not sample.phrases:
        raise InputError(
            f"scene {sample.scene!r}: the encoder 'named' is told what objects are called, but "
            "these data do not know; use procedural scenes, or another encoder"
        )
    instances, labels = (np.concatenate([pair[k].ravel() for pair in known]) for k in (0, 1))
    names = {}
    for object_id in label_maps.ids.tolist():
        shown, counts = np.unique(instances[labels == object_id], return_counts=True)
        most = int(shown[counts.argmax()]) if len(shown) else 0
        if most in sample.phrases:
            names[object_id] = sample.phrases[most]
    return names


def _normal(name: str) -> str:
    return " ".join(str(name).replace("_", " ").casefold().split())


def _read(file: Path) -> tuple[np.ndarray, np.ndarray]:
    try:
        content, _ = unpacked(file.read_bytes())
        names, features = content["names"], content["features"]
    except OSError as problem:
        raise InputError(f"named table {file}: cannot be read ({problem})") from None
    except Exception as problem:  # a damaged file raises almost anything
        raise InputError(
            f"named table {file}: is not a .npz with names and features ({problem})"
        ) from None
    fits = features.ndim == 2 and names.shape == features.shape[:1] and len(names) > 0
    if names.dtype.kind != "U" or features.dtype.kind != "f" or not fits:
        raise InputError(
            f"named table {file}: found names {names.dtype} {names.shape} and features "
            f"{features.dtype} {features.shape}, expected str [M] and float [M, C]"
        )
    return names, features
