"""From where a field is looked at: its own views, other cameras, between two, or along a turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.scene import Camera, Scene

MOST_FRAMES = 2000


@dataclass(frozen=True)
class Viewpoint:
    """A camera, what it is called, and a caption that is true of a picture rendered from it."""

    name: str
    caption: str
    camera: Camera


@dataclass(frozen=True)
class Choice:
    """What the user said of it; at most one of ``views``, ``between`` and ``orbit``.

    Attributes
    ----------
    views : sequence of str
        By name, or number from 0; the first one if nothing is said.
    file : path, optional
        Camera file whose views are meant in place of those of the field.
    between : (str, str, float), optional
        Two views and the share of the way between them.
    orbit : int, optional
        Frames of a turn among all views.

    Raises
    ------
    InputError
        If two of them are said, or a number is out of range.
    """

    views: Sequence[str] = ()
    file: Path | None = None
    between: tuple[str, str, float] | None = None
    orbit: int | None = None

    def __post_init__(self) -> None:
        said = {"--view": self.views, "--between": self.between, "--orbit": self.orbit}
        given = [name for name, value in said.items() if value]
        if len(given) > 1:
            raise InputError(f"{given[0]} and {given[1]}: are two ways to look; give one of them")
        if self.orbit is not None and not 2 <= self.orbit <= MOST_FRAMES:
            raise InputError(
                f"--orbit: found {self.orbit}, expected a number of frames from 2 to {MOST_FRAMES}"
            )

    @property
    def film(self) -> bool:
        """Whether there are frames of a film to draw."""
        return self.orbit is not None

    def of_field(self, folder: Path, field: SemanticField) -> list[Viewpoint]:
        """The viewpoints on a field; InputError if there is no such view."""
        own = _scene(str(folder), field.cameras) if self.file is None else self._listed()
        return self._among(own, lambda: field.gaussians.to_arrays()["means"])

    def of_points(self, points: np.ndarray) -> list[Viewpoint]:
        """The viewpoints on points [N, 3] that have no cameras of their own: those of the file."""
        return self._among(self._listed(), lambda: points)

    def _listed(self) -> Scene:
        assert self.file is not None  # where a field's own cameras are not asked for
        from slgaussian.datasets.recognise import cameras_in

        return _scene(str(self.file), cameras_in(self.file))

    def _among(self, scene: Scene, points: Callable[[], np.ndarray]) -> list[Viewpoint]:
        if self.orbit is not None:
            from slgaussian.cameras.trajectories import orbit

            turn = orbit(list(scene.cameras.values()), points(), self.orbit)
            names = [f"turn {number} of {self.orbit}" for number in range(1, self.orbit + 1)]
            return [
                Viewpoint(name, f"rendering, {name}", camera)
                for name, camera in zip(names, turn, strict=True)
            ]
        if self.between is not None:
            from slgaussian.cameras.trajectories import between

            a, b = (choose(scene, view) for view in self.between[:2])
            share = self.between[2]
            camera = between(scene.cameras[a], scene.cameras[b], share)
            name = f"between {a} and {b} at {share:g}"
            short = f"rendering between {_short(a)} and {_short(b)} at {share:g}"
            return [Viewpoint(name, short, camera)]
        names = [choose(scene, view) for view in self.views or ["0"]]
        return [Viewpoint(n, f"rendering at {_short(n)}", scene.cameras[n]) for n in names]


def choose(scene: Scene, view: str) -> str:
    """The name of the view called ``view``, or of that number; InputError if there is none."""
    names = list(scene.cameras)
    if view.isdecimal() and str(int(view)) == view and int(view) < len(names):
        return names[int(view)]
    return scene.find(view)


def _scene(name: str, cameras: Any) -> Scene:
    """A scene without photographs: only to find names the one way that names are found."""
    return Scene(name, cameras, read=_unreadable)


def _unreadable(name: str) -> Any:
    raise InputError(f"{name}: a field holds no photographs")


def _short(name: str) -> str:
    return PurePosixPath(name).name
