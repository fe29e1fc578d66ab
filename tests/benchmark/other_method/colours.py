"""A method of another package: a text matches pixels of the colour that it names."""

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
    """Settings of the method; calling it prepares a scene."""

    within: float = 0.75

    def __call__(self, inputs):
        """Prepare a scene: compute what all views and texts need."""
        return Scene(inputs.field, self.within)


@dataclass
class Scene:
    field: object
    within: float

    def render(self, camera):
        """Render a view from the Gaussians that all methods share."""
        return View(self.field.render(camera), self.within)


class View:
    def __init__(self, drawn, within):
        self.rgb, self.depth, self.within = drawn.rgb, drawn.depth, within
        self.ids = np.zeros(drawn.ids.shape, np.int32)  # it knows no objects
        self.reader = self

    def unknown_words(self, text):
        """Return the words of a text that are ignored; InputError if all are."""
        unknown = tuple(word for word in text.split() if word not in COLOURS)
        if len(unknown) == len(text.split()):
            raise InputError(f"{text!r}: names no colour")
        return unknown

    def query_all(self, texts, **rules):
        """Answer each text independently."""
        return [Answer(t, self._relevancy(t), self.within, self.unknown_words(t)) for t in texts]

    def segment(self, texts, **rules):
        """Return the best text for each pixel, counted from 1."""
        return np.argmax([self._relevancy(t) for t in texts], 0).astype(np.int32) + 1

    def _relevancy(self, text):
        wanted = np.mean([COLOURS[word] for word in text.split() if word in COLOURS], 0)
        away = np.linalg.norm(self.rgb - wanted, axis=-1)
        return (1 - away / 442).clip(0, 1).astype(np.float32)


class Answer:
    def __init__(self, text, relevancy, within, unknown):
        self.text, self.relevancy, self.unknown = text, relevancy, unknown
        self.mask, self.score = relevancy > within, float(relevancy.max())
        row, column = np.unravel_index(relevancy.argmax(), relevancy.shape)
        self.point = int(column), int(row)
