"""The words of ``docs/measured/masks.md``: what its tables hold, and how to read them."""

from benches.common.markdown_tables import Table, count, hundredths, thousandths

CHART = "Objects matched against baseline and overlap; pixels against copies; matched against time"
PAIRS = "Photographs, true ids, ids by geometric, ids by flow; two pairs of views"

_JUDGED = {
    "objects": ("objects", count),
    "matched": ("matched", thousandths),
    "things": ("things", thousandths),
    "alone": ("alone", thousandths),
    "iou": ("IoU", thousandths),
    "pieces": ("pieces", hundredths),
    "pixels": ("pixels", thousandths),
    "track": ("track, CPU s", hundredths),
    "whole": ("whole, CPU s", hundredths),
}
_FIT = {
    "depth": ("depth", str),
    "objects": ("objects", count),
    "one": ("one region", thousandths),
    "three": ("three", thousandths),
    "any": ("any mask", thousandths),
    "regions": ("regions", count),
    "masks": ("masks, at most", count),
    "seconds": ("CPU s", hundredths),
}

TABLES = {
    "trackers": Table(
        "Trackers",
        "All pairs. *True masks* in the place of proposals leave only the tracker to blame; *back* "
        "is the reverse pass.",
        {
            "tracker": ("tracker", str),
            "proposals": ("proposals", str),
            "way": ("way", str),
        }
        | _JUDGED,
    ),
    "baselines": Table(
        "Baseline",
        "The same pairs, regions, five copies, by the distance between the cameras, which stand "
        "about 3.3 m from what they look at.",
        {"tracker": ("tracker", str), "baseline": ("baseline, m", str)} | _JUDGED,
    ),
    "overlaps": Table(
        "Overlap",
        "The same by the share of the first view that the second sees too.",
        {"tracker": ("tracker", str), "overlap": ("overlap", str)} | _JUDGED,
    ),
    "copies": Table(
        "Copies",
        "The first fifth of the pairs, by the number of copies of each view that vote. *noisy* is "
        "`geometric` made to lose a fifth of the image, in tiles of 16 pixels, anew at every look: "
        "it stands for a network whose answers waver.",
        {"tracker": ("tracker", str), "copies": ("copies", count)} | _JUDGED,
    ),
    "labelled_pairs": Table(
        "Photographs: ids in both views",
        "Categories labelled by hand in a view between the two, found in both by the sensor's "
        "depth: walls, carpets and doors as well as things. *matched* as above; *pixels* is the "
        "share of their points that have one and the same id in both views.",
        {key: _JUDGED.get(key, ("tracker", str)) for key in ("tracker", "objects", "matched")}
        | {key: _JUDGED[key] for key in ("pixels", "track", "whole")},
    ),
    "regions": Table(
        "Does one mask fit one object?",
        "Mean IoU of a true object with its best *one region* of the flat map that association "
        "starts from, with the best union of *three*, and with *any mask* of all levels. Without "
        "depth; with ours, predicted from the two photographs; with the sensor's or the true one.",
        {"what": ("images", str)} | _FIT,
    ),
    "categories": Table(
        "Category by category",
        "IoU of the best mask of all levels with each labelled category of the photographs, the "
        "worst first, and of the best region of the flat map (with our depth).",
        {
            "scene": ("scene", str),
            "category": ("category", str),
            "stuff": ("kind", str),
            "none": ("no depth", thousandths),
            "ours": ("our depth", thousandths),
            "sensor": ("sensor", thousandths),
            "one": ("one region", thousandths),
        },
    ),
    "nms": Table(
        "Suppression of overlapping masks",
        "The sieve of `sam` and `sam2`, in fresh processes: the least of three calls, and memory "
        "beyond that of the masks. *blobs* are like what SAM proposes, 300 of 720 x 960 unless it "
        "says otherwise; *noise*, of independent pixels, is the worst case; *plain product* is the "
        "product of all pixels in float32, which gives the same intersections.",
        {
            "masks": ("masks", str),
            "call": ("call", str),
            "wall": ("s", hundredths),
            "cpu": ("CPU s", hundredths),
            "extra": ("MiB", count),
        },
    ),
}


def page(rows: dict[str, list[dict]], pairs: int, command: str, machine: str) -> str:
    """Markdown of all ``rows``, by the keys of ``TABLES``."""
    tables = "\n".join(TABLES[key].markdown(rows[key]) for key in TABLES if key in rows)
    return f"""# Masks that agree across views, measured

Made by `{command}` on {machine}.

{pairs} pairs of made-up rooms (`slgaussian.datasets.procedural`) have exact ids. They get the depth
that the plane sweep predicts, as in a run, at 416 x 576. An object counts if both views see it in
100 common pixels or more. The columns are:

- *matched*: the share of objects that have the same main id in both views;
- *things*: the same without walls and ceiling;
- *alone*: the same, if also no other object has that main id;
- *IoU*: of an object in the second view with the id that it has in the first;
- *pieces*: how many ids hold 5 % of an object or more in a view;
- *pixels*: the share of an object's common pixels whose ids agree;
- *whole*, *track*: processor seconds for a pair, with proposals and without.

![{PAIRS}](masks.jpg)

Two pairs, 0.3 m and 1.6 m apart: photographs, true ids, ids by `geometric`, ids by `flow`. One
colour is one id, black none.

**Where copies help, and where not.** {copies_help(rows["copies"])}

![{CHART}](masks.svg)

{tables}"""


def copies_help(rows: list[dict]) -> str:
    """What the table of copies says, in sentences."""
    of = {(row["tracker"], row["copies"]): row for row in rows}

    same = [t for t in ("geometric", "flow") if _same(of[t, 1], of[t, 5])]
    told = " and ".join(f"`{tracker}`" for tracker in same)
    kept = (
        f"With {told} five copies give the same as one, to the last digit. They return remembered "
        "labels for a remembered image, so a vote has nothing to decide. The further copies are "
        "not computed, and five cost as much as one. "
        if same
        else ""
    )
    one, three, five, seven = (of["noisy", copies] for copies in (1, 3, 5, 7))
    return (
        f"{kept}With a tracker that is noisy, pixels go from {one['pixels']:.3f} with one copy to "
        f"{three['pixels']:.3f} with three, {five['pixels']:.3f} with five and "
        f"{seven['pixels']:.3f} with seven, and matched goes from {one['matched']:.3f} to "
        f"{five['matched']:.3f} with five. A single look loses a fifth of the image, so more "
        "copies give a better vote. But the first copy of a view is its detection: carried labels "
        "joined with fresh proposals. The detection alone is better than the vote. Copies help "
        "only with a tracker that segments a remembered image better than the detection, and none "
        "of these does. Five, the number of the paper, stays the default, because it costs nothing "
        "where it changes nothing."
    )


def _same(a: dict, b: dict) -> bool:
    return all(a[key] == b[key] for key in ("matched", "alone", "iou", "pieces", "pixels"))
