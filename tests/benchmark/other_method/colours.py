"""A method of another package: a text is where the picture has the colour that it names."""

from dataclasses import dataclass

import numpy as np

from slgaussian.errors import InputError

COLOURS = {
    "red": (200, 40, 40),
    "green": (40, 160, 60),
    "blue": (40, 70, 190),
    "yellow": (220, 200, 50),
    "white": (235, 235, 235),
    "grey": (128, 128, 128),
    "brown": (130, 90, 60),
}


@dataclass
class Colours:
    """Settings of the method, and what it is before it knows a scene."""

    within: float = 0.75

    def __call__(self, inputs):
        """Prepare a scene: here is time to compute whatever all views and texts need."""
        return Scene(inputs.field, self.within)


@dataclass
class Scene:
    field: object
    within: float

    def render(self, camera):
        """The scene as a camera sees it, drawn by the Gaussians that all methods share."""
        return View(self.field.render(camera), self.within)


class View:
    def __init__(self, drawn, within):
        self.rgb, self.depth, self.within = drawn.rgb, drawn.depth, within
        self.ids = np.zeros(drawn.ids.shape, np.int32)  # it knows no objects
        self.reader = self

    def unknown_words(self, text):
        """The words of a text that do not count; InputError if none does."""
        words = text.split()
        unknown = tuple(word for word in words if word not in COLOURS)
        if unknown == tuple(words):
            raise InputError(f"{text!r}: names no colour")
        return unknown

    def query_all(self, texts, **rules):
        """Where each text is, on its own."""
        return [Answer(t, self._relevancy(t), self.within, self.unknown_words(t)) for t in texts]

    def segment(self, texts, **rules):
        """Which text fits each pixel best, from 1 on."""
        return np.argmax([self._relevancy(t) for t in texts], 0).astype(np.int32) + 1

    def _relevancy(self, text):
        wanted = np.array([COLOURS[word] for word in text.split() if word in COLOURS]).mean(0)
        away = np.linalg.norm(self.rgb - wanted, axis=-1)
        return (1 - away / 442).clip(0, 1).astype(np.float32)


@dataclass
class Answer:
    text: str
    relevancy: np.ndarray
    within: float
    unknown: tuple

    @property
    def mask(self):
        return self.relevancy > self.within

    @property
    def point(self):
        row, column = np.argwhere(self.relevancy == self.relevancy.max())[0]
        return int(column), int(row)

    @property
    def score(self):
        return float(self.relevancy.max())
