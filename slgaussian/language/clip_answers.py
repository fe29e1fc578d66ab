"""Questions to which any real CLIP knows the answers, so that random or damaged weights are found.

They need no network and no other model: drawn colours and digits, photographs that come with
scikit-image, and words that are like each other. How many answers are expected lies far above what
chance gives. That of the words was tried on the text vectors of a real ViT-B/32
(``tests/language/test_clip_answers.py``); those of the pictures were set from what is published of
CLIP's zero-shot accuracy, without a real CLIP at hand.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from slgaussian.language.clip import Clip
from slgaussian.language.named import Named
from slgaussian.parts.finding import Finding, Findings

SIDE = 224
"""Of the pictures, in pixels."""

COLOURS = {
    "red": (220, 30, 30),
    "orange": (255, 140, 0),
    "yellow": (250, 230, 30),
    "green": (30, 150, 50),
    "blue": (30, 60, 210),
    "purple": (130, 40, 160),
    "black": (10, 10, 10),
    "white": (250, 250, 250),
}
"""sRGB of the squares that are drawn on grey."""

PHOTOGRAPHS = {
    "astronaut": "an astronaut",
    "chelsea": "a cat",
    "coffee": "a cup of coffee",
    "rocket": "a rocket",
    "brick": "a brick wall",
    "grass": "grass",
    "coins": "coins",
    "page": "a page of text",
}
"""What is to be seen, by the function of ``skimage.data``; all come with its installation."""

LIKE = (
    ("sofa", "armchair", "spoon"),
    ("kitten", "cat", "kettle"),
    ("puppy", "dog", "pepper"),
    ("banana", "orange", "bandanna"),
    ("apple", "pear", "apron"),
    ("horse", "pony", "hose"),
    ("cow", "bull", "crown"),
    ("fork", "knife", "frog"),
    ("bottle", "wine bottle", "button"),
    ("airplane", "helicopter", "apron"),
    ("chair", "stool", "chalice"),
    ("bear", "polar bear", "beer bottle"),
    ("elephant", "giraffe", "elevator car"),
    ("pizza", "sandwich", "pinecone"),
    ("scissors", "knife", "sculpture"),
    ("pen", "pencil", "penguin"),
    ("bicycle", "motorcycle", "binder"),
    ("lion", "tiger", "lime"),
    ("duck", "goose", "duct tape"),
    ("bird", "parrot", "birdcage"),
)
"""A word, one that means something like it, and one that is spelled like it but means another
thing: weights that have learnt nothing go by the letters."""

EXPECTED = {"colours": 6, "digits": 6, "photographs": 6, "words": 17}
"""Right answers that any real CLIP gives, of 8, 10, 8 and 20. By chance it is 1, 1, 1 and 10, and
as many as this with a probability of 0.0001 for pictures, and 0.001 for words."""

SAME = 1e-5
"""Most that a vector may differ by what else is encoded with it."""

OTHER_BATCH = 1e-3
"""Most that it may differ where other numbers of pictures are encoded together."""

REDUCED = 0.01
"""Most that the cosine to the float32 vector may fall short of 1 in a lower precision."""

IDENTICAL = 0.99
"""Median cosine of text vectors to those of a table from which on both are of one model."""

NAMES = 100
"""Names of a table that are compared."""

REGIONS = 60
"""Regions of an image, for the time that an image takes."""

DOUBT = "are these random or damaged?"


def findings(clip: Clip, table: Path | None = None) -> Findings:
    """Ask a CLIP what it must know, one finding a question and one about its cost.

    Parameters
    ----------
    clip : Clip
    table : path, optional
        ``.npz`` of names and their text vectors, as the encoder ``named`` takes it: whether they
        are this model's.

    Raises
    ------
    InputError
        If the model or the table cannot be used at all.
    """
    squares = [square(rgb) for rgb in COLOURS.values()]
    yield from _numbers(clip, squares)
    if clip.network.device.type != "cpu" or clip.precision != "float32":
        yield _reduced(clip, squares)
    yield _words(clip.encode_text)
    yield _quiz(
        clip, "colours", squares, [f"a {name} square" for name in COLOURS], "tell colours apart"
    )
    digits = [drawn_digit(k) for k in range(10)]
    texts = [f'a photo of the number: "{k}".' for k in range(10)]
    yield _quiz(clip, "digits", digits, texts, "read drawn digits")
    try:
        shown = [photograph(name) for name in PHOTOGRAPHS]
    except (ImportError, OSError, ValueError, AttributeError) as problem:
        said = f"photographs: left out, as scikit-image does not give them here ({problem})"
        yield Finding("clip", said, None)
    else:
        texts = [f"a photo of {what}" for what in PHOTOGRAPHS.values()]
        yield _quiz(clip, "photographs", shown, texts, "know what photographs show")
    if table is not None:
        yield _table(clip, table)
    yield _cost(clip, squares)


def square(rgb: tuple[int, int, int]) -> np.ndarray:
    """A picture uint8 [SIDE, SIDE, 3]: a square of one sRGB colour on grey."""
    picture = np.full((SIDE, SIDE, 3), 128, np.uint8)
    picture[SIDE // 5 : -SIDE // 5, SIDE // 5 : -SIDE // 5] = rgb
    return picture


def drawn_digit(digit: int) -> np.ndarray:
    """A picture uint8 [SIDE, SIDE, 3]: a digit in black on white."""
    picture = Image.new("RGB", (SIDE, SIDE), "white")
    font, middle = ImageFont.load_default(0.7 * SIDE), (SIDE / 2, SIDE / 2)
    ImageDraw.Draw(picture).text(middle, str(digit), "black", font, anchor="mm")
    return np.array(picture)


def photograph(name: str) -> np.ndarray:
    """The middle square of one of :data:`PHOTOGRAPHS`, uint8 [SIDE, SIDE, 3]."""
    from skimage import data

    image = np.asarray(getattr(data, name)())
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, 2)
    height, width = image.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = np.ascontiguousarray(image[top : top + side, left : left + side, :3])
    return cv2.resize(middle, (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def right_words(encode_text: Callable[[Sequence[str]], np.ndarray]) -> int:
    """Of how many of :data:`LIKE` the word lies nearer to the one like it than to the other."""
    texts = [f"a {word}" for words in LIKE for word in words]
    vectors = encode_text(texts).reshape(len(LIKE), 3, -1)
    like = np.einsum("tc,tc->t", vectors[:, 0], vectors[:, 1])
    unlike = np.einsum("tc,tc->t", vectors[:, 0], vectors[:, 2])
    return int((like > unlike).sum())


def _numbers(clip: Clip, pictures: Sequence[np.ndarray]) -> Iterator[Finding]:
    """Vectors are unit vectors, and do not depend on what else is encoded."""
    texts = ["a cat", "object", "a red basket"]
    together, words = encode_pictures(clip, pictures), clip.encode_text(texts)
    for what, vectors in (("pictures", together), ("texts", words)):
        lengths = np.linalg.norm(vectors.astype(np.float64), axis=1)
        if not (np.abs(lengths - 1) < 1e-3).all():
            said = f"vectors of {what}: lengths are {lengths.min():.3g} to {lengths.max():.3g}"
            yield Finding("clip", f"{said}, expected 1; {DOUBT}", False)
            return
    alone = encode_pictures(clip, pictures[3:4])[0]
    said_alone = clip.encode_text(texts[2:])[0]
    apart = max(_greatest(alone, together[3]), _greatest(said_alone, words[2]))
    singly = Clip(clip.model, clip.tokenizer, clip.crops, 1, clip.precision, clip.device)
    other = _greatest(encode_pictures(singly, pictures[3:4])[0], alone)
    reduced = clip.network.device.type != "cpu" or clip.precision != "float32"
    allowed = REDUCED if reduced else OTHER_BATCH
    good = apart <= SAME and other <= allowed
    said = f"vectors: finite, of length 1; alone or with others {apart:.1g} apart"
    said += f", in batches of 1 {other:.1g}"
    if not good:
        said += f", expected at most {SAME:.0e} and {allowed:.0e}; the device computes wrongly"
    yield Finding("clip", said, good)


def _greatest(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one.astype(np.float64) - other).max())


def _reduced(clip: Clip, pictures: Sequence[np.ndarray]) -> Finding:
    """What the lower precision of the device costs."""
    exact = Clip(clip.model, clip.tokenizer, clip.crops, clip.batch, "float32", "cpu")
    pairs = encode_pictures(clip, pictures), encode_pictures(exact, pictures)
    lost = float(1 - np.einsum("pc,pc->p", *pairs).min())
    said = f"precision: bfloat16 turns vectors by a cosine of up to {lost:.1g} from float32"
    wrong = f", expected at most {REDUCED}; use float32"
    return Finding("clip", said + ("" if lost <= REDUCED else wrong), lost <= REDUCED)


def _words(encode_text: Callable[[Sequence[str]], np.ndarray]) -> Finding:
    right = right_words(encode_text)
    what = "words are nearer to one of like meaning than to one of like spelling"
    return _judged("words", right, len(LIKE), what, "know what words mean")


def _quiz(
    clip: Clip, name: str, pictures: Sequence[np.ndarray], texts: Sequence[str], skill: str
) -> Finding:
    """Is the text nearest to each picture its own?"""
    cosines = encode_pictures(clip, pictures) @ clip.encode_text(texts).T
    right = int((cosines.argmax(1) == np.arange(len(texts))).sum())
    return _judged(name, right, len(texts), "have the nearest text right", skill)


def _judged(name: str, right: int, of: int, what: str, skill: str) -> Finding:
    good = right >= EXPECTED[name]
    said = f"{name}: {right} of {of} {what}, expected {EXPECTED[name]}"
    return Finding("clip", said + ("" if good else f"; its weights do not {skill}: {DOUBT}"), good)


def _table(clip: Clip, table: Path) -> Finding:
    """Whether the vectors of a table are this model's; another model's say nothing against it."""
    known = Named(table)
    with np.load(table, allow_pickle=False) as content:
        every = [str(name) for name in content["names"]]
    names = every[:: max(1, len(every) // NAMES)][:NAMES]
    vectors = known.encode_text(names)
    said = f"table {table}: "
    own = clip.encode_text([name.replace("_", " ") for name in names])
    if own.shape[1] != vectors.shape[1]:
        said += f"is of another model, with {vectors.shape[1]} axes and not {own.shape[1]}"
        return Finding("clip", said, None)
    with_article = clip.encode_text([f"a {name.replace('_', ' ')}" for name in names])
    alike = max(
        float(np.median(np.einsum("nc,nc->n", vectors, mine))) for mine in (own, with_article)
    )
    said += f"{len(names)} text vectors have a median cosine of {alike:.4f} to it"
    if alike >= IDENTICAL:
        return Finding("clip", f"{said}: both are of one model")
    return Finding("clip", f"{said}, so it is of another model; nothing follows", None)


def _cost(clip: Clip, pictures: Sequence[np.ndarray]) -> Finding:
    """Seconds, after all above has warmed up what there is to warm up."""
    start = time.perf_counter()
    encode_pictures(clip, pictures)
    region = (time.perf_counter() - start) / len(pictures)
    start = time.perf_counter()
    clip.encode_text([f"a {word} box" for word in COLOURS])
    text = (time.perf_counter() - start) / len(COLOURS)
    said = f"cost: {region:.3f} s a region, so {REGIONS * region:.1f} s an image of {REGIONS} "
    return Finding("clip", f"{said}regions, and {text:.3f} s a text", None)


def encode_pictures(clip: Clip, pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Vectors float32 [P, C] of pictures uint8 [SIDE, SIDE, 3]: regions of one tall image."""
    bands = np.arange(len(pictures)).repeat(SIDE)
    masks = np.broadcast_to(
        (bands == np.arange(len(pictures))[:, None])[..., None],
        (len(pictures), len(bands), SIDE),
    )
    return clip.encode_regions(np.concatenate(pictures), np.ascontiguousarray(masks))
