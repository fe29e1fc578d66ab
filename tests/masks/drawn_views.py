"""Small textured pictures with known objects, drawn by the tests themselves."""

import numpy as np
from scipy import ndimage

from slgaussian.geometry import SeenView
from slgaussian.scene import Camera, View

SIZE = (120, 160)


def texture(seed, size=SIZE, contrast=18.0):
    """Smooth noise, float [H, W], that matching can hold on to."""
    noise = np.random.default_rng(seed).standard_normal(size)
    smooth = ndimage.gaussian_filter(noise, 1.5)
    return contrast * smooth / smooth.std()


def canvas(colour=(120, 120, 120), seed=0, contrast=18.0):
    """A background of one textured colour, float [H, W, 3]."""
    return np.asarray(colour, float) + texture(seed, contrast=contrast)[..., None]


def paste(picture, box, colour, seed=None):
    """Draw a (textured, where a seed is given) rectangle (top, bottom, left, right), clipped."""
    top, bottom, left, right = box
    patch = np.broadcast_to(np.asarray(colour, float), (bottom - top, right - left, 3))
    if seed is not None:
        patch = patch + texture(seed, (bottom - top, right - left))[..., None]
    y0, y1 = max(top, 0), min(bottom, picture.shape[0])
    x0, x1 = max(left, 0), min(right, picture.shape[1])
    if y0 < y1 and x0 < x1:
        picture[y0:y1, x0:x1] = patch[y0 - top : y1 - top, x0 - left : x1 - left]


def view(picture, name="a"):
    """A picture as a view; masks read nothing of its camera but the size."""
    height, width = picture.shape[:2]
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return SeenView(View(name, Camera(K, np.eye(4), width, height), image))


def flat(picture, name="a"):
    """A picture as a view of a plane at depth 1."""
    observed = view(picture, name)
    return SeenView(observed.view, np.ones(picture.shape[:2], np.float32))


def with_depths(views, depths):
    """Views as they are seen, each with its depth."""
    return [SeenView(view, depth) for view, depth in zip(views, depths, strict=True)]


def main_label(labels, box):
    """The label that most pixels of a box carry."""
    top, bottom, left, right = box
    return int(np.bincount(labels[max(top, 0) : bottom, max(left, 0) : right].ravel()).argmax())
