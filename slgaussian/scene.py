"""Cameras, views, scenes and samples, which readers produce and all other modules consume.

Convention of the whole project: OpenCV axes (x right, y down, z forward),
camera-to-world poses, intrinsics in pixels, and pixel centres at +0.5, so that the top-left pixel
covers [0, 1] x [0, 1] and its centre is (0.5, 0.5).
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from slgaussian.checks import check_cameras, check_names, name_parts, namesakes, order_naturally
from slgaussian.copies import Thumbnail, are_copies
from slgaussian.errors import InputError
from slgaussian.formats.images import MAX_PIXELS
from slgaussian.formats.resampling import Fit, Window
from slgaussian.io import short_repr
from slgaussian.kernels.seeding import hash_arrays

if TYPE_CHECKING:  # it imports this module
    from slgaussian.cameras.match_graph import MatchGraph

ROTATION_TOLERANCE = 1e-3
"""Largest allowed entry of ``R.T @ R - I``: accepts poses printed with four digits, not scaling."""

MAX_STRETCH = 1.1
"""Ratio of the two focal lengths above which a scene warns: pixels of photographs are square, to a
thousandth in all real data seen."""

MIN_SHARE = 0.5
"""Fraction of the pixels of most photographs below which one that is smaller is named."""

ROUNDING = 1e-13
"""Distance of two positions in the world, as a share of their coordinates, up to which they are one
position computed in two ways in float64."""

MAX_DISTANCE_RATIO = 100.0
"""Largest distance from the origin of the world, in spreads of the positions themselves, at which
float32 holds them: it rounds by 6e-8 of the distance, so a point moves by at most 6e-6 of the
baseline, and in the image by that share of its disparity, under a thousandth of a pixel."""

SAME_PLACE_SHARE, SAME_PLACE_ANGLE = 0.02, 2.0
"""Distance of two cameras, as a share of the largest one of a sample, and angle, degrees, up to
which they may have taken pictures that cannot be told apart, as a film does that pauses."""

PAPER_PIXELS = 416 * 576
"""Number of pixels of the paper's images."""

Size = tuple[int, int] | str
"""Height and width, ``"auto"``, ``"original"`` or ``"at most 312x432"``; see :meth:`Scene.sample`.
"""


@dataclass(frozen=True)
class Estimated:
    """Uncertainty of an estimated camera.

    Attributes:
        focal: (float, float). 90 % confidence interval of the focal length, relative to the
            estimate.
        source: Source of the focal length: "EXIF", "matches", "guess" or "given".
        confidence: Probability, 0 to 1, that the poses of the scene are correct to a few degrees.
    """

    focal: tuple[float, float]
    source: str
    confidence: float

    @staticmethod
    def of(content: Any) -> Estimated:
        """Inverse of :func:`dataclasses.asdict`, also after a round trip through JSON.

        Raises:
            ValueError: If the content is invalid.
        """
        try:
            low, high = map(float, content["focal"])
            confidence = float(content["confidence"])
            if 0 < low <= high < np.inf and 0 <= confidence <= 1:
                return Estimated((low, high), str(content["source"]), confidence)
        except (TypeError, KeyError, ValueError):
            pass
        raise ValueError("says how a camera was estimated in no form that is known")


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Attributes:
        K: float64 [3, 3]. Intrinsics in pixels; pixel centres at +0.5.
        c2w: float64 [4, 4]. Camera-to-world, OpenCV axes.
        width, height: Image size in pixels.
        near, far: Depth range along z in scene units, if known.
        estimated: Uncertainty, if the camera was estimated from photographs; None if it was given.

    Raises:
        InputError: If a number is not finite, the pose is not a rotation and a translation, the
            focal length or size is not positive, there are more than
            :data:`slgaussian.formats.images.MAX_PIXELS` pixels, or near and far are out of order.
    """

    K: np.ndarray
    c2w: np.ndarray
    width: int
    height: int
    near: float | None = None
    far: float | None = None
    estimated: Estimated | None = None

    def __repr__(self) -> str:
        focal, at = (
            ", ".join(f"{x:.4g}" for x in xs) for xs in (self.K[[0, 1], [0, 1]], self.center)
        )
        return f"Camera({self.width}x{self.height}, focal length ({focal}) pixels, at ({at}))"

    def __post_init__(self) -> None:
        K = np.asarray(self.K, dtype=np.float64)
        c2w = np.asarray(self.c2w, dtype=np.float64)
        for name, matrix, shape in (("K", K, (3, 3)), ("c2w", c2w, (4, 4))):
            if matrix.shape != shape:
                raise InputError(f"camera {name}: found shape {matrix.shape}, expected {shape}")
            if not np.isfinite(matrix).all():
                raise InputError(f"camera {name}: holds NaN or infinity, expected finite numbers")
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise InputError(f"camera K: focal lengths {K[0, 0]:g}, {K[1, 1]:g} must be positive")
        R = c2w[:3, :3]
        error = float(np.abs(R.T @ R - np.eye(3)).max())
        if error > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
            raise InputError(
                f"camera c2w: its 3x3 part is not a rotation (orthogonality error {error:.3g}, "
                f"determinant {np.linalg.det(R):.3g}); give a camera-to-world pose without scale"
            )
        if not np.allclose(c2w[3], (0, 0, 0, 1)):
            raise InputError(f"camera c2w: last row is {c2w[3].tolist()}, expected [0, 0, 0, 1]")
        if self.width < 1 or self.height < 1:
            raise InputError(f"camera size {self.width}x{self.height} must be at least 1x1")
        if not self.width * self.height <= MAX_PIXELS:
            raise InputError(
                f"camera size {self.width:g}x{self.height:g}: expected at most {MAX_PIXELS:,} "
                "pixels; shrink the photographs"
            )
        if self.near is not None and not 0 < self.near < np.inf:
            raise InputError(f"camera near: found {self.near}, expected a positive number")
        if self.far is not None and not (self.near or 0) < self.far < np.inf:
            raise InputError(f"camera far: found {self.far}, expected a number above near")
        self.__dict__.update(K=K, c2w=c2w, width=int(self.width), height=int(self.height))

    def relative_to(self, origin: np.ndarray, unit: float = 1.0) -> Camera:
        """Return the camera in a world whose origin float64 [3] and unit are given in this one."""
        if not origin.any() and unit == 1:
            return self
        center = (self.center - origin) / unit
        # Far off, float64 rounds the decimals of a file, and a sweep amplifies its last digit.
        noise = np.spacing(np.abs([self.center, origin]).max() / unit)
        decimal = np.round(center, int(np.floor(-np.log10(noise))) - 1)
        c2w = self.c2w.copy()
        c2w[:3, 3] = decimal if np.abs(decimal - center).max() <= noise else center
        near, far = (None if bound is None else bound / unit for bound in (self.near, self.far))
        return replace(self, c2w=c2w, near=near, far=far)

    def with_range(self, near: float | None, far: float | None) -> Camera:
        """Return the camera with another depth range along z, scene units; None keeps a bound."""
        near, far = self.near if near is None else near, self.far if far is None else far
        return replace(self, near=near, far=far)

    @property
    def w2c(self) -> np.ndarray:
        """World-to-camera, float64 [4, 4]."""
        R = self.c2w[:3, :3].T
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = R, -R @ self.c2w[:3, 3]
        return out

    @property
    def center(self) -> np.ndarray:
        """Position of the camera in the world, float64 [3]."""
        return self.c2w[:3, 3]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points [..., 3] to pixels [..., 2] and depths along z [...], float64.

        Points at or behind the camera get depth <= 0 and meaningless pixels.
        """
        local = points @ self.w2c[:3, :3].T + self.w2c[:3, 3]
        z = local[..., 2]
        safe = np.where(np.abs(z) > 1e-12, z, 1e-12)
        pixels = local @ self.K.T
        return pixels[..., :2] / safe[..., None], z

    def shows(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return which projected points are in the image and in front of the camera, bool [...].

        ``pixels`` [..., 2] and ``depth`` [...] are results of :meth:`project`.
        """
        u, v = pixels[..., 0], pixels[..., 1]
        return (depth > 0) & (u >= 0) & (v >= 0) & (u < self.width) & (v < self.height)

    def rays(self) -> np.ndarray:
        """Compute the world-space ray through every pixel centre, z = 1: float64 [H, W, 3]."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        local = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(self.K).T
        return local @ self.c2w[:3, :3].T

    def unproject(self, depth: np.ndarray) -> np.ndarray:
        """Unproject a z-depth map [H, W] in scene units to world points float64 [H, W, 3]."""
        return self.center + self.rays() * np.asarray(depth, np.float64)[..., None]

    def resize(self, width: int, height: int) -> Camera:
        """Return the camera with its image stretched to ``width`` x ``height``."""
        K = np.diag([width / self.width, height / self.height, 1.0]) @ self.K
        return replace(self, K=K, width=width, height=height)

    def crop(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the camera with its image cropped to a window."""
        K = self.K.copy()
        K[0, 2] -= left
        K[1, 2] -= top
        return replace(self, K=K, width=width, height=height)


@dataclass(frozen=True, eq=False)
class View:
    """One photograph with its camera and, where the data has them, its truths.

    Attributes:
        name: Unique within the scene, usually the file path relative to the scene folder.
        image: uint8 [H, W, 3]. RGB, undistorted.
        depth: float32 [H, W] or None. True z-depth in scene units, 0 where unknown. For evaluation
            only: no method may read it.
        instances: int32 [H, W] or None. True object ids, 0 where none. For evaluation only.
        opaque: bool [H, W] or None. False where the photograph is transparent: nothing is there,
            and the truths are unknown. None where all is opaque.
        window: Part of the photograph that is shown, where it was resized or cropped; None for all
            of it.
        namesakes: Other photographs of the scene with the same file name, see
            :func:`slgaussian.checks.companion`.
    """

    name: str
    camera: Camera
    image: np.ndarray
    depth: np.ndarray | None = None
    instances: np.ndarray | None = None
    opaque: np.ndarray | None = None
    window: Window | None = None
    namesakes: tuple[str, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        if self.image.dtype != np.uint8 or self.image.shape != (*size, 3):
            raise InputError(
                f"view {self.name!r}: image is {self.image.dtype} {self.image.shape}, its camera "
                f"expects uint8 {(*size, 3)}; check w and h in the camera file"
            )
        for name in ("depth", "instances", "opaque"):
            truth = getattr(self, name)
            if truth is not None and truth.shape != size:
                raise InputError(f"view {self.name!r}: {name} is {truth.shape}, expected {size}")
            if truth is not None and self.opaque is not None and name != "opaque":
                object.__setattr__(self, name, np.where(self.opaque, truth, truth.dtype.type(0)))

    @property
    def visible_window(self) -> Window:
        """Window of the photograph that the view shows."""
        return self.window or Window.whole(self.camera.width, self.camera.height)

    def among(self, names: Sequence[str]) -> View:
        """Return the view with its namesakes among the names of its scene's photographs."""
        shared = dict.fromkeys((*self.namesakes, *namesakes(self.name, names)))
        return self if len(shared) == len(self.namesakes) else replace(self, namesakes=(*shared,))

    @cached_property
    def grey(self) -> np.ndarray:
        """The photograph in greyscale, uint8 [H, W]."""
        return cv2.cvtColor(self.image, cv2.COLOR_RGB2GRAY)

    @cached_property
    def lab(self) -> np.ndarray:
        """CIELAB float32 [H, W, 3]: L in 0 to 100, a and b about -100 to 100."""
        return cv2.cvtColor(self.image.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)

    @cached_property
    def thumbnail(self) -> Thumbnail:
        """The photograph in small, by which copies are recognised."""
        return Thumbnail.of(self.image)

    def resize(self, height: int, width: int) -> View:
        """Scale to cover ``height`` x ``width``, then crop the centre, ground truth included.

        See :mod:`slgaussian.formats.resampling`.
        """
        camera = self.camera
        if (camera.height, camera.width) == (height, width):
            return self
        fit = Fit.cover(camera.width, camera.height, width, height)
        part, size = Window.whole(camera.width, camera.height).crop(fit), (height, width)
        full = camera.resize(fit.full_width, fit.full_height)
        return replace(
            self,
            camera=full.crop(fit.left, fit.top, width, height),
            image=fit.photograph(self.image),
            depth=None if self.depth is None else part.depth(self.depth, *size),
            instances=None if self.instances is None else part.ids(self.instances, *size),
            opaque=None if self.opaque is None else part.mask(self.opaque, *size),
            window=self.visible_window.crop(fit),
        )


def opaque_pixels(views: Sequence[View]) -> np.ndarray | None:
    """Return the opaque pixels of views of one size, bool [V, H, W]; None if all are."""
    masks = [view.opaque for view in views]
    if all(mask is None for mask in masks):
        return None
    full = np.ones(views[0].image.shape[:2], bool)
    return np.stack([full if mask is None else mask for mask in masks])


@dataclass(frozen=True, eq=False)
class Sample:
    """Context views, the input of a predictor, and target views for evaluation.

    Attributes:
        scene: Scene id for tables and messages; it does not affect results.
        context: tuple of View. Two or more photographs of the same size.
        targets: tuple of View. Held-out views, possibly none.
        phrases: mapping int -> str. Name of each ground-truth instance id, if known.
        estimation: Estimation of the cameras, from
            :meth:`slgaussian.cameras.estimated.EstimatedCameras.as_json`; empty if they were given.
        matches: Matches of the context views, if they are known.
        rendered: Where the views of a splat were rendered, if they are no photographs: "at the
            given cameras". Empty for photographs.

    Raises:
        InputError: If context views differ in size, are one picture with two poses, or all share
            one position (no baseline).
    """

    scene: str
    context: tuple[View, ...]
    targets: tuple[View, ...] = ()
    phrases: Mapping[int, str] = field(default_factory=dict)
    estimation: Mapping[str, Any] = field(default_factory=dict)
    matches: MatchGraph | None = field(default=None, repr=False)
    rendered: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if len(self.context) < 2:
            raise InputError(
                f"scene {self.scene!r}: found {len(self.context)} context view(s), expected at "
                "least two; add a photograph of the same things from some way apart"
            )
        names = [view.name for view in (*self.context, *self.targets)]
        for group in ("context", "targets"):
            self.__dict__[group] = tuple(v.among(names) for v in getattr(self, group))
        first = self.context[0]
        (h0, w0), name = first.image.shape[:2], f"scene {self.scene!r}: {first.name!r}"
        for view in self.context:
            h1, w1 = view.image.shape[:2]
            if (h1, w1) != (h0, w0):
                smallest = min(h0, h1), min(w0, w1)
                raise InputError(
                    f"{name} is {w0}x{h0} and {view.name!r} is {w1}x{h1}; context views must have "
                    "one size; give one to bring them to, height first: "
                    f"--size {smallest[0]}x{smallest[1]}, or size={smallest} in Python"
                )
        _check_views(self.scene, self.context)
        if self.matches is not None and len(self.matches.keypoints) != len(self.context):
            self.__dict__["matches"] = None  # they are of other views

    @cached_property
    def content(self) -> str:
        """SHA-256, hexadecimal, of the images of the context views in order, without names.

        It seeds random draws (:mod:`slgaussian.kernels.seeding`). Cameras are excluded, because the
        last digits of estimated ones depend on the CPU.
        """
        return hash_arrays(*(view.image for view in self.context))

    def resize(self, height: int, width: int) -> Sample:
        """Scale and centre-crop all views to one size."""
        return replace(
            self,
            context=tuple(view.resize(height, width) for view in self.context),
            targets=tuple(view.resize(height, width) for view in self.targets),
            matches=None,
        )

    def check_held_out(self) -> None:
        """Raise InputError if a target is a context view, or a copy of one by its content."""
        for target, view in product(self.targets, self.context):
            same = "is" if target.name == view.name else "is the same picture as"
            if target.name == view.name or are_copies(target.thumbnail, view.thumbnail):
                raise InputError(
                    f"scene {self.scene!r}: the target {target.name!r} {same} the context view "
                    f"{view.name!r}; a target must be held out"
                )

    def localize(self) -> tuple[Sample, Frame]:
        """Return the sample in the coordinates in which Gaussians are predicted, and their frame.

        They are those of the world unless its origin is far away or its unit unusual, so that the
        result of float32 arithmetic depends on neither.
        """
        centers = np.array([view.camera.center for view in self.context])
        baseline = float(np.linalg.norm(centers - centers[0], axis=1).max())
        frame = Frame(local_origin(centers), thousand_power(baseline))
        views = [
            tuple(replace(view, camera=view.camera.relative_to(*frame)) for view in views)
            for views in (self.context, self.targets)
        ]
        usual = not frame.origin.any() and frame.unit == 1
        return (self if usual else replace(self, context=views[0], targets=views[1])), frame


@dataclass(frozen=True, eq=False)
class Scene:
    """A set of posed photographs, which are read on demand.

    Attributes:
        cameras: mapping str -> Camera. Camera of every view by view name, in the order of the data
            set, natural order if that is the order of letters.
        read: callable str -> View. Reads and undistorts one view.
        phrases: mapping int -> str. Name of each ground-truth instance id, if known.
        estimation: See :class:`Sample`.
        sources: callable str -> sequence of Path. Returns the files of a view and its camera, by
            view name; some may not exist.
        matches: Matches of the photographs in the order of ``cameras``, pixels of the whole
            photographs, if they are known.
    """

    name: str
    cameras: Mapping[str, Camera]
    read: Callable[[str], View]
    phrases: Mapping[int, str] = field(default_factory=dict)
    estimation: Mapping[str, Any] = field(default_factory=dict)
    sources: Callable[[str], Sequence[Path]] = lambda name: ()
    matches: MatchGraph | None = field(default=None, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_names(self.name, self.cameras)
        given, order = list(self.cameras), order_naturally(self.cameras)
        ordered = {name: self.cameras[name] for name in order}
        self.__dict__["cameras"] = ordered
        check_cameras(ordered, lambda name: next(iter(self.sources(name)), f"scene {self.name!r}"))
        if self.matches is not None and order != given:
            self.__dict__["matches"] = self.matches.select([given.index(name) for name in order])
        for name, camera in ordered.items():
            fx, fy = camera.K[[0, 1], [0, 1]]
            if max(fx, fy) > MAX_STRETCH * min(fx, fy):
                warnings.warn(
                    f"scene {self.name!r}: the focal lengths of {name!r} are {fx:.4g} across and "
                    f"{fy:.4g} pixels down, expected equal ones, unless it is stretched",
                    stacklevel=3,
                )
                break

    @property
    def left_out(self) -> Mapping[str, str]:
        """Photographs without an estimated camera, with the reason."""
        reasons = self.estimation.get("left_out")
        return reasons if isinstance(reasons, dict) else {}

    def with_cameras(self, names: Sequence[str]) -> list[str]:
        """Return the names (as for :meth:`find`) without those of :attr:`left_out`."""
        return [
            name
            for name in names
            if name in self.cameras or not any(_answers_to(full, name) for full in self.left_out)
        ]

    def find(self, name: str) -> str:
        """Return the full view name for ``name``, which may omit folders and the extension.

        Raises:
            InputError: If no view, or more than one, matches.
        """
        if name in self.cameras:
            return name
        hits = [full for full in self.cameras if _answers_to(full, name)]
        if len(hits) == 1:
            return hits[0]
        if hits:
            raise InputError(
                f"scene {self.name!r}: view {name!r} is ambiguous: it may be "
                f"{', '.join(hits[:4])}; say more of its path"
            )
        for full, reason in self.left_out.items():
            if _answers_to(full, name):
                raise InputError(
                    f"scene {self.name!r}: {name!r} was left out when cameras were found "
                    f"({reason}); choose another view, or add photographs between it and the others"
                )
        examples = ", ".join(list(self.cameras)[:4])
        raise InputError(
            f"scene {self.name!r}: no view {name!r} among the {len(self.cameras)} that have a "
            f"camera, such as {examples}; choose one of them, or add its camera"
        )

    def sample(
        self,
        context: Sequence[str],
        targets: Sequence[str] = (),
        size: Size = "auto",
        near: float | None = None,
        far: float | None = None,
        judged: Size | None = None,
    ) -> Sample:
        """Read the named views, the context first, and resize them.

        Args:
            context, targets: sequence of str. View names, as for :meth:`find`.
            size: (height, width), "at most 312x432", "auto" or "original". A pair scales and
                centre-crops. "at most" shrinks larger views to that number of pixels; "auto" is at
                most :data:`PAPER_PIXELS`, since one Gaussian per pixel at full resolution would be
                millions. Both keep the aspect ratio; if views differ in size, all are
                centre-cropped to the smallest height and the smallest width.
            near, far: Depth range along z in scene units, for all views. By default that of each
                camera; if it has none, the predictor estimates it.
            judged: as ``size``, optional. Size of the targets, by default ``size``: fields of small
                photographs can be evaluated at the resolution of other methods.

        Raises:
            InputError: If a view cannot be found or read, occurs twice in the context, or the views
                are not a valid sample.
        """
        names = [self.find(name) for name in (*context, *targets)]
        for i, name in enumerate(names[: len(context)]):
            if name in names[:i]:
                raise InputError(
                    f"scene {self.name!r}: the context names {name!r} twice; depth needs "
                    "photographs taken from different positions"
                )
        sizes = [size] * len(context) + [judged or size] * len(targets)
        views = [
            replace(view, camera=view.camera.with_range(near, far))
            for view in self._read_views(names, sizes)
        ]
        n, graph = len(context), None
        if self.matches is not None:
            stored = list(self.cameras)
            graph = self.matches.select([stored.index(name) for name in names[:n]]).crop(views[:n])
            if not graph.connects_all:  # by photographs that are no context
                graph = None
        origin = self.phrases, self.estimation, graph
        return Sample(self.name, tuple(views[:n]), tuple(views[n:]), *origin)

    def views(self, names: Sequence[str], size: Size = "auto") -> list[View]:
        """Read the named views and resize them, as :meth:`sample` does.

        InputError if a view cannot be found or read.
        """
        names = [self.find(name) for name in names]
        return list(self._read_views(names, [size] * len(names)))

    def _read_views(self, names: Sequence[str], sizes: Sequence[Size]) -> Iterator[View]:
        """Read views one at a time, as photographs are large, and resize them."""
        photographs = (*self.cameras, *self.left_out)
        cameras = [self.cameras[name] for name in names]
        smallest = min(c.height for c in cameras), min(c.width for c in cameras)
        if isinstance(sizes[0], str) and sizes[0] != "original":
            self._report_smallest(names, *fit_size(*smallest, sizes[0]), sizes[0])
        for name, size in zip(names, sizes, strict=True):
            view = self.read(name).among(photographs)
            yield view if size == "original" else view.resize(*fit_size(*smallest, size))

    def _report_smallest(self, names: Sequence[str], height: int, width: int, size: Size) -> None:
        """Warn if one photograph leaves less than :data:`MIN_SHARE` of the others to be used."""
        sides = np.array([(self.cameras[name].height, self.cameras[name].width) for name in names])
        covered = (np.max((height, width) / sides, 1) ** 2) * sides.prod(1)
        alone = [math.prod(fit_size(h, w, size)) for h, w in sides.tolist()]
        shares = np.sort(height * width / np.maximum(covered, alone))
        if (share := shares[(len(names) - 1) // 2]) < MIN_SHARE:
            least = int(np.argmin(np.min(sides / np.median(sides, 0), 1)))
            h, w = sides[least]
            warnings.warn(
                f"scene {self.name!r}: {names[least]!r} has {w}x{h} pixels, and as all are brought "
                f"to the smallest height and width, {share:.0%} of the pixels of others are used; "
                "leave it out",
                stacklevel=4,
            )


class Frame(NamedTuple):
    """Local coordinates: their origin float64 [3] and their unit, in those of the world."""

    origin: np.ndarray
    unit: float


def thousand_power(length: float) -> float:
    """Return the power of 1000 nearest to a length: 1 from 0.032 to 31 scene units."""
    return 1000.0 ** round(math.log(length, 1000))


def local_origin(positions: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """Choose the point to which positions [N, 3] in the world are relative where they are float32.

    Returns:
        float64 [3]: Zero, or for positions beyond :data:`MAX_DISTANCE_RATIO`, such as UTM or
            Earth-centred coordinates, a point near their mean with few decimal digits.
    """
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    if not len(positions):
        return np.zeros(3)
    middle = positions.mean(0)
    distance = float(np.linalg.norm(middle))
    # Twice the radius is the baseline of a pair. Positions may all be the same.
    spread = max(2 * float(np.linalg.norm(positions - middle, axis=1).max()), 1e-9 * distance)
    if not distance > MAX_DISTANCE_RATIO * spread:
        return np.zeros(3)
    # A round number, and so far off that the offset of a survey is taken out whole.
    origin: np.ndarray = np.round(middle, -int(np.floor(np.log10(MAX_DISTANCE_RATIO * spread))))
    return origin


def _check_views(scene: str, views: Sequence[View]) -> None:
    """Raise InputError if all views share a position, or two are one picture with two poses."""
    has_baseline = False
    centers = np.stack([view.camera.center for view in views])
    extent = np.linalg.norm(centers[:, None] - centers, axis=-1).max()
    for a, b in combinations(views, 2):
        baseline = float(np.linalg.norm(a.camera.center - b.camera.center))
        if baseline <= ROUNDING * max(np.abs(view.camera.center).max() for view in (a, b)):
            continue
        has_baseline = True
        cosine = (np.trace(a.camera.c2w[:3, :3].T @ b.camera.c2w[:3, :3]) - 1) / 2
        differ = cosine < np.cos(np.radians(SAME_PLACE_ANGLE))
        differ |= baseline > SAME_PLACE_SHARE * extent
        # Copies of a film that pauses are left out later.
        if (differ or np.array_equal(a.image, b.image)) and are_copies(
            a.thumbnail, b.thumbnail, whole=True
        ):
            raise InputError(
                f"scene {scene!r}: {a.name!r} and {b.name!r} are the same picture, yet their "
                "poses differ; one of the two photographs is the wrong file"
            )
    if not has_baseline:
        raise InputError(
            f"scene {scene!r}: {views[0].name!r} and {views[1].name!r} were taken from the same "
            "position (no baseline), so depth cannot be found; choose two photographs taken some "
            "way apart"
        )


def fit_size(height: int, width: int, size: Size) -> tuple[int, int]:
    """Compute the height and width of resized views, for a size other than "original"."""
    if not isinstance(size, str):
        return size
    bound = re.fullmatch(r"at most ([1-9]\d*)x([1-9]\d*)", size)
    if bound is None and size != "auto":
        raise InputError(
            f"size: found {size!r}, expected (height, width), 'at most 312x432', 'auto' or "
            "'original'"
        )
    pixels = PAPER_PIXELS if bound is None else int(bound[1]) * int(bound[2])
    scale = min(1.0, (pixels / (height * width)) ** 0.5)
    return max(1, round(height * scale)), max(1, round(width * scale))


def _answers_to(full: str, name: str) -> bool:
    name = "/".join(name_parts(name, suffix=True))
    stem = full.rsplit(".", 1)[0]
    return any(candidate == name or candidate.endswith("/" + name) for candidate in (full, stem))
