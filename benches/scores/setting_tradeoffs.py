"""Speed against error, setting by setting: `slgaussian tradeoffs` on scenes that are known.

    python -m benches.scores.setting_tradeoffs DATA [--office 8] [--rooms 100-103] [-o FOLDER]

DATA holds ``office``. The presets are picked among the rows by a rule that the page states. Runs
with the same ``--store`` do not compute again what is there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from flows.labelled import labelled_scenes
from flows.room_scenes import room_scene, seeds
from flows.runners.commands import perform
from flows.settings import Settings
from flows.sweep import SEED
from flows.tradeoff_settings import make_tradeoff_settings
from slgaussian.benchmark.tradeoffs import Weighed, charts
from slgaussian.storage.store import write_atomic

KEPT_SHARE = 0.85
"""Of the defaults' IoU and mIoU, what the preset `fast` may keep at least."""

NAMESPACE = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
PLOTS = "tradeoffs.svg", "tradeoffs-memory.svg"


def fast(weighed: list[Weighed]) -> Weighed:
    """The quickest row that keeps enough of what the first one finds."""
    first, *others = (one for one in weighed if one.factor != SEED)
    good = [
        one
        for one in others
        if all(one.scores[name] >= KEPT_SHARE * first.scores[name] for name in ("iou", "miou"))
    ]
    return min(good, key=lambda one: one.whole, default=first)


def main() -> None:
    """Sweep, and write the page."""
    about = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    about.add_argument("data", type=data_folder("office"))
    about.add_argument("--office", type=int, default=8, help="so many of its pairs, evenly")
    about.add_argument("--rooms", default="100-103", help="seeds of made-up rooms")
    about.add_argument("--store", type=Path, default=None)
    about.add_argument("-o", dest="out", type=Path, default=None)
    given = about.parse_args()
    folder = given.data / "office"
    asked = Settings(data=folder, pairs=folder / "pairs.json", labels=folder / "labels")
    pairs = labelled_scenes(asked)[0]
    pairs = pairs[:: max(1, len(pairs) // given.office)][: given.office]
    rooms = [room_scene(seed) for seed in seeds(given.rooms, "--rooms")]
    with tempfile.TemporaryDirectory() as folder_of_run:
        out = Path(folder_of_run)
        values = {
            "scenes": [*pairs, *rooms],
            "store": str(given.store or out / "store"),
            "out": out / "out",
        }
        made = perform("tradeoffs", make_tradeoff_settings(values))
        text = (values["out"] / "tradeoffs.md").read_text()
    _, _, table = text.partition("\n- Error ")
    publish(
        "scores/tradeoffs.md.j2",
        given.out and given.out / "tradeoffs.md",
        command=f"python -m benches.scores.setting_tradeoffs DATA --office {len(pairs)} "
        f"--rooms {given.rooms}",
        office=[scene.name for scene in pairs],
        rooms=len(rooms),
        first=made.weighed[0],
        fast=fast(made.weighed),
        kept_share=KEPT_SHARE,
        table=f"- Error {table}",
    )
    if given.out is not None:
        drawn = list(charts(made.weighed, made.proposal).values())
        for name, svg in zip(PLOTS, drawn, strict=False):
            write_atomic(given.out / name, svg.replace("<svg", f"<svg {NAMESPACE}", 1).encode())


if __name__ == "__main__":
    sys.exit(main())
