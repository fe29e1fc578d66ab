"""Masks measured, as a page.

    python -m benches.masks.mask_quality [DATA] [-o docs/measured]

Proposals that fit objects (``proposal_fit.py``), ids that agree across views
(``id_consistency.py``), and the suppression of overlapping masks (``mask_nms_cost.py``): about half
an hour with 50 pairs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benches.common.pages import publish
from benches.common.photograph_pairs import DATA_HELP, labelled
from benches.masks import id_consistency, mask_nms_cost, proposal_fit
from benches.masks.mask_chart import chart, pairs_picture

KEYS = {
    "trackers": ("tracker", "proposals", "way"),
    "baselines": ("tracker", "baseline"),
    "overlaps": ("tracker", "overlap"),
    "copies": ("tracker", "copies"),
    "labelled_pairs": ("tracker",),
}


def rows_of(table: str, cells: id_consistency.Cells) -> list[dict]:
    named = [dict(zip(KEYS[table], key, strict=True)) | cells[key].row() for key in cells]
    by = KEYS[table][1:] if table not in ("trackers", "labelled_pairs") else ()
    return sorted(named, key=lambda row: (row["tracker"], *(row[key] for key in by)))


def unchanged(copies: list[dict]) -> list[str]:
    """Trackers for which five copies give the same as one, to the last digit."""
    keys = ("matched", "alone", "iou", "pieces", "pixels")
    found = {(row["tracker"], row["copies"]): [row[key] for key in keys] for row in copies}
    return ["`geometric`"] if found["geometric", 1] == found["geometric", 5] else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=labelled, nargs="?", help=f"{DATA_HELP}, and labels/")
    parser.add_argument("--pairs", type=int, default=50, help="of made-up rooms")
    parser.add_argument("-o", "--out", type=Path, help="folder for masks.md, .svg and .jpg")
    parser.add_argument("--look", type=Path, help="picture of the pairs of DATA with their ids")
    given = parser.parse_args()
    rows: dict[str, list[dict]] = {}
    for so_far in id_consistency.procedural_cells(given.pairs):
        tables, pictured = so_far
        done = tables["trackers"]["geometric", "regions", "forth"]
        print(f"pair {len(done.seconds)} of {given.pairs}: {done.row()}", flush=True)
    rows |= {table: rows_of(table, cells) for table, cells in tables.items()}
    rows["regions"] = proposal_fit.procedural_rows()
    if given.data:
        cells, looked_at = id_consistency.labelled_cells(given.data)
        rows["labelled_pairs"] = rows_of("labelled_pairs", cells)
        found, rows["categories"] = proposal_fit.labelled_rows(given.data)
        rows["regions"] += found
        if given.look:
            pairs_picture(list(looked_at.values())).save(given.look)
    rows["nms"] = list(mask_nms_cost.rows())
    words = [
        "python -m benches.masks.mask_quality",
        *["DATA"] * bool(given.data),
        f"--pairs {given.pairs}",
    ]
    command = " ".join([*words, "-o docs/measured"])
    publish(
        "masks/masks.md.j2",
        given.out and given.out / "masks.md",
        rows=rows,
        pairs=given.pairs,
        command=command,
        unchanged=unchanged(rows["copies"]),
    )
    if given.out:
        (given.out / "masks.svg").write_bytes(chart(rows))
        pairs_picture(list(pictured.values())).save(given.out / "masks.jpg", quality=85)


if __name__ == "__main__":
    main()
