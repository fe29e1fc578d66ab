"""Reading of photographs of any format as RGB uint8."""

from __future__ import annotations

import os
import re
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from slgaussian.checks import SUFFIX, companion, name_parts
from slgaussian.datasets.exif import SIDEWAYS_ORIENTATIONS, read_orientation
from slgaussian.datasets.exif import upright as turned_upright
from slgaussian.datasets.lens import Maps, undistort
from slgaussian.errors import InputError
from slgaussian.formats.colour import read_colours
from slgaussian.formats.images import mask_levels, open_image, scale_levels, unreadable
from slgaussian.formats.resampling import Window
from slgaussian.io import file_stamp
from slgaussian.scene import PAPER_PIXELS, Camera, Scene, View

EXTENSIONS = (
    ".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".heic", ".heif", ".webp", ".tif", ".tiff", ".bmp",
    ".dib", ".ppm", ".pgm", ".pnm",
)  # fmt: skip
"""Suffixes of photographs, in lower case."""

IGNORED_FILES = re.compile(
    r"(license|readme|copying).*|(thumbs\.db|desktop\.ini)|.*\.(json|npy|npz|txt|md|bin|db|csv|toml)"
)
"""Files, in lower case, that are passed over without a word, as hidden ones are: those of Windows,
and data and texts that belong to a set of photographs."""

MASK_FOLDER = re.compile(r"masks?(_\d+)?")
MASK_ENDS = ("_mask.png", ".mask.png", ".alpha.png")
DYNAMIC_MASK = "dynamic_mask_"
"""Folders of masks, and ends and the start of names of masks beside photographs, see
:func:`find_masks`."""

MAX_GREY = 0.1
"""Largest fraction of the pixels of a mask that are neither black nor white, as at its edges."""

THUMBNAIL = 4
"""A photograph with this many times fewer pixels than the others is left out of a folder."""

MIN_OPAQUE_ALPHA = 128  # smallest alpha, of 255, of an opaque pixel


def rgb(image: Image.Image, name: str | Path) -> np.ndarray:
    """Return the pixels of an opened image in sRGB, uint8 [H, W, 3], transparent ones over black.

    See :func:`slgaussian.formats.colour.read_colours`; ``name`` is that of the photograph.
    """
    pixels, alpha = read_colours(image, str(name)), read_alpha_channel(image)
    return pixels if alpha is None else composite(pixels, alpha)


def read_alpha_channel(image: Image.Image) -> np.ndarray | None:
    """Return the alpha of an opened image, uint8 [H, W]; None without one.

    Its range is that of a mask, see :func:`slgaussian.formats.images.scale_levels`.
    """
    if "A" not in image.getbands() and "transparency" not in image.info:
        return None
    return scale_levels(np.asarray(image.convert("RGBA"))[..., 3])


def composite(pixels: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Composite uint8 [H, W, 3] with alpha uint8 [H, W] over black, rounded."""
    return ((pixels * alpha[..., None].astype(np.uint16) + 127) // 255).astype(np.uint8)


def open_photograph(
    path: Path, size: tuple[int, int] | None = None, upright: bool = False
) -> tuple[np.ndarray, np.ndarray | None]:
    """Read the pixels of a file, see :func:`rgb`, and the opaque pixels, bool [H, W].

    The second is None if all are opaque; half transparent pixels count as transparent.

    Poses and intrinsics refer to the stored pixels with COLMAP, and to the upright image with other
    tools. ``size``, the camera's width and height, determines which: an EXIF orientation is applied
    only if the rotated photograph has this aspect and the stored one has not; with ``upright``,
    always.

    Raises:
        InputError: If the file is missing or damaged.
    """
    try:
        with open_image(path) as image:
            turn = upright or _needs_turn(image, size)
            image.load()
            oriented = turned_upright(image, read_orientation(image)) if turn else image
            pixels, alpha = read_colours(oriented, str(path)), read_alpha_channel(oriented)
            if alpha is None:
                return pixels, None
            pixels, opaque = composite(pixels, alpha), alpha >= MIN_OPAQUE_ALPHA
    except (OSError, ValueError) as bad:
        raise unreadable(path, bad) from None
    return pixels, None if opaque.all() else opaque


def stored_size(path: Path, size: tuple[int, int] | None = None) -> tuple[int, int] | None:
    """Return width and height of an :func:`open_photograph`; None if it cannot be opened."""
    try:
        with open_image(path) as image:
            return image.size[::-1] if _needs_turn(image, size) else image.size
    except (OSError, ValueError):
        return None


def _needs_turn(image: Image.Image, size: tuple[int, int] | None) -> bool:
    """Tell whether a camera of that size fits only the photograph rotated by its EXIF tag."""
    if size is None or read_orientation(image) not in SIDEWAYS_ORIENTATIONS:
        return False
    return not has_shape(image.size, size) and has_shape(image.size[::-1], size)


def has_shape(stored: tuple[int, int], size: tuple[float, float]) -> bool:
    """Tell whether two sizes (width, height) have one aspect ratio, up to whole pixels."""
    (w, h), (width, height) = stored, size
    return abs(w / width - h / height) <= 1 / width + 1 / height


def is_there(path: Path) -> bool:
    """Tell whether a file exists; invalid names, which camera files may contain, give False."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def name_in(folder: Path, name: str) -> str:
    """Return the name of a photograph below a folder, from a camera file, with slashes.

    Backslashes of Windows and surrounding blanks are part of the name only if such a file exists.
    """
    return name if is_there(folder / name) else name.strip(" \t").replace("\\", "/")


def find_file(path: Path) -> Path | None:
    """Return the photograph at a path whose suffix may be missing or of another format, if any.

    Raises:
        InputError: If it is missing and two photographs differ from it by the suffix only.
    """
    if is_there(path):
        return path
    try:
        names = sorted(os.listdir(path.parent))
    except (OSError, ValueError):
        return None
    stems = (path.name, SUFFIX.sub("", path.name))
    ends = ((name, *os.path.splitext(name)) for name in names)
    fits = [name for name, stem, end in ends if stem in stems and end.lower() in EXTENSIONS]
    if len(fits) > 1:
        raise InputError(f"{path}: may be {fits[0]} or {fits[1]}; remove the wrong one")
    return path.parent / fits[0] if fits else None


def photographs_in(folder: Path) -> list[Path]:
    """List the photographs in a folder, sorted by name; empty if the folder is missing.

    Their masks are left out, and any other file beside them is passed over with a warning.
    """
    if not folder.is_dir():
        return []
    files = [path for path in folder.iterdir() if path.name[0] != "." and path.is_file()]
    pictures = {path for path in files if path.suffix.lower() in EXTENSIONS}
    stems = {part for path in pictures for part in (path.name, path.stem)}
    photographs = sorted(path for path in pictures if not _is_mask(path.name, stems))
    ignored = {path for path in files if IGNORED_FILES.fullmatch(path.name.lower())}
    if photographs and (others := sorted(p.name for p in {*files} - pictures - ignored)):
        warnings.warn(
            f"{folder}: files that are no photographs of a known format are passed over, "
            f"{len(others)}: {', '.join(others[:4])}{', ...' if len(others) > 4 else ''}; save "
            "photographs among them as JPEG",
            stacklevel=1,  # one place for all callers, so that it appears once
        )
    return photographs


def _is_mask(name: str, stems: set[str]) -> bool:
    """Tell whether a file beside photographs with these names and stems is the mask of one."""
    ends = (end for end in MASK_ENDS if name.endswith(end))
    return name.startswith(DYNAMIC_MASK) or any(name.removesuffix(end) in stems for end in ends)


def skip_unreadable(files: Sequence[Path]) -> list[Path]:
    """Return the photographs of a folder that can be read and are no thumbnails of the others.

    Each that is left out is named by a warning.

    Raises:
        InputError: If none can be read.
    """
    pixels: dict[Path, int] = {}
    problems: list[InputError] = []
    for file in files:
        try:
            stamp = file_stamp(file)
            count = _count_pixels if stamp else _count_pixels.__wrapped__
            pixels[file] = count(file, stamp)
        except InputError as bad:
            problems.append(bad)
        except OSError:
            problems.append(InputError(f"{file}: is missing"))
    if problems and not pixels:
        raise problems[0]
    usual = min(float(np.median([*pixels.values(), PAPER_PIXELS])), PAPER_PIXELS)
    small = [file for file in pixels if pixels[file] * THUMBNAIL < usual]
    small = small if len(pixels) - len(small) > 1 else []
    texts = [f"{file}: has {pixels[file]} pixels, far fewer than the others" for file in small]
    for text in (*map(str, problems), *texts):
        warnings.warn(f"{text}; it is left out, name it to use it", stacklevel=2)
    return [file for file in pixels if file not in small]


@lru_cache(maxsize=4096)
def _count_pixels(file: Path, stamp: object) -> int:
    """Decode a photograph, once for each ``stamp``, and return its number of pixels."""
    try:
        with open_image(file) as image:
            count = image.width * image.height
            image.draft("RGB", (1, 1))  # decodes a JPEG all the same, in a third of the time
            rgb(image, file)
    except (OSError, ValueError) as bad:
        raise unreadable(file, bad) from None
    return count


def list_photographs(scene: Path) -> list[Path]:
    """List the photographs in a folder or, if it has none, in its :func:`image_folder`, by name."""
    return photographs_in(scene) or photographs_in(image_folder(scene))


def image_folder(scene: Path, name: str | None = None) -> Path:
    """Return a scene's folder of photographs: ``images``, or the largest of ``images_2`` etc.

    ``name`` overrides this. The folder may be missing; the caller reports it.
    """
    if name is not None:
        return scene / name
    full_size = scene / "images"
    shrunk = [path for path in scene.glob("images_*") if path.name[7:].isdecimal()]
    if full_size.is_dir() or not shrunk:
        return full_size
    return min(shrunk, key=lambda path: int(path.name[7:]))


class Mask(NamedTuple):
    """Mask of a stored photograph.

    Attributes:
        inverted: Whether it is black, not white, where the photograph is valid.
        by_place: Whether its place alone tells that it is a mask, not a file of cameras.
    """

    file: Path
    inverted: bool = False
    by_place: bool = False

    def read_alpha(self, width: int, height: int) -> np.ndarray:
        """Read the mask as an alpha channel uint8 [height, width] of the photograph.

        A mask of another size is resampled. A mask that is black everywhere is named by a warning,
        and by its place one of ids or grey levels is passed over.

        Raises:
            InputError: If the file cannot be read or has another shape than the photograph.
        """
        try:
            levels = mask_levels(self.file, warn=False)
        except InputError as bad:
            if not self.by_place:
                raise
            warnings.warn(f"{bad}; it is passed over", stacklevel=2)
            return np.full((height, width), 255, np.uint8)
        grey = (levels > 25) & (levels < 230)
        if self.by_place and (grey.mean() > MAX_GREY or 0 < levels.max() < 230):
            warnings.warn(
                f"{self.file}: is passed over, as it is not black and white", stacklevel=2
            )
            return np.full((height, width), 255, np.uint8)
        alpha = np.where(levels > 0, 0, 255).astype(np.uint8) if self.inverted else levels
        photograph = Window.whole(width, height)
        photograph.check_shape(self.file, *alpha.shape[::-1])
        if alpha.shape != (height, width):
            opaque = photograph.mask(alpha >= MIN_OPAQUE_ALPHA, height, width)
            alpha = opaque * np.uint8(255)
        if alpha.max() < MIN_OPAQUE_ALPHA:
            warnings.warn(f"{self.file}: masks all of its photograph", stacklevel=2)
        return alpha


def find_masks(photographs: Mapping[str, Path]) -> dict[str, Mask]:
    """Find the masks of photographs by view name, in the layouts of other programs.

    White is valid in ``masks/0001.jpg.png`` (COLMAP) or ``masks/0001.png`` (nerfstudio) of a folder
    ``masks``, ``mask``, ``masks_2`` and so on in or beside the folder of the photographs, and in
    ``0001_mask.png``, ``0001.mask.png`` and ``0001.alpha.png`` beside the photograph. Black is
    valid in ``dynamic_mask_0001.png`` beside it (instant-ngp). A warning counts what is read.

    Raises:
        InputError: If two masks fit a photograph, or two photographs a mask.
    """
    if not photographs:
        return {}
    files = {name: Path(os.path.abspath(file)) for name, file in photographs.items()}
    common = Path(os.path.commonpath([file.parent for file in files.values()]))
    above = [common, *common.parents]
    top = next((folder for folder in above[:3] if folder.name.startswith("images")), common)
    roots = above[: above.index(top) + 2]
    places = [place for root in roots for place in sorted(root.glob("mask*")) if place.is_dir()]
    folders = [f for f in places if MASK_FOLDER.fullmatch(f.name) and f not in above]
    folders = [folder for folder in folders if not (folder / "masks.json").is_file()]  # ids of ours
    scales = [part.removeprefix("images") for part in common.parts if part.startswith("images")]
    folders.sort(key=lambda folder: folder.name.lstrip("mask") not in scales)
    paths = {name: file.relative_to(top).as_posix() for name, file in files.items()}
    namesakes: dict[str, list[str]] = defaultdict(list)
    for path in paths.values():
        namesakes[name_parts(path)[-1]].append(path)
    masks: dict[str, Mask] = {}
    for name, path in paths.items():
        others = namesakes[name_parts(path)[-1]]
        within = (companion(folder, path, EXTENSIONS, others) for folder in folders)
        dynamic = companion(top, path, (".png",), others, DYNAMIC_MASK)
        hits = (companion(top, path, MASK_ENDS, others), dynamic, next(filter(None, within), None))
        fits = [*filter(None, hits)]
        if len(fits) > 1:
            raise InputError(f"{fits[0]}: {fits[1]} masks the same photograph; remove one")
        if fits:
            masks[name] = Mask(fits[0], inverted=fits[0] == dynamic, by_place=True)
    if masks or folders:
        used = {mask.file.parent for mask in masks.values()} or folders
        warnings.warn(
            f"{', '.join(sorted(map(str, used)))}: masks of {len(masks)} of {len(photographs)} "
            "photographs are read, as they are called as these; what is black in them is ignored, "
            f"in {DYNAMIC_MASK}* what is not black; rename them to use all pixels",
            stacklevel=1,  # one place for all callers, so that it appears once
        )
    return masks


def make_scene(
    name: str,
    cameras: Mapping[str, Camera],
    photographs: Mapping[str, Path],
    named_by: str | Path,
    files: Sequence[Path] = (),
    lenses: Mapping[str, Callable[[], Maps]] | None = None,
    upright: bool = False,
    estimation: Mapping[str, Any] | None = None,
) -> Scene:
    """Make a scene of stored photographs, which are opened and undistorted when they are read.

    Args:
        cameras, photographs: Cameras and photographs by view name; a photograph may be missing.
        named_by: File that lists the photographs, for messages.
        files: Files from which the cameras were read.
        lenses: Functions that compute the undistortion maps of views; pinholes are left out.
        upright: Whether the cameras refer to the upright photographs, see :func:`open_photograph`.
        estimation: Record of the estimation of the cameras.
    """
    views = {
        view: partial(open_view, view, camera, photographs[view], named_by, upright)
        for view, camera in cameras.items()
    }
    views |= {view: partial(views[view], lens=lens) for view, lens in (lenses or {}).items()}
    sources = {view: [*files, photograph] for view, photograph in photographs.items()}
    for view, mask in find_masks(photographs).items():
        views[view] = partial(views[view], mask=mask)
        sources[view].append(mask.file)
    read = partial(read_view, views, named_by)
    return Scene(name, cameras, read, estimation=estimation or {}, sources=sources.__getitem__)


def read_view(views: Mapping[str, Callable[[], View]], named_by: str | Path, name: str) -> View:
    """Call the reader of a view by its name; InputError if there is none."""
    if name not in views:
        raise InputError(f"{named_by}: has no view {name!r}")
    return views[name]()


def open_view(
    name: str,
    camera: Camera,
    photograph: Path,
    named_by: str | Path,
    upright: bool = False,
    lens: Callable[[], Maps] | None = None,
    mask: Mask | None = None,
    depth: np.ndarray | None = None,
) -> View:
    """Open a photograph as a view and undistort it; see :func:`make_scene`.

    ``mask`` is a second alpha channel.

    Raises:
        InputError: If a file is missing or damaged, or has another size than the camera.
    """
    if not is_there(photograph):
        raise InputError(
            f"{photograph}: no such photograph, though {named_by} names it; put the file there or "
            "choose another view"
        )
    pixels, opaque = open_photograph(photograph, (camera.width, camera.height), upright)
    height, width = pixels.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{photograph}: is {width}x{height}, but {named_by} says {camera.width}x"
            f"{camera.height}; resize it or scale its camera"
        )
    if mask is not None:
        alpha = mask.read_alpha(width, height)
        visible = (alpha >= MIN_OPAQUE_ALPHA) & (True if opaque is None else opaque)
        pixels, opaque = composite(pixels, alpha), None if visible.all() else visible
    view = View(name, camera, pixels, depth, opaque=opaque)
    return view if lens is None else undistort(view, lens())
