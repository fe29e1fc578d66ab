"""The words of ``docs/queries.md``: what its tables hold, and how to read them."""

from hard_texts import TEMPERATURES
from tables import Table, count, error, ms

_EXACT = {f"exact_{t:g}": (f"T = {t:g}", error) for t in TEMPERATURES}
_HALF = {f"half_{t:g}": (f"half, T = {t:g}", error) for t in TEMPERATURES}

TABLES = {
    "speed": Table(
        "Speed",
        "A field of 60 objects with features of 512 numbers, seen at 416 x 576; texts are encoded "
        "already. Times in ms, the least of up to 11 rounds, as others used the machine too. A "
        "query gives mask, relevancy image, point and objects. *LangSplat's way* decodes the "
        "rendered code of every pixel to 512 numbers with its network "
        "(3-16-32-64-128-256-256-512, random weights, PyTorch) and scores each pixel against the "
        "text and four canonical phrases, which makes the relevancy image alone; further queries "
        "reuse the decoded image, half a gigabyte. *Processor* is time on all cores together, of "
        "which *times less* tells the ratio.",
        {
            "what": ("what", str),
            "asked": ("asked, ms", str),
            "ours": ("ours", ms),
            "ours_cpu": ("processor", ms),
            "theirs": ("LangSplat's way", ms),
            "theirs_cpu": ("processor", ms),
            "ratio": ("times less", count),
        },
    ),
    "errors": Table(
        "Errors",
        "Greatest absolute error of a relevancy at temperature T, against the printed formula in "
        "decimal arithmetic of 60 digits; each case is a test too. First of float64 features, "
        "then of features rounded to half precision, as a bank stores them, against the same "
        "features not rounded.",
        {"case": ("case", str), "about": ("what is hard", str), **_EXACT, **_HALF},
    ),
    "texts": Table(
        "Texts",
        "What the lexicon makes of texts that break encoders.",
        {"text": ("text", str), "answer": ("answer", str)},
    ),
}


def page(rows: dict[str, list[dict]], command: str, machine: str) -> str:
    """Markdown of all ``rows``, by the keys of ``TABLES``."""
    tables = "\n".join(TABLES[key].markdown(found) for key, found in rows.items())
    return f"""# Queries

Made by `{command}` on {machine}.

## How a text is answered

**One number an object.** The memory bank holds a unit vector for each object and context view. The
relevancy of a text is that of section 3.3 of the paper: in each view the text competes with each
canonical phrase in a softmax of two, the least of them counts, and of the views the greatest. It is
computed as a sigmoid of T times the *gap*, the lead in cosine over the best phrase, which neither
overflows nor loses the order of objects at any temperature. 0.5 is "as good as any phrase". Pixels
get the number of the object that they show.

**And groups of objects.** Label maps are one partition, and a word may mean what they cut up: a
sofa and not its cushions. So the objects of all views are merged on into groups, at two levels that
differ in what they merge (`slgaussian/masks/levels.py`), and the bank holds a vector of each group
and view too. A text is then scored on an object and on the groups that hold it, in each view, and
in place of the greatest of these gaps counts their mean, each weighed by e to the gap / 0.05: a
soft greatest, by which one look that fits by chance is worth less than several that agree. Ids,
codes and masks remain those of objects. A bank without groups, as of true names, answers by the
formula above alone.

- `temperature` 10 is LERF's and LangSplat's code, 1 the formula as printed.
- `canonical`: "object", "things", "stuff", "texture" (`lerf`), or any phrases of your own.
- `absent`: what a view says about an object that it does not hold. `skip`, nothing. `zero` is the
  paper's zero vector, gap 0: no object with an absent view is then below 0.5. No zero vector is
  stored for it; the bank says which views hold what.
- Vectors of zero length or with NaN are refused, as are those whose length is off by more than
  1e-3; nearer ones are made unit vectors in float64, so half precision does not bias cosines.
- Ties are decided by the lowest id, and between texts by the first. Equal objects score equal to
  the last bit, wherever they stand in the bank.

**Which objects are taken.** Absolute: with `threshold`, all above it, as the paper does. Relative:
without it, all whose gap is above 0 and at least `share` (0.7) of the best one's. That is the
automatic rule too: several like objects are all taken, the pieces of a wall as well, none if no
object fits better than the phrases, and the temperature plays no part. Rules that let large regions
grow over look-alikes (by size, by likeness of features, by contact, by the largest drop in score)
were tried on 434 queries of 16 procedural rooms and 57 of real offices; the best of
them gained no more than their standard errors over scenes on one of the two. Nor did taking the
whole group of the best object, or a group wherever it fits better than its parts.

**Where it is.** Of the objects whose gap reaches 0.9 of the best one's, the one that the image
shows most of: slivers fit by chance more easily. The point is the pixel of its largest connected
part that lies farthest from its edge, the first in reading order of several: one pixel, the same on
any machine.

**Protocol `langsplat`.** For numbers that compare with LangSplat's: the relevancy image is
smoothed by a 30 x 30 mean, averaged with itself unsmoothed, stretched to [-1, 1] and cut at 0.4,
which is 0.7 of its range, and each pixel takes the majority of 7 x 7. Pixels without an object
count as the least relevant object in view. The point is the pixel of the smoothed image's maximum
nearest the middle of all pixels that reach it. LangSplat counts a hit if *any* of those lies in a
box of the truth, which for one number an object is lenient; `samples.parquet` has that as
`hit_peak` beside `hit_box`.

```python
hit = view.query("red basket", threshold=0.6)  # mask, relevancy, point, score, objects
hits = view.query_all(["red basket", "floor"])  # each text's, at once
hits = field.query(["red basket"], [camera_a, camera_b], protocol="langsplat")
for it in field.describe(["wall", "floor", "red basket"]):
    print(it.id, it.text, it.relevancy, it.views)  # what is in this scene
bank = slgaussian.language.bank.merge(bank, later)  # more views of the same objects
```

{tables}"""
