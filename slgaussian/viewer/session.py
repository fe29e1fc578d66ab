"""What is asked of a scene, shown of it and changed in it, without a browser.

One session is one conversation: whoever looks sees the same answers and changes, each from where he
stands. It is used by one thread at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.field import SemanticField, shown
from slgaussian.formats.ply import load_ply
from slgaussian.gaussians import Gaussians
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.query import QueryResult, Rules, ask
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera
from slgaussian.things import BEST, Thing, words_for
from slgaussian.viewer import paint
from slgaussian.viewer.outline import Outlines
from slgaussian.viewer.stage import Stage

MODES = ("colour", "depth", "objects", "relevancy", "code")

EVEN = 0.5
"""Relevancy of what fits a text as well as it fits the canonical phrases."""

SURE = 0.5
"""Least confidence of a label that is not shown as unsure: its object has three quarters of the
light there."""

FAINT = 0.01
"""Opacity below which a browser draws nothing."""

LAYERS, SWELL = 3, 1.4
"""How often the light of a field's Gaussians is taken, and how much larger they are sent; see
:attr:`Session.solid`."""

_AROUND = 4
"""Pixels around a click that are drawn to know what is there."""


@dataclass(frozen=True)
class Look:
    """What is shown, beside the scene itself.

    Attributes
    ----------
    mode : str
        One of :data:`MODES`.
    selected : int
        The object that was clicked last; 0 for none.
    guesses, unsure : bool
        Whether what no second view confirms, and what has a label that is not sure, is marked.
    """

    mode: str = "colour"
    selected: int = 0
    guesses: bool = False
    unsure: bool = False


@dataclass(frozen=True)
class Answer:
    """What was asked, and what was found.

    Attributes
    ----------
    hits : tuple of QueryResult
        One a text that could be asked. Their "image" is a row with a pixel a Gaussian.
    refused : {text: why}
    rules : Rules
    """

    hits: tuple[QueryResult, ...] = ()
    refused: dict[str, str] = field(default_factory=dict)
    rules: Rules = field(default_factory=Rules)

    @property
    def texts(self) -> list[str]:
        """Those that could be asked."""
        return [hit.text for hit in self.hits]

    def winner(self) -> np.ndarray:
        """Which text fits each Gaussian best, int64 [N] from 1; 0 where none is above the bound."""
        relevancy = np.stack([hit.relevancy[0] for hit in self.hits])
        least = EVEN if self.rules.threshold is None else self.rules.threshold
        return np.where(relevancy.max(0) > least, relevancy.argmax(0) + 1, 0)


class Session:
    """A scene that somebody looks at.

    Parameters
    ----------
    source : path
        Folder of a field, or a ``.ply`` of Gaussians.
    field : SemanticField, optional
        That of the folder, if it is open already.

    Attributes
    ----------
    field : SemanticField or None
        As it is now; None of a ``.ply``, which can be looked at but not asked.
    gaussians : Gaussians
        Those worth drawing; removed objects are among them.
    labels : int32 [N]
        Object of each, 0 for none.
    look : Look
    answer : Answer
    stage : Stage

    Raises
    ------
    InputError, SpecError
        If the source is none, is damaged, or holds no Gaussians.
    """

    def __init__(self, source: Path, field: SemanticField | None = None) -> None:
        self.source, self.field = source, field
        if field is None and source.suffix.lower() == ".ply" and not source.is_dir():
            gaussians, _ = load_ply(source)
            labels = np.zeros(len(gaussians), np.int32)
        else:
            self.field = field or SemanticField.load(source)
            gaussians, labels = self.field.gaussians, self.field.labels()
        visible = (gaussians.opacities >= FAINT).numpy()
        if not visible.any():
            raise InputError(f"{source}: holds no Gaussians to see, so there is nothing to look at")
        if not visible.all():
            gaussians, labels = gaussians[torch.from_numpy(visible)], labels[visible]
        self.gaussians, self.labels, self._visible = gaussians, labels, visible
        self.stage = Stage.of(gaussians, self.cameras)
        self.look, self.answer = Look(), Answer()
        self.confidence: np.ndarray | None = None
        self._plain = paint.plain(gaussians, self.cameras.values())
        self._objects = None
        if self.field is not None:
            self._objects = ObjectMap(labels[None], self.field.bank.ids)
        self._earlier: list[SemanticField] = []
        self._things: dict[int, Thing] = {}
        self._saved = self.field
        self._depth_from = self.stage.first

    @property
    def cameras(self) -> dict[str, Camera]:
        """The context cameras by name; none of a ``.ply``."""
        return {} if self.field is None else dict(self.field.cameras)

    @property
    def solid(self) -> Gaussians:
        """The Gaussians as a browser needs them to draw what :meth:`picture` draws.

        A field has about one Gaussian a pixel of its photographs, half transparent, and its
        pictures are the mean of what is there. A browser lets the background shine through in a
        large window, and viser drops Gaussians that are small in a small one. So their light is
        taken three times, and they are sent a little larger. Those of a ``.ply`` were trained as
        browsers draw, and go as they are.
        """
        plain = self.gaussians
        if self.field is None:
            return plain
        opacities = 1 - (1 - plain.opacities) ** LAYERS
        return replace(plain, opacities=opacities, scales=SWELL * plain.scales)

    @property
    def modes(self) -> tuple[str, ...]:
        """The modes that this scene has."""
        if self.field is None:
            return MODES[:2]
        return MODES if self.field.bank.dimension else MODES[:-1]

    @property
    def removed(self) -> frozenset[int]:
        """The objects that are not shown."""
        return frozenset() if self.field is None else self.field.removed

    def hidden(self) -> np.ndarray:
        """bool [N]: the Gaussians of removed objects, and of their fringes."""
        if not self.removed:
            return np.zeros(len(self.labels), bool)
        return self._asked_field().gone[self._visible]

    @cached_property
    def _outlines(self) -> Outlines:
        views = list(self.cameras.values())
        shape = len(views), views[0].height, views[0].width
        return Outlines(self.labels, self.gaussians.source.numpy(), shape)

    def ask(self, texts: Sequence[str], rules: Rules) -> Answer:
        """Ask for texts, and show the answer; none takes the last answer away.

        Raises
        ------
        InputError
            If this is a ``.ply``, or the encoder is not there.
        """
        own = self._asked_field()
        refused, asked = {}, []
        for text in dict.fromkeys(texts):
            try:
                own.reader.understood(text)
                asked.append(text)
            except InputError as error:
                refused[text] = str(error)
        hits: list[QueryResult] = []
        if asked:
            labels = np.where(np.isin(self.labels, list(self.removed)), 0, self.labels)
            seen = ObjectMap(labels[None], own.bank.ids) if self.removed else self._objects
            assert seen is not None  # of a field there is one
            hits = ask(asked, seen, own.reader, rules)
        self.answer = Answer(tuple(hits), refused, rules)
        mode = "relevancy" if hits else "colour"
        if hits or self.look.mode == "relevancy":
            self.look = replace(self.look, mode=mode)
        return self.answer

    def show(self, mode: str, stand: Camera | None = None) -> None:
        """Show another mode; depth is that from ``stand``."""
        if mode not in self.modes:
            raise InputError(f"mode: found {mode!r}, expected one of {', '.join(self.modes)}")
        self._depth_from = stand or self._depth_from
        self.look = replace(self.look, mode=mode)

    def mark(self, guesses: bool, unsure: bool) -> None:
        """Mark what no second view confirms, and what has a label that is not sure."""
        self.look = replace(self.look, guesses=guesses, unsure=unsure)

    def click(self, camera: Camera, x: float, y: float) -> int:
        """Select the object at (x, y) of what ``camera`` sees, in pixels; its id, 0 for none."""
        found = 0
        if self.field is not None:
            K = camera.K.copy()
            K[:2, 2] += _AROUND - np.floor([x, y])
            side = 2 * _AROUND + 1
            around = replace(camera, K=K, width=side, height=side)
            found = int(self.field.render(around).ids[_AROUND, _AROUND])
        self.look = replace(self.look, selected=found)
        return found

    def colours(self) -> np.ndarray:
        """The colour of each Gaussian as things are now: uint8 [N, 3]."""
        look, out = self.look, self._plain
        if look.mode == "depth":
            out = paint.depth(self.gaussians.means.numpy(), self._depth_from)
        elif look.mode == "objects":
            out = paint.objects(self.labels, out)
        elif look.mode == "code":
            out = paint.codes(self.gaussians.require_features().numpy())
        elif look.mode == "relevancy" and len(self.answer.hits) == 1:
            (hit,) = self.answer.hits
            out = paint.relevancy(hit.relevancy[0], hit.mask[0], out)
        elif look.mode == "relevancy" and self.answer.hits:
            out = paint.words(self.answer.winner(), out)
        if look.guesses and self.gaussians.guessed is not None:
            out = paint.marked(out, self.gaussians.guessed.numpy(), paint.GUESSED)
        if look.unsure and self.confidence is not None:
            unsure = (self.labels == 0) | (self.confidence < SURE)
            out = paint.marked(out, unsure, paint.UNSURE)
        if look.selected:
            own, outline = self.labels == look.selected, self._outlines.of(look.selected)
            out = paint.outlined(out, own, outline, paint.SELECTED)
        return out

    def picture(self, camera: Camera) -> np.ndarray:
        """What is shown, as ``camera`` sees it: uint8 [H, W, 3]."""
        gaussians, colours = self.gaussians, torch.from_numpy(self.colours()).float() / 255
        if self.removed:
            keep = torch.from_numpy(~self.hidden())
            gaussians, colours = gaussians[keep], colours[keep]
        image = rasterize(gaussians, colours, camera)
        drawn = image.values.float().numpy()
        if self.field is None:  # over black, as such files are trained
            return np.rint(drawn.clip(0, 1) * 255).astype(np.uint8)
        return shown(drawn, image.alpha.float().numpy())

    def look_through(self, name: str) -> np.ndarray:
        """The scene in its own colours as one of its cameras sees it: uint8 [H, W, 3].

        What this tells of how sure the labels are is kept in :attr:`confidence`.
        """
        own = self._asked_field()
        camera = own.cameras[name]
        seen = own.changed(removed=frozenset()).render(camera)
        if self.confidence is None:
            self.confidence = np.ones(len(self.labels), np.float32)
        pixels = camera.height * camera.width
        source = self.gaussians.source.numpy().astype(np.int64)
        mine = source // pixels == list(own.cameras).index(name)
        self.confidence[mine] = seen.confidence.ravel()[source[mine] % pixels]
        return seen.rgb

    def things(self) -> dict[int, Thing]:
        """Every object by id, removed ones too, as the field was opened.

        It takes a picture a camera the first time.
        """
        if not self._things:
            own = self._asked_field().changed(removed=frozenset())
            self._things = {thing.id: thing for thing in own.inventory()}
        return self._things

    def thing(self) -> Thing | None:
        """The object that is selected, as things are now; None if there is none."""
        if self.field is None or not self.look.selected:
            return None
        own, id_ = self.field, self.look.selected
        texts = list(dict.fromkeys([*own.taught, *words_for(own)]))
        row = int(np.searchsorted(own.bank.ids, id_))
        scores = own.reader.relevancies(texts, Rules())[:, row]
        best = np.argsort(-scores, kind="stable")[:BEST]
        words = tuple((texts[k], float(scores[k])) for k in best)
        return replace(self.things()[id_], name=own.names.get(id_), words=words)

    @property
    def unsaved(self) -> bool:
        """Whether the field was changed since it was opened or saved."""
        return self.field is not self._saved

    def change(self, changed: SemanticField) -> None:
        """Go on with a changed field, and ask again what was asked."""
        self._earlier.append(self._asked_field())
        self._go_on(changed)

    def undo(self) -> bool:
        """Take the last change back; False if there is none."""
        if not self._earlier:
            return False
        self._go_on(self._earlier.pop())
        return True

    def save(self) -> None:
        """Write all changes into the folder of the field; InputError if it cannot be written."""
        own = self._asked_field()
        own.save_edits(self.source)
        self._saved = own

    def _go_on(self, field: SemanticField) -> None:
        self.field = field
        if self.look.selected in self.removed:
            self.look = replace(self.look, selected=0)
        asked = [*self.answer.texts, *self.answer.refused]
        if asked:
            mode = self.look.mode
            self.ask(asked, self.answer.rules)
            self.look = replace(self.look, mode=mode)

    def _asked_field(self) -> SemanticField:
        if self.field is None:
            raise InputError(
                f"{self.source}: a .ply knows no words and no objects; build a field of "
                "photographs to ask"
            )
        return self.field
